"""Text on the conditions of each ship result: sensors, estimator, lag, delay and mismatch."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.report.formats import join_with_and, plural

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
    groups = group_by_key(known, lambda ship: list_conditions(ship.run))
    if len(groups) == 1:
        (alike,) = groups
        return f"Conditions of {'this' if len(known) == 1 else 'every'} result: {', '.join(alike)}."
    common = [part for part in next(iter(groups), ()) if all(part in own for own in groups)]
    names = [dict.fromkeys(s.run.study or s.name for s in own) for own in groups.values()]
    counts = Counter(name for own in names for name in own)
    sentences = []
    for parts, own in zip(groups, names, strict=True):
        listed = [f"{'points of ' * (counts[name] > 1)}`{name}`" for name in own]
        if (more := len(listed) - MOST_LISTED) > 0:
            listed[MOST_LISTED:] = [plural(more, "more scenario")]
        differing = [part for part in parts if part not in common]
        sentences.append(f"Conditions in {join_with_and(listed)}: {', '.join(differing)}.")
    if common:
        sentences.append(f"Conditions of every result: {', '.join(common)}.")
    return " ".join(sentences)


def list_conditions(run: RunRecord) -> tuple[str, ...]:
    """Return sensors, estimator, lag, delay and mismatch of a run's scenario as texts."""
    documents = run.scenario_documents or {}
    scenario, vessel = documents.get("scenario") or {}, documents.get("vessel") or {}
    plant = scenario.get("plant") or {}
    return *_list_sensors(scenario), *_list_differences(plant, vessel)


def _list_sensors(scenario: Mapping[str, Any]) -> Iterator[str]:
    """Yield what the controller measures and how it is filtered, as text."""
    weather, estimator = scenario.get("environment") or {}, scenario.get("estimator") or {}
    noise, waves = weather.get("noise") or {}, weather.get("waves") or {}
    has_motion = waves.get("motion") is not None
    kind = estimator.get("kind", "measured")
    if any(noise.values()):
        yield f"measurement noise ({noise['position_m']:g} m, {noise['heading_deg']:g}°)"
    else:
        yield "exact sensors"
    yield "first-order wave motion" if has_motion else "no first-order wave motion"
    unfiltered = kind != "measured" and not estimator.get("wave_filter", True)
    yield ESTIMATORS.get(kind, str(kind)) + " without wave filter" * unfiltered


def _list_differences(plant: Mapping[str, Any], vessel: Mapping[str, Any]) -> Iterator[str]:
    """Yield how the simulated ship differs from the controller's model, as text."""
    lag_s, delay = plant.get("thruster_lag_s"), plant.get("delay_samples")
    is_fmu = bool(plant.get("fmu"))
    if lag_s or not is_fmu:
        yield f"thruster lag {lag_s:g} s" if lag_s else "no thruster lag"
    yield f"delay of {plural(delay, 'sample')}" if delay else "no delay"
    if is_fmu:
        yield "the ship is an FMU with its own lag and mismatch"
        return
    shares = {what: plant.get(f"{what}_percent") for what in ("mass", "damping")}
    found = [f"{what} {share:+g} %" for what, share in shares.items() if share]
    if any(plant.get("thrust_loss_percent") or ()):
        losses = "/".join(f"{share:g}" for share in plant["thrust_loss_percent"])
        found.append(f"thrust loss {losses} %")
    if vessel.get("drag"):
        found.append("cross-flow drag against a linear model")
    yield f"mismatch: {', '.join(found)}" if found else "no model mismatch"
