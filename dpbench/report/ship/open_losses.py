"""Losses of thrusters that a folder lists, and of which no closed loop shows that they are held.

A loss is listed by a capability plot or a consequence analysis. A plot is level 1 of DNV-ST-0111:
the largest wind held from the direction of a scenario's wind. Each weather has its own verdict.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.suites.capability import LOST, CapabilityResult, ConsequenceAnalysis
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.analysis.verdict.simulated_losses import SimulatedLoss, list_simulated_losses
from dpbench.bench.capability.frontier import FROM_DEG, INTACT
from dpbench.report.formats import format_wind_held, join_with_and, plural, significant
from dpbench.report.ship.capability_text import describe_analysed_window, describe_time_held
from dpbench.report.ship.ship_text import MOST_NAMED
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import ThrusterSet


@dataclass(frozen=True)
class OpenLosses:
    """Sentences on the losses that no closed loop shows to be held.

    not_held : of losses that level 1 or a consequence analysis finds not held, those that are not
    simulated first, of these the one with the least wind held; not_simulated : of the others, in
    one sentence; "" for none.
    """

    not_held: tuple[str, ...] = ()
    not_simulated: str = ""

    @property
    def summary(self) -> str:
        """Line with the first loss that is not held, how many more, and those not simulated."""
        first, more = self.not_held[:1], len(self.not_held) - 1
        others = (
            [f"Not held either: {more} more, listed by dpbench report --statement."]
            if more > 0
            else []
        )
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
    by_vessel = group_by_key(known, lambda scenario: scenario.vessel.id)
    not_held, not_simulated = list[_WeatherLoss](), dict[str, None]()
    for vessel, own in by_vessel.items():
        thrusters = own[0].vessel.thrusters
        if thrusters is None:
            continue
        names = [scenario.name for scenario in own]
        of_ship = [ship for ship in ships if ship.run.scenario in names]
        plots_of_ship = [plot for plot in plots if plot.vessel == vessel]
        weathers = list(group_by_key(own, _make_weather_key).values())
        for group in _list_groups(vessel, thrusters, names, plots, analyses):
            losses = [*list_simulated_losses(group, thrusters, of_ship)]
            of_weather = [
                _WeatherLoss(group, alike, losses, plots_of_ship, analyses) for alike in weathers
            ]
            found = [one for one in of_weather if one.findings]
            not_held += [one for one in found if not one.has_ship_left]
            if not found and not losses:
                not_simulated[group] = None
    others = " or of ".join(not_simulated)
    sentence = f"Loss of {others}: not simulated, so not shown to be held." if not_simulated else ""
    by_weight = sorted(not_held, key=lambda one: one.order)
    return OpenLosses(tuple(one.sentence for one in by_weight), sentence)


class _WeatherLoss:
    """Loss of a thruster group in one weather: what level 1, analyses and loops find of it.

    alike : scenarios of a ship with this weather; losses : of the group in closed loops of the
    ship in any weather.
    """

    def __init__(
        self,
        group: str,
        alike: Sequence[Scenario],
        losses: Sequence[SimulatedLoss],
        plots: Sequence[CapabilityResult],
        analyses: Sequence[ConsequenceAnalysis],
    ) -> None:
        self._group, self._alike = group, alike
        names = [scenario.name for scenario in alike]
        self._losses = [loss for loss in losses if loss.ship.run.scenario in names]
        self._analyses = [
            analysis
            for analysis in analyses
            if _scenario_of(analysis) in names
            and (_spans_of(analysis, group)["state"] == LOST).any()
        ]
        self._held_mps = math.inf
        self.findings = [*self._level_1_findings(plots), *self._analysis_findings()]
        """Findings, as text, by which the loss is not held."""

    @property
    def has_ship_left(self) -> bool:
        """True if a ship leaves its station after the loss, as its own result states."""
        return any(loss.has_ship_left for loss in self._losses)

    @property
    def order(self) -> tuple[bool, float, float]:
        """Key that sorts losses: not simulated first, then the least wind held, the least wind."""
        wind_mps = _find_wind(self._alike[0]).get("speed_mps", 0.0)
        return bool(self._losses), self._held_mps, wind_mps

    @property
    def sentence(self) -> str:
        """Verdict on the loss: scenario and wind, what finds it not held, how it was simulated."""
        longest = max(self._losses, key=lambda loss: loss.duration_s, default=None)
        if longest is not None:
            where = [longest.ship.name]
            end = f"simulated: on station for {significant(longest.duration_s)} s after the loss"
        else:
            analysed = [_scenario_of(analysis) for analysis in self._analyses]
            where = [*dict.fromkeys(analysed)] or [scenario.name for scenario in self._alike]
            end = "not simulated in this weather"
        more = [plural(len(where) - MOST_NAMED, "more scenario")] * (len(where) > MOST_NAMED)
        named = join_with_and([*(f"`{name}`" for name in where[:MOST_NAMED]), *more])
        wind = _find_wind(self._alike[0])
        weather = f" (wind {wind['speed_mps']:g} m/s from {wind['from_deg']:g}°)" if wind else ""
        by = " and not by ".join(self.findings)
        return f"Loss of {self._group} in {named}{weather}: not held by {by}; {end}."

    def _level_1_findings(self, plots: Sequence[CapabilityResult]) -> Iterator[str]:
        """Yield as text the wind held without the group, by each plot where it is too little."""
        scenario, wind = self._alike[0], _find_wind(self._alike[0])
        for plot in plots if wind else ():
            held_mps = _held_wind_by_direction(plot, self._group)
            if not held_mps:
                continue
            relative_deg = wind["from_deg"] - math.degrees(float(scenario.reference[2]))
            from_deg = min(held_mps, key=lambda at: abs((at - relative_deg + 180.0) % 360 - 180.0))
            # Polygons lie within the circles of level 1: their wind is too small by at most this.
            if held_mps[from_deg] / math.cos(math.pi / plot.sides) < wind["speed_mps"]:
                self._held_mps = min(self._held_mps, held_mps[from_deg])
                most = format_wind_held(held_mps[from_deg])
                least = "no wind" if held_mps[from_deg] == 0.0 else f"at most {most}"
                yield (
                    f"level 1 of DNV-ST-0111, by which the thrusters then hold {least} "
                    f"{_describe_direction(from_deg)}"
                )

    def _analysis_findings(self) -> Iterator[str]:
        """Yield in words when each analysis that once finds the loss not held finds it held."""
        for analysis in self._analyses:
            when = describe_time_held(_spans_of(analysis, self._group))
            lost = "" if math.isnan(analysis.ship_left_s) else " (of a ship that was not held)"
            window = describe_analysed_window(analysis)
            yield (
                f"the static consequence analysis of {window}{lost}, by which it can be held {when}"
            )


def _describe_direction(from_deg: float) -> str:
    """Return a direction clockwise from the bow [°] as text: up to 180° to starboard or port."""
    if from_deg % 180.0 == 0.0:
        return "from astern" if from_deg % 360.0 else "from ahead"
    side = "starboard" if from_deg < 180.0 else "port"
    return f"from {min(from_deg, 360.0 - from_deg):g}° off the bow to {side}"


def _make_weather_key(scenario: Scenario) -> str:
    """Return a text that is equal for scenarios with the same weather, seeds apart, and heading."""
    environment = dict(scenario.files["scenario"].get("environment") or {})
    environment.pop("seed", None)
    return json.dumps([environment, float(scenario.reference[2])], sort_keys=True)


def _find_wind(scenario: Scenario) -> Mapping[str, float]:
    """Return the wind of a scenario's document: `speed_mps`, `from_deg`; empty without wind."""
    return (scenario.files["scenario"].get("environment") or {}).get("wind") or {}


def _spans_of(analysis: ConsequenceAnalysis, group: str) -> pd.DataFrame:
    """Return an analysis' spans of time in which the loss of a group alone is held or not."""
    return analysis.single_losses[analysis.single_losses["group"] == group]


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


def _held_wind_by_direction(plot: CapabilityResult, group: str) -> Mapping[float, float]:
    """Return the largest wind held [m/s] without a group by direction [°]; empty if one lacks."""
    own = plot.edges[plot.edges["case"] == group]
    held = dict(zip(own["from_deg"].astype(float), own["wind_mps"].astype(float), strict=True))
    return held if len(held) == len(FROM_DEG) else {}
