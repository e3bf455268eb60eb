"""Thrusters of one's own from a CSV table: kind, position, and power or thrust; rest assumed.

    kind,x_m,y_m,power_kW,group
    main,-38,-4,2000,board A
    tunnel,32,,800,board B

The columns are keys of `[[thrusters]]` of a vessel file, but for the directions of an azimuth:
sector_from_deg and sector_to_deg, or barred_from_deg and barred_to_deg. An empty cell is a key that
is left out.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.files.regular_files import read_csv_rows
from dpbench.scenario.problem_files import validate_settings_as_model
from dpbench.scenario.tables.vessel_file import MOST_X, ThrusterTable, build_thruster_set
from dpbench.ship.thrusters import Thruster, ThrusterSet
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import Windage

TEXTS = ("name", "kind", "propeller", "group", "barred_protects")
ASSUMED_IN_SOURCE = "; assumed: "
"""Text of a vessel file's `source` after which it lists the values that were assumed."""
_WIND_AREAS = re.compile(r"wind areas (?P<areas>[^;]* m² on the side), scaled from [^;]*")
"""Wind areas in such a list."""
SECTORS = {
    "sector_deg": ("sector_from_deg", "sector_to_deg"),
    "barred_deg": ("barred_from_deg", "barred_to_deg"),
}
"""Columns of the directions in which an azimuth may push, and of those in which it may not."""
COLUMNS = (
    *(key for key in ThrusterTable.model_fields if not key.endswith("sector_deg")),
    *(column for columns in SECTORS.values() for column in columns),
)
REQUIRED = ("kind", "x_m")
MOST_ROWS = 100
LOADING_KW_PER_M2 = {"open": 138.0, "nozzle": 323.0, "tunnel": 297.0}
"""Power over squared diameter of the thrusters of Ratownik."""
ASTERN = 0.79
"""Thrust astern of a main propeller over that ahead: the paper's ship, 980 kN of 1240 kN."""
HULL_WORDS = {
    "submerged_length_m": "length under water",
    "submerged_x_m": "middle of that length",
    "bow_angle_deg": "bow angle at the waterline",
    "aft_fullness": "fullness of the waterline aft",
    "lateral_x_m": "centre of the lateral area above water",
    "submerged_m2": "lateral area under water",
    "current_x_m": "centre of the lateral area under water",
}
"""Words for the keys of `[capability]` that a vessel file may leave out."""
ASSUMED = ("rise_s", "diameter_m", "propeller", "astern")
"""Keys that get a value where a row leaves them out."""
MOST_Y = 0.6
"""Largest distance of a thruster from the centre line over the breadth."""


@dataclass(frozen=True)
class Berth:
    """Dimensions of the ship [m] that thrusters have to fit, and their rise time [s]."""

    length_m: float
    breadth_m: float
    rise_s: float


def read_rows_of_thruster_table(path: Path) -> list[dict[str, str]]:
    """Return a dict for each row of a thruster table, of its filled cells; InputError if bad."""
    rows = read_csv_rows(path)
    names = [cell.strip() for cell in rows[0]] if rows else []
    if len(names) == 1 and (separator := next(filter(names[0].count, ";\t"), "")):
        found = f"columns separated by {separator!r}"
        raise InputError(f"{path}: first row", "", found, "a comma between columns")
    for name in names:
        if name not in COLUMNS or names.count(name) > 1:
            found = "a second column" if names.count(name) > 1 else "an unknown column"
            raise InputError(str(path), repr(name)[:80], found, format_allowed_names(name, COLUMNS))
    if missing := [name for name in REQUIRED if name not in names]:
        required = "kind, x_m, and power_kW or thrust_kN"
        fault = f"column {missing[0]} is missing; required: {required}"
        raise SituationError(f"{path}: first row", fault)
    if not 2 <= len(rows) <= MOST_ROWS + 1:
        raise InputError(str(path), "", f"{len(rows) - 1} thrusters", f"1 to {MOST_ROWS}")
    for number, row in enumerate(rows[1:], start=1):
        if len(row) > len(names):
            where = f"{path}, thruster {number}"
            raise InputError(where, "", f"{len(row)} cells", f"at most {len(names)}")
    return [
        {name: cell.strip() for name, cell in zip(names, row, strict=False) if cell.strip()}
        for row in rows[1:]
    ]


def complete_thruster_values(
    rows: Sequence[Mapping[str, str]], berth: Berth, where: str
) -> tuple[tuple[ThrusterTable, ...], ThrusterSet]:
    """Return thrusters with what their rows leave out, as tables and in SI units.

    Raises InputError, by number of the thruster, for a value that is no number or out of range, a
    place off the ship, and thrusters that leave surge, sway or yaw without force.
    """
    tables = []
    for number, row in enumerate(rows, start=1):
        at = f"{where}, thruster {number}"
        keys: dict[str, Any] = {
            name: text if name in TEXTS else _parse_number_or_raise_input_error(text, at, name)
            for name, text in row.items()
        }
        keys = {"name": f"{keys.get('kind', '')} {number}", "rise_s": berth.rise_s} | keys
        _join_sector_columns(keys, at)
        _add_assumed_propeller_values(keys)
        try:
            tables.append(validate_settings_as_model(keys, ThrusterTable, at))
        except InputError as error:
            if error.key:
                raise
            found = f"columns {', '.join(row)}"  # without the values that are added here
            raise InputError(at, "", found, error.allowed) from error
        _require_thruster_inside_ship(tables[-1], berth, at)
    return tuple(tables), build_thruster_set(tables, where)


def _join_sector_columns(keys: dict[str, Any], where: str) -> None:
    """Replace, in a row's keys, the two columns of a sector by one; InputError if one is empty."""
    for key, columns in SECTORS.items():
        if not any(column in keys for column in columns):
            continue
        for column in columns:
            if column not in keys:
                raise InputError(
                    where,
                    column,
                    "nothing",
                    f"a number, as {' and '.join(columns)} belong together",
                )
        keys[key] = [keys.pop(column) for column in columns]


def _add_assumed_propeller_values(keys: dict[str, Any]) -> None:
    """Add to a row's keys the thruster's propeller, diameter and astern share if not stated."""
    if keys.get("kind") == "main":
        keys.setdefault("astern", ASTERN)
    if "power_kW" not in keys:
        return
    keys.setdefault("propeller", "tunnel" if keys.get("kind") == "tunnel" else "open")
    loading = LOADING_KW_PER_M2.get(keys["propeller"])
    if loading is not None and keys["power_kW"] > 0.0:
        keys.setdefault("diameter_m", float(f"{math.sqrt(keys['power_kW'] / loading):.3g}"))


def _parse_number_or_raise_input_error(text: str, where: str, name: str) -> float:
    """Return the number in a text of a table; InputError for other text."""
    try:
        return float(text)
    except ValueError:
        raise InputError(where, name, repr(text)[:80], "a number") from None


def _require_thruster_inside_ship(table: ThrusterTable, berth: Berth, where: str) -> None:
    """Raise InputError for a thruster that lies outside the ship."""
    for name, most in (("x_m", MOST_X * berth.length_m), ("y_m", MOST_Y * berth.breadth_m)):
        if abs(getattr(table, name)) > most:
            allowed = f"{-most:g} to {most:g} m from midships on this ship"
            raise InputError(where, name, f"{getattr(table, name):g}", allowed)


def split_source(vessel: Vessel) -> tuple[str, str]:
    """Return the source of a vessel, and the values that it lists as assumed; "" without any."""
    source, _, assumed = vessel.source.partition(ASSUMED_IN_SOURCE)
    return source, assumed


def describe_scaled_wind_areas(windage: Windage, library: str) -> str:
    """Return text for a vessel's source on wind areas that are scaled from a library vessel's."""
    return f"wind areas {_format_areas(windage)}, scaled from {library}"


def _format_areas(windage: Windage) -> str:
    """Return wind areas as text."""
    return f"{windage.frontal_m2:.0f} m² in front, {windage.lateral_m2:.0f} m² on the side"


def describe_own_wind_areas(vessel: Vessel) -> str:
    """Return text on wind areas of one's own, in place of those assumed in the source; or ""."""
    assumed = _WIND_AREAS.search(split_source(vessel)[1])
    if assumed is None or vessel.windage is None:
        return ""
    areas = _format_areas(vessel.windage)
    return "" if assumed["areas"] == areas else f"wind areas as given: {areas}"


def list_assumptions_on_vessel(vessel: Vessel) -> list[str]:
    """Return texts on what a vessel's file does not give: of thrusters, wind, hull (level 1).

    The source lists what `dpbench init` assumed; wind areas that were replaced since are left out.
    """
    text = split_source(vessel)[1]
    if describe_own_wind_areas(vessel):
        text = _WIND_AREAS.sub("", text).strip("; ")
    assumed = [text] if text else []
    thrusters = () if vessel.thrusters is None else vessel.thrusters.thrusters
    if heights := _name_unknown_heights(thrusters):
        lost = "loss of thrust by ventilation in waves"
        assumed.append(f"{lost} neglected, as {heights} are unknown")
    hull = vessel.capability
    if hull is not None and hull.assumed:
        of_hull = ", ".join(HULL_WORDS[key] for key in hull.assumed)
        assumed.append(f"hull data from the main dimensions: {of_hull}")
    return assumed


def _name_unknown_heights(thrusters: Sequence[Thruster]) -> str:
    """Return in words the shaft heights that are unknown, and whose unless all; "" without any."""
    screws = {t.name: t.screw for t in thrusters if t.screw is not None}
    lacking = [name for name, screw in screws.items() if screw.height_m is None]
    whose = "" if len(lacking) == len(screws) else f" of {', '.join(lacking)}"
    return f"shaft heights{whose}" if lacking else ""


def describe_assumed_values(
    rows: Sequence[Mapping[str, str]], tables: Sequence[ThrusterTable]
) -> list[str]:
    """Return a sentence for each kind of value that a thruster table leaves out."""
    values = list_assumed_values(rows, tables)
    rises, sizes = values.get("rise times", ""), values.get("diameters", "")
    propellers = values.get("propellers", "")
    astern = values.get("ratio of thrust astern to thrust ahead", "")
    heights = _name_unknown_heights([table.build_thruster() for table in tables])
    sentences = {
        f"Rise times: {rises}, scaled from the ship of Xia, Liu, Pang & Xue with the square root "
        "of the length.": rises,
        f"Diameters, from the power as on the rescue ship Ratownik: {sizes}.": sizes,
        f"Propellers: {propellers}.": propellers,
        f"{heights[:1].upper()}{heights[1:]} (height_m) are unknown: loss of thrust by ventilation "
        "in waves is neglected.": heights,
        f"Ratio of thrust astern to thrust ahead: {astern}.": astern,
        "A thruster without a group fails alone.": any("group" not in row for row in rows),
    }
    return [sentence for sentence, is_needed in sentences.items() if is_needed]


def list_assumed_values(
    rows: Sequence[Mapping[str, str]], tables: Sequence[ThrusterTable]
) -> dict[str, str]:
    """Return by quantity the values that rows of thrusters leave out, and whose they are."""
    named = list(zip(rows, tables, strict=True))
    by_power = [(row, table) for row, table in named if "power_kW" in row]
    mains = [(row, table) for row, table in named if table.kind == "main"]
    values = {
        "rise times": _list_left_out(named, "rise_s", " s"),
        "diameters": _list_left_out(by_power, "diameter_m", " m"),
        "propellers": _list_left_out(by_power, "propeller"),
        "ratio of thrust astern to thrust ahead": _list_left_out(mains, "astern"),
    }
    return {quantity: text for quantity, text in values.items() if text}


def _list_left_out(
    named: Sequence[tuple[Mapping[str, str], ThrusterTable]], key: str, unit: str = ""
) -> str:
    """Return the assumed values of a key with the thrusters they are for, as text; "" without."""
    by_value: dict[str, list[str]] = {}
    for row, table in named:
        if key not in row:
            value = getattr(table, key)
            text = value if isinstance(value, str) else f"{value:.3g}"
            by_value.setdefault(f"{text}{unit}", []).append(table.name)
    if len(by_value) == 1 and len(named) == len(*by_value.values()):
        return str(*by_value)
    return ", ".join(f"{value} ({', '.join(names)})" for value, names in by_value.items())
