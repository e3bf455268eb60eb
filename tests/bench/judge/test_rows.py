"""The rows of both tables from a loop of six steps and a replay of three, worked by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.judge.closed_loop import Evaluated
from dpbench.bench.judge.rows import run_row, step_rows
from dpbench.bench.record.cell import Cell, Outcome, RecordedSource
from dpbench.bench.record.schema import ABSENT
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.calibration import NO_OP
from dpbench.solvers.table import Availability

NAN, INF = np.nan, np.inf
CONFIGURATION = {"solver": "x", "route": "native", "policy": "fresh", "settings": "default"}
PAPER = load_scenario("paper").files
LOOP = Cell(mode="closed_loop", scenario=PAPER, steps=9, **CONFIGURATION)
REPLAY = Cell(mode="replay", scenario=PAPER, steps=3, rounds=2, **CONFIGURATION)
ENDED = Outcome("finished", "", "dense", 15, 12)
OF_TIMING = {"setup_once_ns": np.array([0]), "matrix_updates": np.array([0])}


def loop_steps() -> dict[str, Any]:
    """Right; claimed and false; without an answer twice; infeasible; undecided."""
    steps: dict[str, Any] = {
        "repeat": [0] * 6,
        "k": range(6),
        "counts": [True] * 6,
        "status": ["SOLVED", "SOLVED", "ERROR", "TIME_LIMIT", "PRIMAL_INFEASIBLE", "SOLVED"],
        "claimed": [True, True, False, False, False, True],
        "certificate": ["linear", "gap", "none", "linear", "infeasible", "undecided"],
        "true": [True, False, False, False, True, False],
        "true_1e4": [True, False, False, False, False, False],
        "true_1e6": [False] * 6,
        "fallback": [False, False, True, True, False, True],
        "unconverged": [False, True, False, False, False, False],
        "clipped": [True, True, True, False, False, False],
        "late": [False, False, True, True, False, False],
        "error_move": [0.25, 0.5, INF, INF, NAN, 9.0],
        "error_plan": [0.5, 0.75, 3.0, 2.0, NAN, 9.0],
        "primal": [0.125, 0.0, 4.0, 2.0, 1.0, 9.0],
        "dual": [0.5, 1.0, 1.5, 2.0, 2.5, 9.0],
        "optimum_bound": [1e-13, 3e-13, INF, 2e-13, INF, INF],
        "iterations": [3, 8, ABSENT, ABSENT, 5, ABSENT],
        "total_ns": [10, 20, 30, 40, 50, 60],
        "waited_ns": [0] * 6,
        "emit_ns": [1] * 6,
        "overhead_ns": [2] * 6,
        "latency_ns": [30, 60, ABSENT, 120, 150, 180],
    }
    return {name: np.array(column) for name, column in steps.items()}


def row_of(cell: Cell, steps: dict[str, Any] | None, **changes: Any) -> dict[str, Any]:
    """The row of a cell that was judged, with a metric of its own."""
    evaluated = None if steps is None else Evaluated(OF_TIMING | changes, {"r_rms_m": 0.5})
    return run_row("a1", cell, ENDED, Availability(True), "m", evaluated, steps)


def test_what_is_said_of_the_accuracy_of_a_loop() -> None:
    """Shares are over the four steps whose right answer is known; nothing is charged for the last.

    The median of moves is the upper of 0.25, 0.5, inf and inf.
    """
    row = row_of(LOOP, loop_steps())
    assert row["claimed_share"] == 0.5
    assert (row["true_share"], row["true_1e4_share"], row["true_1e6_share"]) == (0.5, 0.25, 0.0)
    assert (row["claimed_not_true"], row["true_not_claimed"], row["failed_steps"]) == (1, 0, 3)
    assert (row["error_move_p50"], row["error_move_max"], row["error_plan_max"]) == (INF, INF, 3.0)
    assert (row["primal_max"], row["dual_max"], row["optimum_bound_max"]) == (4.0, 2.5, 3e-13)
    assert (row["uncertified"], row["undecided_steps"], row["infeasible_steps"]) == (1, 1, 1)
    assert (row["iterations_p50"], row["iterations_max"]) == (5.0, 8.0)


def test_the_median_of_moves_is_one_that_was_made() -> None:
    """Of an even number the upper one of the two in the middle; of none it is not known."""
    steps = loop_steps()
    steps["error_move"] = np.array([4.0, 1.0, 2.0, 3.0, NAN, 9.0])
    assert row_of(LOOP, steps)["error_move_p50"] == 3.0
    steps["error_move"] = np.full(6, NAN)
    assert np.isnan(row_of(LOOP, steps)["error_move_p50"])
    steps["certificate"] = np.array(["undecided"] * 6)
    assert np.isnan(row_of(LOOP, steps)["true_share"])


def test_how_a_loop_failed_and_recovered() -> None:
    """The fallback acts at steps 2, 3 and 5; two steps after the first an answer is true."""
    row = row_of(LOOP, loop_steps())
    assert (row["fallbacks"], row["fallback_longest"], row["clipped"]) == (3, 2, 3)
    assert row["unconverged"] == 1
    assert row["recover_steps_max"] is pd.NA
    steps = loop_steps()
    steps["fallback"][5] = False
    assert row_of(LOOP, steps)["recover_steps_max"] == 2
    assert (row["deadline_misses"], row["computations"]) == (2, 6)
    assert row["steps_done"] == 6 and row["r_rms_m"] == 0.5 and row["raw_max_ns"] == 60.0


def test_on_a_slow_computer_the_answers_that_were_computed_are_judged() -> None:
    """Step 2 began no computation: its fallback is no failure of an answer, and is still counted.

    Of the five that are left the third has no answer of use, by its status.
    """
    steps = loop_steps()
    steps["total_ns"][2] = ABSENT
    steps["iterations"][2] = 99
    row = row_of(replace(LOOP, slowdown=3.0, deadline_s=0.2), steps)
    assert (row["fallbacks"], row["failed_steps"], row["uncertified"]) == (3, 2, 0)
    assert (row["claimed_share"], row["iterations_max"]) == (0.6, 8.0)
    assert (row["computations"], row["deadline_s"], row["slowdown"]) == (5, 0.2, 3.0)
    # Latencies of 30, 60, 120, 150 and 180 are three times the times taken.
    assert (row["latency_p50_ns"], row["interrupted"]) == (120.0, 0)


def replay_steps(counts: list[bool]) -> dict[str, Any]:
    """A warm-up of one step, then rounds of three and two."""
    steps = {name: column[[0] * 6] for name, column in loop_steps().items()}
    steps["repeat"], steps["k"] = np.array([0, 1, 1, 1, 2, 2]), np.array([0, 0, 1, 2, 0, 1])
    steps["disturbed"] = np.zeros(6, dtype=bool)
    return steps | {"counts": np.array(counts)}


def test_a_replay_is_as_long_as_its_longest_round_that_counts() -> None:
    """Three steps, or two where only the second round counts."""
    kernels = {"reference_kernel_ns": np.ones((3, 2)), "load_kernel_ns": np.ones((3, 1, 1))}
    for rounds, steps_done in (((1, 2), 3), ((2,), 2)):
        steps = replay_steps([r in rounds for r in (0, 1, 1, 1, 2, 2)])
        row = row_of(REPLAY, steps, repeat=steps["repeat"], **kernels)
        assert (row["steps_done"], row["rounds"]) == (steps_done, len(rounds))
        assert np.isnan(row["deadline_s"]) and "fallbacks" not in row
    of_harness = row_of(replace(REPLAY, solver=NO_OP), steps, repeat=steps["repeat"], **kernels)
    assert "claimed_share" not in of_harness and of_harness["raw_samples"] == 2
    # Within its warm-up a replay has metrics and nothing else.
    row = row_of(REPLAY, replay_steps([False] * 6))
    assert row["r_rms_m"] == 0.5 and row["steps_done"] == 0 and "raw_samples" not in row


def test_a_cell_without_steps_has_its_identity_only() -> None:
    """Who it was, on which machine, what became of it, and no figure."""
    none = {name: column[:0] for name, column in loop_steps().items()}
    assert row_of(LOOP, none) == row_of(LOOP, None)
    judged = Evaluated(OF_TIMING, {"r_rms_m": 0.5})
    for known in ((judged, None), (None, loop_steps())):
        row = run_row("a1", LOOP, ENDED, Availability(True), "m", *known)
        assert row == row_of(LOOP, None)
    row = run_row("a1", LOOP, ENDED, Availability(True), "m", None, None, concurrency=2)
    assert (row["run_id"], row["machine_id"], row["concurrency"]) == ("a1", "m", 2)
    assert row_of(LOOP, None)["concurrency"] is pd.NA
    assert (row["outcome"], row["form"], row["n"], row["m"]) == ("finished", "dense", 15, 12)
    assert (row["steps_planned"], row["steps_done"]) == (9, 0)
    controller = PAPER["scenario"]["controller"]
    assert row["N_p"] == controller["prediction_horizon"]
    assert row["N_c"] == controller["control_horizon"]
    assert row["deadline_s"] == load_scenario("paper").sample_s
    assert "r_rms_m" not in row and "raw_p50_ns" not in row


def test_sizes_that_do_not_exist_are_null() -> None:
    """A sequence from elsewhere has no horizons, and a solver that refused got no QP."""
    elsewhere = replace(REPLAY, source=RecordedSource("r"))
    row = run_row("a1", elsewhere, Outcome("refused", "no"), Availability(True), "m", None, None)
    assert all(row[name] is pd.NA for name in ("N_p", "N_c", "n", "m"))


def test_numbers_that_are_absent_are_null_in_the_table_of_steps() -> None:
    """−1 stands for a number that is not there; a latency of 0 is one."""
    steps = {
        "k": np.array([0, 1]),
        "latency_ns": np.array([0, ABSENT]),
        "n_m": np.array([1.0, NAN]),
    }
    table = step_rows("a1", steps)
    assert table["run_id"].tolist() == ["a1", "a1"] and table["k"].tolist() == [0, 1]
    assert table["latency_ns"].isna().tolist() == [False, True]
    assert table["latency_ns"].iloc[0] == 0 and table["n_m"].iloc[0] == 1.0


@pytest.mark.parametrize("bound", [INF, NAN])
def test_a_bound_that_is_not_finite_is_no_bound(bound: float) -> None:
    """The largest bound is of the optima that are certified."""
    steps = loop_steps()
    steps["optimum_bound"][1] = bound
    assert row_of(LOOP, steps)["optimum_bound_max"] == 2e-13
