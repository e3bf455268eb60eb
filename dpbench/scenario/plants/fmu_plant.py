"""An FMU as the plant of a scenario: one instance a run, stepped without any copy by FMPy.

    sample k:   set inputs, then `steps` times doStep, then get outputs

FMPy opens and initialises the instance. The calls of a step are prepared once: FMPy builds its
arguments anew at each call, which takes longer than a step of a ship.
"""

import ctypes
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.scenario.plants.contract import PlantError, PlantMaker
from dpbench.scenario.plants.fmu_interface import FmuInterface, hash_fmu, read_fmu_interface
from dpbench.scenario.tables.scenario_file import FmuTable
from dpbench.ship.estimation.estimator import TURN
from dpbench.ship.layout import HEADING
from dpbench.temporary_folders import process_temporary_folder

_WARNING = 1  # The largest status of FMI with which a call has succeeded
START_TOLERANCE = 1e-6
"""Largest distance of the first outputs from the start of a scenario [m, m/s, rad, rad/s]."""


@dataclass(frozen=True)
class FmuSource:
    """FMU that a scenario names; opened only where a loop of the scenario is run.

    steps : communication steps of the FMU in one sample.
    """

    table: FmuTable
    steps: int
    where: str

    @classmethod
    def from_table(cls, table: FmuTable, sample_s: float, where: str) -> "FmuSource":
        """Return the FMU of a scenario file; InputError for a step that does not fit the sample."""
        step_s = sample_s if table.step_s is None else table.step_s
        steps = round(sample_s / step_s)
        if not (steps >= 1 and abs(steps * step_s - sample_s) <= 1e-9 * sample_s):
            allowed = f"the sample time of {sample_s:.6g} s, or 1/2, 1/3, … of it"
            raise InputError(where, "plant.fmu.step_s", table.step_s, allowed)
        return cls(table, steps, where)

    def make_plant_maker(self, state: Vector, sample_s: float) -> PlantMaker:
        """Return a function that makes an instance, which starts at a state (6,), for one run."""
        return partial(FmuPlant.open, self, state, sample_s)


class FmuPlant:
    """Instance of an FMU that simulates a ship.

    state : (6,) outputs [u, v, r, n, e, ψ] after the last step, SI.
    """

    def __init__(
        self, fmu: Any, interface: FmuInterface, name: str, step_s: float, steps: int
    ) -> None:
        self.name, self.state = name, np.zeros(len(interface.outputs.references))
        self._fmu, self._version = fmu, interface.version
        self._step_s, self._steps, self._done = step_s, steps, 0
        self._si_per_unit = interface.outputs.si_per_unit
        self._per_si = 1.0 / interface.inputs.si_per_unit
        self._set, self._inputs = self._prepare("Set", interface.inputs.references)
        self._get, self._values = self._prepare("Get", interface.outputs.references)
        self._do = self._prepare_do_step()

    @classmethod
    def open(cls, source: FmuSource, state: Vector, sample_s: float) -> "FmuPlant":
        """Return a new instance of an FMU, initialised at a state (6,).

        PlantError where its file is not the one of the scenario, or it fails or starts elsewhere.
        """
        path, table = Path(source.table.file), source.table
        name = f"plant {path.name}"
        if not path.is_file() or hash_fmu(path) != table.sha256:
            found = f"{path} is missing, or not the file that was checked with the scenario"
            raise PlantError(name, found)
        interface = read_fmu_interface(path, table, source.where)
        steps, working_folder = source.steps, Path.cwd()
        try:
            fmu = _instantiate(interface, _extract(path, table.sha256))
            plant = cls(fmu, interface, name, sample_s / steps, steps)
        except Exception as error:  # FMPy raises bare exceptions
            raise PlantError(name, f"the FMU cannot be opened: {error}") from error
        finally:
            # Of a library that cannot be loaded FMPy stays in the folder.
            os.chdir(working_folder)
        plant._initialise(interface, state)
        return plant

    def step(self, u: Vector) -> None:
        """Advance the FMU by one sample under a force (3,) [N, N, N·m]; PlantError if it fails."""
        np.multiply(u, self._per_si, out=self._inputs)
        status = self._set()
        if status > _WARNING:
            raise self._describe_failure(status, "Set")
        for _ in range(self._steps):
            status = self._do(self._done * self._step_s)
            if status > _WARNING:
                raise self._describe_failure(status, "DoStep")
            self._done += 1
        self._read_state()

    def measure(self) -> Vector:
        """Return the state (6,), which is what the FMU's outputs show."""
        return self.state

    def close(self) -> None:
        """Free the instance; a failure to end well is no fault of the run."""
        try:
            self._fmu.terminate()
            self._fmu.freeInstance()
        except Exception:  # FMPy's are bare, and after an error an FMU may refuse to end
            pass

    def _initialise(self, interface: FmuInterface, state: Vector) -> None:
        """Set parameters and start, initialise, and read the first state."""
        fmu, start = self._fmu, interface.start
        values = state[list(interface.start_entries)] / start.si_per_unit
        try:
            if self._version == "2.0":
                fmu.setupExperiment(startTime=0.0)
            for references, numbers in (
                (interface.parameters, interface.values),
                (start.references, values),
            ):
                if references:
                    setter = fmu.setReal if self._version == "2.0" else fmu.setFloat64
                    setter(list(references), numbers.tolist())
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
        except Exception as error:  # FMPy raises bare exceptions
            raise PlantError(self.name, f"the FMU does not start: {error}".rstrip(".")) from error
        self._read_state()
        away = np.abs(self.state - state)
        away[HEADING] = abs(math.remainder(away[HEADING], TURN))
        if not (away <= START_TOLERANCE * np.maximum(1.0, np.abs(state))).all():
            raise PlantError(
                self.name,
                f"[u, v, r, n, e, ψ] starts at {self.state.round(6).tolist()} in the FMU, but at "
                f"{state.round(6).tolist()} in the scenario: name the FMU's start variables in "
                "plant.fmu.start, or change the initial state of the scenario",
            )

    def _read_state(self) -> None:
        """Read the state from the FMU's outputs, in SI."""
        status = self._get()
        if status > _WARNING:
            raise self._describe_failure(status, "Get")
        self.state = self._values * self._si_per_unit

    def _describe_failure(self, status: int, function: str) -> PlantError:
        """Return the error of a call that failed, by its status and the time in the run."""
        word = {2: "discard", 3: "error", 4: "fatal"}.get(status, f"status {status}")
        at = f"t = {self._done * self._step_s:.6g} s"
        return PlantError(self.name, f"the FMU returned {word!r} from {function} at {at}")

    def _prepare(self, verb: str, references: tuple[int, ...]) -> tuple[Callable[[], int], Vector]:
        """Return a function that sets or gets all variables at once, and their array."""
        count, values = len(references), np.zeros(len(references))
        at = (ctypes.c_uint * count)(*references), ctypes.c_size_t(count)
        where = values.ctypes.data_as(ctypes.c_void_p)
        given: tuple[Any, ...] = (ctypes.c_void_p(self._component), *at, where)
        function = f"fmi2{verb}Real"
        if self._version == "3.0":
            function, given = f"fmi3{verb}Float64", (*given, ctypes.c_size_t(count))
        return partial(self._find(function), *given), values

    def _prepare_do_step(self) -> Callable[[float], int]:
        """Return a function of time [s] that advances the FMU by one of its steps."""
        component, number = ctypes.c_void_p(self._component), ctypes.c_double
        h = number(self._step_s)
        if self._version == "2.0":
            do, true = self._find("fmi2DoStep"), ctypes.c_int(1)
            return lambda t: do(component, number(t), h, true)
        function, yes = self._find("fmi3DoStep"), ctypes.c_bool(True)
        event, ended, early = ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool()
        last = number()
        facts = *(ctypes.byref(flag) for flag in (event, ended, early)), ctypes.byref(last)

        def advance(t: float) -> int:
            status: int = function(component, number(t), h, yes, *facts)
            if ended.value or early.value:
                raise PlantError(self.name, f"the FMU ended its simulation at t = {t:.6g} s")
            return status

        return advance

    @property
    def _component(self) -> int:
        """Address of the instance."""
        component = self._fmu.component
        return int(getattr(component, "value", component))

    def _find(self, name: str) -> Callable[..., int]:
        """Return a function of the FMU's library, as C returns its status."""
        # By its index it is a new object: the one by attribute is FMPy's, with types of its own.
        function: Callable[..., int] = self._fmu.dll[name]
        return function


@cache
def _extract(path: Path, sha256: str) -> Path:
    """Return a folder of this process with the contents of an FMU; its checksum is a part of it."""
    import fmpy

    folder = Path(mkdtemp(prefix=f"fmu-{sha256[:8]}-", dir=process_temporary_folder()))
    try:
        fmpy.extract(str(path), unzipdir=str(folder))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def _instantiate(interface: FmuInterface, folder: Path) -> Any:
    """Return FMPy's object of a new instance, which prints nothing."""
    from fmpy import fmi1, fmi2, fmi3

    given = {
        "guid": interface.token,
        "unzipDirectory": str(folder),
        "modelIdentifier": interface.identifier,
        "instanceName": "dpbench",
    }
    if interface.version == "3.0":
        fmu = fmi3.FMU3Slave(**given)
        fmu.instantiate(logMessage=_drop_message)
        return fmu
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_drop_message)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi1.calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi1.free)
    fmu = fmi2.FMU2Slave(**given)
    fmu.instantiate(callbacks=callbacks)
    return fmu


def _drop_message(*message: object) -> None:
    """Drop a message of an FMU: what fails is in the status of its calls."""
