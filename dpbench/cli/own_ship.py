"""`dpbench init`: from what a master knows of his ship to its vessel, scenario and suite file."""

from __future__ import annotations

import argparse
import math
import os
import re
import shlex
import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

from dpbench.cli.own_ship_files import OwnShip, cautions, scenario_text, suite_text, vessel_text
from dpbench.cli.terminal import WIDTH
from dpbench.errors import InputError, SituationError, one_of
from dpbench.scenario.hull_files import Hull, read_mss, read_table
from dpbench.scenario.own_ship import (
    DP_NUMBERS,
    LIBRARY,
    Particulars,
    Thrust,
    largest_sea,
    load_share,
    nearest_ship,
    scale_vessel,
    thrust_to_weight,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.vessel import Vessel

WHERE = "init"


@dataclass(frozen=True)
class Quantity:
    """An option of the command line: what it is, its unit, and what it may be."""

    what: str
    unit: str
    least: float
    most: float

    def read(self, option: str, text: str | None) -> float | None:
        """Its number; None where it is not given."""
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not self.least <= value <= self.most:
            raise InputError(WHERE, f"--{option}", repr(text)[:80], self.allowed)
        return value

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"{self.least:g} to {self.most:g} {self.unit} ({self.what})"


QUANTITIES = {
    "length": Quantity("length between perpendiculars", "m", 10, 500),
    "breadth": Quantity("breadth", "m", 2, 100),
    "draught": Quantity("draught", "m", 0.5, 40),
    "displacement": Quantity("displacement", "t", 10, 1e6),
    "thrust": Quantity("largest force ahead", "kN", 1, 1e5),
    "sway-thrust": Quantity("largest force sideways", "kN", 1, 1e5),
    "yaw-moment": Quantity("largest turning moment", "kN·m", 1, 1e7),
}
PARTICULARS = ("length", "breadth", "draught", "displacement")
_KEYS = {"displacement": "displacement_t"} | {
    option: f"{option}_m" for option in ("length", "breadth", "draught")
}
BLOCK = (0.3, 1.0)
"""Block coefficients of floating things; beyond them a unit is wrong."""
TO_WEIGHT = (5e-4, 0.2)
"""Thrust over weight; the paper's ship has 0.028 ahead."""


def make_own_ship(asked: argparse.Namespace) -> list[str]:
    """Write the files of a ship; lines that say what was written and what comes next.

    Without any particulars, and with `NAME.toml` there, the ship stays as it is and only scenario
    and suite of another sea are written.
    """
    name, folder = asked.name, Path(asked.out)
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,60}", name):
        raise InputError(WHERE, "NAME", repr(name)[:80], "1 to 60 of letters, digits, _ and -")
    vessel_file = folder / f"{name}.toml"
    numbers = {
        option: quantity.read(option, getattr(asked, option.replace("-", "_")))
        for option, quantity in QUANTITIES.items()
    }
    sea = _sea(asked.sea)
    described = asked.from_mss or asked.from_csv or asked.like or any(numbers.values())
    texts: dict[str, str] = {}
    remarks: list[str] = []
    if described or not os.path.isfile(vessel_file):
        ship = _new_ship(asked, numbers)
        texts[vessel_file.name] = vessel_text(ship, _command(asked))
        vessel, remarks = ship.vessel, cautions(ship)
    else:
        if sea is None:
            instead = f"give --sea, 1 to {max(DP_NUMBERS)}, or describe the ship anew"
            raise SituationError(WHERE, f"{vessel_file} exists; {instead}")
        vessel = load_vessel(vessel_file)
    number = largest_sea(vessel) if sea is None else sea
    texts |= _sea_files(name, vessel, number, chosen=sea is None)
    _write(folder, texts, force=asked.force)
    return _said(folder, texts, vessel, number, remarks)


def _sea_files(name: str, vessel: Vessel, number: int, *, chosen: bool) -> dict[str, str]:
    """Scenario and suite of a sea, which gives them its name where it was asked for."""
    stem = name if chosen else f"{name}_sea{number}"
    weather = f"{name}_weather.toml" if chosen else f"{stem}.toml"
    return {
        weather: scenario_text(name, vessel, number, chosen=chosen),
        f"{stem}_suite.toml": suite_text(name, weather, vessel, number),
    }


def _sea(text: str | None) -> int | None:
    if text is not None and text not in map(str, DP_NUMBERS):
        allowed = f"1 to {max(DP_NUMBERS)} (DP capability number)"
        raise InputError(WHERE, "--sea", repr(text)[:80], allowed)
    return None if text is None else int(text)


def _new_ship(asked: argparse.Namespace, numbers: dict[str, float | None]) -> OwnShip:
    """Make the ship that the options describe."""
    if asked.from_mss and asked.from_csv:
        raise SituationError(
            WHERE, "--from-csv and --from-mss exclude each other; give one of them"
        )
    hull: Hull | None = None
    if asked.from_mss or asked.from_csv:
        hull = (
            read_mss(Path(asked.from_mss)) if asked.from_mss else read_table(Path(asked.from_csv))
        )
    own = _particulars(numbers, hull)
    thrust = _thrust(numbers, own)
    if asked.like is not None and asked.like not in LIBRARY:
        raise InputError(WHERE, "--like", repr(asked.like)[:80], one_of(asked.like, list(LIBRARY)))
    like = asked.like or nearest_ship(own)
    vessel = scale_vessel(like, own, thrust, asked.name)
    if hull is not None:
        vessel = replace(vessel, M=hull.M, D=hull.D, where=asked.from_mss or asked.from_csv)
    return OwnShip(asked.name, own, vessel, like, hull)


def _particulars(numbers: dict[str, float | None], hull: Hull | None) -> Particulars:
    """Read the particulars from the options, then from the file.

    InputError for those that neither has.
    """
    values = {}
    for option in PARTICULARS:
        quantity = QUANTITIES[option]
        value = numbers[option]
        if value is None and hull is not None and _KEYS[option] in hull.particulars:
            value = quantity.read(option, f"{hull.particulars[_KEYS[option]]:.9g}")
        if value is None:
            raise InputError(WHERE, f"--{option}", "nothing", quantity.allowed)
        values[option] = value
    length, breadth, draught, displacement = (values[option] for option in PARTICULARS)
    own = Particulars(length, breadth, draught, 1000.0 * displacement)
    if not BLOCK[0] <= own.block_coefficient <= BLOCK[1]:
        found = (
            f"{displacement:g} t in a block of {length:g} x {breadth:g} x {draught:g} m, a block "
            f"coefficient of {own.block_coefficient:.2g}"
        )
        raise InputError(WHERE, "--displacement", found, f"{BLOCK[0]:g} to {BLOCK[1]:g}")
    return own


def _thrust(numbers: dict[str, float | None], own: Particulars) -> Thrust:
    """Read the forces in N and N·m; InputError for one that no such ship has."""
    for option, lever_m in (("thrust", 1.0), ("sway-thrust", 1.0), ("yaw-moment", own.length_m)):
        value = numbers[option]
        if value is None:
            continue
        share = thrust_to_weight(own, 1000.0 * value / lever_m)
        if not TO_WEIGHT[0] <= share <= TO_WEIGHT[1]:
            weight = value / share
            unit = QUANTITIES[option].unit
            allowed = f"{TO_WEIGHT[0] * weight:.3g} to {TO_WEIGHT[1] * weight:.3g} {unit}"
            raise InputError(WHERE, f"--{option}", f"{value:g}", f"{allowed} for this displacement")
    ahead = numbers["thrust"]
    if ahead is None:
        raise InputError(WHERE, "--thrust", "nothing", QUANTITIES["thrust"].allowed)
    sway, yaw = numbers["sway-thrust"], numbers["yaw-moment"]
    return Thrust(
        1000.0 * ahead,
        None if sway is None else 1000.0 * sway,
        None if yaw is None else 1000.0 * yaw,
    )


def _command(asked: argparse.Namespace) -> str:
    """Return the command line, as far as it describes the ship."""
    words = ["dpbench", "init", asked.name]
    for option in (*QUANTITIES, "like", "from-mss", "from-csv", "sea"):
        value = getattr(asked, option.replace("-", "_"))
        if value is not None:
            words += [f"--{option}", str(value)]
    return shlex.join(words)


def _write(folder: Path, texts: dict[str, str], *, force: bool) -> None:
    """Write all files, or none where one of them is there already."""
    for name in texts:
        if os.path.lexists(folder / name) and not force:
            instead = "choose another name or folder (--out), or add --force to overwrite it"
            raise SituationError(WHERE, f"{folder / name} exists; {instead}")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _said(
    folder: Path, texts: dict[str, str], vessel: Vessel, number: int, remarks: list[str]
) -> list[str]:
    """List the files written, the load of the sea on the ship, and the next commands."""
    paths = [str(folder / name) for name in texts]
    share = load_share(vessel, number)
    lines = [f"wrote {path}" for path in paths]
    lines += [line for remark in remarks for line in textwrap.wrap(remark, WIDTH)]
    lines.append(f"sea: DP number {number}; its mean force takes {share:.0%} of the limits")
    if share > 1.0:
        lines.append("This ship cannot hold there: see --sea, --sway-thrust and --yaw-moment.")
    return [*lines, f"next: dpbench check {paths[0]}", f"      dpbench run {paths[-1]}"]
