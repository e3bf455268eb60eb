"""Hulls from files: a vessel structure of the MSS toolbox, or a table of coefficients.

**MSS** (Fossen & Perez, Marine Systems Simulator): a `.mat` file with a structure `vessel`, made by
its `veres2vessel` or `wamit2vessel`. Surge, sway and yaw are rows and columns 1, 2 and 6. The ship
of dynamic positioning is that of low frequency: M = MRB + A(ω₀) and D = B(ω₀) + Bv(ω₀) at the
lowest frequency of the file (Fossen 2021, chapter 6), at its first speed where it has several.

**Table**: a CSV file with the columns `coefficient,value` (and any further one, as for remarks):

    coefficient,value,remark
    length_m,82.8
    M11,7.0101e6,mass with added mass
    D22,8.8164e5

`length_m`, `breadth_m`, `draught_m` and `displacement_t` are the particulars; M11 M22 M26 M66 and
D11 D22 D26 D62 D66 are entries in SI units, numbered as the six degrees of freedom. Couplings may
be left out and are zero then, D62 is then D26.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix
from dpbench.errors import InputError, format_allowed_names
from dpbench.files.mat import read_mat_structure_in_child
from dpbench.files.regular_files import read_csv_rows

_Fields = Mapping[str, NDArray[Any]]
_NOTHING = np.zeros(0)
_SURGE_SWAY_YAW = np.ix_([0, 1, 5], [0, 1, 5])
NEXT_DIFFERS = 0.1
"""Relative change of the added mass to the next frequency from which on there is a remark."""

PARTICULARS = ("length_m", "breadth_m", "draught_m", "displacement_t")
REQUIRED = ("M11", "M22", "M66", "D11", "D22", "D66")
COUPLINGS = ("M26", "D26", "D62")


@dataclass(frozen=True, eq=False)
class Hull:
    """Inertia M and damping D (3, 3) [SI] read from a hull file, with main dimensions."""

    M: Matrix
    D: Matrix
    particulars: dict[str, float]
    method: str
    remarks: list[str] = field(default_factory=list)


def read_hull_from_mss_file(path: Path) -> Hull:
    """Return the hull in a `vessel` structure of the MSS toolbox, a MATLAB file."""
    names, vessel = read_mat_structure_in_child(path, "vessel")
    if not vessel:
        found = ", ".join(names)[:200] or "nothing"
        raise InputError(str(path), "vessel", found, "a structure `vessel` of the MSS toolbox")
    rigid = _read_numeric_field(vessel, path, "MRB")
    omega = np.atleast_1d(_read_numeric_field(vessel, path, "freqs")).ravel()
    added, potential = (
        _read_frequency_dependent_matrices(vessel, path, key, omega) for key in ("A", "B")
    )
    viscous = _read_viscous_damping_by_frequency(vessel, path, omega)
    if rigid.shape != (6, 6):
        raise InputError(str(path), "vessel.MRB", f"shape {rigid.shape}", "shape (6, 6)")
    lowest, *others = np.argsort(omega)
    M = (rigid + added[lowest])[_SURGE_SWAY_YAW]
    D = (potential[lowest] + viscous[lowest])[_SURGE_SWAY_YAW]
    first = f"{omega[lowest]:.3g} rad/s"
    remarks = []
    if others:
        here, there = (np.diag(added[k][_SURGE_SWAY_YAW]) for k in (lowest, others[0]))
        ratios = there / here
        if (np.abs(ratios - 1.0) > NEXT_DIFFERS).any():
            texts = ", ".join(f"{ratio:.2f}" for ratio in ratios)
            remarks.append(
                f"At the next frequency, {omega[others[0]]:.3g} rad/s, the added mass of surge, "
                f"sway, yaw is {texts} times that at {first}: strip theory may be weak there."
            )
    method = f"M = MRB + A and D = B + Bv of {path.name} at its lowest frequency, {first}"
    return Hull(M, D, _read_dimensions_and_displacement(vessel), method, remarks)


def _read_numeric_field(vessel: _Fields, path: Path, key: str) -> Matrix:
    """Return a hull file's field as finite floats; InputError if it is missing or not numeric."""
    array = vessel.get(f"vessel.{key}", _NOTHING)
    if not array.size:
        found = "no numbers" if f"vessel.{key}" in vessel else "nothing"
        raise InputError(str(path), f"vessel.{key}", found, "an array of numbers")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(str(path), f"vessel.{key}", "NaN or infinity", "finite numbers")
    return array


def _read_frequency_dependent_matrices(
    vessel: _Fields, path: Path, key: str, omega: Matrix
) -> Matrix:
    """Return a hull file's frequency-dependent matrices (frequencies, 6, 6) at the first speed."""
    array = _read_numeric_field(vessel, path, key)
    # One frequency alone loses its axis in MATLAB.
    array = array[:, :, np.newaxis] if array.ndim == 2 else array
    array = array[..., 0] if array.ndim == 4 else array
    if array.shape != (6, 6, omega.size):
        expected = f"shape (6, 6, {omega.size}), as there are {omega.size} frequencies"
        raise InputError(str(path), f"vessel.{key}", f"shape {array.shape}", expected)
    return np.moveaxis(array, -1, 0)


def _read_viscous_damping_by_frequency(vessel: _Fields, path: Path, omega: Matrix) -> Matrix:
    """Return a hull file's viscous damping (frequencies, 6, 6); InputError if it has none."""
    if "vessel.Bv" not in vessel:
        allowed = (
            "viscous damping (MSS: ABCtransform, viscous), as there is no other damping at low "
            "frequency"
        )
        raise InputError(str(path), "vessel.Bv", "nothing", allowed)
    if _read_numeric_field(vessel, path, "Bv").ndim == 2:
        return np.broadcast_to(_read_numeric_field(vessel, path, "Bv"), (omega.size, 6, 6))
    return _read_frequency_dependent_matrices(vessel, path, "Bv", omega)


def _read_dimensions_and_displacement(vessel: _Fields) -> dict[str, float]:
    """Return the dimensions and displacement that an MSS vessel file states."""
    keys = {"length_m": "Lpp", "breadth_m": "B", "draught_m": "T", "displacement_t": "m"}
    per = {"displacement_t": 1000.0}
    numbers = {name: vessel.get(f"vessel.main.{key}", _NOTHING) for name, key in keys.items()}
    return {
        name: float(number) / per.get(name, 1.0)
        for name, number in numbers.items()
        if number.ndim == 0 and 0.0 < float(number) < np.inf
    }


def read_hull_from_csv_table(path: Path) -> Hull:
    """Return the hull in a CSV table of inertia and damping coefficients."""
    values = _read_coefficients_by_name(path)
    for name in REQUIRED:
        if name not in values:
            needed = f"one row for each of {', '.join(REQUIRED)}"
            raise InputError(str(path), name, "nothing", needed)
    m26, d26 = values.get("M26", 0.0), values.get("D26", 0.0)
    d62 = values.get("D62", d26)
    M = [[values["M11"], 0, 0], [0, values["M22"], m26], [0, m26, values["M66"]]]
    D = [[values["D11"], 0, 0], [0, values["D22"], d26], [0, d62, values["D66"]]]
    particulars = {name: values[name] for name in PARTICULARS if name in values}
    method = f"the coefficients of {path.name}"
    return Hull(np.array(M, dtype=float), np.array(D, dtype=float), particulars, method)


def _read_coefficients_by_name(path: Path) -> dict[str, float]:
    """Return the hull coefficients of a CSV table by name; InputError for a bad row."""
    rows = read_csv_rows(path)
    if not rows or [cell.strip() for cell in rows[0][:2]] != ["coefficient", "value"]:
        found = repr(",".join(rows[0]))[:80] if rows else "an empty file"
        raise InputError(str(path), "first row", found, "coefficient,value")
    values: dict[str, float] = {}
    known = (*PARTICULARS, *REQUIRED, *COUPLINGS)
    for cell, *rest in rows[1:]:
        name = cell.strip()
        if name not in known or name in values:
            found, allowed = "a second row", "one row for each coefficient"
            if name not in values:
                found = "an unknown coefficient"
                allowed = f"{format_allowed_names(name, known)}; each once"
            raise InputError(str(path), repr(name)[:80], found, allowed)
        values[name] = _parse_valid_hull_coefficient(path, name, rest[0] if rest else "")
    return values


def _parse_valid_hull_coefficient(path: Path, name: str, text: str) -> float:
    """Return a hull coefficient, finite and, unless a coupling, above zero; else InputError."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (name not in COUPLINGS and value <= 0.0):
        allowed = "a number" if name in COUPLINGS else "a number above zero"
        raise InputError(str(path), name, repr(text)[:80], allowed)
    return value
