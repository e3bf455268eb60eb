"""The worked examples at the head of the modules: what they say a hand computes, the code computes.

A module takes part by having an example; the kernels that are hard to read must have one.
"""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "dpbench"
EXPLAINED = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    for path in PACKAGE.rglob("*.py")
    if "\n>>> " in path.read_text(encoding="utf-8")
)
HARD = {
    "dpbench.qp.referee.kernels",
    "dpbench.qp.referee.nearby",
    "dpbench.qp.referee.rational",
    "dpbench.qp.referee.referee",
    "dpbench.ship.estimation.kalman",
    "dpbench.solvers.own.active_set.kernel",
    "dpbench.solvers.own.hildreth",
    "dpbench.solvers.own.exact_point",
}


@pytest.mark.parametrize("name", EXPLAINED)
def test_the_examples_of_a_module_are_true(name: str) -> None:
    """Every line of an example gives what stands below it."""
    outcome = doctest.testmod(import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0


def test_the_hard_kernels_have_an_example() -> None:
    """None of them has lost its own."""
    assert set(EXPLAINED) >= HARD
