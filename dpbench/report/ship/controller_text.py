"""Text on the controllers of scenarios: sample time, horizons, weights, and what they leave out."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dpbench.analysis.records.run_record import group_by_key
from dpbench.report.formats import join_with_and, plural
from dpbench.scenario.scenario import Scenario

MOST_NAMED = 3
"""Scenarios of one controller that are named."""
OUTPUT_UNITS = "[1/m², 1/m², 1/rad²]"
MOVE_UNITS = "[1/N², 1/N², 1/(N·m)²]"


def describe_controllers(scenarios: Sequence[Scenario]) -> list[str]:
    """Return a sentence on each controller of some scenarios: sample, horizons and weights."""
    alike = group_by_key(scenarios, _describe_settings)
    lines = []
    for settings, own in alike.items():
        names = [*dict.fromkeys(scenario.name for scenario in own)]
        more = [plural(len(names) - MOST_NAMED, "more scenario")] * (len(names) > MOST_NAMED)
        lines.append(f"Controller in {join_with_and([*names[:MOST_NAMED], *more])}: {settings}.")
    return lines


def _describe_settings(scenario: Scenario) -> str:
    """Return the settings of a scenario's controller as text."""
    controller = scenario.files["scenario"]["controller"]
    horizons = f"{controller['prediction_horizon']}/{controller['control_horizon']}"
    parts = (
        {"forces": "plans forces", "thrusters": "commands thrusters"}.get(
            controller.get("kind", "forces"), "plans forces and allocates thrust (cascade)"
        ),
        f"sample time {scenario.sample_s:g} s",
        f"prediction/control horizon {horizons} samples",
        f"Q = {_format_diagonal(controller['output_weight'])} {OUTPUT_UNITS}",
        *_list_input_weights(controller),
    )
    return ", ".join(parts)


def _list_input_weights(controller: Mapping[str, Any]) -> Iterator[str]:
    """Yield the weights of moves and thrust of a controller's table as text."""
    if controller.get("move_weight") is not None:
        yield f"R = {_format_diagonal(controller['move_weight'])} {MOVE_UNITS}"
    if controller.get("move_weight_relative") is not None:
        weights = _format_diagonal(controller["move_weight_relative"])
        yield f"R = {weights}/(maximum increment)²"
    if table := controller.get("thrusters"):
        yield f"R = {table['move_weight_relative']:g}/(maximum increment)²"
        yield f"W = {table['thrust_weight_relative']:g}/(largest thrust)²"


def _format_diagonal(weights: Sequence[float]) -> str:
    """Return a diagonal weight as text."""
    return f"diag({', '.join(f'{weight:g}' for weight in weights)})"


def list_model_gaps(scenarios: Sequence[Scenario]) -> list[str]:
    """Return sentences on what neither controllers nor ships of some scenarios model."""
    sets = [s.vessel.thrusters for s in scenarios if s.vessel.thrusters is not None]
    has_rudder = any(t.kind == "main" for every in sets for t in every.thrusters)
    unused = [describe_unused_turning(scenario) for scenario in scenarios]
    rudders = ["Rudders are not modelled."] if has_rudder else []
    return [*rudders, *dict.fromkeys(filter(None, unused))]


def describe_unused_turning(scenario: Scenario) -> str:
    """Return a sentence on turning rates of azimuths that its controller ignores; "" for none."""
    controller, thrusters = scenario.files["scenario"]["controller"], scenario.vessel.thrusters
    table = controller.get("thrusters") or {}
    if thrusters is None or table.get("azimuth_turning", False):
        return ""
    if not any(thruster.turning_radps is not None for thruster in thrusters.thrusters):
        return ""
    if controller.get("kind", "forces") == "thrusters":
        return "turning_degps is not used without azimuth_turning = true in the controller."
    return "turning_degps is not used: the controller does not plan directions."
