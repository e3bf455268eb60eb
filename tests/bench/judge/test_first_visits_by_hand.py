"""First visits and loop ratios worked by hand."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.judge.answer_caching import (
    add_loop_ratios,
    compute_caching_metrics,
    find_caching_sign,
)
from dpbench.bench.record.raw_log import COUNTERS

NAN = math.nan


@pytest.mark.parametrize(
    ("figures", "remembered"),
    [
        ((3.0, 10.0, 0.05, 15.0), False),
        ((3.001, NAN, NAN, NAN), True),
        ((NAN, 10.001, NAN, NAN), True),
        ((NAN, NAN, 0.0501, NAN), True),
        ((NAN, NAN, NAN, 15.001), True),
        ((NAN, NAN, NAN, NAN), False),
    ],
)
def test_limits_of_figures(figures: tuple[float, float, float, float], remembered: bool) -> None:
    assert (find_caching_sign(*figures) is not None) is remembered


def _log(first: list[float], *rounds: list[float], warm_up: int = 0, **columns: Any) -> Any:
    """A log of a warm-up round and of rounds with these times [ns] of their steps.

    The first visits are given apart; all rounds have one attempt.
    """
    steps, count = len(first), 1 + len(rounds)
    total = np.zeros((count, steps), np.int64)
    for r, times in enumerate(rounds, 1):
        total[r, : len(times)] = times
    times = np.zeros((count, steps, 3), np.int64)
    times[:, :, 1] = total
    usual = {
        "times": times,
        "done": np.array([warm_up, *map(len, rounds)]),
        "first_ns": np.array(first, np.int64),
        "attempts": np.ones(count, np.int64),
        "counters": np.zeros((count, len(COUNTERS))),
        "reference_kernel_ns": np.full((count, 2), 100.0),
        "first_reference_kernel_ns": np.full(count, 100.0),
    }
    return SimpleNamespace(**usual | columns)


def _metrics(log: Any) -> tuple[float, float]:
    found = compute_caching_metrics(log)
    return found["first_visit_ratio"], found["first_visit_excess"]


def test_the_ratio_of_first_visits() -> None:
    """The shortest later visit counts: 30 over 10, whatever the round of the first visit took."""
    found = _metrics(_log([30] * 20, [99] * 20, [10] * 20, [15] * 20))
    assert found == (3.0, 0.0)


@pytest.mark.parametrize(
    ("first", "later", "known"),
    [
        ([30] * 20 + [0], 21, True),
        ([30] * 19 + [0], 20, False),
        ([30] * 19 + [-1], 20, False),
        ([30] * 20, 19, False),
    ],
)
def test_twenty_pairs_of_visits_are_needed(first: list[float], later: int, known: bool) -> None:
    """A step without a first visit (0), a recorded one (−1), or a later one counts for none."""
    log = _log(first, [1] * len(first), [10] * later)
    assert (not math.isnan(_metrics(log)[0])) is known


def test_slow_first_visits_beyond_those_of_later_rounds() -> None:
    """Five of 20 first visits exceed four times the shortest later one, one later visit does.

    The excess is (5 - 2 - 1) / 20 with one involuntary switch, and a visit of four times is none.
    """
    first = [41.0] * 5 + [40.0] + [10.0] * 14
    third = [10.0] * 18 + [40.0, 41.0]
    log = _log(first, first, [10] * 20, third)
    assert _metrics(log) == (1.0, pytest.approx((5 - 2) / 20))
    log.counters[1, COUNTERS.index("involuntary_switches")] = 1.0
    assert _metrics(log)[1] == pytest.approx(0.1)
    log.counters[1, COUNTERS.index("involuntary_switches")] = math.nan
    assert _metrics(log)[1] == pytest.approx(0.15)


def test_switches_explain_slow_first_visits_by_the_share_of_timed_calls() -> None:
    """Shortest visits of 40 steps take 1 ms of a round of 40 ms: of 50 switches at most 4/40 hit.

    Five with three standard deviations are 5 + 3·sqrt(5) = 11.7, so that 12 of 20 are explained.
    """
    usual = [25_000.0] * 40
    log = _log([250_000.0] * 20 + [25_000.0] * 20, usual, usual, usual)
    log.counters[1, COUNTERS.index("replay_s")] = 0.04
    log.counters[1, COUNTERS.index("involuntary_switches")] = 50.0
    assert _metrics(log)[1] == pytest.approx((20 - 12) / 40)


def test_a_slow_machine_explains_slow_first_visits() -> None:
    """The kernel took 1.5 times its best: a ratio of 3 becomes 2, and the limit is six times."""
    kernels = np.array([[0.0, 0.0], [150.0, 120.0], [100.0, 110.0]])
    slower = {
        "reference_kernel_ns": kernels,
        "first_reference_kernel_ns": np.array([900, 150, 100]),
    }
    first = [61.0] * 4 + [60.0] * 2 + [30.0] * 14
    assert _metrics(_log(first, first, [10] * 20, **slower)) == (2.0, 0.2)
    for around_first in (50, 0):
        slower["first_reference_kernel_ns"] = np.array([900, around_first, 100])
        assert _metrics(_log(first, first, [10] * 20, **slower))[0] == 3.0
    slower["reference_kernel_ns"] = 0.0 * kernels
    assert _metrics(_log(first, first, [10] * 20, **slower))[0] == 3.0


def test_a_round_that_was_run_again_is_a_later_visit() -> None:
    log = _log([30] * 20, [10] * 20, [15] * 20, attempts=np.array([1, 2, 1]))
    log.counters[1, COUNTERS.index("involuntary_switches")] = 8.0
    assert _metrics(log) == (3.0, 0.0)


@pytest.mark.parametrize(("attempts", "ratio"), [(1, NAN), (2, 40.0)])
def test_a_warm_up_alone_is_compared_with_its_last_attempt(attempts: int, ratio: float) -> None:
    """Its visits of 0 ns count as 1 ns; run once, it has first visits alone."""
    log = _log([40] * 20, warm_up=20, attempts=np.array([attempts]))
    assert _metrics(log)[0] == pytest.approx(ratio, nan_ok=True)


def test_the_warm_up_is_asked_where_too_few_steps_follow_it() -> None:
    """The warm-up visits 20 of 30 steps: all rounds that follow are later visits."""
    log = _log([40] * 20 + [90] * 10, [10] * 30, [20] * 30, warm_up=20)
    assert _metrics(log) == (4.0, 0.0)


def test_a_round_without_steps_is_no_visit() -> None:
    log = _log([30] * 40, [99] * 40, [10] * 20, [])
    assert _metrics(log) == (3.0, 0.0)
    assert math.isnan(_metrics(_log([30] * 40, [99] * 40, []))[0])


def _rows(*rows: dict[str, Any]) -> pd.DataFrame:
    usual = {
        "scenario": "paper",
        "solver": "daqp",
        "route": "native",
        "policy": "warm",
        "settings": "default",
        "options": "",
        "formulation": "condensed_box",
        "units": "scaled",
        "mode": "closed_loop",
        "outcome": "finished",
        "failed_steps": 0,
        "slowdown": 0.0,
        "steps_done": 100,
        "raw_p50_ns": 10.0,
        "raw_p90_ns": 20.0,
    }
    return pd.DataFrame([usual | row for row in rows])


REPLAY = {"mode": "replay", "raw_p50_ns": 2.0, "raw_p90_ns": 8.0}


@pytest.mark.parametrize(
    ("loop", "ratios"),
    [
        ({}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "raw_p90_ns": 12.0}, (3.0, 1.5)),
        ({"steps_done": 99, "raw_p50_ns": 6.0}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "failed_steps": 1}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "outcome": "timed_out"}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "slowdown": 8.0}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "policy": "reuse"}, (5.0, 2.5)),
        ({"steps_done": 101, "raw_p50_ns": 6.0, "scenario": "calm"}, (5.0, 2.5)),
    ],
)
def test_the_longest_loop_is_compared(loop: dict[str, Any], ratios: tuple[float, float]) -> None:
    found = add_loop_ratios(_rows({}, REPLAY, loop))
    assert found.loc[1, ["loop_ratio", "loop_tail_ratio"]].to_list() == list(ratios)
    assert found.loc[[0, 2], ["loop_ratio", "loop_tail_ratio"]].isna().all().all()


def test_loop_ratios_without_their_columns() -> None:
    columns = ["loop_ratio", "loop_tail_ratio"]
    assert add_loop_ratios(_rows(REPLAY))[columns].isna().all().all()
    assert (
        add_loop_ratios(_rows({}, REPLAY).drop(columns="failed_steps"))[columns].isna().all().all()
    )
    found = add_loop_ratios(_rows({}, REPLAY).drop(columns="raw_p90_ns"))
    assert found.loc[1, "loop_ratio"] == 5.0 and found["loop_tail_ratio"].isna().all()


def test_a_cascade_is_compared_by_its_controller() -> None:
    found = add_loop_ratios(_rows({"controller_p50_ns": 4.0}, REPLAY))
    assert found.loc[1, ["loop_ratio", "loop_tail_ratio"]].to_list() == [2.0, 2.5]
    found = add_loop_ratios(_rows({"controller_p50_ns": NAN}, REPLAY))
    assert found.loc[1, "loop_ratio"] == 5.0
