"""Losses of thrusters that a folder lists, and of which no closed loop shows that they are held.

A loss is listed by a capability plot or a consequence analysis. A plot is level 1 of DNV-ST-0111:
the largest wind held from the direction of a scenario's wind.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import LOST, CapabilityResult, ConsequenceAnalysis
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.bench.capability.frontier import FROM_DEG, INTACT
from dpbench.report.capability_text import describe_time_held
from dpbench.report.formats import format_rounded_down, significant
from dpbench.report.ship_text import list_losses
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import ThrusterSet


@dataclass(frozen=True)
class OpenLosses:
    """Sentences on the losses that no closed loop shows to be held.

    not_held : of losses that level 1 or a consequence analysis finds not held; not_simulated : of
    the others, in one sentence; "" for none.
    """

    not_held: tuple[str, ...] = ()
    not_simulated: str = ""

    @property
    def summary(self) -> str:
        """Line with the first loss that is not held, how many more, and those not simulated."""
        first, more = self.not_held[:1], len(self.not_held) - 1
        others = [f"Not held either: {more} more, see the statement."] if more > 0 else []
        return " ".join([*first, *others, *filter(None, [self.not_simulated])])


def find_open_losses(
    records: Records,
    ships: Sequence[ShipResult],
    plots: Sequence[CapabilityResult],
    analyses: Sequence[ConsequenceAnalysis],
) -> OpenLosses:
    """Return sentences on losses that are not simulated, or not held by level 1 or an analysis."""
    if not plots and not analyses:
        return OpenLosses()
    known = [scenario for scenario in map(records.build_scenario, records.scenarios) if scenario]
    by_vessel = {s.vessel.id: s.vessel.thrusters for s in known if s.vessel.thrusters is not None}
    not_held, not_simulated = [], []
    for vessel, thrusters in by_vessel.items():
        own = [scenario for scenario in known if scenario.vessel.id == vessel]
        names = [scenario.name for scenario in own]
        of_ship = [ship for ship in ships if ship.run.scenario in names]
        for group in _list_groups(vessel, thrusters, names, plots, analyses):
            lasting_s = _longest_simulation_s(group, thrusters, of_ship)
            why = [
                *_level_1_findings(group, own, [plot for plot in plots if plot.vessel == vessel]),
                *_analysis_findings(group, names, analyses),
            ]
            if why and not _has_left_after(group, thrusters, of_ship):
                simulated = (
                    "not simulated"
                    if math.isnan(lasting_s)
                    else f"on station for the {significant(lasting_s)} s that are simulated"
                )
                not_held.append(f"Loss of {group}: not held ({simulated}: {'; '.join(why)}).")
            elif math.isnan(lasting_s):
                not_simulated.append(group)
    others = " or of ".join(not_simulated)
    sentence = f"Loss of {others}: not simulated, so not shown to be held." if not_simulated else ""
    return OpenLosses(tuple(not_held), sentence)


def _list_groups(
    vessel: str,
    thrusters: ThrusterSet,
    scenarios: Sequence[str],
    plots: Sequence[CapabilityResult],
    analyses: Sequence[ConsequenceAnalysis],
) -> list[str]:
    """Return a ship's failure groups that a capability plot or an analysis of it names."""
    named = {str(case) for plot in plots if plot.vessel == vessel for case in plot.edges["case"]}
    for analysis in analyses:
        if _scenario_of(analysis) in scenarios:
            named |= set(analysis.groups)
    return [group for group in thrusters.indices_by_failure_group if group in named - {INTACT}]


def _scenario_of(analysis: ConsequenceAnalysis) -> str:
    """Return the name of the scenario along which a consequence analysis runs."""
    return analysis.name.partition("[")[0]


def _losses_of_group(
    group: str, thrusters: ThrusterSet, ships: Sequence[ShipResult]
) -> Iterator[tuple[float, ShipResult]]:
    """Yield the time [s] and the ship result of each loss of a whole thruster group."""
    members = set(thrusters.indices_by_failure_group[group])
    for ship in ships:
        for at_s, names in list_losses(ship.run):
            lost = thrusters.find_indices_of_thrusters_or_groups(names, ship.name, "faults.lost")
            if members <= lost and at_s < ship.run.exact_steps * ship.run.sample_s:
                yield at_s, ship


def _longest_simulation_s(group: str, thrusters: ThrusterSet, ships: Sequence[ShipResult]) -> float:
    """Return how long a closed loop goes on after the loss of a group [s]; NaN without one."""
    return max(
        (
            ship.run.exact_steps * ship.run.sample_s - at_s
            for at_s, ship in _losses_of_group(group, thrusters, ships)
        ),
        default=math.nan,
    )


def _has_left_after(group: str, thrusters: ThrusterSet, ships: Sequence[ShipResult]) -> bool:
    """Return whether a ship leaves its station after the loss of a group, as its result states."""
    return any(
        ship.has_left_station and ship.run.exact_left_s >= at_s
        for at_s, ship in _losses_of_group(group, thrusters, ships)
    )


def _level_1_findings(
    group: str, scenarios: Sequence[Scenario], plots: Sequence[CapabilityResult]
) -> Iterator[str]:
    """Yield in words the winds held without a thruster group that are below a scenario's."""
    seen = set()
    for plot in plots:
        held_mps = _held_wind_by_direction(plot, group)
        for scenario in scenarios:
            wind = (scenario.files["scenario"].get("environment") or {}).get("wind")
            if not wind or not held_mps:
                continue
            relative_deg = wind["from_deg"] - math.degrees(float(scenario.reference[2]))
            from_deg = min(held_mps, key=lambda at: abs((at - relative_deg + 180.0) % 360 - 180.0))
            if held_mps[from_deg] < wind["speed_mps"]:
                seen.add((held_mps[from_deg], from_deg, wind["speed_mps"]))
    for most_mps, from_deg, wind_mps in sorted(seen):
        yield (
            f"by level 1 the thrusters then hold {format_rounded_down(most_mps)} m/s of wind from "
            f"{from_deg:g}°, and the scenario has {wind_mps:g} m/s"
        )


def _held_wind_by_direction(plot: CapabilityResult, group: str) -> Mapping[float, float]:
    """Return the largest wind held [m/s] without a group by direction [°]; empty if one lacks."""
    own = plot.edges[plot.edges["case"] == group]
    held = dict(zip(own["from_deg"].astype(float), own["wind_mps"].astype(float), strict=True))
    return held if len(held) == len(FROM_DEG) else {}


def _analysis_findings(
    group: str, scenarios: Sequence[str], analyses: Sequence[ConsequenceAnalysis]
) -> Iterator[str]:
    """Yield in words when a loss is held, for each consequence analysis that once finds it not."""
    for analysis in analyses:
        own = analysis.spans[analysis.spans["group"] == group]
        if _scenario_of(analysis) in scenarios and (own["state"] == LOST).any():
            yield f"by the consequence analysis it can be held {describe_time_held(own)}"
