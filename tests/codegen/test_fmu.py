"""The controller as an FMU: valid, and it steers the ship as the Python loop does."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench.arrays import Vector
from dpbench.cli.main import main
from dpbench.codegen.controller_data import (
    ControllerData,
    read_controller_data_of_scenario,
    record_closed_loop_trajectory,
)
from dpbench.codegen.fmu import SYSTEMS, list_fmu_variables
from dpbench.codegen.generate import generate_controller
from dpbench.scenario.scenario import load_scenario
from tests.codegen.c_controller import steer

PACKAGES = ("fmpy", "ziglang")
missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(missing), reason=f"{missing} not installed: extras embedded and fmi"),
]
STEPS = 1000


class FmuController:
    """An FMU by FMPy, stepped once a sample."""

    def __init__(self, path: Path, data: ControllerData, folder: Path) -> None:
        import fmpy

        fmpy.extract(str(path), unzipdir=str(folder))
        model = fmpy.read_model_description(str(path))
        facts = {
            "guid": model.guid,
            "modelIdentifier": model.coSimulation.modelIdentifier,
            "unzipDirectory": str(folder),
        }
        self.version = int(model.fmiVersion[0])
        self.fmu: Any = self._open(facts)
        self.k, self._sample_s, self._data = 0, data.scenario.sample_s, data
        variables = list_fmu_variables(data)
        self._inputs = [v for v in variables if v.causality == "input"]
        self._commands = [v.reference for v in variables if v.name.startswith("command_")]
        self._status = next(v.reference for v in variables if v.name == "status")

    def _open(self, facts: dict[str, Any]) -> Any:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        fmu = FMU2Slave(**facts) if self.version == 2 else FMU3Slave(**facts)
        fmu.instantiate()
        if self.version == 2:
            fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        return fmu

    def step(self, numbers: Vector) -> tuple[Vector, int]:
        """Return command and status for the inputs of a sample."""
        fmu, is_2 = self.fmu, self.version == 2
        for v, x in zip(self._inputs, numbers.tolist(), strict=True):
            if v.is_integer:
                (fmu.setInteger if is_2 else fmu.setInt32)([v.reference], [int(x)])
            else:
                (fmu.setReal if is_2 else fmu.setFloat64)([v.reference], [x])
        now = self.k * self._sample_s
        fmu.doStep(currentCommunicationPoint=now, communicationStepSize=self._sample_s)
        self.k += 1
        status = (fmu.getInteger if is_2 else fmu.getInt32)([self._status])[0]
        return np.array((fmu.getReal if is_2 else fmu.getFloat64)(self._commands)), status

    def close(self) -> None:
        """End the FMU and free its library."""
        self.fmu.terminate()
        self.fmu.freeInstance()


@pytest.fixture(scope="module", params=[(3, "paper"), (2, "thrusters_loss")])
def built(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, ControllerData]:
    """An FMU of a scenario's controller."""
    version, name = request.param
    folder = tmp_path_factory.mktemp("fmu")
    path = folder / f"{name}.fmu"
    generate_controller(name, out=folder / "sources", steps=3, fmu=path, fmi=version, counts=False)
    return path, read_controller_data_of_scenario(load_scenario(name))


def test_an_fmu_is_valid(built: tuple[Path, ControllerData]) -> None:
    """FMPy finds nothing wrong, and there is a library for each system."""
    from fmpy import read_model_description
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(built[0])) == []
    model = read_model_description(str(built[0]))
    names = zipfile.ZipFile(built[0]).namelist()
    for place, _, ending in SYSTEMS[int(model.fmiVersion[0])]:
        assert f"binaries/{place}/{model.coSimulation.modelIdentifier}{ending}" in names
    units = {variable.name: variable.unit for variable in model.modelVariables}
    assert (units["heading"], units["yaw_rate"], units["north"]) == ("rad", "rad/s", "m")


def test_an_fmu_steers_as_the_python_loop(
    built: tuple[Path, ControllerData], tmp_path: Path
) -> None:
    """Every command of the closed loop is within 1e-9 of the maximum increment."""
    path, data = built
    expected = record_closed_loop_trajectory(data, "paper_active_set", STEPS).commands
    controller = FmuController(path, data, tmp_path)
    commands = steer(data, controller, len(expected))
    controller.close()
    assert np.abs((commands - expected) / data.du_max).max() < 1e-9


def test_a_restored_state_goes_on_as_before(
    built: tuple[Path, ControllerData], tmp_path: Path
) -> None:
    """Saved as bytes and set again, the same inputs lead to the same commands."""
    path, data = built
    inputs = record_closed_loop_trajectory(data, "paper_active_set", 40).inputs
    controller = FmuController(path, data, tmp_path)
    fmu, is_2 = controller.fmu, controller.version == 2
    for numbers in inputs[:20]:
        controller.step(numbers)
    state = fmu.getFMUstate() if is_2 else fmu.getFMUState()
    stored = (fmu.serializeFMUstate if is_2 else fmu.serializeFMUState)(state)
    (fmu.freeFMUstate if is_2 else fmu.freeFMUState)(state)
    first = [controller.step(numbers)[0] for numbers in inputs[20:]]
    again = (fmu.deSerializeFMUstate if is_2 else fmu.deserializeFMUState)(stored)
    (fmu.setFMUstate if is_2 else fmu.setFMUState)(again)
    (fmu.freeFMUstate if is_2 else fmu.freeFMUState)(again)
    controller.k = 20
    second = [controller.step(numbers)[0] for numbers in inputs[20:]]
    controller.close()
    assert np.array_equal(first, second)
    assert not np.array_equal(first[0], first[-1])


@pytest.mark.skipif(
    shutil.which("wine") is None, reason="Wine, which loads a Windows library, is not installed"
)
def test_the_library_for_windows_gives_the_same_commands(
    built: tuple[Path, ControllerData], tmp_path: Path
) -> None:
    """Loaded by a program of Windows, its commands are those of the Python loop."""
    import fmpy

    path, data = built
    expected = record_closed_loop_trajectory(data, "paper_active_set", STEPS)
    fmpy.extract(str(path), unzipdir=str(tmp_path))
    model = fmpy.read_model_description(str(path))
    version = int(model.fmiVersion[0])
    target = ["-target", "x86_64-windows-gnu"]
    source = Path(__file__).with_name("fmu_host.c")
    host = [sys.executable, "-m", "ziglang", "cc", "-std=c99", str(source), *target]
    subprocess.run([*host, "-o", "host.exe"], cwd=tmp_path, check=True)
    np.ascontiguousarray(expected.inputs).tofile(tmp_path / "inputs")
    place = next(place for place, _, ending in SYSTEMS[version] if ending == ".dll")
    words = [version, f"binaries/{place}/{model.coSimulation.modelIdentifier}.dll", model.guid]
    words += [
        data.scenario.sample_s,
        "inputs",
        "commands",
        *(x.shape[1] for x in (expected.inputs, expected.commands)),
    ]
    settings = {"WINEDEBUG": "-all", "WINEPREFIX": str(tmp_path / "wine")}
    command = ["wine", "host.exe", *map(str, words)]
    subprocess.run(command, cwd=tmp_path, check=True, env={**os.environ, **settings})
    commands = np.fromfile(tmp_path / "commands").reshape(expected.commands.shape)
    assert np.abs((commands - expected.commands) / data.du_max).max() < 1e-9


def test_a_version_that_does_not_exist_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line."""
    words = ["--out", str(tmp_path / "c"), "--fmu", str(tmp_path / "x.fmu"), "--fmi", "1"]
    assert main(["codegen", "paper", *words]) == 2
    assert capsys.readouterr().err == "dpbench: --fmi: found 1; allowed: 2 or 3\n"
