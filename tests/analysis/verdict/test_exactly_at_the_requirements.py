"""Verdicts on figures that lie exactly at a limit of the requirements."""

from __future__ import annotations

import math
from typing import Any

import pytest

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import (
    Requirements,
    cost_ratio,
    is_right,
    is_right_to_the_end,
    survived,
)
from dpbench.analysis.verdict.verdict import verdicts_of

LIMIT = 0.0078125
"""Limit of `error_move`: 2⁻⁷, which every table stores exactly."""
BEYOND = math.nextafter(LIMIT, 1.0)
REQUIREMENTS = Requirements(error_move=LIMIT, failed_steps=2)


def only_run(records: Any) -> RunRecord:
    """Return the only run of the records."""
    (run,) = records.view().runs
    assert isinstance(run, RunRecord)
    return run


@pytest.mark.parametrize(("error", "right"), [(LIMIT, True), (BEYOND, False), (math.inf, False)])
@pytest.mark.parametrize("mode", ["loop", "replay"])
def test_an_error_at_the_requirements_is_right(
    mode: str, error: float, right: bool, records: Any
) -> None:
    getattr(records, mode)("daqp", error=error)
    assert is_right(only_run(records), REQUIREMENTS) is right


@pytest.mark.parametrize(("failed", "right"), [(2, True), (3, False)])
def test_as_many_failed_steps_as_allowed_are_right(failed: int, right: bool, records: Any) -> None:
    records.loop("daqp", failed=failed)
    assert is_right(only_run(records), REQUIREMENTS) is right


@pytest.mark.parametrize(
    ("loop", "replay", "state"),
    [
        ({"error": LIMIT}, {"error": LIMIT}, "pass"),
        ({"error": BEYOND}, {}, "fail"),
        ({}, {"error": BEYOND}, "fail"),
        ({"failed": 2}, {"failed": 2}, "pass"),
        ({"failed": 3}, {}, "fail"),
        ({}, {"failed": 3}, "fail"),
    ],
)
def test_the_verdict_of_figures_at_the_requirements(
    loop: dict[str, Any], replay: dict[str, Any], state: str, records: Any
) -> None:
    records.loop("daqp", **loop)
    records.replay("daqp", **replay)
    (verdict,) = verdicts_of(records.view(), REQUIREMENTS).references
    assert verdict.state == state
    assert bool(verdict.causes) is (state == "fail")


def test_a_stopped_loop_is_not_right_to_the_end(records: Any) -> None:
    """A loop stopped after its last step is right, but not right to the end."""
    records.loop("daqp", outcome="timed_out")
    assert is_right(only_run(records), REQUIREMENTS)
    assert not is_right_to_the_end(only_run(records), REQUIREMENTS)


@pytest.mark.parametrize(
    ("cost", "violations", "kept"),
    [(88.0, 0.0, True), (88.001, 0.0, False), (80.0, 1.0, False), (72.0, 0.0, True)],
)
def test_a_loop_survives_within_a_tenth_of_the_exact_cost(
    cost: float, violations: float, kept: bool, records: Any
) -> None:
    """A cost of exactly 1.1 times the exact cost survives; a violated limit does not."""
    figures = {"closed_loop_cost": cost, "exact_cost": 80.0, "limit_violations": violations}
    records.loop("daqp", **figures)
    assert survived(only_run(records)) is kept
    assert cost_ratio(only_run(records)) == cost / 80.0
