"""Newer releases of the installed solvers, as the package index of pip has them.

One call of pip resolves all distributions without installing anything. It reads the metadata of
newer wheels alone, for this Python and this machine. Without an index pip finds nothing newer
either, so a second call then looks for a distribution that every index of packages has.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata

from packaging.utils import canonicalize_name

from dpbench.solvers.table import TABLE

_PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "--quiet")
_RESOLVE = ("install", "--dry-run", "--upgrade", "--no-deps", "--only-binary", ":all:")
_IMPATIENT = ("--retries", "0", "--timeout", "3", "--report", "-")
_PROBE = ("--ignore-installed", "qpsolvers")
"""Arguments with which the resolution fails where no index answers: a small wheel, required."""


@dataclass(frozen=True)
class Release:
    """A newer release of a distribution, and the solvers of the table that it brings."""

    distribution: str
    installed: str
    newest: str
    solvers: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.distribution} {self.newest} (installed: {self.installed})"


def list_installed_distributions() -> dict[str, str]:
    """Return the installed version of each distribution with a solver of the table."""
    names = dict.fromkeys(row.distribution for row in TABLE.values() if row.distribution)
    found: dict[str, str] = {}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def find_newer_releases(timeout_s: float) -> list[Release] | None:
    """Return newer releases of installed solvers; None if pip or its index does not answer.

    timeout_s : the longest wait for each of two calls of pip [s].
    """
    installed = list_installed_distributions()
    try:
        answer = _resolve_newest_with_pip(list(installed), timeout_s)
        newest = {
            canonicalize_name(item["metadata"]["name"]): str(item["metadata"]["version"])
            for item in json.loads(answer)["install"]
        }
        if not newest:
            _resolve_newest_with_pip(_PROBE, timeout_s)
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        return None
    return [
        Release(
            name,
            version,
            newest[canonicalize_name(name)],
            tuple(row.name for row in TABLE.values() if row.distribution == name),
        )
        for name, version in installed.items()
        if newest.get(canonicalize_name(name), version) != version
    ]


def _resolve_newest_with_pip(names: Sequence[str], timeout_s: float) -> str:
    """Return pip's installation report of what an upgrade of `names` would install, as JSON.

    CalledProcessError where pip fails; TimeoutExpired after `timeout_s`.
    """
    command = [*_PIP, *_RESOLVE, *_IMPATIENT, *names]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=True)
    return done.stdout
