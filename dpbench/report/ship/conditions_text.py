"""Text on the conditions of each ship result: realisations, sensors, lag, mismatch."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.report.formats import join_with_and, plural
from dpbench.scenario.conditions import Conditions, read_conditions
from dpbench.scenario.problem_files import list_shipped_problem_names

MOST_LISTED = 12
"""Scenarios of equal conditions that are named; more are counted."""
ESTIMATORS = {
    "measured": "no state estimator",
    "kalman": "Kalman filter",
    "passive": "passive observer",
}


def describe_conditions_of_ships(ships: Sequence[ShipResult]) -> str:
    """Return a sentence on each group of ships with equal conditions, as one text.

    Ships without a reference loop or without scenario documents are left out.
    """
    known = [s for s in ships if s.state != "not run" and s.run.scenario_documents is not None]
    by_name = group_by_key(known, _name_ship)
    drawn = {name: _list_realisations(own) for name, own in by_name.items()}
    groups = group_by_key(known, lambda s: (*drawn[_name_ship(s)], *list_conditions(s.run)))
    if len(groups) == 1:
        (alike,) = groups
        return f"Conditions of {'this' if len(known) == 1 else 'every'} result: {', '.join(alike)}."
    common = [part for part in next(iter(groups), ()) if all(part in own for own in groups)]
    names = [dict.fromkeys(map(_name_ship, own)) for own in groups.values()]
    counts = Counter(name for own in names for name in own)
    sentences = []
    for parts, own in zip(groups, names, strict=True):
        listed = [f"{'points of ' * (counts[name] > 1)}`{name}`" for name in own]
        if (more := len(listed) - MOST_LISTED) > 0:
            listed[MOST_LISTED:] = [plural(more, "more scenario")]
        if differing := [part for part in parts if part not in common]:
            sentences.append(f"Conditions in {join_with_and(listed)}: {', '.join(differing)}.")
    if common:
        sentences.append(f"Conditions of every result: {', '.join(common)}.")
    return " ".join(sentences)


def _name_ship(ship: ShipResult) -> str:
    """Return the name of a ship's study or scenario."""
    return ship.run.study or ship.name


def _list_realisations(ships: Sequence[ShipResult]) -> list[str]:
    """Return a text on the realisations of a scenario's or study's weather; none if not random."""
    scenarios = [(ship.run.scenario_documents or {}).get("scenario") or {} for ship in ships]
    seeds = {read_conditions(scenario).seed for scenario in scenarios} - {None}
    if len(seeds) == 1:
        return [f"one realisation (seed {seeds.pop()})"]
    return [plural(len(seeds), "realisation")] if seeds else []


def list_conditions(run: RunRecord) -> tuple[str, ...]:
    """Return sensors, estimator, lag, delay, turning and mismatch of a run's scenario as texts."""
    documents = run.scenario_documents or {}
    scenario, vessel = documents.get("scenario") or {}, documents.get("vessel") or {}
    known = read_conditions(scenario, vessel)
    turning = ["no rate limit on azimuth angles"] * _turns_azimuths_freely(scenario, vessel)
    return *_list_sensors(known), *turning, *_list_differences(known)


def _turns_azimuths_freely(scenario: Mapping[str, Any], vessel: Mapping[str, Any]) -> bool:
    """Return whether a scenario's controller commands azimuths without a limit on their turning."""
    controller = scenario.get("controller") or {}
    has_azimuth = any(one.get("kind") == "azimuth" for one in vessel.get("thrusters") or ())
    is_limited = (controller.get("thrusters") or {}).get("azimuth_turning", False)
    return controller.get("kind") == "thrusters" and has_azimuth and not is_limited


def _list_sensors(known: Conditions) -> Iterator[str]:
    """Yield what the controller measures and how it is filtered, as text."""
    if any(known.noise):
        yield "measurement noise (standard deviation {:g} m, {:g}°)".format(*known.noise)
    else:
        yield "exact sensors"
    yield "first-order wave motion" if known.has_motion else "no first-order wave motion"
    unfiltered = known.estimator != "measured" and not known.has_wave_filter
    yield ESTIMATORS.get(known.estimator, known.estimator) + " without wave filter" * unfiltered


def caution_on_ideal_sensors(ships: Sequence[ShipResult]) -> list[str]:
    """Return a caution where no scenario has noise or wave motion, of ships of one's own only."""
    documents = [ship.run.scenario_documents or {} for ship in ships]
    known = [read_conditions(own.get("scenario") or {}) for own in documents]
    vessels = {own.get("vessel_name") for own in documents}
    is_own = vessels - {None, *list_shipped_problem_names("vessels")}
    if not is_own or any(one.has_motion or any(one.noise) for one in known):
        return []
    return [
        "Exact sensors and no first-order wave motion in every scenario: with noise, motion and an "
        "estimator, the offsets may be several times as large, or the ship may leave its station."
    ]


def _list_differences(known: Conditions) -> Iterator[str]:
    """Yield how the simulated ship differs from the controller's model, as text."""
    if known.lag_s or not known.is_fmu:
        yield f"thruster lag {known.lag_s:g} s" if known.lag_s else "no thruster lag"
    yield f"delay of {plural(known.delay_samples, 'sample')}" if known.delay_samples else "no delay"
    if known.is_fmu:
        yield "the ship is an FMU with its own lag and mismatch"
        return
    shares = {"mass": known.mass_percent, "damping": known.damping_percent}
    found = [f"{what} {share:+g} %" for what, share in shares.items() if share]
    if any(known.thrust_loss_percent):
        losses = "/".join(f"{share:g}" for share in known.thrust_loss_percent)
        found.append(f"thrust loss {losses} %")
    if known.has_drag:
        found.append("the ship has cross-flow drag; the controller's model is linear")
    yield f"with model mismatch ({'; '.join(found)})" if found else "no model mismatch"
