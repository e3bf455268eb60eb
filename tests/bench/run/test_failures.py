"""Reports of a solver's failures in a run."""

import pytest

from dpbench.bench.run.timed_solver import list_failure_descriptions


@pytest.mark.parametrize(
    ("counts", "output"),
    [
        ({}, []),
        ({"inaccurate": 10, "maximum": 16}, ["16 × maximum", "10 × inaccurate"]),
        (
            {"a": 1, "b": 5, "c": 2, "d": 4, "e": 1},
            ["5 × b", "4 × d", "2 × c", "2 × other words"],
        ),
    ],
)
def test_failures_are_counted_by_their_words(counts: dict[str, int], output: list[str]) -> None:
    assert list_failure_descriptions(counts) == output
