"""Failure, accuracy and deadline figures of closed loops, counted by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.judge.closed_loop import Evaluated
from dpbench.bench.judge.deadlines import (
    deadline_metrics,
    late_columns,
    longest_streak,
    steps_to_recover,
)
from dpbench.bench.judge.rows import run_row
from dpbench.bench.judge.rules import is_disturbed, is_ranked
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.schema import ABSENT
from dpbench.bench.run.slow_computer import ComputationalDelay
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.table import Availability

INF, NAN = np.inf, np.nan
KNOWN = ("linear", "linear")


def flags(text: str) -> np.ndarray:
    """Return the flags written as a row of 0 and 1."""
    return np.array([letter == "1" for letter in text])


def closed_loop_row(slowdown: float = 0.0, **columns: Any) -> dict[str, Any]:
    """Return the row of a loop with correct, timely steps except for these columns."""
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
    steps |= {name: np.asarray(column) for name, column in columns.items()}
    once = {"setup_once_ns": np.array([0]), "matrix_updates": np.array([0])}
    files = load_scenario("calm").files
    cell = Cell("closed_loop", files, "daqp", "native", "warm", "high", K, slowdown=slowdown)
    outcome, library = Outcome("finished", ""), Availability(True)
    return run_row("run", cell, outcome, library, "", Evaluated(once, {}), steps)


def test_fallbacks_of_a_known_run() -> None:
    """The fallback acts for one, three and two steps; the second recovery takes five."""
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
    """A loop without a fallback, or with one that never ends, has no recovery time."""
    row = closed_loop_row(true=flags("110"))
    assert (row["fallbacks"], row["fallback_longest"]) == (0, 0)
    assert row["recover_steps_max"] is pd.NA
    lasting = closed_loop_row(fallback=flags("0100001"), true=flags("1110110"))
    assert lasting["recover_steps_max"] is pd.NA
    assert lasting["fallback_longest"] == 1


def test_accuracy_of_a_known_run() -> None:
    """Shares of eight steps leave out an undecided and an uncertified one."""
    row = closed_loop_row(
        certificate=[
            "linear",
            "gap",
            "rational",
            "linear",
            "linear",
            "undecided",
            "none",
            "infeasible",
        ],
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
        optimum_bound=[1e-12, 3e-12, 2e-12, 1e-12, 1e-12, INF, INF, INF],
        iterations=[4, 8, 2, 10, ABSENT, 3, 7, 9],
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


def test_the_median_error_is_one_that_occurred() -> None:
    """The median of an even number of errors is the upper of the middle two."""
    assert closed_loop_row(error_move=[0.4, 0.1, 0.3, 0.2])["error_move_p50"] == 0.3


def test_an_infinite_error_is_no_missing_one() -> None:
    """One step with an infinite error makes the largest error infinite."""
    assert closed_loop_row(error_move=[0.1, INF, NAN])["error_move_max"] == INF


def test_deadlines_of_a_known_run() -> None:
    """Ten steps on a computer twice as slow; two of them without a computation.

    Latencies 200, 100, 900, 700, 300, 200, 200, 200: their median is 200. 100 is less than twice
    the measured 100 ns, by the time that the kernel gave to others.
    """
    row = closed_loop_row(
        slowdown=2.0,
        late=flags("0011100100"),
        true=flags("1110101111"),
        total_ns=[100, 100, 450, ABSENT, 350, 150, 100, ABSENT, 100, 100],
        latency_ns=[200, 100, 900, ABSENT, 700, 300, 200, ABSENT, 200, 200],
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
        "total_ns": [100, 900, ABSENT, 100],
        "latency_ns": [200, 1800, ABSENT, 200],
        "status": ["SOLVED", "SOLVED", "", "ERROR"],
        "claimed": flags("1100"),
        "true": flags("1100"),
        "error_move": [0.1, 0.2, NAN, INF],
        "error_plan": [0.1, 0.2, NAN, INF],
    }
    row = closed_loop_row(slowdown=2.0, **columns)
    assert (row["failed_steps"], row["fallbacks"]) == (1, 4)
    assert row["claimed_share"] == row["true_share"] == pytest.approx(2 / 3)
    # Where the ship waits for every answer, each fallback is a failure.
    assert closed_loop_row(**columns)["failed_steps"] == 4


def test_an_ordinary_loop_has_misses_and_no_latencies() -> None:
    """A loop without a slow-down counts misses and reports no latency."""
    row = closed_loop_row(late=flags("0110"))
    assert (row["deadline_misses"], row["longest_miss_streak"]) == (2, 2)
    assert row["miss_recover_steps_max"] == 2
    assert "latency_p50_ns" not in row and "interrupted" not in row


def test_half_a_nanosecond_is_rounding() -> None:
    """A latency of 1.5 · 101 ns = 151.5 ns is 151 or 152 ns, and neither was interrupted."""
    steps = {
        "late": flags("000"),
        "true": flags("111"),
        "total_ns": np.array([101, 101, 101]),
        "latency_ns": np.array([151, 152, 150]),
    }
    assert deadline_metrics(steps, 1.5)["interrupted"] == 1


def test_an_answer_exactly_in_time_is_not_late() -> None:
    """An answer at the budget of 1000 ns is in time; a step without a computation is late."""
    took = np.array([1000, 1001, 999, 3000])
    plain = late_columns(ComputationalDelay(0.0, 1000, 2000), took, took)
    assert plain["late"].tolist() == [False, True, False, True]
    assert "latency_ns" not in plain
    latency = np.array([1000, 1001, 999, -7, -1, 0])
    slow = late_columns(ComputationalDelay(2.0, 1000, 2000), latency, np.array([9000] * 6))
    assert slow["late"].tolist() == [False, True, False, True, True, False]
    assert slow["latency_ns"].tolist() == [1000, 1001, 999, ABSENT, ABSENT, 0]


@pytest.mark.parametrize(
    ("row", "longest"), [("", 0), ("0", 0), ("1", 1), ("1101", 2), ("0111", 3), ("10111101", 4)]
)
def test_longest_run_of_flags(row: str, longest: int) -> None:
    """The longest run may be at the start, in the middle or at the end."""
    assert longest_streak(flags(row)) == longest


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
    """The slowest recovery counts; None where a run never recovers."""
    assert steps_to_recover(flags(bad), flags(good)) == steps


@pytest.mark.parametrize(
    ("concurrency", "machine", "ranked"),
    [(1.0, "a", True), (2.0, "a", False), (1.0, "b", False), (NAN, "b", True), (1.5, "a", False)],
)
def test_times_are_ranked_where_they_were_taken_alone(
    concurrency: float, machine: str, ranked: bool
) -> None:
    """Ranked times come from one cell at a time on the machine of the folder."""
    assert is_ranked(concurrency, machine, "a") is ranked


def test_exactly_the_factor_is_not_disturbed() -> None:
    """A kernel of 125 ns is undisturbed beside a best of 100 ns, one of 126 ns is not."""
    kernel_ns = np.array([[100.0, 125.0], [125.0, 110.0], [126.0, 100.0], [100.0, 126.0]])
    assert is_disturbed(kernel_ns).tolist() == [False, False, True, True]
