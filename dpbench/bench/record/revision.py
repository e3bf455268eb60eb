"""The commit of dpbench that made a run: from its git checkout, or from its installer."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from dpbench.bench.record.descriptions import SuiteDescription

Revision = dict[str, Any]
"""`commit`, the full hash, and `clean`: whether the files of the package were those of the commit;
empty where neither a checkout nor an installer tells."""
WAIT_S = 10.0


@cache
def revision() -> Revision:
    """Return the revision of the running package."""
    return checked_out(Path(__file__).parents[2]) or installed()


def checked_out(package: Path) -> Revision:
    """Return the revision of a package that is part of a git checkout."""
    commit = _git(package, "rev-parse", "HEAD")
    # An environment may lie in the checkout of another project, which ignores it.
    part = _git(package, "ls-files", "--error-unmatch", "__init__.py")
    changes = _git(package, "status", "--porcelain", "--", ".")
    if commit is None or part is None or changes is None:
        return {}
    return {"commit": commit, "clean": changes == ""}


def installed() -> Revision:
    """Return the commit that dpbench was installed from, as noted by its installer (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("dpbench").read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return {}
    commit = json.loads(noted or "{}").get("vcs_info", {}).get("commit_id")
    return {} if commit is None else {"commit": str(commit), "clean": True}


def revisions(earlier: list[Revision], now: Revision) -> list[Revision]:
    """Return all revisions that cells of a folder were run with, the latest last."""
    return [*(one for one in earlier if one != now), *([now] if now else [])]


def revision_text(suite: SuiteDescription) -> str:
    """Return the revisions of `suite.json` in words; "" where there are none."""
    named = [
        f"{one['commit'][:12]}{'' if one['clean'] else ' with changes'}"
        for one in suite.get("revisions", [])
    ]
    return f"commit {', '.join(named)}" if named else ""


def made_by(suite: SuiteDescription) -> str:
    """Return version and revisions of dpbench in `suite.json`."""
    version = f"dpbench {suite.get('harness_version', '')}"
    return ", ".join(filter(None, (version, revision_text(suite))))


def _git(folder: Path, *words: str) -> str | None:
    """Return the output of git in a folder; None where it is missing or fails."""
    try:
        answer = subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True,
            text=True,
            timeout=WAIT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()
