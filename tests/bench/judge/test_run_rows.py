"""Rows of both tables, with failure, accuracy and deadline figures counted by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.judge import rows, timing
from dpbench.bench.judge.evaluation import EvaluatedCell
from dpbench.bench.judge.rows import make_run_row, make_step_rows
from dpbench.bench.judge.rules import has_comparable_times
from dpbench.bench.record.cell import CONTROLLER, Cell, HardestSource, Outcome, RecordedSource
from dpbench.bench.record.schema import MISSING_INT
from dpbench.bench.run.slow_computer import ComputationalDelay
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.calibration import NO_OP
from dpbench.solvers.table import Availability

INF, NAN = np.inf, np.nan
PAPER = load_scenario("paper").files
LOOP = Cell("closed_loop", PAPER, "daqp", "native", "warm", "high", 9)
REPLAY = replace(LOOP, mode="replay", steps=3, rounds=2)
ONCE = {"setup_once_ns": np.array([0]), "matrix_updates": np.array([0])}


def flags(text: str) -> np.ndarray:
    """Return the flags written as a row of 0 and 1."""
    return np.array([letter == "1" for letter in text])


def row_of(cell: Cell, steps: Any = None, judged: Any = None, **given: Any) -> dict[str, Any]:
    outcome = Outcome("finished", "", "dense", 15, 12)
    return make_run_row("a1", cell, outcome, Availability(True), "m", judged, steps, **given)


def loop_steps(**columns: Any) -> dict[str, Any]:
    """Return correct, timely steps of a loop except for these columns."""
    K = len(next(iter(columns.values())))
    no, yes = np.zeros(K, dtype=bool), np.ones(K, dtype=bool)
    steps: dict[str, Any] = {
        "repeat": np.zeros(K, dtype=np.int32),
        "k": np.arange(K, dtype=np.int32),
        "counts": yes,
        "status": np.full(K, "SOLVED"),
        "certificate": np.full(K, "linear"),
        **dict.fromkeys(("claimed", "true", "true_1e4", "true_1e6"), yes),
        **dict.fromkeys(("fallback", "unconverged", "clipped", "late"), no),
        **dict.fromkeys(("error_move", "error_plan", "primal", "dual"), np.zeros(K)),
        "optimum_bound": np.full(K, 1e-12),
        "iterations": np.full(K, 5),
        **dict.fromkeys(("total_ns", "latency_ns", "emit_ns", "overhead_ns"), np.full(K, 100)),
        "waited_ns": np.zeros(K, dtype=np.int64),
    }
    return steps | {name: np.asarray(column) for name, column in columns.items()}


def closed_loop_row(slowdown: float = 0.0, **columns: Any) -> dict[str, Any]:
    cell = replace(LOOP, slowdown=slowdown)
    return row_of(cell, loop_steps(**columns), EvaluatedCell(ONCE, {}))


def test_fallbacks_of_a_known_run() -> None:
    row = closed_loop_row(
        fallback=flags("0101110001100"),
        true=flags("1010000011011"),
        unconverged=flags("0000001100000"),
        clipped=flags("1100000000001"),
    )
    assert (row["fallbacks"], row["fallback_longest"]) == (6, 3)
    # From step 1 to 2, from 3 to 8, from 9 to 9
    assert row["recover_steps_max"] == 5
    assert (row["unconverged"], row["clipped"]) == (2, 3)


def test_without_a_fallback_there_is_nothing_to_recover_from() -> None:
    row = closed_loop_row(true=flags("110"))
    assert (row["fallbacks"], row["fallback_longest"]) == (0, 0)
    assert row["recover_steps_max"] is pd.NA
    lasting = closed_loop_row(fallback=flags("0100001"), true=flags("1110110"))
    assert lasting["recover_steps_max"] is pd.NA
    assert lasting["fallback_longest"] == 1


def test_accuracy_of_a_known_run() -> None:
    row = closed_loop_row(
        certificate=["linear", "gap", *["linear"] * 3, "undecided", "none", "infeasible"],
        claimed=flags("11100111"),
        true=flags("11010000"),
        true_1e4=flags("11000000"),
        true_1e6=flags("10000000"),
        status=["SOLVED"] * 3 + ["MAX_ITERATIONS"] * 2 + ["SOLVED"] * 3,
        unconverged=flags("00011000"),
        fallback=flags("00000100"),
        error_move=[0.1, 0.2, 0.3, 0.4, 0.05, 9.0, NAN, NAN],
        error_plan=[0.2, 0.3, 0.4, 0.5, 0.6, 9.0, NAN, NAN],
        primal=[0.1, 0.0, 0.0, 0.0, 0.0, 9.0, 0.2, 0.3],
        dual=[0.0, 0.4, 0.0, 0.0, 0.0, 9.0, 0.1, 0.2],
        optimum_bound=[1e-12, 3e-12, 2e-12, 1e-12, 1e-12, INF, NAN, INF],
        iterations=[4, 8, 2, 10, MISSING_INT, 3, 7, 9],
    )
    assert row["claimed_share"] == 0.75
    # Six steps have a known right answer.
    assert row["true_share"] == 0.5
    assert row["true_1e4_share"] == pytest.approx(2 / 6)
    assert row["true_1e6_share"] == pytest.approx(1 / 6)
    # Claimed, known and not true: steps 2 and 7; true, known and not claimed: step 3.
    assert (row["claimed_not_true"], row["true_not_claimed"]) == (2, 1)
    # 0.05, 0.1, 0.2, 0.3, 0.4 without the undecided 9
    assert (row["error_move_p50"], row["error_move_max"]) == (0.2, 0.4)
    assert (row["error_plan_max"], row["primal_max"], row["dual_max"]) == (0.6, 0.3, 0.4)
    assert row["optimum_bound_max"] == 3e-12
    assert (row["uncertified"], row["undecided_steps"], row["infeasible_steps"]) == (1, 1, 1)
    # The two unfinished iterates; the fallback of the undecided step is nobody's fault.
    assert row["failed_steps"] == 2
    # Median of 2, 3, 4, 7, 8, 9, 10
    assert (row["iterations_p50"], row["iterations_max"]) == (7.0, 10.0)


def test_the_iterations_of_the_slowest_hundredth_are_those_of_a_windows_stretch() -> None:
    """One of 100 steps has more, three of 300; each step counts once, with its largest round."""
    counts = np.arange(300)
    steps = {"k": np.tile(counts, 2), "iterations": np.concatenate([counts, counts[::-1]])}
    by_step = np.maximum(counts, counts[::-1])  # 150, 151, ..., 299, each twice
    assert np.sort(by_step)[-4] == 298
    find = rows._find_iterations_of_slowest_hundredth
    assert find(steps, CONTROLLER) == 298.0
    assert find(steps, HardestSource("turn", of=500)) == np.sort(by_step)[-6] == 297.0
    assert find(steps, HardestSource("turn", of=50_000)) == 150.0
    unknown = {"k": counts, "iterations": np.full(300, MISSING_INT)}
    assert np.isnan(find(unknown, CONTROLLER))


def test_the_median_error_is_one_that_occurred_and_an_infinite_one_counts() -> None:
    assert closed_loop_row(error_move=[0.4, 0.1, 0.3, 0.2])["error_move_p50"] == 0.3
    assert closed_loop_row(error_move=[0.1, INF, NAN])["error_move_max"] == INF
    unknown = closed_loop_row(error_move=[NAN] * 2, certificate=["undecided"] * 2)
    assert np.isnan(unknown["error_move_p50"]) and np.isnan(unknown["true_share"])


def test_deadlines_of_a_known_run() -> None:
    """Ten steps on a computer twice as slow; two of them without a computation.

    Latencies 200, 100, 900, 700, 300, 200, 200, 200: their median is 200. 100 is less than twice
    the measured 100 ns, by the time that the kernel gave to others.
    """
    row = closed_loop_row(
        slowdown=2.0,
        late=flags("0011100100"),
        true=flags("1110101111"),
        total_ns=[100, 100, 450, MISSING_INT, 350, 150, 100, MISSING_INT, 100, 100],
        latency_ns=[200, 100, 900, MISSING_INT, 700, 300, 200, MISSING_INT, 200, 200],
    )
    assert (row["deadline_misses"], row["longest_miss_streak"]) == (4, 3)
    # From step 2: the answer of 4 is true and late, that of 5 in time and wrong, 6 is both.
    assert row["miss_recover_steps_max"] == 4
    assert row["computations"] == 8
    assert row["interrupted"] == 1
    assert (row["latency_p50_ns"], row["latency_max_ns"]) == (200.0, 900.0)


def test_a_late_answer_is_judged_as_any_other() -> None:
    """A late answer is no failure: of four steps only the one without an answer fails.

    The second step was late, the third had no computation.
    """
    columns: dict[str, Any] = {
        "fallback": flags("1111"),
        "late": flags("0110"),
        "total_ns": [100, 900, MISSING_INT, 100],
        "latency_ns": [200, 1800, MISSING_INT, 200],
        "status": ["SOLVED", "SOLVED", "", "ERROR"],
        "claimed": flags("1100"),
        "true": flags("1100"),
        "error_move": [0.1, 0.2, NAN, INF],
        "error_plan": [0.1, 0.2, NAN, INF],
    }
    row = closed_loop_row(slowdown=2.0, **columns)
    assert (row["failed_steps"], row["fallbacks"]) == (1, 4)
    assert row["claimed_share"] == row["true_share"] == pytest.approx(2 / 3)
    # Where the ship waits for every answer, each fallback is a failure, and there is no latency.
    plain = closed_loop_row(**columns)
    assert (plain["failed_steps"], plain["deadline_misses"]) == (4, 2)
    assert "latency_p50_ns" not in plain and "interrupted" not in plain


def test_a_replay_is_as_long_as_its_longest_round_that_counts() -> None:
    repeat, k = np.array([0, 1, 1, 1, 2, 2]), np.array([0, 0, 1, 2, 0, 1])
    kernels = {"reference_kernel_ns": np.ones((3, 2)), "load_kernel_ns": np.ones((3, 1, 1))}
    judged = EvaluatedCell(ONCE | kernels | {"repeat": repeat}, {"r_rms_m": 0.5})
    steps = loop_steps(repeat=repeat, k=k, disturbed=flags("000000"))
    for counts, length, rounds in (("011111", 3, 2), ("000011", 2, 1)):
        steps["counts"] = flags(counts)
        row = row_of(REPLAY, steps, judged)
        assert (row["steps_done"], row["rounds"]) == (length, rounds)
        assert np.isnan(row["deadline_s"]) and "fallbacks" not in row
    of_harness = row_of(replace(REPLAY, solver=NO_OP), steps, judged)
    assert "claimed_share" not in of_harness and of_harness["raw_samples"] == 2
    # Within its warm-up a replay has metrics, errors and failed steps, and nothing else.
    row = row_of(REPLAY, steps | {"counts": flags("000000")}, judged)
    assert row["r_rms_m"] == 0.5 and row["steps_done"] == 0 and "raw_samples" not in row
    assert "failed_steps" in row and "true_share" not in row


def test_a_cell_without_steps_has_its_identity_only() -> None:
    judged, steps = EvaluatedCell(ONCE, {"r_rms_m": 0.5}), loop_steps(true=flags("1"))
    none = {name: column[:0] for name, column in steps.items()}
    for parts in ((none, judged), (None, judged), (steps, None)):
        assert row_of(LOOP, *parts) == row_of(LOOP)
    row = row_of(LOOP, concurrency=2)
    assert (row["run_id"], row["machine_id"], row["concurrency"]) == ("a1", "m", 2)
    assert row_of(LOOP)["concurrency"] is pd.NA
    assert (row["outcome"], row["form"], row["n"], row["m"]) == ("finished", "dense", 15, 12)
    assert (row["steps_planned"], row["steps_done"]) == (9, 0)
    controller = PAPER["scenario"]["controller"]
    assert row["N_p"] == controller["prediction_horizon"]
    assert row["N_c"] == controller["control_horizon"]
    assert row["deadline_s"] == load_scenario("paper").sample_s
    assert "r_rms_m" not in row and "raw_p50_ns" not in row
    # A sequence from elsewhere has no horizons, and a solver that refused got no QP.
    elsewhere = replace(REPLAY, source=RecordedSource("r"))
    row = make_run_row(
        "a1", elsewhere, Outcome("refused", "no"), Availability(True), "m", None, None
    )
    assert all(row[name] is pd.NA for name in ("N_p", "N_c", "n", "m"))


def test_numbers_that_are_absent_are_null_in_the_table_of_steps() -> None:
    """An integer of −1 is a missing number; a latency of 0 is one."""
    steps = {"k": np.array([0, 1]), "latency_ns": np.array([0, MISSING_INT])}
    table = make_step_rows("a1", steps | {"n_m": np.array([1.0, NAN])})
    assert table["run_id"].tolist() == ["a1", "a1"] and table["k"].tolist() == [0, 1]
    assert table["latency_ns"].isna().tolist() == [False, True]
    assert table["latency_ns"].iloc[0] == 0 and table["n_m"].iloc[0] == 1.0


def test_half_a_nanosecond_is_rounding() -> None:
    """A latency of 1.5 · 101 ns = 151.5 ns is 151 or 152 ns, and neither was interrupted."""
    steps = {
        "late": flags("000"),
        "true": flags("111"),
        "total_ns": np.array([101, 101, 101]),
        "latency_ns": np.array([151, 152, 150]),
    }
    assert timing.compute_deadline_metrics(steps, 1.5)["interrupted"] == 1


def test_an_answer_exactly_in_time_is_not_late() -> None:
    """An answer at the budget of 1000 ns is in time; a step without a computation is late."""
    took = np.array([1000, 1001, 999, 3000])
    plain = timing.make_deadline_columns(ComputationalDelay(0.0, 1000, 2000), took, took)
    assert plain["late"].tolist() == [False, True, False, True]
    assert "latency_ns" not in plain
    latency = np.array([1000, 1001, 999, -7, -1, 0])
    slow = timing.make_deadline_columns(
        ComputationalDelay(2.0, 1000, 2000), latency, np.array([9000] * 6)
    )
    assert slow["late"].tolist() == [False, True, False, True, True, False]
    assert slow["latency_ns"].tolist() == [1000, 1001, 999, MISSING_INT, MISSING_INT, 0]


@pytest.mark.parametrize(
    ("row", "longest"), [("", 0), ("0", 0), ("1", 1), ("1101", 2), ("0111", 3), ("10111101", 4)]
)
def test_longest_run_of_flags(row: str, longest: int) -> None:
    assert timing.length_of_longest_streak(flags(row)) == longest


@pytest.mark.parametrize(
    ("bad", "good", "steps"),
    [
        ("0100", "1010", 1),
        ("0100", "1001", 2),
        ("1110", "0001", 3),
        ("0100", "0100", 0),
        ("0100", "1100", 0),
        ("0100", "1000", None),
        ("0000", "1111", None),
        ("101000", "010001", 3),
        ("100010", "000100", None),
    ],
)
def test_steps_to_the_next_good_one(bad: str, good: str, steps: int | None) -> None:
    assert timing.count_steps_to_recover(flags(bad), flags(good)) == steps


@pytest.mark.parametrize(
    ("concurrency", "machine", "ranked"),
    [(1.0, "a", True), (2.0, "a", False), (1.0, "b", False), (NAN, "b", True), (1.5, "a", False)],
)
def test_times_taken_alone_are_ranked(concurrency: float, machine: str, ranked: bool) -> None:
    assert has_comparable_times(concurrency, machine, "a") is ranked
