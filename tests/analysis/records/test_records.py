"""Step times out of step rows."""

from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.bench.judge.rules import counting_rows
from dpbench.bench.record.recorded_steps import StepsInMemory
from dpbench.bench.record.result_folder import Results


def _spoil(records: Any, rounds: list[int]) -> Records:
    found = records.results()
    steps = found.steps.copy()
    steps["disturbed"] = steps["repeat"].isin(rounds)
    repeat, disturbed = (steps[name].to_numpy() for name in ("repeat", "disturbed"))
    steps["counts"] = counting_rows(repeat, disturbed)
    return Records(Results(found.runs, StepsInMemory(steps), found.machine, found.suite))


def test_algorithmic_time_is_the_minimum_over_rounds(records: Any) -> None:
    """Per step the fastest counting round is the algorithmic time; a step cut short has its own."""
    records.replay("daqp", steps=100, rounds=3)
    view = records.view()
    steps = view.steps(view.runs[0])
    pivot = steps[~steps["warmup"]].pivot(index="k", columns="repeat", values="total_ns")
    times = view.times(view.runs[0])
    assert times is not None
    np.testing.assert_array_equal(times.algo_ns, pivot.min(axis=1).astype(float))
    assert times.raw_max_ns == pivot.max().max()


def test_disturbed_rounds_do_not_count(records: Any) -> None:
    """A round in which the machine was slowed is left out, unless no other is left."""
    records.replay("daqp", steps=100, rounds=3)
    for disturbed, counting in (([1], [2, 3]), ([1, 2, 3], [1, 2, 3])):
        view = _spoil(records, disturbed)
        steps, times = view.steps(view.runs[0]), view.times(view.runs[0])
        least = steps[steps["repeat"].isin(counting)].groupby("k")["total_ns"].min()
        assert times is not None
        np.testing.assert_array_equal(times.algo_ns, least.astype(float))


def test_a_run_without_counting_rounds_has_no_time(records: Any) -> None:
    records.replay("daqp", steps=100, rounds=0)
    view = records.view()
    assert view.times(view.runs[0]) is None


def test_the_scenario_comes_from_the_rows(records: Any) -> None:
    records.loop("daqp")
    scenario = records.view().scenario("paper")
    assert scenario is not None
    np.testing.assert_allclose(scenario.problem.du_max, [32736.0, 11008.0, 475200.0], rtol=1e-12)
    assert records.view().scenario("rough") is None
