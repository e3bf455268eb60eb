"""Findings and requirements without a result folder."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from dpbench.analysis.verdict.findings import (
    DOUBTS,
    LATE,
    MISSED,
    NEAR,
    OWN_DOING,
    STATES,
    worst_first,
)
from dpbench.analysis.verdict.requirements import Requirements, cost_ratio, is_right, survived


def test_the_worst_run_is_first_and_the_others_keep_their_order() -> None:
    """Of two equal figures the first is the worst; without a run there is no finding."""
    runs: list[Any] = [
        SimpleNamespace(name=n, x=x) for n, x in zip("abcd", (2, 5, 1, 5), strict=True)
    ]
    (found,) = worst_first("failed", runs, lambda run: float(run.x))
    assert [run.name for run in found.runs] == ["b", "a", "c", "d"]
    assert (found.kind, found.value, found.steps) == ("failed", 5.0, 0)
    assert math.isnan(found.machine)
    assert worst_first("failed", [], lambda run: 0.0) == []


def test_verdicts_are_ordered_from_best_to_worst() -> None:
    """What something contradicts is late or fails; a crash fails, a hang is late."""
    assert MISSED == ("late", "fail")
    assert STATES == ("pass", "borderline", "inconclusive", "late", "fail", "not run")
    assert [kind in LATE for kind in OWN_DOING] == [False, True]
    assert not {*DOUBTS} & {*NEAR} and not {*LATE} & {*DOUBTS, *NEAR}


def test_the_requirements_of_a_suite() -> None:
    """Entries replace the defaults, unknown ones are ignored, limits are in ns as well."""
    assert Requirements.of({}) == Requirements(1e-2, 0, 3.0, 300.0)
    found = Requirements.of(
        {"requirements": {"p99_ms": 2.0, "deadline_ms": 50.0, "failed_steps": 1, "x": 1}}
    )
    assert found == Requirements(1e-2, 1, 2.0, 50.0)
    assert (found.p99_ns, found.deadline_ns) == (2e6, 5e7)


@pytest.mark.parametrize(
    ("columns", "right"),
    [
        ({}, True),
        ({"outcome": "timed_out"}, True),
        ({"outcome": "invalid"}, False),
        ({"done": 119}, False),
        ({"loop_ratio": 40.0}, False),
        ({"error": math.nan}, False),
    ],
)
def test_a_run_is_right_with_all_steps_and_no_memory(
    records: Any, columns: dict[str, Any], right: bool
) -> None:
    records.loop("daqp", **columns)
    (run,) = records.view().runs
    assert is_right(run, Requirements()) is right


@pytest.mark.parametrize(("done", "ratio"), [(119, None), (120, 1.5), (121, 1.5)])
def test_the_cost_of_a_complete_loop(records: Any, done: int, ratio: float | None) -> None:
    columns = {"closed_loop_cost": 3.0, "exact_cost": 2.0, "limit_violations": 0}
    records.loop("daqp", steps=120, done=done, **columns)
    (run,) = records.view().runs
    found = cost_ratio(run)
    assert math.isnan(found) if ratio is None else found == ratio
    assert not survived(run)
