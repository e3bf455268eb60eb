"""The variables of an FMU that are a ship's, checked against its model description.

Nothing of the FMU runs here: only its XML is read.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.files.regular_files import open_regular_file
from dpbench.scenario.tables.scenario_file import FmuTable

STATE_NAMES = ("surge", "sway", "yaw", "north", "east", "heading")
"""Names of [u, v, r, n, e, ψ] in the tables of an FMU."""
FORCE_NAMES = ("surge", "sway", "yaw")
_VERSIONS = ("2.0", "3.0")
_WHAT = "a co-simulation FMU of FMI version 2.0 or 3.0"
_REAL = ("Real", "Float64")
# Exponents of kg, m, s; those of rad are left out, as angles are often declared as numbers.
_FORCE, _MOMENT, _LENGTH, _ANGLE = (1, 1, -2), (1, 2, -2), (0, 1, 0), (0, 0, 0)
_SPEED, _RATE = (0, 1, -1), (0, 0, -1)
_FORCE_UNITS = (_FORCE, _FORCE, _MOMENT)
_STATE_UNITS = (_SPEED, _SPEED, _RATE, _LENGTH, _LENGTH, _ANGLE)
_SI_NAMES = {
    _FORCE: ("N",),
    _MOMENT: ("N.m", "N·m", "Nm", "N*m"),
    _LENGTH: ("m",),
    _ANGLE: ("rad", "1"),
    _SPEED: ("m/s",),
    _RATE: ("rad/s", "1/s"),
}


@dataclass(frozen=True, eq=False)
class FmuVariables:
    """Variables of an FMU: value references, and the SI value of one of each variable's unit."""

    references: tuple[int, ...]
    si_per_unit: Vector


@dataclass(frozen=True, eq=False)
class FmuInterface:
    """Needs of an instance of an FMU: version, names, and the variables that dpbench uses.

    inputs, outputs : force (3,) and state (6,) of the ship; start : entries of the state that are
    set, with their variables; parameters : variables, with their values.
    """

    version: str
    token: str
    identifier: str
    inputs: FmuVariables
    outputs: FmuVariables
    start_entries: tuple[int, ...]
    start: FmuVariables
    parameters: tuple[int, ...]
    values: Vector


def hash_fmu(path: Path) -> str:
    """Return the SHA-256 of an FMU; InputError where it cannot be read."""
    with open_regular_file(path, _WHAT) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_fmu_interface(path: Path, table: FmuTable, where: str) -> FmuInterface:
    """Return the variables of an FMU that a scenario names, from its model description.

    InputError, naming `where`, key, found and allowed, for no co-simulation FMU of this system, a
    missing variable, or one of a wrong causality, type or unit.
    """
    described = _read_description(path, where)
    reader = _VariableReader(described, path.name, where)
    start = {name: getattr(table.start, name) for name in STATE_NAMES}
    given = {name: variable for name, variable in start.items() if variable is not None}
    return FmuInterface(
        described.fmiVersion,
        described.guid,
        described.coSimulation.modelIdentifier,
        reader.read_all("inputs", table.inputs.model_dump(), FORCE_NAMES, _FORCE_UNITS, "input"),
        reader.read_all("outputs", table.outputs.model_dump(), STATE_NAMES, _STATE_UNITS, "output"),
        tuple(STATE_NAMES.index(name) for name in given),
        reader.read_all("start", given, tuple(given), _units_of(given), "start"),
        tuple(
            reader.find(f"parameters.{name}", name, "parameter").valueReference
            for name in table.parameters
        ),
        np.array([*table.parameters.values()], dtype=np.float64),
    )


def _units_of(names: Mapping[str, str]) -> Sequence[tuple[int, int, int]]:
    """Return the units of entries of the state."""
    return [_STATE_UNITS[STATE_NAMES.index(name)] for name in names]


def _read_description(path: Path, where: str) -> Any:
    """Return the model description of an FMU; InputError unless this system can co-simulate it."""
    key = "plant.fmu.file"
    try:
        import fmpy
        from fmpy.model_description import read_model_description
    except ModuleNotFoundError:
        fault = "an FMU needs FMPy, which is not installed: run `pip install 'dpbench[fmi]'`"
        raise SituationError(f"{where}: {key}", fault) from None
    try:
        described, systems = read_model_description(str(path)), fmpy.supported_platforms(str(path))
    except Exception as error:  # FMPy's are bare; zipfile and lxml raise their own
        lines = str(error).split("\n- ")
        fault = " ".join(lines[:2]) + f"; and {len(lines) - 2} more" * (len(lines) > 2)
        raise InputError(where, key, f"{path.name}, an invalid FMU ({fault})", _WHAT) from error
    version = str(described.fmiVersion)
    if version not in _VERSIONS:
        raise InputError(where, key, f"FMI {version} in {path.name}", _WHAT)
    if described.coSimulation is None:
        raise InputError(where, key, f"{path.name}, which has no co-simulation interface", _WHAT)
    system = fmpy.platform_tuple if version == "3.0" else fmpy.platform
    if system not in systems and fmpy.platform not in systems:
        found = f"{path.name} for {', '.join(systems) or 'no system'}"
        raise InputError(where, key, found, f"an FMU for {system}")
    return described


class _VariableReader:
    """Reader of an FMU's variables by name, which refuses those that do not fit."""

    def __init__(self, described: Any, name: str, where: str) -> None:
        self._variables = {v.name: v for v in described.modelVariables}
        self._units = {unit.name: unit.baseUnit for unit in described.unitDefinitions}
        self._name, self._where = name, where

    def read_all(
        self,
        key: str,
        variables: Mapping[str, str],
        names: Sequence[str],
        units: Sequence[tuple[int, int, int]],
        use: str,
    ) -> FmuVariables:
        """Return the variables of several names, each with its physical dimension, in order."""
        found = [self.find(f"{key}.{name}", variables[name], use) for name in names]
        factors = [
            self._find_factor(f"{key}.{name}", variable, unit)
            for name, variable, unit in zip(names, found, units, strict=True)
        ]
        references = tuple(variable.valueReference for variable in found)
        return FmuVariables(references, np.array(factors, dtype=np.float64))

    def find(self, key: str, name: str, use: str) -> Any:
        """Return a variable by name; InputError for none, or of a wrong causality or type."""
        variable = self._variables.get(name)
        fitting = [v.name for v in self._variables.values() if _fits(v, use)]
        if variable is not None and variable.name in fitting:
            return variable
        found = f"{name!r}, which {self._name} does not have"
        if variable is not None:
            kind = f"{variable.type}{'' if not variable.shape else ' array'}"
            found = (
                f"{name!r}, which has causality {variable.causality} and type {kind} in "
                f"{self._name}"
            )
        word = "variable that can be set at the start" if use == "start" else use
        names = format_allowed_names(name, fitting) if fitting else "the FMU has none"
        raise InputError(self._where, f"plant.fmu.{key}", found, f"a real-valued {word}: {names}")

    def _find_factor(self, key: str, variable: Any, dimension: tuple[int, int, int]) -> float:
        """Return what 1 of a variable is in SI units; InputError for another dimension."""
        unit = variable.unit or (variable.declaredType and variable.declaredType.unit)
        si_names = _SI_NAMES[dimension]
        base = self._units.get(unit)
        if not unit or (base is None and unit in si_names):
            return 1.0
        allowed = (
            f"{si_names[0]}, another unit of the same dimension that {self._name} defines, or no "
            "unit"
        )
        if base is None:
            found = f"{variable.name!r} in {unit!r}, a unit that {self._name} does not define"
            raise InputError(self._where, f"plant.fmu.{key}", found, allowed)
        others = (base.A, base.K, base.mol, base.cd)
        if (base.kg, base.m, base.s) != dimension or any(others) or base.offset:
            found = f"{variable.name!r} in {unit!r}"
            raise InputError(self._where, f"plant.fmu.{key}", found, allowed)
        factor = float(base.factor)
        if not (math.isfinite(factor) and factor > 0.0):
            raise InputError(self._where, f"plant.fmu.{key}", f"a factor of {factor}", "above 0")
        return factor


def _fits(variable: Any, use: str) -> bool:
    """Return whether a variable of an FMU is a real number that can be used so."""
    if variable.type not in _REAL or variable.shape:
        return False
    if use == "start":
        return variable.causality == "parameter" or variable.initial in ("exact", "approx")
    return bool(variable.causality == use)
