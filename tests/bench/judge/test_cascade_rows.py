"""Rows of a step that solves two QPs."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, open_workspace, run_closed_loop
from dpbench.bench.judge.rows import (
    join_cascade_steps,
    make_run_row,
    make_step_columns,
    make_step_rows,
    sum_step_times_ns,
)
from dpbench.bench.judge.rules import StepColumns, compute_first_move_errors, mask_failed_steps
from dpbench.bench.record.cell import Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.record.schema import MISSING_INT
from dpbench.solvers.table import Availability
from tests.bench.judge.known_runs import judged_loop

STEPS, BAD = 20, 5


def judged(units: str = "scaled", spoil: Any = None) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Steps and run of a short cascade by daqp, its log changed by `spoil` before it is judged."""
    evaluated, _, cell = judged_loop(spoil, "thrusters_cascade", units, STEPS)
    steps = make_step_columns(cell, evaluated)
    outcome = Outcome("finished", "", "dense", 30, 30)
    rows = make_step_rows("run", steps)
    return rows, make_run_row("run", cell, outcome, Availability(True), "", evaluated, steps)


def test_both_qps_are_timed_together_and_apart() -> None:
    logs: list[RawLog] = []
    steps, run = judged(spoil=logs.append)
    log = logs[0]
    assert log.allocation is not None
    second = steps["allocation_ns"]
    pairs = ((log.times, steps["total_ns"] - second), (log.allocation.times, second))
    for times, column in pairs:
        assert column.tolist() == np.maximum(times[0, :, 1:5], 0).sum(axis=1).tolist()
    assert steps["solve_ns"].tolist() == log.times[0, :, 3].tolist()
    assert run["setup_once_ns"] == log.setup_once_ns[0] + log.allocation.setup_once_ns[0]


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_a_right_cascade_is_right(units: str) -> None:
    steps, run = judged(units)
    assert steps["true"].all() and steps["claimed"].all()
    assert (run["failed_steps"], run["claimed_not_true"], run["uncertified"]) == (0, 0, 0)
    assert steps["allocation_error"].max() < 1e-6
    assert 0.0 < run["undelivered_share"] == steps["undelivered_share"].max() < 1e-4
    assert run["limit_violations"] == 0.0
    assert run["thrust_share"] > 0.0


def test_a_wrong_allocation_makes_its_step_wrong() -> None:
    def spoil(log: RawLog) -> None:
        assert log.allocation is not None
        log.allocation.z[0, BAD, 2] += 0.05

    steps, run = judged(spoil=spoil)
    assert steps.index[~steps["true"]].tolist() == [BAD]
    assert steps["allocation_error"][BAD] == pytest.approx(0.05, rel=1e-6)
    assert steps["error_move"].max() < 1e-6
    assert run["claimed_not_true"] == 1
    assert run["error_move_max"] == pytest.approx(0.05, rel=1e-6)


def test_the_baseline_law_allocates_by_the_pseudo_inverse() -> None:
    case = load_scenario("thrusters_cascade").truncate(STEPS)
    steps = run_closed_loop(case, open_workspace("unconstrained_clipped"), formulation="none").steps
    assert steps["allocation_ns"].isna().all()
    assert steps["allocation_error"].isna().all()
    # Until the first limit acts, what is delivered is what is demanded.
    assert steps["undelivered_share"][0] < 1e-12
    assert np.hypot(steps["n_m"], steps["e_m"]).max() < 0.5


def answers(**changes: list[Any]) -> StepColumns:
    """Columns of five solved and certified QPs, some of them changed."""
    facts: dict[str, Any] = dict.fromkeys(("claimed", "true", "true_1e4", "true_1e6"), True)
    facts |= {"status": "SOLVED", "certificate": "linear", "error_move": 0.1}
    facts |= {
        "setup_ns": MISSING_INT,
        "update_ns": MISSING_INT,
        "solve_ns": 7,
        "read_ns": 3,
        "waited_ns": 4,
    }
    facts |= {"fallback": False, "unconverged": False}
    columns = {name: [fact] * 5 for name, fact in facts.items()}
    return {name: np.array(column) for name, column in (columns | changes).items()}


def test_a_step_is_as_good_as_the_worse_of_its_answers() -> None:
    """Five steps: both right; second wrong; second without an answer; first infeasible, second
    right; first infeasible, second without an answer."""
    first = answers(
        status=["SOLVED"] * 3 + ["PRIMAL_INFEASIBLE"] * 2,
        claimed=[True] * 3 + [False] * 2,
        certificate=["linear"] * 3 + ["infeasible"] * 2,
    )
    second = answers(
        status=["SOLVED", "SOLVED", "ERROR", "SOLVED", "ERROR"],
        claimed=[True, True, False, True, False],
        true=[True, False, False, True, False],
        error_move=[0.05, 0.7, np.inf, 0.2, np.inf],
    )
    steps = join_cascade_steps(first, second)
    assert steps["claimed"].tolist() == [True, True, False, False, False]
    assert steps["true"].tolist() == [True, False, False, True, False]
    assert steps["status"].tolist() == ["SOLVED", "SOLVED", "ERROR", "PRIMAL_INFEASIBLE", "ERROR"]
    assert steps["certificate"].tolist() == ["linear"] * 3 + ["infeasible", "linear"]
    assert (
        sum_step_times_ns(steps).tolist() == [20] * 5
        and steps["allocation_ns"].tolist() == [10] * 5
    )
    assert steps["waited_ns"].tolist() == [8] * 5
    assert compute_first_move_errors(steps).tolist() == [0.1, 0.7, np.inf, 0.2, np.inf]
    # The loop falls back where either has no answer: a right claim of infeasibility is no failure.
    steps["fallback"] = np.array([False, False, True, True, True])
    assert mask_failed_steps(steps).tolist() == [False, False, True, False, True]


@pytest.mark.parametrize("certificate", ["none", "undecided"])
def test_what_is_not_known_of_either_qp_is_not_known_of_the_step(certificate: str) -> None:
    unknown = answers(certificate=[certificate, *["linear"] * 4])
    for pair in ((unknown, answers()), (answers(), unknown)):
        assert join_cascade_steps(*pair)["certificate"].tolist() == [certificate, *["linear"] * 4]
