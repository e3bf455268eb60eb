"""Solvers of controllers that command thrusters, compared with those that command forces."""

import json
import math
from types import SimpleNamespace
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import MISSED, Requirements
from dpbench.analysis.verdict.thruster_verdicts import (
    ThrusterVerdicts,
    compare_thrusters_with_forces,
    find_largest_ratio_to_best,
    is_mostly_thruster_control,
    list_late_losses,
    select_thruster_control_loops,
)

REQUIREMENTS = Requirements()


def _cell(**scenario: Any) -> str:
    """The cell of a loop whose scenario holds these entries."""
    return json.dumps({"scenario": {"scenario": scenario}})


THRUSTERS = _cell(controller={"kind": "thrusters"})
FORCES = _cell(controller={})


def _with_thrusters(records: Any, solver: str, **columns: Any) -> None:
    """A loop and a replay of `turn` that command thrusters; `columns` are those of the loop."""
    records.loop(solver, "turn", cell=THRUSTERS, **columns)
    records.replay(solver, "turn", cell=THRUSTERS, settings=columns.get("settings", "default"))


def _with_forces(records: Any, solver: str, **columns: Any) -> None:
    records.loop(solver, cell=FORCES, **columns)
    records.replay(solver, cell=FORCES)


def test_who_passes_with_thrusters_and_with_forces() -> None:
    verdicts = ThrusterVerdicts(
        ("paper",),
        {"a": "pass", "b": "pass", "c": "fail", "d": "pass", "e": "inconclusive", "z": "pass"},
        {
            "b": "late",
            "a": "pass",
            "c": "pass",
            "d": "borderline",
            "e": "inconclusive",
            "f": "fail",
        },
        {},
    )
    assert verdicts.list_solvers_with_state("pass") == ["a", "c"]
    assert verdicts.list_solvers_with_state("borderline", "inconclusive") == ["d", "e"]
    assert verdicts.list_solvers_with_state(*MISSED) == ["b", "f"]
    assert verdicts.passing_with_forces == ["a", "b", "d"]


@pytest.mark.parametrize(
    ("thrusters", "forces", "about"),
    [(0, 0, False), (0, 1, False), (1, 1, False), (1, 0, True), (2, 1, True), (1, 2, False)],
)
def test_a_folder_is_about_thrusters_by_more_than_half_of_its_scenarios(
    records: Any, thrusters: int, forces: int, about: bool
) -> None:
    names = iter(["turn", "paper", "calm", "rough"])
    for cell in [THRUSTERS] * thrusters + [FORCES] * forces:
        name = next(names)
        for solver in ("daqp", "scs") if cell == FORCES else ("daqp",):
            records.loop(solver, name, cell=cell)
    records.replay("daqp", "rough[0:300]", cell=THRUSTERS, steps=300)
    assert is_mostly_thruster_control(records.view()) is about


def test_the_best_outcome_of_a_solver_counts(records: Any) -> None:
    _with_forces(records, "daqp")
    _with_forces(records, "piqp")
    _with_forces(records, "scs", error=0.5)
    records.loop("osqp", scenario="calm", cell="")
    records.loop("qoco", cell=FORCES)
    _with_thrusters(records, "daqp", error=0.5)
    _with_thrusters(records, "daqp", settings="high")
    _with_thrusters(records, "piqp", outcome="hung", done=0)
    _with_thrusters(records, "scs", error=0.5)
    records.refused("ecos", "it takes no start", cell=THRUSTERS)
    found = compare_thrusters_with_forces(records.view(), REQUIREMENTS)
    assert found.forces == ("paper",)
    assert found.with_forces == {
        "daqp": "pass",
        "piqp": "pass",
        "scs": "fail",
        "qoco": "inconclusive",
    }
    assert found.with_thrusters == {"daqp": "pass", "piqp": "late", "scs": "fail"}
    assert found.faults == {"piqp": "too late", "scs": "wrong"}
    assert found.list_solvers_with_state("pass") == ["daqp"]


@pytest.mark.parametrize(
    ("default", "high", "fault"),
    [
        ({"outcome": "hung", "done": 0}, {"outcome": "hung", "done": 0}, "too late"),
        ({"error": 0.5}, {"error": 0.5}, "wrong"),
        ({"error": 0.5}, {"outcome": "hung", "done": 0}, "too late or wrong"),
        ({"error": 0.5}, {"outcome": "refused", "done": 0}, "wrong"),
        ({"outcome": "hung", "done": 0}, {"outcome": "hung", "error": 0.5}, "too late"),
        ({"error": 0.5}, {"outcome": "hung", "error": 0.5}, "wrong"),
        ({"outcome": "hung", "error": 0.5}, {"outcome": "hung", "error": 0.5}, "wrong"),
    ],
)
def test_the_fault_of_a_solver_is_that_of_all_its_configurations(
    records: Any, default: dict[str, Any], high: dict[str, Any], fault: str
) -> None:
    records.loop("daqp", cell=THRUSTERS, **default)
    records.loop("daqp", cell=THRUSTERS, settings="high", **high)
    assert compare_thrusters_with_forces(records.view(), REQUIREMENTS).faults == {"daqp": fault}


def _powered(records: Any, solver: str, scenario: str = "turn", **columns: Any) -> None:
    """A loop that commands thrusters and records their power."""
    records.loop(solver, scenario, cell=THRUSTERS, **{"power_share": 0.2} | columns)


def test_the_best_loop_is_right_ran_farthest_and_is_nearest(records: Any) -> None:
    _powered(records, "wrong", steps=300, error=0.5, dev_position_max_m=0.0)
    _powered(records, "short", steps=60, dev_position_max_m=0.0)
    _powered(records, "far", dev_position_max_m=0.2)
    _powered(records, "near", dev_position_max_m=0.1)
    _powered(records, "stopped", steps=300, outcome="timed_out", dev_position_max_m=0.0)
    _powered(records, "slowed", steps=300, slowdown=0.5, dev_position_max_m=0.0)
    _powered(records, "unpowered", steps=300, power_share=math.nan, dev_position_max_m=0.0)
    _powered(records, "law", steps=300, formulation="none", dev_position_max_m=0.0)
    _powered(records, "lone", "calm", error=0.5)
    found = select_thruster_control_loops(records.view(), REQUIREMENTS)
    assert {name: run.solver for name, run in found.best.items()} == {"turn": "near"}
    names = ["wrong", "short", "far", "near", "stopped"]
    assert list(found.configurations) == [f"{name} (qpsolvers fresh)" for name in names]
    assert [len(runs) for runs in found.configurations.values()] == [1] * 5


def test_loops_are_grouped_by_configuration(records: Any) -> None:
    for scenario in ("turn", "calm"):
        _powered(records, "daqp", scenario)
        _powered(records, "daqp", scenario, settings="high")
    found = select_thruster_control_loops(records.view(), REQUIREMENTS)
    assert list(found.best) == ["calm", "turn"]
    assert {
        label: [run.scenario for run in runs] for label, runs in found.configurations.items()
    } == {
        "daqp (qpsolvers fresh)": ["turn", "calm"],
        "daqp (qpsolvers fresh, high)": ["turn", "calm"],
    }


def _run(**columns: Any) -> Any:
    return SimpleNamespace(**columns)


def test_the_largest_ratio_of_a_metric_by_hand() -> None:
    """3 / 2 and 5 / 4: the first is larger; a metric of zero or without a value has no ratio."""
    best: Any = {"a": _run(power_share=2.0), "b": _run(power_share=4.0), "c": _run(power_share=0.0)}
    runs = [_run(scenario=name, power_share=x) for name, x in (("b", 5.0), ("a", 3.0), ("c", 9.0))]
    assert find_largest_ratio_to_best(runs, best, "power_share") == 1.5
    assert find_largest_ratio_to_best(runs[:1], best, "power_share") == 1.25
    assert math.isnan(find_largest_ratio_to_best(runs[2:], best, "power_share"))
    unknown = best | {"a": _run(power_share=math.nan)}
    assert find_largest_ratio_to_best(runs[1::-1], unknown, "power_share") == 1.25
    small: Any = {"a": _run(power_share=0.5)}
    assert (
        find_largest_ratio_to_best([_run(scenario="a", power_share=0.25)], small, "power_share")
        == 0.5
    )


@pytest.mark.parametrize(
    ("at_s", "lost"),
    [
        ([49.5], []),
        ([50.0], ["bow"]),
        ([99.0], ["bow"]),
        ([99.5], ["bow"]),
        ([100.0], []),
        ([101.0], []),
        ([50.0, 60.0], ["bow", "bow"]),
        ([40.0, 60.0], []),
        ([60.0, 40.0], []),
        ([60.0, 100.0], []),
    ],
)
def test_losses_in_the_second_half(at_s: list[float], lost: list[str]) -> None:
    """200 steps of 0.5 s are 100 s: every loss must be at 50 s or later, and before the end."""
    faults = [{"at_s": at, "lost": ["bow"]} for at in at_s]
    scenario = {"sample_s": 0.5, "faults": [{"at_s": 1.0, "lost": []}, {"at_s": 2.0}, *faults]}
    assert list_late_losses(_run(scenario_documents={"scenario": scenario}, steps_done=200)) == lost


def test_all_that_one_fault_takes_is_lost() -> None:
    faults = [{"at_s": 80.0, "lost": ["group 1", 2]}, {"at_s": 70.0, "lost": ["stern"]}]
    files = {"scenario": {"sample_s": 0.5, "faults": faults}}
    assert list_late_losses(_run(scenario_documents=files, steps_done=200)) == [
        "group 1",
        "2",
        "stern",
    ]


@pytest.mark.parametrize("files", [None, {}, {"scenario": {"faults": None}}])
def test_a_loop_without_faults_loses_nothing(files: dict[str, Any] | None) -> None:
    assert list_late_losses(_run(scenario_documents=files, steps_done=200)) == []
