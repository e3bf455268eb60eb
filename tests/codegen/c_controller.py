"""A generated controller, compiled and called: it steers the simulated ship."""

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest

from dpbench.arrays import Matrix, Vector
from dpbench.codegen.controller_data import ControllerData, list_thruster_states_by_sample
from dpbench.scenario.controllers.controller import stack_lower_and_upper_limits
from dpbench.ship.plant import SUBSTEPS, Sensors, ShipPlant

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
MOST_BYTES = 2**20


def compile_c(folder: Path, out: Path, *options: str, warnings: Sequence[str] = WARNINGS) -> Path:
    """Compile all C sources of a folder with gcc, warnings being errors."""
    sources = sorted(str(path) for path in folder.glob("*.c"))
    common = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", *warnings]
    subprocess.run([*common, *options, "-o", str(out), *sources, "-lm"], check=True)
    return out


class SteppedController(Protocol):
    """A controller that is stepped with the inputs of a sample."""

    def step(self, numbers: Vector) -> tuple[Vector, int]:
        """Return command and status."""


class CController:
    """The controller of a folder by its C interface; it is compiled once."""

    def __init__(self, folder: Path, data: ControllerData, applied: Vector) -> None:
        library = folder / "step.so"
        if not library.exists():
            compile_c(folder, library, "-shared", "-fPIC")
        self._library = ctypes.CDLL(str(library))
        self._memory = ctypes.create_string_buffer(MOST_BYTES)
        self._data, self._n_u = data, len(data.du_max)
        self._library.controller_start(self._memory, applied.ctypes.data_as(ctypes.c_void_p))

    def step(self, numbers: Vector) -> tuple[Vector, int]:
        """Return command and status for the inputs of a sample, in the order of the header."""
        count = sum(not signal.is_integer for signal in self._data.inputs)
        given = numbers[:count].tobytes() + numbers[count:].astype(np.intc).tobytes()
        answer = ctypes.create_string_buffer(8 * self._n_u + 16)
        self._library.controller_step(self._memory, given, answer)
        status = int(np.frombuffer(answer, dtype=np.intc, offset=8 * self._n_u)[0])
        return np.frombuffer(answer, count=self._n_u).copy(), status


def steer(data: ControllerData, controller: SteppedController, steps: int) -> Matrix:
    """Return the commands (K, n_u) of a compiled controller that steers the simulated ship."""
    scenario = data.scenario.truncate(steps)
    weather, sample_s = scenario.environment, scenario.sample_s
    loads, actuators = weather.wind_and_drift_coefficients(scenario.vessel), scenario.actuators
    ship = scenario.true_ship
    plant = ShipPlant(ship, scenario.first_state, sample_s, loads=loads, actuators=actuators)
    sea, sensors = (
        weather.build_weather_table_at_stages(steps, sample_s, SUBSTEPS),
        Sensors(weather, steps, sample_s),
    )
    reference = scenario.build_reference_table(steps)
    limits = stack_lower_and_upper_limits(
        scenario.controller.list_planned_force_limits_by_sample(steps)
    )
    lost = list_thruster_states_by_sample(scenario.controller, steps)
    state = np.hstack(limits) if data.thrusters is None else lost
    commands = np.zeros((steps, len(data.du_max)))
    for k in range(steps):
        measured = sensors.measure_state(plant.state, k)
        numbers = np.concatenate([measured, reference[k], state[k]])
        commands[k], _ = controller.step(numbers)
        plant.advance_by_one_sample(commands[k], sea[k])
    return commands
