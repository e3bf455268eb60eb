"""The lists of `make mutants` fit the code: its targets, and the lines of equivalent mutants."""

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
