"""Git commit of a package and the file in which a build keeps it.

The build of a wheel loads this module alone: it imports the standard library only.
"""

import json
import subprocess
from pathlib import Path

BUILT_COMMIT = "built_commit.json"
"""File of an installed package with the commit that it was built from."""
WAIT_S = 10.0


def read_commit(package: Path) -> tuple[str, bool] | None:
    """Return a package's git commit and whether its files are unchanged; None if unknown."""
    commit = run_git(package, "rev-parse", "HEAD")
    # An environment may lie in the checkout of another project, which ignores it.
    part = run_git(package, "ls-files", "--error-unmatch", "__init__.py")
    changes = run_git(package, "status", "--porcelain", "--", ".")
    if commit is None or part is None or changes is None:
        return None
    return commit, changes == ""


def write_built_commit(folder: Path, commit: str, *, is_clean: bool) -> Path:
    """Write the commit that a package is built from into a folder; return the file."""
    file = folder / BUILT_COMMIT
    file.write_text(json.dumps({"commit": commit, "clean": is_clean}), encoding="utf-8")
    return file


def read_built_commit(package: Path) -> tuple[str, bool] | None:
    """Return the commit that an installed package was built from, and whether it was unchanged."""
    try:
        built = json.loads((package / BUILT_COMMIT).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return str(built["commit"]), bool(built["clean"])


def run_git(folder: Path, *words: str) -> str | None:
    """Return the output of a git command in a folder; None where git is missing or fails."""
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
