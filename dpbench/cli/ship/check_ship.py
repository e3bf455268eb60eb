"""Text of `dpbench check` on a ship: its numbers, its weather, the offsets its controller holds."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.capability.mean_load import compute_share_of_thrust
from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.bench.design import (
    OFFSETS_M,
    Bracket,
    can_recover_from_offset,
    find_bracket_in_still_water,
)
from dpbench.bench.progress import Progress, Silent
from dpbench.cli.ship.ideal_sensors import describe_ideal_sensors
from dpbench.cli.terminal import WIDTH
from dpbench.report.formats import (
    format_rounded_down,
    format_rounded_up,
    join_with_and,
    significant,
)
from dpbench.report.ship.controller_text import describe_unused_turning
from dpbench.scenario.own_ship import SPARE
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.ship import characteristics as ships
from dpbench.ship.capability.loads import (
    CALM,
    CapabilityHull,
    Condition,
    compute_mean_environmental_loads,
)
from dpbench.ship.capability.losses import list_thruster_cautions
from dpbench.ship.environment import Environment
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import AXIS_NAMES, Vessel

WITHOUT = "--quick skips it"
LEFT_OUT = "not simulated (--quick): the sideways offsets from which each tuning recovers"
CONTROLLERS = ("paper", "rough")
"""The scenarios whose controllers a vessel is tried with: the paper's 30/5 and the robust 60/10."""
_SPEEDS = ("m/s", "m/s", "°/s")
_DEGREES = np.array([1.0, 1.0, np.degrees(1.0)])
_KILO = np.array([1e3, 1e3, 1e3])
_SAME = 1e-3
"""Relative difference of forces that counts as none: azimuths are polygons in a sector."""
_WIDTHS = (22, 19, 19, 19)
LEVEL_1 = "DNV-ST-0111, level 1"
_MOST_OF_LEVEL_1 = f"; at most {100 * SPARE:.0f} % is allowed."
FACTOR = 2.0
"""Ratio of a mean load in simulation to that of level 1 beyond which a caution is printed."""
MATTERS = 0.05
"""Share of the largest force above which a mean load is worth a caution."""
CALM_PERIOD_S = CALM[2]
_TRIALS = 2 * len(OFFSETS_M)


def describe_checked_vessel(
    file: Path, vessel: Vessel, progress: Progress | None = None, *, quick: bool = False
) -> str:
    """Return a text on a ship, and on sideways offsets from which two controllers recover it.

    quick : simulate nothing, and state what is left out.
    """
    tuned = [load_scenario(f"{name}@{file.resolve()}") for name in CONTROLLERS]
    first = f"{file.name}: a vessel, {vessel.title}"
    return _join_lines(
        first, [*format_limits_by_axis(vessel), *_try_offsets(tuned, progress, quick=quick)]
    )


def describe_checked_scenario(
    name: str | Path,
    scenario: Scenario,
    progress: Progress | None = None,
    *,
    quick: bool = False,
) -> str:
    """Return a text on a scenario: ship, weather load, sideways offsets that are recovered.

    quick : simulate nothing, and state what is left out.
    """
    shown = name.name if isinstance(name, Path) else name
    steps = f"{scenario.steps} step{'s' * (scenario.steps != 1)}"
    first = f"{shown}: a scenario of {steps} with vessel {scenario.vessel.id}"
    loads = compare_with_level_1(scenario) or textwrap.wrap(_describe_weather_load(scenario), WIDTH)
    turning = textwrap.wrap(describe_unused_turning(scenario), WIDTH)
    sensors = textwrap.wrap(describe_ideal_sensors(scenario.files["scenario"]), WIDTH)
    about = [*format_limits_by_axis(scenario.vessel), *turning, *loads, *sensors]
    return _join_lines(first, [*about, *_try_offsets([scenario], progress, quick=quick)])


def _join_lines(first: str, others: Sequence[str]) -> str:
    """Return lines joined to one text, the first one shortened to 80 columns."""
    return "\n".join([textwrap.shorten(first, WIDTH, placeholder=" …"), *others])


def format_limits_by_axis(vessel: Vessel) -> list[str]:
    """Return lines of a table: a ship's force limits, rise times and accelerations by axis.

    Of a ship with thrusters the largest force in an axis is that without any in the others, also
    with the half turns that controllers plan with.
    """
    kilo, per = ("k", 1e3) if vessel.tau_max[0] >= 1e3 else ("", 1.0)
    unit = f"{kilo}N"
    reach = None if vessel.thrusters is None else ThrusterReach(vessel.thrusters)
    pure = vessel if reach is None else _limit_to_pure_forces(vessel, reach)
    forces = [("largest force alone", *_format_forces(pure, unit, per))]
    if (np.abs(vessel.tau_max - pure.tau_max) > _SAME * vessel.tau_max).any():
        forces.append(("with other axes", *_format_forces(vessel, unit, per)))
    if vessel.thrusters is not None and vessel.thrusters.has_half_turns:
        planned = vessel.thrusters.copy_with_convex_sectors()
        halves = _limit_to_pure_forces(vessel, ThrusterReach(planned))
        forces.append(("alone, in half turns", *_format_forces(halves, unit, per)))
    rise = vessel.tau_max / vessel.rate_max
    acceleration = pure.accelerations_at_force_limits()[1] * _KILO
    speeds = (
        ships.compute_speeds_at_force_limits(pure)[1],
        ships.compute_linear_damping_speeds(vessel),
    )
    drift = _format_with_units(speeds[0] * _DEGREES, _SPEEDS, speeds[1] * _DEGREES)
    rows = [
        ("", "surge", "sway", "yaw"),
        *forces,
        ("zero to full in", *(f"{_format_number(t)} s" for t in rise)),
        (
            "time constant",
            *(f"{_format_number(t)} s" for t in ships.compute_axis_time_constants_s(vessel)),
        ),
        ("acceleration alone", *_format_with_units(acceleration, ("mm/s²", "mm/s²", "mrad/s²"))),
        ("speed at full force", *drift),
        *(_format_drag(vessel, speed, unit, per) for speed in (0.5, 1.0)),
    ]
    table = [f"{row[0]:<22}" + "".join(f"{cell:<19}" for cell in row[1:]) for row in rows]
    find_share = None if reach is None else reach.find_least_thrust_share
    current_mps = ships.find_largest_current_abeam_mps(vessel, find_share)
    lines = [line.rstrip() for line in table]
    held = _describe_current_held(pure, current_mps)
    lines += textwrap.wrap(f"{held} {_describe_drag(vessel, unit, per)}", WIDTH)
    if vessel.thrusters is None:
        return lines
    on_thrusters = [
        *vessel.thrusters.sector_descriptions,
        *list_thruster_cautions(vessel.thrusters),
    ]
    return [*lines, *(line for text in on_thrusters for line in textwrap.wrap(text, WIDTH))]


def _limit_to_pure_forces(vessel: Vessel, reach: ThrusterReach) -> Vessel:
    """Return a vessel whose limits its thrusters make without a force in another axis."""
    low, high = reach.find_least_and_largest_pure_forces()
    tau_min, tau_max = np.maximum(vessel.tau_min, low), np.minimum(vessel.tau_max, high)
    return replace(vessel, tau_min=tau_min, tau_max=tau_max)


def _format_forces(vessel: Vessel, unit: str, per: float) -> list[str]:
    """Return the limits of force and moment as text, divided by `per`, with their units."""
    limits = zip(vessel.tau_min / per, vessel.tau_max / per, strict=True)
    units = (unit, unit, f"{unit}·m")
    return [f"{_format_range(*pair)} {unit}" for pair, unit in zip(limits, units, strict=True)]


def _describe_drag(vessel: Vessel, unit: str, per: float) -> str:
    """Return sentences on a ship's drag, and on how far the controller's model is from it."""
    if vessel.drag is None:
        return "The damping is linear at every speed, as in the controller's model."
    linear = f"{_format_number(vessel.D[ships.SWAY, ships.SWAY] / per)} {unit}"
    return (
        "The simulated drag is cross-flow. The controller's linear model gives "
        f"{linear} at 1 m/s sideways."
    )


def _format_range(low: float, high: float) -> str:
    """Return a range of numbers as text: ±high, or "low to high" if it is not symmetric."""
    least, most = _format_number(low), _format_number(high)
    return f"±{most}" if abs(low + high) <= _SAME * high else f"{least} to {most}"


def _format_with_units(
    values: Vector, units: Sequence[str], most: Sequence[float] | Vector = 3 * (np.inf,)
) -> list[str]:
    """Return each number with its unit, or as "> limit" where it exceeds its limit."""
    return [
        f"{_format_number(value) if value <= limit else f'> {significant(limit, 2)}'} {unit}"
        for value, unit, limit in zip(values, units, most, strict=True)
    ]


def _format_number(value: float) -> str:
    """Return a number as text of three digits, large ones without a decimal point."""
    return f"{value:.0f}" if abs(value) >= 99.5 else significant(value)


def _format_drag(vessel: Vessel, speed: float, unit: str, per: float) -> tuple[str, ...]:
    """Return a row: the force that keeps a speed [m/s, °/s] in each axis through calm water."""
    velocities = np.diag([speed, speed, speed / _DEGREES[2]])
    drag = np.array([vessel.force_to_keep_velocity(row)[i] for i, row in enumerate(velocities)])
    return f"drag at {speed:g} m/s, °/s", *_format_with_units(drag / per, (unit, unit, f"{unit}·m"))


def _describe_current_held(vessel: Vessel, current_mps: float) -> str:
    """Return a sentence on the largest current abeam that the ship holds."""
    most = ships.compute_linear_damping_speeds(vessel)[ships.SWAY]
    largest = (
        format_rounded_down(current_mps, 2) if current_mps <= most else f"> {significant(most, 2)}"
    )
    return f"The ship holds a current of {largest} m/s abeam."


def _describe_weather_load(scenario: Scenario) -> str:
    """Return words on a weather's mean force as shares of the ship's limits and thrust."""
    vessel = scenario.vessel
    load = ships.compute_mean_weather_force(
        vessel, scenario.environment, float(scenario.reference[2])
    )
    against = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    by_axis = zip(AXIS_NAMES, np.abs(load) / against, strict=True)
    shares = ", ".join(f"{axis} {100 * share:.0f} %" for axis, share in by_axis)
    most, together = compute_share_of_thrust(vessel, load), ""
    if vessel.thrusters is not None:
        together = f", {100 * most:.0f} % of the thrust"
    over = "; the ship cannot hold it" if most > 1.0 else ""
    after, _ = _describe_shares_after_losses(scenario, {"simulated": load})
    return f"mean force: {shares} of the limits{together}{over}{'.' if after else ''}{after}"


def _describe_shares_after_losses(
    scenario: Scenario, loads: Mapping[str, Vector]
) -> tuple[str, list[str]]:
    """Return sentences on the thrust that loads need after each loss, and cautions on level 1.

    "" and no caution without a loss.
    """
    faults = scenario.files["scenario"].get("faults") or []
    losses = sorted((one for one in faults if one.get("lost")), key=lambda one: one["at_s"])
    if scenario.vessel.thrusters is None or not losses:
        return "", []
    reach, lost, cautions = ThrusterReach(scenario.vessel.thrusters), set[int](), list[str]()
    text = " These shares are those of the intact ship."
    for loss in losses:
        names, at_s = loss["lost"], loss["at_s"]
        lost |= scenario.vessel.thrusters.find_indices_of_thrusters_or_groups(names, "", "")
        needed, too_large = [], []
        for name, load in loads.items():
            share, model = reach.find_least_thrust_share(-load, lost), name.rpartition(", ")[2]
            percent = f"{100 * share:.0f}" if share <= 1.0 else "more than 100"
            needed.append(f"{percent} % ({model})")
            too_large += [model] * (share > 1.0)
            if name == LEVEL_1 and share > SPARE:
                exact = significant(100.0 * share) if share <= 1.0 else percent
                cautions.append(
                    f"CAUTION: after the loss of {join_with_and(names)} at {at_s:g} s, the level-1 "
                    f"load needs {exact} % of the remaining thrust{_MOST_OF_LEVEL_1}"
                )
        text += f" After the loss of {join_with_and(names)} at {at_s:g} s, the mean load needs "
        text += f"{' or '.join(needed)} of the remaining thrust."
        if too_large:
            text += f" The ship then cannot hold the mean load ({' or '.join(too_large)})."
    return text, cautions


def compare_with_level_1(scenario: Scenario) -> list[str]:
    """Return lines of a table: the mean loads of a weather, simulated and by level 1.

    None where level 1 has no loads: without the hull of `[capability]`, for a model ship, and in
    weather without wind, current and waves. Slow forces of the scenario are in both.
    """
    vessel, weather = scenario.vessel, scenario.environment
    heading_rad = float(scenario.reference[2])
    is_model = float(scenario.files["vessel"]["model_scale"]) != 1.0
    if vessel.capability is None or is_model or not _has_wind_waves_or_current(weather):
        return []
    simulated = ships.compute_mean_weather_force(vessel, weather, heading_rad)
    slow = replace(weather, wind=None, current=None, drift=None)
    level_1 = ships.compute_mean_weather_force(vessel, slow, heading_rad)
    level_1 = level_1 + _compute_level_1_load(vessel.capability, weather, heading_rad)
    reach = None if vessel.thrusters is None else ThrusterReach(vessel.thrusters)
    pure = vessel if reach is None else _limit_to_pure_forces(vessel, reach)
    loads = {"simulated": simulated, LEVEL_1: level_1}
    shares = {
        name: np.abs(load) / np.where(load < 0.0, pure.tau_max, -pure.tau_min)
        for name, load in loads.items()
    }
    unit, per = ("kN", 1e3) if vessel.tau_max[0] >= 1e3 else ("N", 1.0)
    rows: list[tuple[str, ...]] = [("mean load", *AXIS_NAMES)]
    for name, load in loads.items():
        cells = zip(load / per, (unit, unit, f"{unit}·m"), shares[name], strict=True)
        rows.append(
            (name, *(f"{_format_number(n)} {u} ({100 * share:.0f} %)" for n, u, share in cells))
        )
    lines = [
        "".join(f"{cell:<{at}}" for cell, at in zip(row, _WIDTHS, strict=True)) for row in rows
    ]
    most, whole = float(shares["simulated"].max()), "limits"
    surge, sway, yaw = map(float, shares[LEVEL_1])
    needed = max(surge, sway + yaw)  # The same thrusters make sway force and yaw moment.
    about = "Percentages are of the largest force alone."
    if reach is not None:
        taken = {name: reach.find_least_thrust_share(-load) for name, load in loads.items()}
        # A force in one axis may make one in another easier.
        most, needed, whole = taken["simulated"], taken[LEVEL_1], "thrust"
        about += (
            f" All axes together need {100 * taken['simulated']:.0f} % of the thrust (simulated) "
            f"or {100 * taken[LEVEL_1]:.0f} % (level 1, which allows at most {100 * SPARE:.0f} %)."
        )
    about += " The ship cannot hold the simulated mean load." if most > 1.0 else ""
    after, cautions = _describe_shares_after_losses(scenario, loads)
    over = f"CAUTION: the level-1 load needs {significant(100.0 * needed)} % of the {whole}"
    notes = [about + after, *[over + _MOST_OF_LEVEL_1] * (needed > SPARE), *cautions]
    notes += _caution_on_difference(loads, shares, has_current=weather.current is not None)
    wrapped = (line for note in notes for line in textwrap.wrap(note, WIDTH))
    return [*(line.rstrip() for line in lines), *wrapped]


def _has_wind_waves_or_current(weather: Environment) -> bool:
    """Return whether a weather has wind, waves or current that is not zero."""
    wind, current, drift = weather.wind, weather.current, weather.drift
    return bool(
        (wind and wind.speed_mps) or (current and current.speed_mps) or (drift and drift.sea.hs_m)
    )


def _compute_level_1_load(hull: CapabilityHull, weather: Environment, heading_rad: float) -> Vector:
    """Return the mean load (3,) [N, N, N·m] of wind, current and waves by level 1."""
    wind, current, drift = weather.wind, weather.current, weather.drift
    sea = None if drift is None else drift.sea
    condition = Condition(
        0.0 if wind is None else wind.speed_mps,
        0.0 if sea is None else sea.hs_m,
        CALM_PERIOD_S if sea is None else sea.tp_s,
        0.0 if current is None else current.speed_mps,
    )
    load: Vector = np.zeros(3)
    for i, source in enumerate((wind, current, sea)):
        if source is not None:
            from_rad = source.to_rad - heading_rad + np.pi
            load = load + compute_mean_environmental_loads(hull, condition, from_rad)[i]
    return load


def _caution_on_difference(
    loads: Mapping[str, Vector], shares: Mapping[str, Vector], *, has_current: bool
) -> list[str]:
    """Return a caution on axes whose mean loads differ by more than a factor; none without any."""
    simulated, level_1 = loads["simulated"], loads[LEVEL_1]
    least, most = np.sort(np.abs([simulated, level_1]), axis=0)
    differs = (most > FACTOR * least) | (simulated * level_1 < 0.0)
    matters = np.maximum(shares["simulated"], shares[LEVEL_1]) > MATTERS
    axes = [name for name, is_off in zip(AXIS_NAMES, differs & matters, strict=True) if is_off]
    if not axes:
        return []
    lacks = "; the simulated ship has no Munk moment of the current" if has_current else ""
    return [
        f"CAUTION: the mean load in {join_with_and(axes)} differs by more than a factor of "
        f"{FACTOR:g} between simulation and level 1{lacks if 'yaw' in axes else ''}."
    ]


def _try_offsets(tuned: Sequence[Scenario], progress: Progress | None, *, quick: bool) -> list[str]:
    """Return lines on the sideways offsets, simulated in still water, that controllers recover."""
    if quick:
        return [LEFT_OUT]
    progress = progress or Silent()
    progress.remark(
        f"simulating the recovery from sideways offsets, which may take minutes ({WITHOUT})"
    )
    progress.start(_TRIALS * len(tuned))
    lines = []
    for scenario in tuned:
        trials = 0

        def holds(trial: Scenario, offset_m: float, sides: Sequence[float]) -> bool:
            nonlocal trials
            trials += 1
            progress.advance(1, f"offset of {offset_m:g} m sideways")
            return can_recover_from_offset(trial, offset_m, sides)

        bracket = find_bracket_in_still_water(scenario, holds)
        progress.advance(_TRIALS - trials, "")
        controller = scenario.controller.tuning_and_horizons_label
        # Offsets are at full size; a model ship's own are printed.
        scale = Froude(float(scenario.files["vessel"]["model_scale"])).length_factor
        lines.append(f"tuning {controller:<14} {_describe_bracket(bracket, scale)}")
    return lines


def _describe_bracket(bracket: Bracket, scale: float) -> str:
    """Return in words the largest sideways offset recovered and the smallest that is not [m]."""
    holds = f"{float(format_rounded_down(scale * bracket.holds_m)):g}"
    if bracket.fails_m is None:
        return f"recovers from at least {holds} m abeam in calm water"
    fails = f"{float(format_rounded_up(scale * bracket.fails_m)):g}"
    if bracket.holds_m == 0.0:
        return f"does not recover from {fails} m abeam in calm water"
    return f"recovers from {holds} m abeam in calm water, not {fails} m"
