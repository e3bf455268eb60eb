"""Studies: points of keys, draws, replicates, and the cells they mean."""

from math import prod
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.run_request import reduce_suite
from dpbench.bench.plan.study_points import StudyTable, list_study_points
from dpbench.bench.plan.suite import SuiteFile
from dpbench.bench.record.schema import make_study_value_columns
from dpbench.errors import InputError
from dpbench.scenario.problem_files import validate_settings_as_model
from dpbench.scenario.scenario import build_scenario_from_documents

HS, TP = "environment.waves.hs_m", "environment.waves.tp_s"
WIND, SEED = "environment.wind.speed_mps", "environment.seed"
HORIZON = "controller.prediction_horizon"


def _suite(study: dict[str, Any], **of_suite: Any) -> SuiteFile:
    document = {"title": "x", "solvers": ["daqp", "osqp"], "baseline_law": False} | of_suite
    return validate_settings_as_model(
        document | {"study": [{"base": "weather"} | study]}, SuiteFile, "suite"
    )


@given(
    sizes=st.lists(st.integers(1, 4), min_size=0, max_size=3),
    zipped=st.integers(1, 3),
    drawn=st.sampled_from([1, 2, 4]),
    replicates=st.integers(1, 3),
)
def test_points_of_a_product(sizes: list[int], zipped: int, drawn: int, replicates: int) -> None:
    table = StudyTable(
        base="x",
        product={f"p{i}": list(range(size)) for i, size in enumerate(sizes)},
        zip={"a": list(range(zipped)), "b": [-v for v in range(zipped)]},
        design={"kind": "sobol", "points": drawn, "ranges": {"c": [0.0, 1.0]}},
        replicates={"key": "seed", "count": replicates, "first": 5},
    )
    points = list_study_points(table, {})
    assert len(points) == prod(sizes) * zipped * drawn * replicates
    assert len({(p.index, p.replicate) for p in points}) == len(points)
    assert len({tuple(p.values.items()) for p in points}) * replicates == len(points)
    assert all(p.values["b"] == -p.values["a"] for p in points)
    if replicates > 1:
        assert {p.of_replicate["seed"] for p in points} == set(range(5, 5 + replicates))


@given(points=st.sampled_from([2, 8, 64]), seed=st.integers(0, 99))
def test_each_interval_of_a_latin_hypercube_has_one_point(points: int, seed: int) -> None:
    ranges = {"a": [-3.0, 5.0], "b": [10.0, 11.0]}
    design = {"kind": "latin_hypercube", "points": points, "seed": seed, "ranges": ranges}
    table = StudyTable(base="x", design=design)
    for key, (low, high) in ranges.items():
        drawn = np.array([p.values[key] for p in list_study_points(table, {})])
        cells = np.floor((drawn - low) / (high - low) * points).astype(int)
        assert sorted(cells) == list(range(points))


def test_whole_numbers_stay_whole() -> None:
    ranges = {HORIZON: [30.0, 60.0], WIND: [5.0, 18.0]}
    table = StudyTable(base="x", design={"kind": "sobol", "points": 8, "ranges": ranges})
    drawn = [p.values for p in list_study_points(table, {HORIZON: 60, WIND: 10.7})]
    assert all(isinstance(p[HORIZON], int) and 30 <= p[HORIZON] <= 60 for p in drawn)
    assert len({p[WIND] for p in drawn}) == 8


def test_cells_of_a_study_are_the_scenarios_they_say() -> None:
    study = {
        "settings": ["default", "1e-4"],
        "steps": 30,
        "replicates": {"count": 2, "first": 4},
        "product": {HORIZON: [30, 60]},
        "zip": {HS: [1, 2.5, 3.0], TP: [6, 7.0, 8.0]},
    }
    cells = [p.cell for p in plan_suite(_suite(study))]
    assert len(cells) == 2 * 3 * 2 * 2 * 2
    for cell in cells:
        assert cell.study is not None
        scenario, x = build_scenario_from_documents(cell.scenario), cell.study.x
        environment = cell.scenario["scenario"]["environment"]
        assert scenario.problem.N_p == x[HORIZON] and cell.steps == 30
        assert (environment["waves"]["hs_m"], environment["waves"]["tp_s"]) == (x[HS], x[TP])
        assert environment["seed"] == 3 + cell.study.replicate
    studies = [(c.study, c.solver, c.settings) for c in cells]
    assert all(studies.count(one) == 1 for one in studies)
    order = [(study.replicate, study.point) for study, *_ in studies if study is not None]
    assert order == sorted(order)


def test_columns_of_a_study_in_the_table_of_runs() -> None:
    cells = [p.cell for p in plan_suite(_suite({"steps": 9, "product": {WIND: [5.0, 9.0]}}))]
    runs = pd.DataFrame({"cell": ["{}", *(cell.to_json() for cell in cells)]})
    columns = make_study_value_columns(runs)
    assert columns["study"].tolist() == ["", *["weather"] * 4]
    assert columns["study_point"].tolist()[1:] == [0, 0, 1, 1]
    assert columns[f"x_{WIND}"].tolist()[1:] == [5.0, 5.0, 9.0, 9.0]
    assert columns.iloc[0].drop("study").isna().all()


@pytest.mark.parametrize(
    ("study", "said"),
    [
        (
            {"base": "rough", "replicates": {"count": 3}},
            r"seed.*has no random part.*, or with gusts in \[environment.wind\]; `dpbench list",
        ),
        ({"base": "rough", "product": {"title": ["a", "b"]}}, "title.*changes nothing"),
        ({"product": {"environment.wnd.speed_mps": [1.0]}}, "unknown key 'wnd'.*wind"),
        ({"product": {HORIZON: [5]}}, "control_horizon.*10"),
        ({"product": {WIND: ["fast", 2.0]}}, "speed_mps.*'fast'"),
        ({"base": "weathr"}, "weathr.*weather"),
    ],
)
def test_an_impossible_study_is_refused(study: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        plan_suite(_suite(study))


@pytest.mark.parametrize(
    ("study", "said"),
    [
        (
            {"zip": {HS: [1.0], TP: [1.0, 2.0]}},
            "key zip: found lists of 1 and 2 values; allowed: the same number of values for each",
        ),
        ({"zip": {HS: [1.0]}, "product": {HS: [2.0]}}, "each key once"),
        ({"replicates": {"count": 2}, "product": {SEED: [1, 2]}}, "not both"),
        (
            {"design": {"kind": "sobol", "points": 6, "ranges": {HS: [1.0, 2.0]}}},
            "key design.points: found 6; allowed: a power of two for sobol",
        ),
        (
            {"design": {"kind": "sobol", "points": 8, "ranges": {HS: [2.0, 2.0]}}},
            f"key design.ranges.{HS}: found [2.0, 2.0]; allowed: an increasing range",
        ),
    ],
)
def test_a_table_that_contradicts_itself(study: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        _suite(study)
    assert said in str(caught.value)


def test_choices_of_the_command_line_hold_for_studies() -> None:
    suite = reduce_suite(_suite({"steps": 30}), settings=["1e-5"], steps=7)
    (cell,) = [p.cell for p in plan_suite(suite, solvers=["osqp"])]
    assert (cell.solver, cell.settings, cell.steps) == ("osqp", "1e-5", 7)
