"""Experiments of runs and the state of each run in its experiment."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.run_matrix import (
    Experiment,
    RunMatrix,
    get_configuration_in_common_form,
)
from dpbench.analysis.verdict.verdict import judge_solvers

REQUIREMENTS = Requirements()


def _matrix(records: Any, kept: int = 0) -> RunMatrix:
    view = records.view()
    return RunMatrix.from_records(view, judge_solvers(view, REQUIREMENTS), view.study, kept)


def _labels(matrix: RunMatrix) -> list[str]:
    return [experiment.label for experiment in matrix.experiments]


def _window(records: Any, solver: str, steps: int = 30, **columns: Any) -> None:
    """A window of `paper`."""
    source = {"kind": "hardest", "name": "paper hardest 30", "of": 450}
    cell = {"scenario": records.scenario("paper").files, "source": source}
    name = "paper hardest 30"
    records.replay(solver, name, steps=steps, spread=0.0, cell=json.dumps(cell), **columns)


@pytest.mark.parametrize(
    ("experiment", "label"),
    [
        (Experiment("closed_loop", "paper", "scaled"), "paper"),
        (Experiment("replay", "paper", "scaled"), "paper (replay)"),
        (Experiment("closed_loop", "paper", "si"), "paper (in SI units)"),
        (Experiment("closed_loop", "paper", "scaled", 0.5), "paper (computer × 0.5)"),
        (Experiment("closed_loop", "paper", "scaled", 20.0), "paper (computer × 20)"),
        (
            Experiment("closed_loop", "paper", "scaled", 0.0, "condensed_stacked"),
            "paper (condensed stacked)",
        ),
        (
            Experiment("replay", "paper", "si", 2.5, "condensed_stacked"),
            "paper (replay, in SI units, computer × 2.5, condensed stacked)",
        ),
        (
            Experiment("closed_loop", "paper", "scaled", 0.0, "", "seas", 3, 2),
            "seas: point 3, realisation 2",
        ),
    ],
)
def test_the_label_of_an_experiment(experiment: Experiment, label: str) -> None:
    assert experiment.label == label


def test_the_experiment_of_each_kind_of_run(records: Any) -> None:
    records.loop("daqp")
    records.loop("daqp", slowdown=0.5)
    records.replay("daqp", "paper[0:300]", steps=300)
    records.sea("daqp", 3, 2, {"hs_m": 1.0}, slowdown=4.0, formulation="sparse")
    loop, slow, replay, sea = records.view().all_runs
    assert Experiment.from_run(loop, "sparse") == Experiment(
        "closed_loop", "paper", "scaled", 0.0, "sparse"
    )
    assert Experiment.from_run(slow) == Experiment("closed_loop", "paper", "scaled", 0.5)
    assert Experiment.from_run(replay) == Experiment("replay", "paper[0:300]", "scaled")
    assert Experiment.from_run(sea, "sparse") == Experiment(
        "closed_loop", "paper", "scaled", 0.0, "", "seas", 3, 2
    )


@pytest.mark.parametrize(("first", "second", "kept"), [(120, 60, 0), (60, 120, 1), (120, 120, 0)])
def test_the_longer_of_two_runs_counts(first: int, second: int, kept: int, records: Any) -> None:
    for steps in (first, second):
        records.loop("daqp", steps=steps)
    matrix = _matrix(records)
    assert list(matrix.runs) == [(0, 0)]
    assert matrix.runs[0, 0].run_id == f"run{kept:04d}"


def test_another_formulation_has_a_experiment_of_its_own(records: Any) -> None:
    records.loop("daqp")
    records.loop("daqp", formulation="condensed_stacked")
    records.loop("daqp", formulation="condensed_stacked", slowdown=8.0)
    matrix = _matrix(records)
    assert _labels(matrix) == ["paper", "paper (condensed stacked)", "paper (computer × 8)"]
    assert [c.formulation for c in matrix.configurations] == ["condensed_box"]


def test_units_belong_to_the_experiment_of_a_configuration(records: Any) -> None:
    records.replay("daqp", units="si")
    records.loop("daqp", units="si")
    records.loop("daqp")
    records.loop("unconstrained_clipped", formulation="none")
    matrix = _matrix(records)
    assert _labels(matrix) == ["paper", "paper (in SI units)", "paper (replay, in SI units)"]
    assert sorted(matrix.runs) == [(0, 0), (0, 1), (0, 2)]
    assert matrix.configurations == [get_configuration_in_common_form(records.view().runs[0])]
    assert {c.units for c in matrix.configurations} == {"scaled"}
    assert {p: run.run_id for p, run in matrix.first_run_by_experiment.items()} == {
        0: "run0002",
        1: "run0001",
        2: "run0000",
    }


def test_the_runs_of_a_study_that_are_kept(records: Any) -> None:
    records.loop("daqp")
    for replicate in (1, 2):
        records.sea("scs", 0, replicate, {"hs_m": 1.0}, settings="high")
    matrix = _matrix(records, kept=1)
    assert _labels(matrix) == [
        "paper",
        "seas: point 0, realisation 1",
        "seas: point 0, realisation 2",
    ]
    assert sorted(matrix.runs) == [(0, 0), (1, 1)]
    assert matrix.judged_experiment_indices == [0]
    assert matrix.settings_levels == ["default"]
    assert [c.solver for c in matrix.configurations] == ["daqp", "scs"]
    assert [c.solver for c in matrix.reference_configurations] == ["daqp"]
    assert sorted(_matrix(records, kept=0).runs) == [(0, 0)]


def test_references_where_nothing_is_judged_are_the_first_of_each_solver(records: Any) -> None:
    for solver, settings in (("daqp", "high"), ("daqp", "default"), ("scs", "default")):
        records.sea(solver, 0, 1, {"hs_m": 1.0}, settings=settings)
    references = _matrix(records).reference_configurations
    assert [(c.solver, c.settings) for c in references] == [("daqp", "high"), ("scs", "default")]


def test_levels_are_in_the_order_of_use(records: Any) -> None:
    for settings in ("special", "high", "low", "default"):
        records.loop("daqp", settings=settings)
    assert _matrix(records).settings_levels == ["default", "low", "high", "special"]


def test_scenarios_are_those_that_rows_carry(records: Any) -> None:
    records.loop("daqp")
    records.sea("daqp", 0, 1, {"hs_m": 1.0})
    records.sea("scs", 0, 1, {"hs_m": 1.0})
    bare = {"study": {"name": "seas", "point": 0, "replicate": 2, "x": {}}}
    named = {"study": "seas", "study_point": 0, "replicate": 2}
    records.loop("daqp", cell=json.dumps(bare), **named)
    matrix = _matrix(records)
    loop, sea, same, unknown = matrix.records.all_runs
    assert matrix.build_scenario_of_run(loop) is matrix.records.build_scenario("paper")
    assert (found := matrix.build_scenario_of_run(sea)) is not None and found.name == "paper"
    assert matrix.build_scenario_of_run(same) is found
    assert matrix.build_scenario_of_run(unknown) is None


@pytest.mark.parametrize(
    ("columns", "state"),
    [
        ({}, "pass"),
        ({"error": 0.5}, "fail"),
        ({"outcome": "hung", "done": 0}, "late"),
        ({"outcome": "timed_out", "done": 40}, "inconclusive"),
        ({"steps": 450, "raw_p50_ns": 3e6}, "borderline"),
        ({"outcome": "refused", "done": 0}, "not run"),
        ({"slowdown": 8.0, "exact_cost": 100.0}, "pass"),
        ({"slowdown": 0.5, "exact_cost": 50.0}, "late"),
        ({"exact_cost": 50.0}, "pass"),
        ({"slowdown": 8.0, "exact_cost": 50.0, "error": 0.5}, "fail"),
    ],
)
def test_the_state_of_a_run_alone(records: Any, columns: dict[str, Any], state: str) -> None:
    records.loop("daqp", **columns)
    matrix = _matrix(records)
    assert matrix.get_state_in_experiment(0, 0) == state
    assert matrix.get_state_in_experiment(0, 1) == matrix.get_state_in_experiment(1, 0) == "not run"


@pytest.mark.parametrize(
    ("columns", "state"),
    [
        ({"error": 0.5}, "fail"),
        ({"settings": "high", "error": 0.5}, "pass"),
        ({"units": "si", "error": 0.5}, "pass"),
        ({"formulation": "sparse", "error": 0.5}, "pass"),
    ],
)
def test_a_window_counts_in_its_loop(records: Any, columns: dict[str, Any], state: str) -> None:
    records.loop("daqp")
    records.loop("daqp", units="si")
    records.replay("daqp")
    if state == "pass":
        _window(records, "daqp")
    _window(records, "daqp", **columns)
    matrix = _matrix(records)
    assert _labels(matrix) == ["paper", "paper (in SI units)", "paper (replay)"]
    loop = matrix.find_index(get_configuration_in_common_form(matrix.records.all_runs[0]))
    states = [matrix.get_state_in_experiment(loop, p) for p in range(3)]
    assert states == [state, "pass", "pass"]


def test_the_replay_behind_a_p99(records: Any) -> None:
    records.loop("daqp")
    records.replay("daqp", "rough[900:1400]", steps=500, median_us=10.0, spread=0.0)
    records.replay("daqp", median_us=50.0, spread=0.0)
    matrix = _matrix(records)
    (verdict,) = matrix.verdicts.verdicts_on_references
    margin = matrix.get_speed_margin(verdict.configuration)
    assert margin is not None and margin.allowed_slowness_factor == pytest.approx(60.0, rel=1e-3)
    number = matrix.find_timed_experiment_index(verdict)
    assert number is not None and matrix.experiments[number] == Experiment(
        "replay", "paper", "scaled"
    )


def test_without_a_replay_no_p99_has_an_experiment(records: Any) -> None:
    records.loop("daqp", raw_max_ns=math.nan)
    matrix = _matrix(records)
    (verdict,) = matrix.verdicts.verdicts_on_references
    assert matrix.find_timed_experiment_index(verdict) is None
    assert matrix.get_speed_margin(verdict.configuration) is None
    assert matrix.find_longest_timing(verdict.configuration) is None


def test_the_longest_timing_is_of_scaled_runs_outside_studies(records: Any) -> None:
    records.loop("daqp", raw_max_ns=2e6)
    records.replay("daqp", raw_max_ns=3e6)
    records.loop("daqp", "calm", raw_max_ns=math.nan)
    records.loop("daqp", units="si", raw_max_ns=9e6)
    records.sea("daqp", 0, 1, {"hs_m": 1.0}, raw_max_ns=9e6)
    records.loop("scs", raw_max_ns=9e6)
    matrix = _matrix(records, kept=1)
    found = matrix.find_longest_timing(matrix.configurations[0])
    assert (found.mode, found.raw_max_ns) == ("replay", 3e6)


def test_the_longest_timing_may_be_in_a_window(records: Any) -> None:
    records.loop("daqp", "turn", raw_max_ns=2e6)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"steps": 30, "scenario": "turn", "cell": cell}
    records.replay("daqp", "turn hardest 30", raw_max_ns=4e6, **window)
    matrix = _matrix(records)
    assert matrix.find_longest_timing(matrix.configurations[0]).raw_max_ns == 4e6


def test_runs_with_infeasible_steps_are_those_that_are_judged(records: Any) -> None:
    records.replay("daqp", infeasible_steps=18, rounds=3)
    records.loop("daqp", infeasible_steps=4)
    records.loop("daqp", "calm", infeasible_steps=0)
    records.loop("daqp", units="si", infeasible_steps=7)
    records.sea("daqp", 0, 1, {"hs_m": 1.0}, infeasible_steps=7)
    records.loop("scs", infeasible_steps=7)
    matrix = _matrix(records, kept=1)
    found = matrix.list_runs_with_infeasible_steps(matrix.configurations[0])
    assert {(run.mode, run.infeasible_steps) for run in found} == {
        ("closed_loop", 4),
        ("replay", 18),
    }


def test_the_index_of_a_configuration(records: Any) -> None:
    """A configuration that was not run has the index -1."""
    records.loop("daqp")
    records.loop("scs")
    matrix = _matrix(records)
    first, second = matrix.configurations
    assert (matrix.find_index(first), matrix.find_index(second)) == (0, 1)
    records.loop("osqp")
    assert matrix.find_index(_matrix(records).configurations[2]) == -1
