"""The lists of `make mutants` fit the code: its targets, and the lines of equivalent mutants."""

import subprocess
import sys
import tomllib

import pytest

from tests.mutants import EQUIVALENT, ROOT, TARGETS

ENTRIES = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["equivalent"]


@pytest.mark.parametrize(("target", "tests"), TARGETS.items())
def test_targets_and_their_tests_exist(target: str, tests: str) -> None:
    """A file or package, and what must fail where a fault is planted in it."""
    assert (ROOT / target).exists() and (ROOT / tests).exists()


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["mutant"])
def test_an_equivalent_mutant_is_of_a_line_that_exists(entry: dict[str, str]) -> None:
    """Remove the entry, or correct it, where the line has changed; each has a reason."""
    lines = (ROOT / entry["file"]).read_text(encoding="utf-8").splitlines()
    assert entry["line"] in map(str.strip, lines)
    assert entry["mutant"] != entry["line"]
    assert entry["reason"].endswith(".")


PLANT = """
from tests.mutants import ROOT, Mutant, _outcome
path = ROOT / "dpbench/bench/progress.py"
text = path.read_text(encoding="utf-8")
for one in (text, text.replace('f"dpbench: ', 'f"')):
    mutant = Mutant("", path, one, 1, "", "")
    print(_outcome(100.0, ["tests/bench/test_progress.py"], mutant), flush=True)
"""


@pytest.mark.slow
def test_a_fault_is_planted_in_what_the_tests_import() -> None:
    """Pytest rewrites all modules of a package with plug-ins, and would read the original."""
    done = subprocess.run(
        [sys.executable, "-c", PLANT], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["survived", "killed"]
