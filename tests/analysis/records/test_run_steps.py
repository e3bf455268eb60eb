"""The steps of runs against group-bys of pandas, and planted hard ones."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.run_steps import (
    COUNTING_COLUMNS,
    MEASURES,
    TIME_COLUMNS,
    Delays,
    Measure,
    RunSteps,
    StepTimes,
    extract_counting_rows,
    find_delays,
    find_hardest_steps,
    yield_delays_by_run,
    yield_merged_steps_by_run,
    yield_step_times_by_run,
)
from dpbench.bench.record.schema import convert_to_step_columns


def _several(records: Any) -> pd.DataFrame:
    """Loops and replays of several rounds, one of them cut short."""
    records.loop("daqp", steps=40)
    records.replay("osqp", steps=60, rounds=4, iterations=9, error=0.2, wrong=(3,), lost=(7,))
    records.replay("scs", steps=60, rounds=2, done=25, error=1e-3)
    steps: pd.DataFrame = records.results().steps
    return steps


def _by_run(steps: pd.DataFrame) -> dict[str, RunSteps]:
    return dict(yield_merged_steps_by_run(extract_counting_rows(steps)))


def _floats(column: Any) -> Any:
    return column.to_numpy(dtype=np.float64, na_value=np.nan)


def test_every_run_with_a_counting_step_is_there_once(records: Any) -> None:
    steps = _several(records)
    found = [name for name, _ in yield_merged_steps_by_run(extract_counting_rows(steps))]
    assert found == ["run0000", "run0001", "run0002"]


def test_figures_are_those_of_pandas(records: Any) -> None:
    """Least and largest time, largest error, iterations and active limits over the rounds that
    count; flags of the last of them."""
    steps = _several(records)
    counting = steps[steps["counts"]]
    for name, run in _by_run(steps).items():
        own = counting[counting["run_id"] == name]
        groups = own.groupby("k")
        np.testing.assert_array_equal(run.k, np.array(sorted(own["k"].unique())))
        for values, column, how in (
            (run.time_ns, "total_ns", "min"),
            (run.raw_ns, "total_ns", "max"),
            (run.error, "error_move", "max"),
            (run.iterations, "iterations", "max"),
            (run.n_active, "n_active", "max"),
        ):
            np.testing.assert_array_equal(values, _floats(groups[column].agg(how)), err_msg=column)
        last = groups.tail(1).set_index("k").sort_index()
        for values, column in (
            (run.claimed, "claimed"),
            (run.late, "late"),
            (run.fallback, "fallback"),
            (run.clipped, "clipped"),
        ):
            np.testing.assert_array_equal(values, last[column].to_numpy(dtype=bool))
        assert run.rounds == own["repeat"].nunique()


def test_a_warm_up_counts_nowhere(records: Any) -> None:
    records.replay("daqp", steps=5, rounds=2)
    steps = records.results().steps.copy()
    warm_up = steps["warmup"].to_numpy(dtype=bool)
    steps.loc[warm_up, "total_ns"] = 1
    (run,) = _by_run(convert_to_step_columns(steps)).values()
    assert run.time_ns.min() > 1 and run.rounds == 2


@pytest.mark.parametrize("measure", MEASURES)
def test_planted_hard_steps_are_found_hardest_first(records: Any, measure: Measure) -> None:
    records.replay("daqp", steps=50, rounds=1, spread=0.0)
    steps = records.results().steps.copy()
    column, planted = {
        "time": ("total_ns", {11: 900_000, 4: 700_000}),
        "iterations": ("iterations", {30: 90, 2: 80}),
        "error": ("error_move", {49: np.inf, 0: 0.5}),
    }[measure]
    for k, value in planted.items():
        steps.loc[steps["k"] == k, column] = value
    (run,) = _by_run(convert_to_step_columns(steps)).values()
    found = find_hardest_steps(run, measure)
    assert len(found) == 5
    values = run.get_values_of_measure(measure)[found].tolist()
    assert run.k[found[:2]].tolist() == list(planted)
    assert values[:2] == [float(v) for v in planted.values()]
    assert values == sorted(values, reverse=True)


def test_steps_without_a_figure_are_none_of_the_hardest(records: Any) -> None:
    records.loop("daqp", steps=20)
    (run,) = _by_run(records.results().steps).values()
    assert np.isnan(run.iterations).all() and not len(find_hardest_steps(run, "iterations"))
    assert len(find_hardest_steps(run, "time", count=3)) == 3


def test_the_status_is_what_was_said_where_the_error_is_largest(records: Any) -> None:
    records.replay("daqp", steps=3, rounds=3)
    steps = records.results().steps.copy()
    steps["status"] = "SOLVED"
    worst = (steps["k"] == 1) & (steps["repeat"] == 2)
    steps.loc[worst, "error_move"] = 0.3
    steps.loc[worst, "status"] = "MAX_ITERATIONS"
    (run,) = _by_run(convert_to_step_columns(steps)).values()
    assert run.status.tolist() == ["SOLVED", "MAX_ITERATIONS", "SOLVED"]


def test_an_answer_whose_right_one_is_not_known_is_not_untrue(records: Any) -> None:
    records.replay("daqp", steps=3, rounds=1)
    steps = records.results().steps.copy()
    steps["true"] = False
    steps.loc[steps["k"] == 1, "certificate"] = "none"
    (run,) = _by_run(convert_to_step_columns(steps)).values()
    assert run.true.tolist() == [False, True, False]


def test_no_counting_row_is_no_run(records: Any) -> None:
    assert _by_run(records.results().steps) == {}
    records.replay("daqp", steps=3, rounds=0)
    assert _by_run(records.results().steps) == {}


def test_the_named_columns_are_all_that_is_read(records: Any) -> None:
    steps = _several(records)
    for columns in (COUNTING_COLUMNS, TIME_COLUMNS):
        assert len(set(columns)) == len(columns)
    assert len(extract_counting_rows(steps[list(COUNTING_COLUMNS)])) == steps["counts"].sum()
    assert len(dict(yield_step_times_by_run(steps[list(TIME_COLUMNS)]))) == 3
    assert len(dict(yield_delays_by_run(steps[list(TIME_COLUMNS)]))) == 3


def test_a_run_without_rows_has_none_to_select(records: Any) -> None:
    counting = extract_counting_rows(_several(records))
    assert not len(counting.select_run("unknown"))
    assert set(counting.select_run("run0002").run_id) == {"run0002"}


def test_chosen_steps_keep_their_values_and_the_rounds(records: Any) -> None:
    (run,) = _by_run(_replay_of(records, steps=6)).values()
    chosen = run.select_steps(np.array([4, 1]))
    assert chosen.k.tolist() == [4, 1] and chosen.rounds == run.rounds == 2
    np.testing.assert_array_equal(chosen.time_ns, run.time_ns[[4, 1]])
    np.testing.assert_array_equal(chosen.status, run.status[[4, 1]])


def _replay_of(records: Any, **columns: Any) -> pd.DataFrame:
    records.replay("daqp", rounds=2, **columns)
    steps: pd.DataFrame = records.results().steps
    return steps


ROUNDS = (
    # Round, step, timing and wait [ns]; round 0 does not count, and step 2 was never solved.
    *((0, 0, 1, 0), (0, 1, 1, 0), (0, 3, 1, 0)),
    *((1, 0, 10, 0), (1, 1, 40, 25), (1, 3, 30, 0)),
    *((2, 0, 12, 4), (2, 1, 50, 0), (2, 3, 28, 3)),
    (3, 0, 11, 0),
)


def _timings(*changes: tuple[int, int, int, float | None]) -> pd.DataFrame:
    """Steps of run `a` by hand with changed rows, and of run `b` with one."""
    rows = {(r, k): (ns, wait) for r, k, ns, wait in (*ROUNDS, *changes)}
    keys = np.array(list(rows))
    timing, wait = zip(*rows.values(), strict=True)
    own = pd.DataFrame({"run_id": "a", "repeat": keys[:, 0], "k": keys[:, 1]})
    own = own.assign(counts=own["repeat"] > 0, total_ns=timing, waited_ns=wait)
    other = own.tail(1).assign(run_id="b", k=0, total_ns=7, waited_ns=2)
    both = pd.concat([own, other], ignore_index=True)
    return both.astype({"total_ns": "Int64", "waited_ns": "Int64"})


def _times(*changes: tuple[int, int, int, float | None]) -> StepTimes:
    times = dict(yield_step_times_by_run(_timings(*changes)))
    assert list(times) == ["a", "b"] and times["b"].algo_ns.tolist() == [7.0]
    return times["a"]


def test_step_times_by_hand() -> None:
    times = _times()
    assert times.k.tolist() == [0, 1, 3]
    assert times.algo_ns.tolist() == [10.0, 40.0, 28.0]
    assert times.net_ns is not None and times.net_ns.tolist() == [8.0, 15.0, 25.0]
    assert times.timings.tolist() == [3, 2, 2]
    assert times.raw_max_ns == 50.0
    assert times.rounds_ns.tolist() == [30.0, 28.0, 11.0]
    assert times.wait_ns[1] == times.hardest_wait_ns == 25.0


def test_the_wait_of_the_hardest_step_is_the_least_of_its_fastest_timings() -> None:
    assert _times((2, 1, 40, 9)).hardest_wait_ns == 9.0
    assert _times((2, 1, 41, 9)).hardest_wait_ns == 25.0


def test_of_an_unknown_wait_no_net_time_is_known() -> None:
    times = _times((1, 1, 40, None))
    assert times.net_ns is None and times.hardest_wait_ns == 0.0
    assert times.algo_ns.tolist() == [10.0, 40.0, 28.0]


def _listed(delays: Delays) -> dict[str, list[float]]:
    names = ("samples", "base_ns", "round", "delay_ns", "own_ns", "net_ns")
    return {name: getattr(delays, name).tolist() for name in names}


def test_delays_by_hand() -> None:
    """A timing over twice the fastest one of its step is a delay, at twice it is none."""
    late = (2, 3, 71, 30), (3, 0, 20, 0), (2, 0, 21, 4)
    found = dict(yield_delays_by_run(_timings(*late)))
    delays = found["a"]
    assert _listed(delays) == {
        "samples": [3, 3, 1],
        "base_ns": [80.0, 80.0, 10.0],
        "round": [1, 1],
        "delay_ns": [21.0, 71.0],
        "own_ns": [10.0, 30.0],
        "net_ns": [17.0, 41.0],
    }
    assert delays.step_ns == 30.0 and delays.has_waits
    for limit_ns, count in ((16.0, 2), (17.0, 1), (40.0, 1), (41.0, 0)):
        assert delays.count_late_by_repetition(limit_ns).tolist() == [0, count, 0]
    # They are 7 and 11 ns over their base times, without their waits.
    for longer_ns, count in ((6.0, 2), (7.0, 1), (10.0, 1), (11.0, 0), (6.0, 2)):
        assert delays.count_stalls_by_repetition(longer_ns).tolist() == [0, count, 0]
    gross = delays.without_waits
    assert gross.net_ns.tolist() == [21.0, 71.0] and not gross.has_waits
    assert gross.count_late_by_repetition(41.0).tolist() == [0, 1, 0]
    assert _listed(found["b"])["delay_ns"] == []


def test_two_rounds_tell_a_step_from_a_delay() -> None:
    k, zeros = np.array([0, 1, 0, 1]), np.zeros(4)
    delays = find_delays(np.array([1, 1, 2, 2]), k, np.array([10.0, 90.0, 12.0, 30.0]), zeros)
    assert delays.delay_ns.tolist() == [90.0] and delays.own_ns.tolist() == [30.0]


def test_in_one_round_a_delay_is_what_is_over_the_median() -> None:
    k, zeros = np.arange(4), np.zeros(4)
    timings = np.array([10.0, 30.0, np.nan, 12.0])
    delays = find_delays(k * 0, k, timings, zeros)
    assert _listed(delays) == {
        "samples": [3],
        "base_ns": [36.0],
        "round": [0],
        "delay_ns": [30.0],
        "own_ns": [12.0],
        "net_ns": [30.0],
    }
    assert delays.step_ns == delays.net_step_ns == 12.0
    unknown = find_delays(k * 0, k, timings, np.array([0.0, 8.0, 0.0, np.nan]))
    assert unknown.net_ns.tolist() == [30.0] and not unknown.has_waits
    assert unknown.net_step_ns == 12.0
    waits = find_delays(k * 0, k, timings, np.array([0.0, 25.0, 0.0, 6.0]))
    assert (waits.step_ns, waits.net_step_ns, waits.without_waits.net_step_ns) == (12.0, 6.0, 12.0)
    nothing = find_delays(k * 0, k, np.full(4, np.nan), zeros)
    assert np.isnan(nothing.step_ns) and not len(nothing.samples)


def test_all_steps_of_a_short_run_are_ordered(records: Any) -> None:
    (run,) = _by_run(_replay_of(records, steps=6)).values()
    for count in (5, 6, 7):
        found = find_hardest_steps(run, "time", count)
        expected = np.argsort(-run.time_ns, kind="stable")[:count]
        np.testing.assert_array_equal(found, expected)
