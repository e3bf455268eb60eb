"""Typed records of runs, and step times out of step rows."""

import json
import math
from dataclasses import fields
from typing import Any, get_args, get_type_hints

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import Count, RunRecord, build_run_records
from dpbench.bench.judge.rules import mask_counted_rows
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import RUN_COLUMNS, convert_to_run_columns
from tests.result_folder import StepsInMemory

TYPES = {"str": str, "bool": bool, "int64": int, "Int64": Count, "float64": float}
DERIVED = [
    "files",
    "source",
    "first",
    "fallback",
    "backup",
    "x",
    "default_route",
    "own_switches_a_step",
    "untimed_iterations",
    "untimed_iterations_max",
]


def _record(**columns: Any) -> RunRecord:
    (record,) = build_run_records(convert_to_run_columns(pd.DataFrame([columns])))
    return record


def test_a_record_has_columns_of_the_schema() -> None:
    names = [field.name for field in fields(RunRecord)]
    columns = [name for name in RUN_COLUMNS if name in names]
    assert names == columns + DERIVED
    hints = get_type_hints(RunRecord)
    for column in columns:
        literals = {type(value) for value in get_args(hints[column])}
        assert (literals or {hints[column]}) == {TYPES[RUN_COLUMNS[column][0]]}, column


def test_every_column_is_read_as_its_type() -> None:
    record = _record(run_id="a", mode="replay", steps_planned=5, rounds=3)
    for field in fields(RunRecord):
        if field.name not in DERIVED:
            assert isinstance(getattr(record, field.name), TYPES[RUN_COLUMNS[field.name][0]])
    assert (record.run_id, record.steps_planned, record.rounds) == ("a", 5, 3.0)
    assert math.isnan(record.failed_steps) and math.isnan(record.r_rms_m)
    assert not record.default_route


def test_a_random_sequence_has_the_family_it_was_drawn_of() -> None:
    recipe = {"family": "plain", "n": 8, "m": 12, "seed": 1}
    record = _record(cell=json.dumps({"source": {"kind": "random", "recipe": recipe}}))
    assert record.family == "plain"
    recorded = _record(cell=json.dumps({"source": {"kind": "recorded", "name": "x"}}))
    assert (recorded.family, recorded.scenario_documents) == ("", None)


@pytest.mark.parametrize(
    ("sequence", "without"),
    [("paper-60-10[0:300]", "paper[0:300]"), ("paper-60-10", "paper"), ("rough[9:12]",) * 2],
)
def test_horizons_are_told_from_the_name(sequence: str, without: str) -> None:
    record = _record(sequence=sequence, N_p=60, N_c=10)
    assert record.horizons == (60, 10)
    assert record.sequence_without_horizons == without
    assert _record(sequence=sequence).horizons is None


@pytest.mark.parametrize(
    ("columns", "label", "name"),
    [
        ({}, "osqp (native fresh)", "osqp (native)"),
        ({"policy": "warm"}, "osqp (native warm)", "osqp (native, warm)"),
        ({"settings": "high"}, "osqp (native fresh, high)", "osqp (native, high)"),
        ({"units": "si"}, "osqp (native fresh, in SI units)", "osqp (native), si"),
        ({"formulation": "none"}, "osqp (native fresh)", "osqp (native)"),
        (
            {"formulation": "condensed_stacked"},
            "osqp (native fresh, condensed stacked)",
            "osqp (native), condensed stacked",
        ),
    ],
)
def test_a_configuration_is_called_by_its_options(
    columns: dict[str, str], label: str, name: str
) -> None:
    plain = {"policy": "fresh", "settings": "default", "units": "scaled"}
    plain |= {"solver": "osqp", "route": "native", "formulation": "condensed_box"}
    record = _record(**(plain | columns))
    assert (record.configuration.label, record.solver_label) == (label, name)


def test_an_alias_makes_no_other_configuration() -> None:
    known = Configuration("osqp", "native", "fresh", alias=("high",))
    assert known == Configuration("osqp", "native", "fresh")
    assert len({known, Configuration("osqp", "native", "fresh")}) == 1


def _spoil(records: Any, rounds: list[int]) -> Records:
    found = records.results()
    steps = found.steps.copy()
    steps["disturbed"] = steps["repeat"].isin(rounds)
    repeat, disturbed = (steps[name].to_numpy() for name in ("repeat", "disturbed"))
    steps["counts"] = mask_counted_rows(repeat, disturbed)
    return Records(Results(found.runs, StepsInMemory(steps), found.machine, found.suite))


def test_algorithmic_time_is_the_minimum_over_rounds(records: Any) -> None:
    records.replay("daqp", steps=100, rounds=3)
    view = records.view()
    steps = view.read_step_table(view.runs[0])
    pivot = steps[~steps["warmup"]].pivot(index="k", columns="repeat", values="total_ns")
    times = view.get_step_times(view.runs[0])
    np.testing.assert_array_equal(times.algo_ns, pivot.min(axis=1).astype(float))
    assert times.raw_max_ns == pivot.max().max()


def test_disturbed_rounds_do_not_count(records: Any) -> None:
    records.replay("daqp", steps=100, rounds=3)
    for disturbed, counting in (([1], [2, 3]), ([1, 2, 3], [1, 2, 3])):
        view = _spoil(records, disturbed)
        steps, times = view.read_step_table(view.runs[0]), view.get_step_times(view.runs[0])
        least = steps[steps["repeat"].isin(counting)].groupby("k")["total_ns"].min()
        np.testing.assert_array_equal(times.algo_ns, least.astype(float))


def test_a_run_without_counting_rounds_has_no_time(records: Any) -> None:
    records.replay("daqp", steps=100, rounds=0)
    view = records.view()
    assert view.get_step_times(view.runs[0]) is None


def test_the_scenario_comes_from_the_rows(records: Any) -> None:
    records.loop("daqp")
    scenario = records.view().build_scenario("paper")
    np.testing.assert_allclose(scenario.problem.du_max, [32736.0, 11008.0, 475200.0], rtol=1e-12)
    assert records.view().build_scenario("rough") is None
