"""A scenario in words for the statement: weather, losses, thrusters."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dpbench.analysis.records.run_record import group_by
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.report.formats import join_with_and
from dpbench.report.ship_text import describe_ship, list_losses
from dpbench.ship.thrusters import describe_sector


def describe_scenario(ship: ShipResult) -> Iterator[str]:
    """Yield one line on a scenario: what became of the ship, its title, weather and losses."""
    yield describe_ship(ship)
    scenario = (ship.run.scenario_files or {}).get("scenario")
    if scenario is not None:
        parts = [_describe_weather(scenario.get("environment") or {})]
        parts += [
            f"loss of {join_with_and(lost)} at {at_s:g} s" for at_s, lost in list_losses(ship.run)
        ]
        yield f"{scenario.get('title', ship.name)}: {'; '.join(parts)}"


def _describe_weather(environment: Mapping[str, Any]) -> str:
    """State mean wind, waves and current with their directions; or that there are none."""
    wind, waves, current = (environment.get(key) for key in ("wind", "waves", "current"))
    parts = []
    if wind:
        parts.append(f"wind {wind['speed_mps']:g} m/s from {wind['from_deg']:g}°")
    if waves:
        height = f"Hs {waves['hs_m']:g} m, Tp {waves['tp_s']:g} s"
        parts.append(f"{height} from {waves['from_deg']:g}°")
    if current:
        parts.append(f"current {current['speed_mps']:g} m/s to {current['towards_deg']:g}°")
    if any(environment.get("mean_kN") or ()):
        surge, sway, yaw = environment["mean_kN"]
        parts.append(f"mean force {surge:g} kN, {sway:g} kN, {yaw:g} kN·m")
    return ", ".join(parts) or "no wind, waves or current"


def describe_thrusters(thrusters: Sequence[Mapping[str, Any]]) -> str:
    """List the thrusters of a vessel document by switchboard, with their powers; "" without any."""
    by_board = group_by(thrusters, lambda one: str(one.get("group") or "no group"))
    boards = [f"{board}: {', '.join(map(_name_thruster, own))}" for board, own in by_board.items()]
    return "; ".join(boards)


def _name_thruster(thruster: Mapping[str, Any]) -> str:
    """Name a thruster with its power and the directions it pushes in, where they are known."""
    power_kW, sector_deg = thruster.get("power_kW"), thruster.get("sector_deg")
    facts = [f"{power_kW:g} kW"] if power_kW else []
    facts += [describe_sector(*sector_deg)] if sector_deg else []
    return str(thruster["name"]) + (f" ({', '.join(facts)})" if facts else "")
