"""The text of the three files of a ship of one's own: TOML with its reasons beside it."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix
from dpbench.scenario.hull_files import Hull
from dpbench.scenario.own_ship import (
    LIBRARY,
    Particulars,
    froude_time,
    regression_added_mass,
    rigid_body,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.scenario.sea_states import (
    CURRENT_SHARE,
    DP_NUMBERS,
    FROM_DEG,
    SPARE,
    load_share,
    sea_state,
)
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


def comment(*paragraphs: str) -> str:
    """Paragraphs as comments of a file."""
    lines = []
    for paragraph in paragraphs:
        lines += textwrap.wrap(
            " ".join(paragraph.split()), WIDTH, break_long_words=False, break_on_hyphens=False
        )
    return "".join(f"# {line}\n" for line in lines)


def vessel_text(ship: OwnShip, command: str) -> str:
    """Return the vessel file; `command` is what it was written by."""
    own, vessel = ship.own, ship.vessel
    title = (
        f"{ship.name}, {own.length_m:g} x {own.breadth_m:g} x {own.draught_m:g} m, "
        f"{own.displacement_kg / 1000:.6g} t"
    )
    library = load_vessel(ship.like)
    source = ship.hull.method if ship.hull else f"scaled from {ship.like}: {library.source}"
    return (
        comment(f"Written by: {command}", *_hull_comments(ship))
        + f"title = {_quoted(title)}\nsource = {_quoted(source)}\n"
        + f"length_m = {_number(own.length_m)}\n"
        + comment("Surge, sway, yaw in kg, m, s: M with the added mass, and D.")
        + f"inertia = {_rows(vessel.M)}\ndamping = {_rows(vessel.D)}\n\n"
        + _limits_text(ship)
        + _above_water_text(ship)
    )


def _hull_comments(ship: OwnShip) -> list[str]:
    """How inertia and damping were made, how far that holds, and what was found odd."""
    if ship.hull is not None:
        return [f"Hull: {ship.hull.method}.", *cautions(ship), _added_mass_check(ship)]
    hull = (
        f"Hull: inertia and damping of the library vessel {ship.like} in the Bis system, "
        "M = m N Mb N and D = m sqrt(g/L) N Db N with N = diag(1, 1, L) (Fossen, Handbook of "
        "Marine Craft Hydrodynamics and Motion Control, 2021), at this length and "
        "displacement."
    )
    forms = ", ".join(
        f"{what} {own:.2f} (there {library:.2f})" for what, own, library in _forms(ship)
    )
    valid = (
        "Valid for station keeping, that is slow motion through the water, of a ship of one hull "
        f"and of that form: {forms}; block coefficient {ship.own.block_coefficient:.2f}."
    )
    better = "Coefficients of your own ship are better: dpbench init --from-csv or --from-mss."
    return [hull, valid, *cautions(ship), _added_mass_check(ship), better]


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


def _added_mass_check(ship: OwnShip) -> str:
    """Compare the added mass with published regressions."""
    added = np.diag(ship.vessel.M) - rigid_body(ship.own)
    ratios = added / regression_added_mass(ship.own)
    said = ", ".join(f"{axis} {ratio:.2f}" for axis, ratio in zip(_AXES, ratios, strict=True))
    return (
        "Check: its added mass over that of published regressions (surge: Söding 1982; sway, yaw: "
        f"Clarke, Gedling & Hine 1983; yaw inertia of the hull with a radius of L/4): {said}."
    )


_AXES = ("surge", "sway", "yaw")


def _limits_text(ship: OwnShip) -> str:
    vessel, library = ship.vessel, load_vessel(ship.like)
    ranges = [_list(pair) for pair in zip(vessel.tau_min, vessel.tau_max, strict=True)]
    astern = -library.tau_min[0] / library.tau_max[0]
    rise = vessel.tau_max[0] / vessel.rate_max[0]
    return (
        "[limits]\n"
        + comment(
            "Ahead as given. What was not given is the share of the ship of Xia, Liu, Pang & Xue: "
            f"astern {astern:.2f} and sideways {library.tau_max[1] / library.tau_max[0]:.2f} of "
            "the force ahead, the moment "
            f"{library.tau_max[2] / library.tau_max[1] / library.length_m:.2f} of force sideways "
            "times length."
        )
        + f"surge_N = {ranges[0]}\nsway_N = {ranges[1]}\nyaw_Nm = {ranges[2]}\n"
        + comment(
            f"Zero to full ahead takes {rise:.1f} s: "
            f"{library.tau_max[0] / library.rate_max[0]:.1f} s on that ship, and times grow with "
            "the root of the length (Froude)."
        )
        + f"rate_max_N_per_s = {_list(vessel.rate_max)}\n\n"
    )


def _above_water_text(ship: OwnShip) -> str:
    air, water = ship.vessel.windage, ship.vessel.reflection
    assert air is not None and water is not None, "every library vessel has both"
    return (
        "[windage]\n"
        + comment(f"Areas of {ship.like}, scaled: L·B in front, L² on the side. Yours are better.")
        + f"frontal_m2 = {_number(air.frontal_m2)}\nlateral_m2 = {_number(air.lateral_m2)}\n"
        + f"c_x = {_number(air.c_x)}\nc_y = {_number(air.c_y)}\nc_n = {_number(air.c_n)}\n\n"
        + "[reflection]\n"
        + f"breadth_m = {_number(water.breadth_m)}\nhead = {_number(water.head)}\n"
        + f"beam = {_number(water.beam)}\nyaw = {_number(water.yaw)}\n"
    )


def sample_s(vessel: Vessel) -> float:
    """Scale the paper's 0.3 s to this size, in steps of 0.05 s [s]."""
    slower = froude_time(vessel.length_m)
    return max(0.05, round(round(SAMPLE_S * slower / 0.05) * 0.05, 2))


def scenario_text(name: str, vessel: Vessel, number: int, *, chosen: bool) -> str:
    """Return the scenario file: the ship at its reference in a sea, `chosen` or asked for."""
    longer = froude_time(vessel.length_m) ** 2
    north_m, east_m = (_number(round(metres * longer, 2)) for metres in START_M)
    step_s = sample_s(vessel)
    # A lever that grows with the ship.
    yaw_weight = float(f"{YAW_WEIGHT * longer**2:.3g}")
    return f"""{comment(_why_this_sea(name, vessel, number, chosen=chosen))}\
title = "{name} in the sea of DP number {number}"
shows = "{_sea_in_words(number)}"
vessel = "{name}.toml"
# The paper's 0.3 s for its ship of 76 m; times grow with the root of the length.
sample_s = {_number(step_s)}
duration_s = {_number(STEPS * step_s)}

# The paper's transfer, at this size: the rate limits are active in it.
[start]
north_m = {north_m}
east_m = {east_m}

{_environment_text(number)}
[controller]
tuning = "robust"
# The paper's 30/5 sees less than its thrusters take from zero to full.
prediction_horizon = 60
control_horizon = 10
# 1/m², 1/m², 1/rad²; moves in multiples of 1/(largest step)².
output_weight = [1.0, 1.0, {_number(yaw_weight)}]
move_weight_relative = [0.1, 0.1, 0.1]
"""


def _why_this_sea(name: str, vessel: Vessel, number: int, *, chosen: bool) -> str:
    share = load_share(vessel, number)
    limit = f"whose mean force takes at most {SPARE:.0%} of the limits"
    why = "as asked for"
    if chosen:
        why = (
            f"the largest {limit}" if share <= SPARE else f"the smallest, as there is none {limit}"
        )
    return (
        f"The sea of DP number {number} (DNV-ST-0111), {why}; here it takes {share:.0%}. "
        f"Another one: dpbench init {name} --sea N, 1 to {max(DP_NUMBERS)}. "
        "The motion in the single wave is left out: [environment.waves.motion] and an [estimator]."
    )


def _sea_in_words(number: int) -> str:
    wind_mps, hs_m, _, _ = DP_NUMBERS[number]
    return (
        f"Gusty wind of {wind_mps:g} m/s, a current, and drift of waves of {hs_m:g} m, from "
        f"{FROM_DEG:g} degrees off the bow; the ship comes in from some metres off."
    )


def _environment_text(number: int) -> str:
    sea = sea_state(number)
    assert sea.wind and sea.current and sea.waves, "a sea state has all three"
    slower = comment(
        f"{CURRENT_SHARE:g} of the standard's {DP_NUMBERS[number][3]:g} m/s: linear damping, meant "
        "for some cm/s, makes of that about the standard's force on the paper's ship."
    )
    return f"""[environment]
ramp_s = {_number(sea.ramp_s)}
seed = {sea.seed}

[environment.wind]
speed_mps = {_number(sea.wind.speed_mps)}
from_deg = {_number(sea.wind.from_deg)}

[environment.current]
{slower}speed_mps = {_number(sea.current.speed_mps)}
towards_deg = {_number(sea.current.towards_deg)}

[environment.waves]
hs_m = {_number(sea.waves.hs_m)}
tp_s = {_number(sea.waves.tp_s)}
from_deg = {_number(sea.waves.from_deg)}
"""


def suite_text(name: str, weather: str, vessel: Vessel, number: int) -> str:
    """Return the suite file, which compares solvers on this ship and weather."""
    step_s = sample_s(vessel)
    return f"""\
# Which solver steers this ship, right on every step and in time? About a minute.
title = "{name}: which solver holds it in the sea of DP number {number}"
solvers = {json.dumps(SOLVERS)}
cell_limit_s = 30.0
rounds = 3

[demand]
# Of one rate-limit step, on every step; the p99 is 1 % of the sample.
error_move = 1e-2
failed_steps = 0
p99_ms = {_number(10.0 * step_s)}
deadline_ms = {_number(1000.0 * step_s)}

# Each solver steers the ship itself: what it does to the ship.
[[closed_loop]]
scenarios = ["{weather}"]
routes = ["native"]
policies = ["reuse"]
settings = ["default", "high"]

# The same {STEPS} QPs for all: how long a step takes, with a p99.
[[replay]]
scenario = "{weather}"
routes = ["native"]
policies = ["reuse"]
settings = ["default", "high"]
"""


def _number(value: float) -> str:
    """Return a TOML float of six digits."""
    text = f"{float(value):.6g}"
    return text if any(sign in text for sign in ".en") else f"{text}.0"


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"


def _rows(matrix: Matrix) -> str:
    return f"[{', '.join(_list(row) for row in matrix)}]"


def _quoted(text: str) -> str:
    """Return a TOML string, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)
