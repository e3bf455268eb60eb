"""`design.json`: what was found of controllers in ships, and what could not be and why."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter, ValidationError

from dpbench.bench.design.region_of_attraction import RegionOfAttraction
from dpbench.bench.record.result_folder import write_json
from dpbench.errors import ResultsError

DESIGN_FILE = "design.json"
DESIGN_SCHEMA = 1

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class DesignRecord:
    """What was found of a design, in SI units on the ship's own scale.

    Parameters
    ----------
    vessel, controller : names of the vessel and of the scenario the controller is that of.
    tuning, terminal, N_p, N_c, sample_s : of the controller.
    length_m, model_scale : of the vessel; 1 : model_scale, 1 is full size.
    ramp_s : from no force to all of it at the limits of rate, the slowest axis.
    eigenvalues : real and imaginary parts of the closed loop without limits, by falling modulus.
    spectral_radius : the largest modulus.
    K_mpc, K_y : rows of the gains (paper eq. 33).
    controllable : dimension of the controllable subspace, of so many `states`.
    condition_scaled, condition_si : condition numbers of P.
    regions : one for each weather.
    wall_s : what finding all this took.
    """

    vessel: str
    controller: str
    tuning: str
    terminal: str
    N_p: int
    N_c: int
    sample_s: float
    length_m: float
    model_scale: float
    ramp_s: float
    eigenvalues: tuple[tuple[float, float], ...]
    spectral_radius: float
    K_mpc: Rows
    K_y: Rows
    states: int
    controllable: int
    condition_scaled: float
    condition_si: float
    regions: tuple[RegionOfAttraction, ...]
    wall_s: float


@dataclass(frozen=True)
class MissingDesign:
    """A design that could not be looked into, and why."""

    vessel: str
    controller: str
    reason: str


@dataclass(frozen=True)
class Designs:
    """The content of `design.json`."""

    # A key too many or a number that is none is damage.
    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    schema: int
    records: tuple[DesignRecord, ...]
    missing: tuple[MissingDesign, ...]

    @classmethod
    def of(cls, records: Iterable[DesignRecord], missing: Iterable[MissingDesign] = ()) -> Designs:
        """Such records in the schema of today."""
        return cls(DESIGN_SCHEMA, tuple(records), tuple(missing))


def write_design(folder: Path, designs: Designs | None) -> None:
    """Write `design.json`, whole or not at all; None removes one that is there."""
    path = folder / DESIGN_FILE
    if designs is None:
        path.unlink(missing_ok=True)
    else:
        write_json(path, asdict(designs))


def load_design(folder: str | Path) -> Designs | None:
    """Read the `design.json` of a result folder; None where there is none.

    Raises
    ------
    ResultsError : naming file and key, when it is damaged or of another schema.
    """
    path = Path(folder) / DESIGN_FILE
    return read_designs(path) if path.exists() else None


def read_designs(path: Path) -> Designs:
    """Read a file that holds designs; ResultsError as `load_design`."""
    where = str(path)
    try:
        text = path.read_text(encoding="utf-8")
        document = json.loads(text)
    except OSError as error:
        raise ResultsError(where, "", error.strerror or "unreadable", "a JSON file") from error
    except ValueError as error:
        raise ResultsError(where, "", f"no JSON ({error})", "a JSON document") from error
    if not isinstance(document, dict):
        raise ResultsError(where, "", type(document).__name__, "a JSON object")
    if document.get("schema") != DESIGN_SCHEMA:
        found = f"schema {document.get('schema')}"
        raise ResultsError(where, "schema", found, f"schema {DESIGN_SCHEMA}; run again")
    try:
        return TypeAdapter(Designs).validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        found = "nothing" if first["type"] == "missing" else repr(first["input"])[:80]
        allowed = f"what `dpbench run` writes ({first['msg']}); run again"
        raise ResultsError(where, key, found, allowed) from error
