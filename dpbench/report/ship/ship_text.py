"""Text of the controller's own result: the first lines of every report."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.ship_results import ShipResult, is_accurate_loop
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.bench.run.exact_loop import HEADING_DEG
from dpbench.report.formats import format_share, join_with_and, plural, significant
from dpbench.report.ship.conditions_text import (
    caution_on_ideal_sensors,
    describe_conditions_of_ships,
)
from dpbench.report.ship.thrust_text import explain_departure
from dpbench.scenario.conditions import read_conditions
from dpbench.scenario.scenario import Scenario
from dpbench.scenario.stability import describe_unstable_loop

LOST = "The controller does not hold this ship"
BANNER = f"{LOST} in this weather"
NOT_RUN = "The ship was not run: no reference loop shows whether the controller holds it."
AT_END = "at the end"
NEAR_SHARE = 0.8
"""Share of its station from which on a ship that stays is said to come near the limits."""
MOST_NAMED = 3
"""Scenarios that a sentence describes or names."""
MOST_VALUES, MOST_LETTERS = 2, 60
"""Values of a study's point, and letters, that are shown with its number."""
WIND_KEYS = {"environment.wind.speed_mps": 0, "environment.wind.from_deg": 1}
"""Keys whose values are shown first, in their order."""
POINT_PREFIXES = ("environment.", "controller.")
"""Tables of a scenario whose names are left out of such a value's key."""


@dataclass(frozen=True)
class ShipSummary:
    """First lines of a report: a warning where the controller does not hold a ship, and results.

    warning : begins with `BANNER`, or with `LOST` where some ships are held or all lost ones start
    off their station, have loops that are unstable without limits or a mean load beyond their
    thrust; "" where no ship is lost.
    state : where the ship is on station, has not settled or has no result; "" without any ship.
    limits : the share of steps with active limits.
    details : approaches to a setpoint, losses, offsets that still grow.
    caution : of ships on station with little margin, still moving away, farther off since a
    loss, or lost with an accurate solver, of exact sensors on a ship of one's own, and in a report
    of losses that no closed loop shows to be held; "" without any.
    conditions : sensors, estimator, lag, delay and mismatch, by scenarios with equal ones.
    wash : caution on azimuths of one's own ship that may hit each other.
    """

    warning: str = ""
    state: str = ""
    details: str = ""
    caution: str = ""
    limits: str = ""
    conditions: str = ""
    wash: str = ""

    @property
    def headline(self) -> str:
        """State and active limits of the ships as one text."""
        return " ".join(filter(None, (self.state, self.limits)))

    @property
    def text(self) -> str:
        """State, active limits and details of the ships as one text."""
        return " ".join(filter(None, (self.headline, self.details)))

    @property
    def lines(self) -> list[str]:
        """Lines of the ship's summary that are not empty, the warning first."""
        return [line for line in (self.warning, self.text, self.caution) if line]


def summarise_ships(ships: Sequence[ShipResult]) -> ShipSummary:
    """Return sentences on the scenarios in which the controller, exactly solved, holds the ship."""
    if not ships:
        return ShipSummary()
    known = [ship for ship in ships if ship.state != "not run"]
    if not known:
        return ShipSummary(state=NOT_RUN)
    lost = [ship for ship in known if ship.has_left_station]
    warning = " ".join(filter(None, _warn_of_lost(lost, known)))
    state = [
        _describe_kept(known),
        _name_stopped_before_loss(known),
        _name_unsettled(known),
        *_describe_rest(ships),
    ]
    details = [
        *_describe_transfers(known),
        *_describe_after_losses(known),
        *_describe_growth(known),
    ]
    return ShipSummary(
        warning,
        state=" ".join(filter(None, state)),
        details=" ".join(details),
        caution=" ".join([*_describe_small_margins(known), *caution_on_ideal_sensors(known)]),
        limits=" ".join(_describe_limits(known)),
        conditions=describe_conditions_of_ships(known),
    )


def _warn_of_lost(lost: Sequence[ShipResult], known: Sequence[ShipResult]) -> Iterator[str]:
    """Yield sentences on ships driven off by weather, off at the start, and of unstable loops.

    Last on those whose mean load exceeds the thrust, though the run ends before they leave.
    """
    unstable = [ship for ship in lost if not math.isnan(ship.unstable_radius)]
    away = [ship for ship in lost if ship not in unstable and ship.is_lost_at_start]
    driven = [ship for ship in lost if ship not in unstable and not ship.is_lost_at_start]
    if driven:
        sensors = " with these sensors" * any(map(_has_noise_or_estimator, driven))
        held = sum(ship.is_held for ship in known)
        share = f"{len(driven)} of {len(known)} {_name_kind(known)}"
        where = f"{LOST} in the weather of {share}" if held else BANNER
        others = f" (it holds it in {held})" * bool(held)
        opening = f"{where}{sensors}{_name_failures(driven)}{others}, whatever the solver"
        yield f"{opening}: {_describe_lost(driven)}."
        yield from map(explain_departure, _sort_by_importance(driven)[:MOST_NAMED])
    if away:
        opening = "Elsewhere it starts" if driven else f"{LOST}: it starts"
        yield f"{opening} off its station and ends farther away: {_describe_lost(away)}."
    if unstable:
        controllers = [ship.run.files["scenario"]["controller"] for ship in unstable]
        horizons = sorted({controller["prediction_horizon"] for controller in controllers})
        radius = max(ship.unstable_radius for ship in unstable)
        loop = describe_unstable_loop(_join_first(map(str, horizons)), radius)
        opening = "Elsewhere its loop is" if driven or away else f"{LOST}: its loop is"
        yield f"{opening} {loop}, whatever weather and solver: {_describe_lost(unstable)}."
    if overloaded := [ship for ship in known if ship.state == "on station" and not ship.is_held]:
        most = max(ship.overload for ship in overloaded)
        opening = "Nor does it hold it" if lost else f"{LOST}, whatever the solver,"
        yield (
            f"{opening} in {_name_ships(overloaded)}: the mean load needs "
            f"{format_overload(most)}. The run ({_format_durations(overloaded)}) ended before the "
            "ship left its station."
        )


def format_overload(share: float) -> str:
    """Return the share of its thrust that a ship's mean load takes as text."""
    if math.isinf(share):
        return "a force that no thrust makes"
    return f"{100.0 * share:.0f} % of the thrust"


def _name_kind(known: Sequence[ShipResult]) -> str:
    """Return whether ships are those of scenarios, realisations of studies, or both."""
    kinds = {"realisations" if ship.run.study else "scenarios" for ship in known}
    return " and ".join(sorted(kinds, reverse=True))


def _has_noise_or_estimator(ship: ShipResult) -> bool:
    """Return whether a ship's scenario has measurement noise or an estimator."""
    known = read_conditions((ship.run.scenario_documents or {}).get("scenario") or {})
    return any(known.noise) or known.estimator != "measured"


def _get_faults(run: RunRecord) -> Sequence[Mapping[str, Any]]:
    """Return the tables of the faults in the scenario of a run."""
    return (run.scenario_documents or {}).get("scenario", {}).get("faults") or ()


def _name_failures(lost: Sequence[ShipResult]) -> str:
    """Return words for what was lost before each of these ships left; "" if one lost nothing."""
    before = [
        [
            name
            for at_s, names in list_losses(ship.run)
            if at_s <= ship.run.exact_left_s
            for name in names
        ]
        for ship in lost
    ]
    if not all(before):
        return ""
    losses = dict.fromkeys(join_with_and(names) for names in before)
    return f" after the loss of {' or of '.join(losses)}"


def _describe_lost(lost: Sequence[ShipResult]) -> str:
    """Return when and how far lost ships leave their station as text, those of a study together."""
    by_study = group_by_key((ship for ship in lost if ship.run.study), lambda ship: ship.run.study)
    alone = _sort_by_importance(lost)
    is_intact = [not _has_fault_before_departure(ship) for ship in alone]
    subjects = ["the intact ship" if one and not all(is_intact) else "it" for one in is_intact]
    named = [*zip(alone, subjects, strict=True)][:MOST_NAMED]
    parts = [_describe_departure(ship, subject) for ship, subject in named]
    if others := alone[MOST_NAMED:]:
        parts.append(f"it leaves in {plural(len(others), 'more scenario')}")
    for study, seas in by_study.items():
        far = max(seas, key=lambda ship: ship.run.exact_offset_max_m)
        parts.append(
            f"in {plural(len(seas), 'realisation')} of `{study}` it leaves, by up to "
            f"{significant(far.run.exact_offset_max_m)} m at {_name_sea(far.run)}"
            f"{_format_farther_loop(far)}"
        )
    return "; ".join(parts)


def _sort_by_importance(lost: Sequence[ShipResult]) -> list[ShipResult]:
    """Return lost ships outside of studies: intact ones first, then the one farthest off."""
    alone = (ship for ship in lost if not ship.run.study)
    far = {ship: ship.run.exact_offset_max_m / ship.run.station_radius_m for ship in alone}
    return sorted(far, key=lambda ship: (_has_fault_before_departure(ship), -far[ship]))


def _has_fault_before_departure(ship: ShipResult) -> bool:
    """Return whether a lost ship has lost thrusters or limits before it leaves its station."""
    return any(fault["at_s"] <= ship.run.exact_left_s for fault in _get_faults(ship.run))


def _describe_departure(ship: ShipResult, subject: str) -> str:
    """Return as text when a lost ship leaves its station, its largest offset and the last."""
    run = ship.run
    heading = f"; largest heading error {significant(run.exact_heading_max_deg)}°"
    turned = heading if run.exact_heading_max_deg > HEADING_DEG else ""
    back = " and returns" if ship.is_inside_at_end else ""
    moving = ", still moving away when the run ends" if ship.is_moving_away else ""
    limits = _format_station_limits(ship)
    left = f"leaves its station ({limits}) at {significant(run.exact_left_s)} s{back}"
    if ship.is_lost_at_start:
        left = f"starts off its station ({limits})"
    return (
        f"in `{ship.name}`{_format_wind(run)} {subject} {left}; largest "
        f"offset {significant(run.exact_offset_max_m)} m at {significant(run.exact_offset_max_s)} s"
        f"{_format_farther_loop(ship)}, last offset {significant(run.exact_offset_end_m)} m"
        f"{moving}{turned}"
    )


def describe_departure_with_solver(exact: ShipResult, own: ShipResult) -> str:
    """Return a sentence on a ship that leaves, or does not arrive, with a solver; "" for none.

    exact : the ship of the reference loop, where it is on station; own : that of the solver's loop.
    """
    run = own.run
    if exact.state != "on station" or own.state == "not run":
        return ""
    if exact.has_transfer or not own.has_left_station:
        return (
            f"With this solver, the ship is not at its setpoint at the end (offset "
            f"{significant(run.exact_offset_end_m)} m, heading error "
            f"{significant(run.exact_heading_end_deg)}°)."
        ) * (not own.is_inside_at_end)
    turned = f", largest heading error {significant(run.exact_heading_max_deg)}°"
    return (
        f"With this solver, the ship leaves its station ({_format_station_limits(own)}) at "
        f"{significant(run.exact_left_s)} s: largest offset {significant(run.exact_offset_max_m)} m"
        f"{turned * (run.exact_heading_max_deg > HEADING_DEG)}."
    )


_IN_RUN = {
    "on station": "stays on station",
    "leaves": "leaves its station at {left} s",
    "leaves and returns": "leaves its station at {left} s and returns",
    "not arrived": "is not at its setpoint at the end",
}
"""Results for the ship of one closed loop in words, by `ShipResult.state`."""


def describe_ship_of_run(own: ShipResult) -> str:
    """Return a sentence on the ship of a solver's loop, with its largest offsets and their limits.

    "" without a ship. After a transfer, offsets count from the arrival on.
    """
    if own.state == "not run":
        return ""
    run, since = own.run, " after its arrival" * own.has_transfer
    state = _IN_RUN[own.state].format(left=significant(run.exact_left_s))
    return (
        f"In this run, the ship {state} (largest offset{since} "
        f"{significant(run.exact_offset_max_m)} m of {run.station_radius_m:.3g} m, heading error "
        f"{significant(run.exact_heading_max_deg)}° of {HEADING_DEG:g}°)."
    )


def _format_wind(run: RunRecord) -> str:
    """Return the mean wind of a run's scenario in brackets; "" without wind."""
    scenario = (run.scenario_documents or {}).get("scenario", {})
    wind = (scenario.get("environment") or {}).get("wind") or {}
    return f" (wind {wind['speed_mps']:g} m/s)" if wind.get("speed_mps") else ""


def _format_farther_loop(ship: ShipResult) -> str:
    """Return how far the ship of a solver goes where that is much farther; "" elsewhere."""
    if (loop := ship.farther_loop) is None:
        return ""
    fails = "" if is_accurate_loop(loop) else ", which is inaccurate or fails there,"
    return f" (with `{loop.solver}`{fails} up to {significant(loop.r_max_m)} m)"


def describe_ship(ship: ShipResult) -> str:
    """Return a line on what the controller does to the ship of a scenario."""
    run = ship.run
    if ship.state == "not run":
        return f"`{ship.name}`: not run"
    left = f" (at {significant(run.exact_left_s)} s)" if ship.has_left_station else ""
    needs = f", the mean load needs {format_overload(ship.overload)}"
    over = needs * (ship.overload > 1.0)
    result, since = f"{ship.state}{left}{over}", ""
    if ship.has_transfer and not ship.has_left_station:
        result, since = _describe_arrival([ship]), " after it"
    return (
        f"`{ship.name}`: {result}; largest offset{since} "
        f"{significant(run.exact_offset_max_m)} m {_format_time_of_offset(run)}"
        f"{_format_farther_loop(ship)}, last {significant(run.exact_offset_end_m)} m; "
        f"limits active in {format_share(run.exact_active_share)} of "
        f"{plural(run.exact_steps, 'step')}"
        + ", without those of lost thrusters"
        * bool(list_losses(run))
    )


def _describe_arrival(moved: Sequence[ShipResult]) -> str:
    """Return as text from when on ships are on station after a move, and how far off before.

    The last time and the largest offset of all; without numbers where they are unknown.
    """
    known = [ship.run for ship in moved if not math.isnan(ship.run.exact_transfer_s)]
    if not known:
        return "on station after the approach to its setpoint"
    last_s = max(run.exact_transfer_s for run in known)
    off_m = max(run.exact_transfer_offset_max_m for run in known)
    latest = " at the latest" if len(moved) > 1 else ""
    return (
        f"up to {significant(off_m)} m from its setpoint during the approach and on station "
        f"from t = {significant(last_s)} s{latest}"
    )


def _format_time_of_offset(run: RunRecord) -> str:
    """Return the time of a ship's largest offset as text; the start includes the first sample."""
    if run.exact_offset_max_s <= run.sample_s:
        return "at the start"
    return f"at {significant(run.exact_offset_max_s)} s"


def describe_unmet(ships: Sequence[ShipResult], scenarios: Sequence[Scenario]) -> list[str]:
    """Return the names of what no QP of these runs met: active limits, losses, lag and others."""
    known = [ship.run for ship in ships if ship.state != "not run"]
    met = {
        "an active limit": any(run.exact_active_share > 0.0 for run in known),
        "a problem without a feasible point": any(run.infeasible_steps > 0 for run in known),
    }
    of_scenarios = [_list_conditions(scenario) for scenario in scenarios]
    names = dict.fromkeys(name for conditions in of_scenarios for name in conditions)
    met |= {name: any(conditions[name] for conditions in of_scenarios) for name in names}
    return [what for what, is_met in met.items() if not is_met]


def _list_conditions(scenario: Scenario) -> dict[str, bool]:
    """Return which conditions a scenario contains, by name, as its documents state them.

    An FMU may have any mass, damping and lag.
    """
    document = scenario.files["scenario"]
    weather, known = (
        document.get("environment") or {},
        read_conditions(document, scenario.files["vessel"]),
    )
    return {
        "a loss of thrusters or limits": bool(document.get("faults")),
        "waves": known.has_waves,
        "first-order wave motion": known.has_motion,
        "gusts": (weather.get("wind") or {}).get("gusts", "none") != "none",
        "squalls": bool(weather.get("squalls")),
        "measurement noise": any(known.noise),
        "a state estimator": known.estimator != "measured",
        "thruster lag": known.lag_s > 0.0 or known.is_fmu,
        "actuator delay": known.delay_samples > 0,
        "thrust below that commanded": any(known.thrust_loss_percent),
        "a model mismatch of the mass": known.mass_percent != 0.0 or known.is_fmu,
        "a model mismatch of the damping": known.damping_percent != 0.0
        or known.has_drag
        or known.is_fmu,
    }


def _format_station_limits(ship: ShipResult) -> str:
    """Return the limits of a ship's station as text: radius and heading."""
    return f"{ship.run.station_radius_m:.3g} m, {HEADING_DEG:g}°"


def _describe_kept(known: Sequence[ShipResult]) -> str:
    """Return a sentence on where the ship stays on station, and how far off; "" for nowhere."""
    kept = [ship for ship in known if ship.is_held]
    if not kept:
        return ""
    farthest = max(kept, key=lambda ship: ship.run.exact_offset_max_m / ship.run.station_radius_m)
    run = farthest.run
    if len(known) == 1:
        where = f"in `{farthest.name}` ({_format_durations(kept)})"
        at, end = f" {_format_time_of_offset(run)}", "the end"
    else:
        where = f"in {len(kept)} of {len(known)} {_name_kind(known)} of {_format_durations(kept)}"
        at, end = f", {_format_time_of_offset(run)} of {_locate_ship(farthest)}", "its end"
    from_deg = find_weather_direction(ship.run for ship in known)
    weather = "" if math.isnan(from_deg) else f" in weather from {from_deg:g}°"
    largest = "The largest" if len(kept) == len(known) else "There, the largest"
    if moved := [ship for ship in kept if ship.has_transfer]:
        kind = "scenario" if len(moved) == 1 else "scenarios"
        where += f", in {kind} {_name_ships(moved)}" * (len(known) > 1) + " after an approach"
        largest += " offset on station"
    else:
        largest += " offset"
    return (
        "With exactly solved QPs, the controller holds the ship on station "
        f"({_format_station_limits(farthest)}){weather} {where}. {largest} is "
        f"{significant(run.exact_offset_max_m)} m{at} "
        f"({significant(run.exact_offset_end_m)} m at {end})."
    )


def _format_durations(ships: Sequence[ShipResult]) -> str:
    """Return the simulated time [s] of ships as text, a range where it differs."""
    times_s = [ship.run.exact_steps * ship.run.sample_s for ship in ships]
    shortest, longest = f"{min(times_s):.4g}", f"{max(times_s):.4g}"
    return f"{shortest} s" if shortest == longest else f"{shortest} to {longest} s"


def _describe_transfers(known: Sequence[ShipResult]) -> Iterator[str]:
    """Yield a sentence on ships that move to a new setpoint and then stay on station, if any."""
    if moved := [ship for ship in known if ship.state == "on station" and ship.has_transfer]:
        loops = "reference loop" if len(moved) == 1 else "reference loops"
        yield f"In the {loops} of {_name_ships(moved)}, the ship is {_describe_arrival(moved)}."


def find_weather_direction(runs: Iterable[RunRecord]) -> float:
    """Return the direction [°] that all weather in the scenarios of runs comes from; NaN if none.

    NaN also if wind, waves and current of these scenarios have several directions.
    """
    directions = set()
    for run in runs:
        weather = (run.scenario_documents or {}).get("scenario", {}).get("environment") or {}
        origins = [
            (weather.get("wind") or {}).get("from_deg"),
            (weather.get("waves") or {}).get("from_deg"),
            (weather.get("current") or {}).get("towards_deg", math.nan) + 180.0,
        ]
        known = [deg for deg in origins if deg is not None and not math.isnan(deg)]
        directions |= {deg % 360.0 for deg in known} or {math.nan}
    return directions.pop() if len(directions) == 1 else math.nan


def _describe_after_losses(known: Sequence[ShipResult]) -> Iterator[str]:
    """Yield how far ships outside of studies are off after a loss as text, the farthest first."""
    after = [ship for ship in known if not ship.run.study and _has_loss(ship)]
    after.sort(key=lambda ship: -ship.run.exact_loss_offset_max_m / ship.run.station_radius_m)
    for ship in after[:MOST_NAMED]:
        run = ship.run
        losses = [f"{join_with_and(names)} at {at_s:g} s" for at_s, names in list_losses(run)]
        what = (
            f"the loss of {join_with_and(losses)}"
            if losses
            else "the reduction of the force limits"
        )
        largest = (
            f"{significant(run.exact_loss_offset_max_m)} m",
            f"{significant(run.exact_loss_heading_max_deg)}°",
        )
        last = (
            f"{significant(run.exact_offset_end_m)} m",
            f"{significant(run.exact_heading_end_deg)}°",
        )
        since = _format_time_since_loss(run)
        end = AT_END if since == AT_END else f"{AT_END}, {since}"
        ending = f". {end.capitalize()}, the offset is {last[0]} and the heading error {last[1]}"
        if ship.is_unsettled and last == largest:
            ending = f", both {end}"
        if ship.has_undamped_swing:
            swing = significant(run.exact_loss_swing_m)
            ending += f"; the ship still swings by {swing} m, without decay"
        yield (
            f"After {what} in `{ship.name}`, the largest offset is {largest[0]} and "
            f"the largest heading error {largest[1]}{ending}."
        )


def _name_stopped_before_loss(known: Sequence[ShipResult]) -> str:
    """Return a sentence that names runs stopped before a fault of their scenario; "" for none."""
    early = [
        ship
        for ship in known
        if any(
            fault["at_s"] >= ship.run.exact_steps * ship.run.sample_s
            for fault in _get_faults(ship.run)
        )
    ]
    runs = f"{'run' if len(early) == 1 else 'runs'} of {_name_ships(early)}"
    were = "was" if len(early) == 1 else "were"
    return (
        f"The {runs} {were} stopped before a loss in the scenario, so the ship was not simulated "
        "after it."
    ) * bool(early)


def _name_unsettled(known: Sequence[ShipResult]) -> str:
    """Return a sentence that names ships outside of studies whose small offset still grows."""
    growing = [ship for ship in known if ship.is_unsettled and _has_small_growth(ship)]
    return f"{AT_END.capitalize()} of {_name_ships(growing)}, the offset has not settled." * bool(
        growing
    )


def _describe_growth(known: Sequence[ShipResult]) -> Iterator[str]:
    """Yield a sentence on the last offsets of such ships without a loss, if any."""
    growing = [
        ship
        for ship in known
        if ship.is_unsettled and _has_small_growth(ship) and not _has_loss(ship)
    ]
    if growing:
        far_m = max(ship.run.exact_offset_end_m for ship in growing)
        up_to = "up to " * (len(growing) > 1)
        yield (
            f"After the last step of {_name_ships(growing)}, the offset is "
            f"{up_to}{significant(far_m)} m and still growing."
        )


def _has_small_growth(ship: ShipResult) -> bool:
    """Return whether no study and no caution names a ship that stays on station."""
    return ship.state == "on station" and not (ship.run.study or ship.is_moving_away)


def _has_loss(ship: ShipResult) -> bool:
    """Return whether a ship on its station loses thrusters or limits within its run."""
    return not math.isnan(ship.run.exact_loss_offset_max_m)


def _describe_small_margins(known: Sequence[ShipResult]) -> list[str]:
    """Return lines on ships moving away at the end, near a limit, or lost by one solver alone."""
    kept = sorted(
        (ship for ship in known if ship.state == "on station"),
        key=lambda ship: -ship.used_share_of_station_limits,
    )
    moving = [ship for ship in kept if ship.is_moving_away and not _has_loss(ship)]
    rising = [ship for ship in kept if ship.is_moving_away and _has_loss(ship)]
    near = [ship for ship in kept if ship.used_share_of_station_limits >= NEAR_SHARE]
    sentences = []
    if moving:
        sentences.append(
            "The ship is still moving away when the run ends in "
            f"{_join_first(map(_locate_ship, moving))}: only a longer run shows whether it stays "
            "on station."
        )
    if rising:
        sentences.append(
            "The offset after a loss still rises when the run ends in "
            f"{_join_first(map(_describe_rise, rising))}: a longer `duration_s` shows whether "
            "it settles."
        )
    if near:
        up_to = "up to " if len(near) > 1 else ""
        share = format_share(near[0].used_share_of_station_limits)
        reached = [_format_largest_error(near[0])]
        reached += [_locate_ship(near[0])] * bool(near[0].run.study)
        share += f" ({', '.join(reached)})"
        sentences.append(
            f"The margin is small: the ship reaches {up_to}{share} of "
            f"the limits of its station in {_name_ships(near)}."
        )
    if far := [s for s in kept if (loop := s.farther_loop) and is_accurate_loop(loop)]:
        parts = _join_first(f"{_locate_ship(ship)}{_format_farther_loop(ship)}" for ship in far)
        sentences.append(
            "With an accurate solver the ship leaves the station that it keeps with exactly solved "
            f"QPs in {parts}."
        )
    return sentences


def _format_largest_error(ship: ShipResult) -> str:
    """Return a ship's offset or heading error as text, whichever is nearer to its limit."""
    run = ship.run
    if run.exact_heading_max_deg / HEADING_DEG > run.exact_offset_max_m / run.station_radius_m:
        return f"heading error {significant(run.exact_heading_max_deg)}°"
    return f"offset {significant(run.exact_offset_max_m)} m"


def _describe_rise(ship: ShipResult) -> str:
    """Return a text on a ship whose offset rises after a loss: how far it is, how long after."""
    run = ship.run
    far = f"{significant(run.exact_offset_end_m)} m of {run.station_radius_m:.3g} m"
    return f"{_locate_ship(ship)} ({far}, {_format_time_since_loss(run)})"


def _format_time_since_loss(run: RunRecord) -> str:
    """Return as text how long after the last loss of thrusters a run ends."""
    end_s = run.exact_steps * run.sample_s
    lost_s = [at_s for at_s, _ in list_losses(run) if at_s < end_s]
    return f"{significant(end_s - max(lost_s))} s after the loss" if lost_s else AT_END


def _describe_rest(ships: Sequence[ShipResult]) -> list[str]:
    """Return lines on ships that have not reached their setpoint, and on those without a loop."""
    away = [ship for ship in ships if ship.state == "not arrived"]
    absent = [ship for ship in ships if ship.state == "not run"]
    sentences = []
    if away:
        far = max(away, key=lambda ship: ship.run.exact_offset_end_m)
        sentences.append(
            f"The ship is not at its setpoint at the end of {_name_ships(away)} (offset up to "
            f"{significant(far.run.exact_offset_end_m)} m)."
        )
    if absent:
        sentences.append(
            f"The ship was not run in {_name_ships(absent)}: there is no reference loop."
        )
    return sentences


def _describe_limits(known: Sequence[ShipResult]) -> list[str]:
    """Return lines on the share of steps with active limits, and where the QP was never hard."""
    by_share = sorted(known, key=lambda ship: ship.run.exact_active_share)
    least, most = by_share[0], by_share[-1]
    low, high = (format_share(ship.run.exact_active_share) for ship in (least, most))
    is_part = 0 < sum(ship.is_held for ship in known) < len(known)
    opening = f"Over all {len(known)} {_name_kind(known)}, limits are" if is_part else "Limits are"
    if high == "0 %":
        of_lost = ", apart from those of lost thrusters" * any(list_losses(s.run) for s in known)
        return [f"No limit is ever active{of_lost}, so no QP is hard."]
    if low == high:
        return [f"{opening} active in {low} of the steps."]
    by_name = group_by_key(known, lambda ship: ship.run.study or ship.name)
    shares = {name: max(s.run.exact_active_share for s in own) for name, own in by_name.items()}
    never = [ship for name, own in by_name.items() if shares[name] == 0.0 for ship in own]
    return [
        f"{opening} active in {low} ({_locate_ship(least)}) to {high} ({_locate_ship(most)}) of "
        "the steps.",
        *([f"In {_name_ships(never)} no limit is ever active."] if never else []),
    ]


def _locate_ship(ship: ShipResult) -> str:
    """Return the name of a ship's scenario, or of the point and realisation of a study."""
    run = ship.run
    if not run.study:
        return f"`{ship.name}`"
    return f"{_name_sea(run)} of `{run.study}`"


def _name_sea(run: RunRecord) -> str:
    """Return the name of the point and realisation of a study's run."""
    return f"point {run.study_point:.0f}{_describe_point(run)}, realisation {run.replicate:.0f}"


def _describe_point(run: RunRecord) -> str:
    """Return the first values of a study's point as text; "" where they are none or too long."""
    ordered = sorted(run.x.items(), key=lambda item: WIND_KEYS.get(item[0], len(WIND_KEYS)))
    shown = {
        key.split(".", 1)[-1] if key.startswith(POINT_PREFIXES) else key: value
        for key, value in ordered[:MOST_VALUES]
        if isinstance(value, int | float | str)
    }
    values = [
        f"`{key} = {value}`" if isinstance(value, str) else f"`{key} = {value:g}`"
        for key, value in shown.items()
    ]
    named = f"{', '.join(values)}, …" if len(run.x) > len(shown) else join_with_and(values)
    return f" with {named}" if values and len(named) <= MOST_LETTERS else ""


def _name_ships(ships: Sequence[ShipResult]) -> str:
    """Return the names of the first scenarios of some ships, and a count of the others."""
    names = dict.fromkeys(ship.run.study or ship.name for ship in ships)
    return _join_first(f"`{name}`" for name in names)


def _join_first(texts: Iterable[str]) -> str:
    """Return the first of some texts as a list in words, and a count of the others."""
    known = [*texts]
    others = len(known) - MOST_NAMED
    return join_with_and([*known[:MOST_NAMED], *([f"{others} more"] if others > 0 else [])])
