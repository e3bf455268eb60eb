"""An FMU as the plant: the project's own ship as one behaves as in the Python loop."""

import sys
from pathlib import Path

import numpy as np
import pytest

from dpbench import PlantError, load_scenario, run_closed_loop
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.scenario.plants.fmu_plant import FmuPlant
from dpbench.scenario.scenario import Scenario
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from tests.scenario.plants.fmus import FAULTS, needs_fmi, write_scenario

pytestmark = needs_fmi
FORCE = np.array([2e4, -3e4, 4e5])


def scenario_with(fmu: Path, folder: Path, **given: object) -> Scenario:
    """The scenario `paper` with an FMU for its ship."""
    return load_scenario(write_scenario(folder, str(fmu), **given))


def opened(scenario: Scenario) -> FmuPlant:
    """An instance of the FMU of a scenario."""
    assert scenario.fmu is not None
    plant = scenario.fmu.make_plant_maker(scenario.first_state, scenario.sample_s)()
    assert isinstance(plant, FmuPlant)
    return plant


@pytest.mark.parametrize("steps", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_own_ship_as_an_fmu_equals_the_python_loop(
    fmu: Path, tmp_path: Path, steps: int
) -> None:
    scenario = scenario_with(fmu, tmp_path).truncate(steps)
    own, theirs = (
        solve_loop_exactly(case) for case in (load_scenario("paper").truncate(steps), scenario)
    )
    assert np.abs(own.state - theirs.state).max() < 1e-9
    assert np.abs((own.tau - theirs.tau) / scenario.vessel.tau_max).max() < 1e-9


def test_its_own_step_is_a_fraction_of_the_sample(fmu: Path, tmp_path: Path) -> None:
    scenario = scenario_with(fmu, tmp_path, extra="step_s = 0.1", weather=False)
    plant, state = opened(scenario), scenario.first_state
    # Three steps of 0.1 s have as many sub-steps together as a plant with three times as many.
    ship = ShipPlant(scenario.true_ship, state, 0.3, 3 * SUBSTEPS)
    for _ in range(5):
        plant.step(FORCE)
        ship.advance_by_one_sample(FORCE, np.zeros((6 * SUBSTEPS + 1, 3)))
    assert np.abs(plant.state - ship.state).max() < 1e-12
    plant.close()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("error", r"the FMU returned 'error' from DoStep at t = 3 s"),
        ("nan", r"the state is not finite after .*: state = \[ *nan"),
        ("at start", "the FMU does not start"),
    ],
)
def test_a_fault_of_the_fmu_is_told_with_its_name(
    fmu2: Path, tmp_path: Path, fault: str, words: str
) -> None:
    path = write_scenario(tmp_path, str(fmu2))
    with path.open("a") as file:
        file.write(f"fault = {FAULTS[fault]}.0\nfault_s = 3.0\n")
    with pytest.raises(PlantError, match=rf"plant ship2\.fmu: {words}"):
        run_closed_loop(path, "daqp", steps=20)


def test_an_fmu_that_starts_elsewhere_is_refused(fmu2: Path, tmp_path: Path) -> None:
    path = write_scenario(tmp_path, str(fmu2))
    path.write_text(path.read_text().replace(', east = "e0"', ""))
    with pytest.raises(
        PlantError, match=r"starts at .*1\.2, 0\.0.* name the FMU's start variables"
    ):
        run_closed_loop(path, "daqp", steps=2)


def test_a_file_that_was_replaced_is_not_opened(fmu2: Path, tmp_path: Path) -> None:
    copy = tmp_path / "ship.fmu"
    copy.write_bytes(fmu2.read_bytes())
    scenario = scenario_with(copy, tmp_path)
    copy.write_bytes(fmu2.read_bytes() + b"\n")
    with pytest.raises(PlantError, match="missing, or not the file that was checked"):
        run_closed_loop(scenario, "daqp", steps=2)


def test_without_fmpy_the_extra_is_named(
    fmu2: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ValueError, match=r"pip install 'dpbench\[fmi\]'"):
        scenario_with(fmu2, tmp_path)
