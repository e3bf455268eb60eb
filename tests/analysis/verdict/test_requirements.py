"""Requirements and findings, and figures that lie exactly at a limit."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.requirements import (
    DOUBTS,
    LATE,
    MISSED,
    NEAR,
    OWN_DOING,
    STATES,
    Requirements,
    compute_cost_ratio,
    has_survived,
    is_right_on_every_step,
    is_right_to_the_end,
    make_finding_on_worst_runs,
)
from dpbench.analysis.verdict.verdict import judge_solvers

LIMIT = 0.0078125
"""Limit of `error_move`: 2⁻⁷, which every table stores exactly."""
BEYOND = math.nextafter(LIMIT, 1.0)
NEVER_FEASIBLE = {"error": math.nan, "infeasible_steps": 120}
REQUIREMENTS = Requirements(error_move=LIMIT, failed_steps=2)


def only_run(records: Any) -> RunRecord:
    """Return the only run of the records."""
    (run,) = records.view().runs
    assert isinstance(run, RunRecord)
    return run


@pytest.mark.parametrize("mode", ["loop", "replay"])
@pytest.mark.parametrize(
    ("columns", "right"),
    [
        ({}, True),
        ({"error": LIMIT}, True),
        ({"error": BEYOND}, False),
        ({"error": math.inf}, False),
        ({"error": math.nan}, False),
        ({**NEVER_FEASIBLE, "true_share": 1.0}, True),
        ({**NEVER_FEASIBLE, "true_share": 0.99}, False),
        ({**NEVER_FEASIBLE, "true_share": 1.0, "done": 119}, False),
        ({**NEVER_FEASIBLE, "true_share": 1.0, "uncertified": 1}, False),
        ({**NEVER_FEASIBLE, "true_share": 1.0, "undecided_steps": 1}, False),
        ({"failed": 2}, True),
        ({"failed": 3}, False),
        ({"outcome": "timed_out"}, True),
        ({"outcome": "invalid"}, False),
        ({"done": 119}, False),
        ({"loop_ratio": 40.0}, False),
    ],
)
def test_a_run_is_right_with_all_steps_within_the_limits_and_no_memory(
    mode: str, columns: dict[str, Any], right: bool, records: Any
) -> None:
    getattr(records, mode)("daqp", **columns)
    assert is_right_on_every_step(only_run(records), REQUIREMENTS) is right


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
    (verdict,) = judge_solvers(records.view(), REQUIREMENTS).verdicts_on_references
    assert verdict.state == state
    assert bool(verdict.causes) is (state == "fail")


def test_a_stopped_loop_is_not_right_to_the_end(records: Any) -> None:
    records.loop("daqp", outcome="timed_out")
    assert is_right_on_every_step(only_run(records), REQUIREMENTS)
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
    assert has_survived(only_run(records)) is kept
    assert compute_cost_ratio(only_run(records)) == cost / 80.0


def test_the_worst_run_is_first_and_the_others_keep_their_order() -> None:
    runs: list[Any] = [
        SimpleNamespace(solver_label=n, x=x, exact_left_s=math.nan)
        for n, x in zip("abcd", (2, 5, 1, 5), strict=True)
    ]
    (found,) = make_finding_on_worst_runs("failed", runs, lambda run: float(run.x))
    assert [run.solver_label for run in found.runs] == ["b", "a", "c", "d"]
    assert (found.kind, found.value, found.steps) == ("failed", 5.0, 0)
    assert math.isnan(found.machine)
    assert make_finding_on_worst_runs("failed", [], lambda run: 0.0) == []


def test_a_run_with_a_lost_ship_comes_after_the_worst_with_a_ship_on_station() -> None:
    """Its ship leaves whatever the solver; where all ships leave, the worst is first."""
    names, errors, left_s = "abc", (9.0, 2.0, 3.0), (120.0, math.nan, math.nan)
    runs: list[Any] = [
        SimpleNamespace(solver_label=n, x=x, exact_left_s=at)
        for n, x, at in zip(names, errors, left_s, strict=True)
    ]
    (found,) = make_finding_on_worst_runs("inaccurate", runs, lambda run: float(run.x))
    assert [run.solver_label for run in found.runs] == ["c", "a", "b"] and found.value == 3.0
    (alone,) = make_finding_on_worst_runs("inaccurate", runs[:1], lambda run: float(run.x))
    assert alone.value == 9.0


def test_verdicts_are_ordered_from_best_to_worst() -> None:
    assert MISSED == ("late", "fail")
    assert STATES == ("pass", "borderline", "inconclusive", "late", "fail", "not run")
    assert [kind in LATE for kind in OWN_DOING] == [False, True]
    assert not {*DOUBTS} & {*NEAR} and not {*LATE} & {*DOUBTS, *NEAR}


def test_the_requirements_of_a_suite() -> None:
    assert Requirements.from_suite({}) == Requirements(1e-2, 0, 3.0, 300.0)
    found = Requirements.from_suite(
        {"requirements": {"p99_ms": 2.0, "deadline_ms": 50.0, "failed_steps": 1, "x": 1}}
    )
    assert found == Requirements(1e-2, 1, 2.0, 50.0)
    assert (found.p99_ns, found.deadline_ns) == (2e6, 5e7)


@pytest.mark.parametrize(("done", "ratio"), [(119, None), (120, 1.5), (121, 1.5)])
def test_the_cost_of_a_complete_loop(records: Any, done: int, ratio: float | None) -> None:
    columns = {"closed_loop_cost": 3.0, "exact_cost": 2.0, "limit_violations": 0}
    records.loop("daqp", steps=120, done=done, **columns)
    (run,) = records.view().runs
    found = compute_cost_ratio(run)
    assert math.isnan(found) if ratio is None else found == ratio
    assert not has_survived(run)
