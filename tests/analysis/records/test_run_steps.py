"""The steps of runs against group-bys of pandas, and planted hard ones."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.run_steps import (
    MEASURES,
    Measure,
    RunSteps,
    extract_counting_rows,
    find_hardest_steps,
    yield_merged_steps_by_run,
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
