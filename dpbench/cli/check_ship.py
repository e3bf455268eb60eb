"""Text of `dpbench check` on a ship: its numbers, its weather, the offsets its controller holds."""

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.design import OFFSETS_M, Bracket, find_still_water_bracket, is_held
from dpbench.bench.progress import Progress, Silent
from dpbench.cli.terminal import WIDTH
from dpbench.report.formats import rounded_down, rounded_up, significant
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.ship import characteristics as ships
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

CONTROLLERS = ("paper", "rough")
"""The scenarios whose controllers a vessel is tried with: the paper's 30/5 and the robust 60/10."""
_SPEEDS = ("m/s", "m/s", "°/s")
_DEGREES = np.array([1.0, 1.0, np.degrees(1.0)])
_KILO = np.array([1e3, 1e3, 1e3])
_TRIALS = 2 * len(OFFSETS_M)


def vessel_text(file: Path, vessel: Vessel, progress: Progress | None = None) -> str:
    """Describe a vessel, and the largest offsets from which the two tunings bring it back."""
    tuned = [load_scenario(f"{name}@{file.resolve()}") for name in CONTROLLERS]
    first = f"{file.name}: a vessel, {vessel.title}"
    return _text(first, [*ship_lines(vessel), *_offset_lines(tuned, progress)])


def scenario_text(name: str | Path, scenario: Scenario, progress: Progress | None = None) -> str:
    """Describe a scenario: its ship, the load of its weather, the offsets its tuning holds."""
    shown = name.name if isinstance(name, Path) else name
    first = f"{shown}: a scenario of {scenario.steps} steps with vessel {scenario.vessel.id}"
    about = [*ship_lines(scenario.vessel), _weather_line(scenario)]
    return _text(first, [*about, *_offset_lines([scenario], progress)])


def _text(first: str, others: Sequence[str]) -> str:
    return "\n".join([textwrap.shorten(first, WIDTH, placeholder=" …"), *others])


def ship_lines(vessel: Vessel) -> list[str]:
    """Make the lines of a vessel: a table of three axes, and its sideways force."""
    kilo, per = ("k", 1e3) if vessel.tau_max[0] >= 1e3 else ("", 1.0)
    limits = zip(vessel.tau_min / per, vessel.tau_max / per, strict=True)
    units = (f"{kilo}N", f"{kilo}N", f"{kilo}N·m")
    force = [f"{_range(*pair)} {unit}" for pair, unit in zip(limits, units, strict=True)]
    rise = vessel.tau_max / vessel.rate_max
    reach = vessel.reachable_acceleration()[1] * _KILO
    drift = _with_units(
        ships.steady_speed(vessel)[1] * _DEGREES, _SPEEDS, ships.slow_speed(vessel) * _DEGREES
    )
    rows = [
        ("", "surge", "sway", "yaw"),
        ("largest force", *force),
        ("zero to full in", *(f"{_short(t)} s" for t in rise)),
        ("time constant", *(f"{_short(t)} s" for t in ships.axis_time_constants_s(vessel))),
        ("acceleration at full", *_with_units(reach, ("mm/s²", "mm/s²", "mrad/s²"), [np.inf] * 3)),
        ("linear drift at full", *drift),
    ]
    table = [f"{row[0]:<22}" + "".join(f"{cell:<19}" for cell in row[1:]) for row in rows]
    return [*(line.rstrip() for line in table), _sideways_line(vessel, f"{kilo}N", per)]


def _range(low: float, high: float) -> str:
    return f"±{_short(high)}" if low == -high else f"{_short(low)}..{_short(high)}"


def _with_units(values: Vector, units: Sequence[str], most: Sequence[float] | Vector) -> list[str]:
    """Format numbers with units; of one above `most` only that."""
    return [
        f"{_short(value) if value <= limit else f'> {significant(limit, 2)}'} {unit}"
        for value, unit, limit in zip(values, units, most, strict=True)
    ]


def _short(value: float) -> str:
    """Format three digits; large numbers whole, without a point."""
    return f"{value:.0f}" if abs(value) >= 99.5 else significant(value)


def _sideways_line(vessel: Vessel, unit: str, per: float) -> str:
    """Compare the force for 1 m/s sideways with the limits; name the current that can be held."""
    needs = ships.sideways_force(vessel)[ships.SWAY] / per
    has = min(-vessel.tau_min[ships.SWAY], vessel.tau_max[ships.SWAY]) / per
    most = ships.slow_speed(vessel)[ships.SWAY]
    current = ships.largest_current_abeam_mps(vessel)
    largest = rounded_down(current, 2) if current <= most else f"> {significant(most, 2)}"
    needed = f"1 m/s sideways needs {_short(needs)} {unit} of {_short(has)}"
    return f"{needed}; holds {largest} m/s of current abeam"


def _weather_line(scenario: Scenario) -> str:
    """Return the mean force of the weather at the reference as a share of the limits."""
    vessel = scenario.vessel
    load = ships.mean_load(vessel, scenario.environment, float(scenario.reference[2]))
    against = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    shares = ", ".join(f"{share:.0%}" for share in np.abs(load) / against)
    over = " - it cannot hold" if (np.abs(load) > against).any() else ""
    return f"mean force of its weather: {shares} of the limits{over}"


def _offset_lines(tuned: Sequence[Scenario], progress: Progress | None) -> list[str]:
    """Try which offsets each tuning holds in still water."""
    progress = progress or Silent()
    progress.start(_TRIALS * len(tuned))
    lines = []
    for scenario in tuned:
        trials = 0

        def holds(trial: Scenario, offset_m: float, sides: Sequence[float]) -> bool:
            nonlocal trials
            trials += 1
            progress.advance(1, f"sideways by {offset_m:g} m")
            return is_held(trial, offset_m, sides)

        bracket = find_still_water_bracket(scenario, holds)
        progress.advance(_TRIALS - trials, "")
        controller = scenario.controller.label
        # Offsets are at full size; a model ship's own are printed.
        scale = Froude(float(scenario.files["vessel"]["model_scale"])).length
        lines.append(f"tuning {controller:<14} {_bracket_text(bracket, scale)}")
    return lines


def _bracket_text(bracket: Bracket, scale: float) -> str:
    holds = f"{float(rounded_down(scale * bracket.holds_m)):g}"
    if bracket.fails_m is None:
        return f"holds calm water, from {holds} m sideways and all below"
    fails = f"{float(rounded_up(scale * bracket.fails_m)):g}"
    if bracket.holds_m == 0.0:
        return f"does not hold calm water: {fails} m sideways is too much"
    return f"holds calm water, up to {holds} m sideways (not {fails} m)"
