"""The text of the three files of a ship of one's own: TOML with its reasons beside it."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dpbench.report.words import document
from dpbench.scenario.hull_files import Hull
from dpbench.scenario.own_ship import (
    CURRENT_SHARE,
    DP_NUMBERS,
    FROM_DEG,
    LIBRARY,
    SPARE,
    Particulars,
    froude_time,
    load_share,
    regression_added_mass,
    rigid_body,
    sea_state,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather.waves import WATER_DENSITY

WIDTH = 96
STEPS = 1000
"""Of the scenario: what a p99 needs."""
SAMPLE_S = 0.3
START_M = (1.2, 1.3)
"""North and east; sample and start are the paper's."""
YAW_WEIGHT = 3000.0
"""Of the robust tuning of the paper's ship [1/rad²]; its lever is 0.72 L."""
FORM_DIFFERS = 0.2
"""From here on a ratio of the form counts as another form than the library vessel's."""
SOLVERS = ("daqp", "quadprog", "osqp", "piqp", "proxqp", "clarabel", "paper_active_set")


@dataclass(frozen=True, eq=False)
class OwnShip:
    """A new ship.

    `like` is the library vessel it is scaled from, `hull` the file that replaces its inertia and
    damping.
    """

    name: str
    own: Particulars
    vessel: Vessel
    like: str
    hull: Hull | None


def vessel_text(ship: OwnShip, command: str) -> str:
    """Return the vessel file; `command` is what it was written by."""
    vessel = ship.vessel
    assert vessel.windage is not None and vessel.reflection is not None, "as every library vessel"
    added = (np.diag(vessel.M) - rigid_body(ship.own)) / regression_added_mass(ship.own)
    return document(
        "own_vessel.toml",
        **vars(ship),
        command=command,
        comment=_comment,
        quoted=_quoted,
        library=load_vessel(ship.like),
        forms=_forms(ship),
        cautions=cautions(ship),
        added=dict(zip(("surge", "sway", "yaw"), added.tolist(), strict=True)),
        ranges=list(zip(vessel.tau_min, vessel.tau_max, strict=True)),
    )


def _comment(caller: Callable[[], str]) -> str:
    """Wrap a paragraph of a template as comments of a file."""
    text = " ".join(caller().split())
    lines = textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False)
    return "".join(f"# {line}\n" for line in lines)


def _forms(ship: OwnShip) -> list[tuple[str, float, float]]:
    """Ratios that two ships of one form share: name, of this ship, of the library's."""
    own, library = ship.own, LIBRARY[ship.like]
    volumes_m3 = own.displacement_kg / WATER_DENSITY, library.mass_kg / WATER_DENSITY
    slender = own.length_m / math.cbrt(volumes_m3[0]), library.length_m / math.cbrt(volumes_m3[1])
    broad = own.length_m / own.breadth_m, library.length_m / library.breadth_m
    return [("L/B", *broad), ("L/volume^(1/3)", *slender)]


def cautions(ship: OwnShip) -> list[str]:
    """Return warnings about the numbers, for the master, as sentences."""
    if ship.hull is not None:
        return ship.hull.remarks
    others = [
        what for what, own, library in _forms(ship) if abs(own / library - 1.0) > FORM_DIFFERS
    ]
    if not others:
        return []
    differs = f"differ{'s' * (len(others) == 1)} by more than {FORM_DIFFERS:.0%}"
    return [f"CAUTION: another form than that of {ship.like}: {' and '.join(others)} {differs}."]


def sample_s(vessel: Vessel) -> float:
    """Scale the paper's 0.3 s to this size, in steps of 0.05 s [s]."""
    slower = froude_time(vessel.length_m)
    return max(0.05, round(round(SAMPLE_S * slower / 0.05) * 0.05, 2))


def scenario_text(name: str, vessel: Vessel, number: int, *, chosen: bool) -> str:
    """Return the scenario file: the ship at its reference in a sea, `chosen` or asked for."""
    longer = froude_time(vessel.length_m) ** 2
    wind_mps, hs_m, _, current_mps = DP_NUMBERS[number]
    return document(
        "own_scenario.toml",
        comment=_comment,
        name=name,
        number=number,
        most=max(DP_NUMBERS),
        why=_why_this_sea(load_share(vessel, number), chosen=chosen),
        share=load_share(vessel, number),
        wind_mps=wind_mps,
        hs_m=hs_m,
        current_mps=current_mps,
        current_share=CURRENT_SHARE,
        from_deg=FROM_DEG,
        step_s=sample_s(vessel),
        steps=STEPS,
        start=[round(metres * longer, 2) for metres in START_M],
        sea=sea_state(number),
        # A lever that grows with the ship.
        yaw_weight=float(f"{YAW_WEIGHT * longer**2:.3g}"),
    )


def _why_this_sea(share: float, *, chosen: bool) -> str:
    if not chosen:
        return "as asked for"
    limit = f"whose mean force takes at most {SPARE:.0%} of the limits"
    return f"the largest {limit}" if share <= SPARE else f"the smallest, as there is none {limit}"


def suite_text(name: str, weather: str, vessel: Vessel, number: int) -> str:
    """Return the suite file: which solver steers this ship there, right and in time."""
    return document(
        "own_suite.toml",
        name=name,
        weather=weather,
        number=number,
        solvers=json.dumps(SOLVERS),
        steps=STEPS,
        step_s=sample_s(vessel),
    )


def _quoted(text: str) -> str:
    """Return a TOML string, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)
