"""The design of the paper's controller: region, poles, and the processes they are found in."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpbench import load_scenario
from dpbench.bench.design.design import Design, plan_designs
from dpbench.bench.design.design_file import Designs
from dpbench.bench.design.region_of_attraction import verdict
from dpbench.bench.design.run_designs import WORK, DesignStore, run_designs, work_of_designs
from dpbench.bench.plan.suite import DesignTable
from dpbench.bench.progress import Silent
from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.bench.workers.child import template_context
from dpbench.errors import CertificateError, InputError
from dpbench.qp.referee.referee import certify
from dpbench.scenario.problem_files import problems_root
from dpbench.scenario.scenario import Scenario, condense, scenario_of

pytestmark = pytest.mark.alone

TABLE = DesignTable(controllers=["paper"], vessels=["supply_fs99"])


def campaign(designs: list[Design], store: DesignStore, folder: Path) -> Designs:
    cores = sorted(os.sched_getaffinity(0))
    return run_designs(
        designs,
        store,
        context=template_context(),
        folder=folder,
        cores=cores,
        progress=Silent(),
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> DesignStore:
    """Where finished designs are kept."""
    return DesignStore(tmp_path_factory.mktemp("cells"), "machine")


@pytest.fixture(scope="module")
def found(store: DesignStore, tmp_path_factory: pytest.TempPathFactory) -> Designs:
    """The paper's controller in the paper's ship, looked into in a process of its own."""
    return campaign(plan_designs(TABLE), store, tmp_path_factory.mktemp("noise"))


@pytest.fixture(scope="module")
def still() -> Scenario:
    """Trials of the paper's controller in still water."""
    files = plan_designs(TABLE)[0].files
    return scenario_of(files | {"scenario": files["scenario"] | {"environment": {}}})


def test_the_paper_holds_1_65_m_and_not_1_8_m(still: Scenario) -> None:
    """In still water the paper's 30/5 brings the ship back from 1.65 m and not from 1.8 m."""
    assert verdict(still, 1.65) == "holds"
    assert verdict(still, 1.8) == "fails"


def test_what_it_does_not_hold_ends_in_a_limit_cycle_of_some_five_metres(still: Scenario) -> None:
    """From 1.8 m the ship neither comes back nor leaves: it circles 5 to 6 m away."""
    state = solve_exactly(replace(still, start=np.array([0.0, 1.8, 0.0]))).state
    away = np.hypot(state[-200:, 3], state[-200:, 4])
    assert 5.0 < away.max() < 6.0


def test_the_region_of_attraction_of_the_paper_lies_between_the_two(found: Designs) -> None:
    """The edge in still water is bracketed within 1.65 to 1.8 m, to 5 %; no offset holds beyond."""
    region = found.records[0].regions[0]
    assert region.weather == "still water"
    assert region.bracket.fails_m is not None
    assert 1.65 <= region.bracket.holds_m < region.bracket.fails_m <= 1.8
    assert region.bracket.fails_m - region.bracket.holds_m <= 0.05 * region.bracket.fails_m
    assert region.bracket.above_m == ()


def test_weather_makes_the_region_of_attraction_smaller_from_one_side(found: Designs) -> None:
    """In the weather of `calm`, which pushes to starboard, port is the side that fails first."""
    still, calm = (region.bracket for region in found.records[0].regions)
    assert calm.edge is not None
    assert calm.edge.side == "port"
    assert calm.holds_m < still.holds_m


def test_the_eigenvalues_are_the_poles_of_the_loop_the_optima_close(found: Designs) -> None:
    """Stepping the model with the certified optimum from each unit state gives the same poles."""
    builder = condense(load_scenario("paper"))
    model = builder.control.model
    columns = []
    for x in np.eye(9):
        # So small that no limit is active; the loop is linear there.
        step = builder.emit(1e-6 * x, np.zeros(3), np.zeros(3))
        move = builder.moves(certify(builder.problem(step)).z)[0]
        columns.append(model.A @ x + model.B @ (1e6 * move))
    poles = np.linalg.eigvals(np.column_stack(columns))
    recorded = np.array([complex(*root) for root in found.records[0].eigenvalues])
    # Nearest pole, as conjugates may come in any order; certified z is good to 1e-13.
    distance = np.abs(poles[:, None] - recorded[None, :])
    assert distance.min(axis=0).max() < 1e-6
    assert distance.min(axis=1).max() < 1e-6
    assert found.records[0].spectral_radius == pytest.approx(np.abs(poles).max(), abs=1e-6)


def test_the_record_knows_its_ship_and_controller(found: Designs) -> None:
    """The horizon of 9 s is shorter than the 11.4 s from no thrust to full."""
    record = found.records[0]
    assert (record.vessel, record.controller) == ("supply_fs99", "paper")
    assert record.N_p * record.sample_s == pytest.approx(9.0)
    assert record.ramp_s == pytest.approx(11.4, abs=0.05)
    assert (record.controllable, record.states) == (9, 9)


def test_a_step_without_a_certified_optimum_leaves_a_trial_undecided(
    still: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a certificate nothing is said about an offset."""

    def refuse(scenario: Scenario) -> None:
        raise CertificateError(f"{scenario.name}: step 0 has no certified optimum")

    monkeypatch.setattr("dpbench.bench.design.region_of_attraction.solve_exactly", refuse)
    assert verdict(still, 1.0) == "undecided"


def test_a_model_ship_is_tried_on_its_own_scale() -> None:
    """Time and tolerance follow Froude's law: at 1 : 70, 1 m holds, 1.25 m does not."""
    files = plan_designs(DesignTable(controllers=["paper"], vessels=["cybership2"]))[0].files
    scenario = scenario_of(files)
    assert scenario.steps == 2000
    assert verdict(scenario, 1.0 / 70.0) == "holds"
    assert verdict(scenario, 1.25 / 70.0) == "fails"


def test_a_finished_design_is_not_looked_into_again(
    found: Designs, store: DesignStore, tmp_path: Path
) -> None:
    """A second run takes the record from the cells folder and starts no process."""
    designs = plan_designs(TABLE)
    assert work_of_designs(designs, store) == 0
    assert campaign(designs, store, tmp_path) == found
    assert list(tmp_path.iterdir()) == []


def test_a_design_of_another_controller_machine_or_a_fresh_run_is_not_finished(
    found: Designs, store: DesignStore
) -> None:
    """The key of a record holds what it depends on."""
    (design,) = plan_designs(TABLE)
    (other,) = plan_designs(DesignTable(controllers=["rough"], vessels=["supply_fs99"]))
    cells = store.path(design).parent
    assert found.missing == ()
    assert store.finished(other) is None
    assert DesignStore(cells, "another").finished(design) is None
    assert work_of_designs([design], DesignStore(cells, "machine", fresh=True)) == WORK


def test_a_damaged_record_is_looked_into_again(
    found: Designs, store: DesignStore, tmp_path: Path
) -> None:
    """What an interrupted run left half written is not taken for a record."""
    (design,) = plan_designs(TABLE)
    again = DesignStore(tmp_path, "machine")
    text = store.path(design).read_text(encoding="utf-8")
    again.path(design).write_text(text[: len(text) // 2], encoding="utf-8")
    assert again.finished(design) is None
    again.path(design).write_text(text, encoding="utf-8")
    assert again.finished(design) == found.records[0]


def test_a_design_whose_process_fails_is_missing_with_the_reason(tmp_path: Path) -> None:
    """A crash ends no campaign: the design is named with the last words of its process."""
    (design,) = plan_designs(TABLE)
    broken = Design("paper", design.files | {"vessel": {}})
    designs = campaign([broken], DesignStore(tmp_path / "cells", "machine"), tmp_path)
    assert designs.records == ()
    (missing,) = designs.missing
    assert (missing.vessel, missing.controller) == ("supply_fs99", "paper")
    assert "this key is required" in missing.reason


@pytest.mark.parametrize(
    ("controllers", "vessels", "says"),
    [
        (["papre"], ["osv"], "'papre'"),
        (["paper"], ["osw"], "'osw'"),
        (["paper", "paper"], ["osv"], "'paper' twice"),
        (["paper"], ["osv", "osv"], "'osv' twice"),
        (["paper"], ["no/such.toml"], "no/such.toml"),
    ],
)
def test_a_bad_table_is_refused_before_anything_runs(
    controllers: list[str], vessels: list[str], says: str
) -> None:
    """An unknown name, or one given twice, is an error in one line."""
    with pytest.raises(InputError, match=says):
        plan_designs(DesignTable(controllers=controllers, vessels=vessels))


def test_files_beside_the_suite_are_designs_too(tmp_path: Path) -> None:
    """A person's own ship and controller are looked for beside the suite, with its own sample."""
    problems = problems_root()
    ship = (problems / "vessels" / "osv.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(ship, encoding="utf-8")
    text = (problems / "scenarios" / "rough.toml").read_text(encoding="utf-8")
    text = text.replace("sample_s = 0.3", "sample_s = 0.6")
    (tmp_path / "coarse.toml").write_text(text, encoding="utf-8")
    table = DesignTable(controllers=["coarse.toml"], vessels=["mine.toml"])
    (design,) = plan_designs(table, tmp_path)
    assert (design.controller, design.vessel) == ("coarse", "mine")
    scenario = scenario_of(design.files)
    assert (scenario.sample_s, scenario.steps, scenario.tuning) == (0.6, 1000, "robust")
