"""Which commit of dpbench made a run: from its git checkout, or from what an installer noted."""

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
    """The revision of the running package."""
    return checked_out(Path(__file__).parents[2]) or installed()


def checked_out(package: Path) -> Revision:
    """The revision of a package that lies in a git checkout, and is a part of it."""
    commit = _git(package, "rev-parse", "HEAD")
    # An environment may lie in the checkout of another project, which ignores it.
    part = _git(package, "ls-files", "--error-unmatch", "__init__.py")
    changes = _git(package, "status", "--porcelain", "--", ".")
    if commit is None or part is None or changes is None:
        return {}
    return {"commit": commit, "clean": changes == ""}


def installed() -> Revision:
    """The commit that dpbench was installed from, as its installer noted it (PEP 610)."""
    try:
        noted = importlib.metadata.distribution("dpbench").read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return {}
    commit = json.loads(noted or "{}").get("vcs_info", {}).get("commit_id")
    return {} if commit is None else {"commit": str(commit), "clean": True}


def revisions(earlier: list[Revision], now: Revision) -> list[Revision]:
    """All revisions that cells of a folder were run with, the latest last."""
    return [*(one for one in earlier if one != now), *([now] if now else [])]


def revision_text(suite: SuiteDescription) -> str:
    """The revisions that `suite.json` names, in words; empty where it names none."""
    named = [
        f"{one['commit'][:12]}{'' if one['clean'] else ' with changes'}"
        for one in suite.get("revisions", [])
    ]
    return f"commit {', '.join(named)}" if named else ""


def made_by(suite: SuiteDescription) -> str:
    """The dpbench that made a run, by what `suite.json` says: its version and revisions."""
    version = f"dpbench {suite.get('harness_version', '')}"
    return ", ".join(filter(None, (version, revision_text(suite))))


def _git(folder: Path, *words: str) -> str | None:
    """What git says in a folder; None where it is missing or fails."""
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
