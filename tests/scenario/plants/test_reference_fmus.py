"""The Reference-FMUs of the Modelica Association, where a user has them.

`DPBENCH_REFERENCE_FMUS` names the folder of a release of https://github.com/modelica/Reference-FMUs
or of its build; without it these tests are skipped. They are no ships: their states stand in for
the six of one, and each is compared with explicit Euler steps, which is how they integrate.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench import InputError, load_scenario
from dpbench.scenario.plants import fmu_plant
from dpbench.scenario.plants.fmu_interface import FmuInterface, FmuVariables, hash_fmu
from dpbench.scenario.plants.fmu_plant import FmuSource
from dpbench.scenario.tables.scenario_file import FmuTable
from tests.scenario.plants.fmus import needs_fmi, write_scenario

FOLDER = os.environ.get("DPBENCH_REFERENCE_FMUS", "")
FMUS = sorted(path for path in Path(FOLDER).rglob("*.fmu") if FOLDER)
pytestmark = [
    needs_fmi,
    pytest.mark.skipif(not FMUS, reason="DPBENCH_REFERENCE_FMUS names no folder with FMUs"),
]
Derivative = Callable[[Any], list[float]]
MODELS: dict[str, tuple[dict[str, float], float, Derivative]] = {
    "Dahlquist": ({"x": 1.0}, 0.1, lambda x: [-x[0]]),
    "VanDerPol": ({"x0": 2.0, "x1": 0.0}, 0.01, lambda x: [x[1], (1 - x[0] ** 2) * x[1] - x[0]]),
    "BouncingBall": ({"h": 1.0, "v": 0.0}, 1e-3, lambda x: [x[1], -9.81]),
}
"""States with their start, internal step [s] and derivative. The ball falls for 0.45 s."""


def describe(path: Path) -> Any:
    """The model description of an FMU."""
    from fmpy.model_description import read_model_description

    return read_model_description(str(path), validate=False)


def can_be_opened(path: Path, name: str) -> bool:
    """Return whether an FMU is one of a model, in a version that dpbench co-simulates."""
    return path.stem == name and describe(path).fmiVersion in ("2.0", "3.0")


@pytest.mark.parametrize("name", MODELS)
def test_steps_are_those_of_euler(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [path for path in FMUS if can_be_opened(path, name)]
    assert paths, f"{FOLDER} has no {name}.fmu of FMI 2.0 or 3.0"
    start, internal_s, derivative = MODELS[name]
    repeats = 6 // len(start)
    for path in paths:
        described = describe(path)
        known = {v.name: v.valueReference for v in described.modelVariables}
        none = FmuVariables((), np.zeros(0))
        states = FmuVariables(tuple(known[x] for x in start) * repeats, np.ones(6))
        interface = FmuInterface(
            described.fmiVersion,
            described.guid,
            described.coSimulation.modelIdentifier,
            **{"inputs": none, "outputs": states, "start_entries": (), "start": none},
            **{"parameters": (), "values": np.zeros(0)},
        )
        monkeypatch.setattr(fmu_plant, "read_fmu_interface", lambda *_, made=interface: made)
        table = FmuTable.model_construct(file=str(path), sha256=hash_fmu(path))
        state = np.array([*start.values()])
        plant = FmuSource(table, 2, "test").make_plant_maker(np.tile(state, repeats), 0.2)()
        for _ in range(2):
            for _ in range(round(0.2 / internal_s)):
                state = state + internal_s * np.array(derivative(state))
            plant.step(np.zeros(0))
            assert np.abs(plant.state.reshape(repeats, -1) - state).max() < 1e-9, path
        plant.close()


def test_what_no_ship_can_be_is_said_as_it_is_read(tmp_path: Path) -> None:
    """Each is refused for its version, for no co-simulation, or for the inputs it does not have."""
    for path in FMUS:
        with pytest.raises(InputError) as caught:
            load_scenario(write_scenario(tmp_path, str(path)))
        message = str(caught.value)
        assert path.name in message and "\n" not in message
        assert any(
            text in message
            for text in ("FMI 1.0", "no co-simulation", "'Fx', which", "invalid FMU", "for linux64")
        ), message
