"""Step times out of step rows."""

from typing import Any

import numpy as np
import pytest

from dpbench.analysis.records import Records
from dpbench.bench.judge.rules import counting_rows
from dpbench.bench.record.result_folder import Results


def _spoil(records: Any, rounds: list[int]) -> Records:
    found = records.results()
    steps = found.steps.copy()
    steps["disturbed"] = steps["repeat"].isin(rounds)
    repeat, disturbed = (steps[name].to_numpy() for name in ("repeat", "disturbed"))
    steps["counts"] = counting_rows(repeat, disturbed)
    return Records(Results(found.runs, steps, found.machine, found.suite))


def test_algorithmic_time_is_the_minimum_over_rounds(records: Any) -> None:
    """Per step the fastest counting round is the algorithmic time; all samples stay in the
    common_steps."""
    records.replay("daqp", steps=100, rounds=3)
    view = records.view()
    steps = view.steps(view.runs[0])
    pivot = steps[~steps["warmup"]].pivot(index="k", columns="repeat", values="total_ns")
    times = view.times(view.runs[0])
    assert times is not None
    np.testing.assert_array_equal(times.algo_ns, pivot.min(axis=1).astype(float))
    assert (len(times.raw_ns), times.rounds) == (300, 3)


def test_the_median_over_rounds_is_found_step_by_step(records: Any) -> None:
    """An even count of rounds has the mean of the middle two; a step cut short has its own few."""
    records.replay("daqp", steps=50, rounds=4)
    found = records.results()
    cut = found.steps[~((found.steps["repeat"] == 4) & (found.steps["k"] >= 30))]
    view = Records(Results(found.runs, cut, found.machine, found.suite))
    times = view.times(view.runs[0])
    assert times is not None
    medians = cut[~cut["warmup"]].astype({"total_ns": float}).groupby("k")["total_ns"].median()
    np.testing.assert_array_equal(times.typical_ns, medians.to_numpy())
    assert not np.array_equal(times.typical_ns, times.algo_ns)
    np.testing.assert_array_equal(np.bincount(times.raw_k), [4] * 30 + [3] * 20)


def test_disturbed_rounds_do_not_count(records: Any) -> None:
    """A round in which the machine was slowed is left out, unless no other is left."""
    records.replay("daqp", steps=100, rounds=3)
    some = _spoil(records, [1])
    every = _spoil(records, [1, 2, 3])
    assert [v.times(v.runs[0]).rounds for v in (some, every)] == [2, 3]  # type: ignore[union-attr] # both have steps


def test_a_run_without_counting_rounds_has_no_time(records: Any) -> None:
    """A replay that got no further than its warm-up has no step time."""
    records.replay("daqp", steps=100, rounds=0)
    view = records.view()
    assert view.times(view.runs[0]) is None


def test_phases_are_medians_of_their_own(records: Any) -> None:
    """Phases keep their share of the step and a phase that is no part of it has no number.

    The records give update 0.2 of the total; each is rounded to 1 ns of some 20 µs.
    """
    records.replay("daqp", steps=200)
    view = records.view()
    times = view.times(view.runs[0])
    assert times is not None
    assert times.phase_ns["update"] == pytest.approx(0.2 * np.median(times.raw_ns), rel=1e-3)
    assert np.isnan(times.phase_ns["setup"])


def test_the_scenario_comes_from_the_rows(records: Any) -> None:
    """Limits and sample time are those of the run, not those of a file that may have changed."""
    records.loop("daqp")
    scenario = records.view().scenario("paper")
    assert scenario is not None
    np.testing.assert_allclose(scenario.du_max, [32736.0, 11008.0, 475200.0], rtol=1e-12)
    assert records.view().scenario("rough") is None
