"""Newer releases of the solvers, and what the conformance tests say of them.

`make outdated` lists them. Each newer release is installed into an environment of its own in
`build/outdated/`, which finds everything else in the one that calls; its solvers' tests run there.
Exit code: 0 all pass, or nothing is newer; 1 a test fails; 2 the package index does not answer.
"""

import argparse
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from dpbench.solvers.releases import Release, find_newer_releases

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "outdated"
PATIENCE_S = 300.0


def make_environment(folder: Path) -> Path:
    """Return the Python of a new environment that also sees the packages of this one."""
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    purelib = sysconfig.get_path("purelib", "venv", {"base": str(folder), "platbase": str(folder)})
    Path(purelib, "beneath.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin" / "python"


def run_conformance_tests(release: Release) -> str:
    """Return the last line of the tests of a release's solvers; its full output is stored."""
    folder = FOLDER / release.distribution
    python = make_environment(folder)
    wanted = f"{release.distribution}=={release.newest}"
    pip = [python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", wanted]
    done = subprocess.run(pip, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        tests = [python, "-m", "pytest", "-q", "-m", "not alone", "tests/solvers"]
        # The pins of the repository are not those of a release that is tried.
        chosen = " or ".join(release.solvers)
        command = [*tests, "-k", chosen, "-p", "no:cacheprovider"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    text = done.stdout + done.stderr
    (folder / "output.txt").write_text(text, encoding="utf-8")
    last = next((line for line in reversed(text.splitlines()) if line.strip()), "no output")
    return last.strip("= ")


def main(arguments: list[str] | None = None) -> int:
    """List newer releases and test them; return the exit code."""
    parser = argparse.ArgumentParser(prog="make outdated", description=__doc__)
    parser.add_argument("--list", action="store_true", help="only list them")
    only_list: bool = parser.parse_args(arguments).list
    releases = find_newer_releases(PATIENCE_S)
    if releases is None:
        print("the package index does not answer")
        return 2
    failed = 0
    for release in releases:
        print(release, end="" if not only_list else "\n", flush=True)
        if only_list:
            continue
        result = run_conformance_tests(release)
        failed += "failed" in result or "error" in result.lower() or "passed" not in result
        print(f": {result} ({FOLDER.relative_to(ROOT)}/{release.distribution}/output.txt)")
    if not releases:
        print("no solver has a newer release")
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
