"""Text of what thrusters hold: capability numbers, and losses in a consequence analysis."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import (
    HELD,
    LOST,
    Answers,
    BatchAnswers,
    CapabilityResult,
    ConsequenceAnalysis,
    build_capability_results,
    build_consequence_analyses,
    find_largest_solve_time_share,
    select_configurations_in_all_analyses,
)
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.analysis.verdict.verdict import explain_deployment_blocker
from dpbench.bench.capability.frontier import INTACT, CapabilityPlot, compute_capability
from dpbench.report.formats import format_wind_held, join_with_and, plural, significant
from dpbench.report.ship.ship_text import find_weather_direction, format_overload
from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.ship.capability.losses import caution_on_wash
from dpbench.ship.thrusters import ThrusterSet


def describe_capability(records: Records, plot: CapabilityResult) -> Iterator[str]:
    """Yield sentences on a ship's capability numbers, and least wind held intact, after a loss."""
    if plot.edges.empty:
        return
    intact = plot.edges[plot.edges["case"] == INTACT]
    failed = plot.edges[plot.edges["case"] != INTACT]
    wording = f"Intact, {plot.vessel} holds {_format_least_wind(intact)}"
    if len(failed):
        wording += f"; after the loss of {' '.join(_find_worst_loss(failed))}"
    if plot.capability_numbers_text:
        rudders = " without rudders" if _has_rudder_caution(records, plot.vessel) else ""
        yield f"{plot.capability_numbers_text}{rudders}."
        if planned := _compute_planned_numbers(records, plot.vessel):
            yield f"With the half turns in which the controllers plan: {planned}."
    about = f"DNV-ST-0111, level 1; azimuths as polygons of {plot.sides} sides"
    yield f"{wording} ({about}{_explain_sectors(records, plot.vessel)})."


def _list_thruster_sets(records: Records, vessel: str) -> list[ThrusterSet]:
    """Return the thrusters of a ship, by its id, in each of these scenarios."""
    known = filter(None, map(records.build_scenario, records.scenarios))
    thrusters = [scenario.vessel.thrusters for scenario in known if scenario.vessel.id == vessel]
    return [one for one in thrusters if one is not None]


def list_wash_cautions(records: Records) -> list[str]:
    """Return sentences on azimuths of one's own ships whose wash may hit another one."""
    known = filter(None, map(records.build_scenario, records.scenarios))
    vessels = {scenario.vessel.id for scenario in known}
    own = vessels.difference(list_shipped_problem_names("vessels"))
    every = [one for vessel in sorted(own) for one in _list_thruster_sets(records, vessel)]
    found = dict.fromkeys(text for one in every for text in caution_on_wash(one))
    return [text.replace("CAUTION: closed", "Closed") for text in found]


def _has_rudder_caution(records: Records, vessel: str) -> bool:
    """Return whether main propellers alone push aft on a ship of these scenarios, by its id."""
    return any(one.caution_on_rudders for one in _list_thruster_sets(records, vessel))


def _explain_sectors(records: Records, vessel: str) -> str:
    """Return text on the directions counted where controllers plan with less; "" elsewhere."""
    if not any(one.has_half_turns for one in _list_thruster_sets(records, vessel)):
        return ""
    return "; in all directions outside their barred zones"


def _compute_planned_numbers(records: Records, vessel: str) -> str:
    """Return a ship's DP capability numbers with the half turns of its controllers; or ""."""
    known = filter(None, map(records.build_scenario, records.scenarios))
    ships = [scenario.vessel for scenario in known if scenario.vessel.id == vessel]
    for ship in ships:
        if ship.thrusters is not None and ship.thrusters.has_half_turns:
            planned = replace(ship, thrusters=ship.thrusters.copy_with_convex_sectors())
            return compute_capability(CapabilityPlot(planned)).notation
    return ""


def describe_worst_loss(records: Records, plot: CapabilityResult) -> str:
    """Return a sentence on the wind held after the worst loss, over all directions; or ""."""
    failed = plot.edges[plot.edges["case"] != INTACT]
    if failed.empty:
        return ""
    case, wind = _find_worst_loss(failed)
    sectors = _explain_sectors(records, plot.vessel)
    return f"After the worst loss, of {case}, {plot.vessel} holds {wind} (level 1{sectors})."


def _find_worst_loss(failed: pd.DataFrame) -> tuple[str, str]:
    """Return the case in which the least wind is held, and that wind with direction, as text."""
    case = str(failed.nsmallest(1, "wind_mps")["case"].iloc[0])
    return case, _format_least_wind(failed[failed["case"] == case])


def _format_least_wind(edges: pd.DataFrame) -> str:
    """Return a text of the least wind held over all directions [m/s], and its direction.

    "no wind" where none is held from any direction. Of equal winds the first direction from the bow
    to starboard counts, as in `dpbench init`.
    """
    rounded = edges.assign(wind_mps=edges["wind_mps"].round(3))
    least = rounded.sort_values(["wind_mps", "from_deg"]).iloc[0]
    is_alike = len(edges) > 1 and (edges["wind_mps"] == least["wind_mps"]).all()
    if least["wind_mps"] == 0.0:
        return "no wind" if is_alike else f"no wind from {least['from_deg']:.0f}°"
    weakest = f"in its weakest direction, from {least['from_deg']:.0f}°"
    where = "from every direction" if is_alike else weakest
    return f"{format_wind_held(least['wind_mps'])} of wind {where}"


_NEVER = "at no time"
STATIC = (
    "The analysis is static: it balances only the filtered mean force of the analysed steps, so "
    "the simulated ship may hold its station or leave it."
)


def describe_time_held(of_group: pd.DataFrame) -> str:
    """Return in words when a thruster loss can be held: throughout, until a time, or never."""
    states, change_s = of_group["state"].tolist(), of_group["from_s"].iloc[-1]
    if states == [HELD]:
        return "throughout"
    # A time that rounds to 0 s is that of the first samples alone.
    if HELD not in states or (states == [HELD, LOST] and change_s < 0.5):
        return _NEVER
    if states == [HELD, LOST]:
        return (
            f"until {change_s:.0f} s, after which the remaining thrusters cannot produce the "
            "required force"
        )
    if states == [LOST, HELD]:
        return f"from {change_s:.0f} s on"
    long_s = of_group["to_s"] - of_group["from_s"]
    share = long_s[of_group["state"] == HELD].sum() / long_s.sum()
    return f"in {100.0 * share:.0f} % of the time"


def describe_losses_held(analysis: ConsequenceAnalysis) -> str:
    """Return a text on which thruster losses can be held and when, and the force asked for.

    With cautions where a closed loop or the mean load shows that the ship is not held.
    """
    loop, held = _describe_analysed_loop(analysis), "; ".join(_list_times_held(analysis))
    return " ".join(
        [
            f"In {analysis.name}{loop} {held} ({describe_required_force(analysis)}).",
            STATIC,
            *list_analysis_cautions(analysis),
        ]
    )


def _list_times_held(analysis: ConsequenceAnalysis) -> Iterator[str]:
    """Yield in words when each loss can be held; those after simulated losses are further ones."""
    spans = analysis.spans
    for losses, own in spans.groupby("losses"):
        when: dict[str, list[str]] = {}
        for group, of_group in own.groupby("group", sort=False):
            when.setdefault(describe_time_held(of_group), []).append(str(group))
        before = describe_losses_before(analysis, int(str(losses)))
        opening = f"{before}, the further loss" if before else "the loss"
        if not before and (spans["losses"] > 0).any():
            opening = f"before {own['to_s'].max():.4g} s {opening}"
        held = [f"of {' or of '.join(groups)} can be held {time}" for time, groups in when.items()]
        yield f"{opening} {f'; {opening} '.join(held)}"
    if spans.empty:
        yield "the loop has lost all analysed groups before the first analysed step"


def describe_losses_before(analysis: ConsequenceAnalysis, losses: int) -> str:
    """Return in words the first losses that the loop of an analysis simulates; "" for none."""
    known = list_losses(analysis.run)[:losses] if analysis.run else []
    named = [f"{join_with_and(names)} at {at_s:g} s" for at_s, names in known]
    return f"after the loss of {join_with_and(named)}" if named else ""


def list_analysis_cautions(analysis: ConsequenceAnalysis) -> list[str]:
    """Return cautions where a loop or the mean load shows that the ship of an analysis is lost."""
    cautions = [describe_analysed_ship(analysis)]
    if analysis.overload > 1.0:
        cautions.append(
            f"CAUTION: the mean load needs {format_overload(analysis.overload)}, so the ship does "
            "not hold its station, even without a loss."
        )
    departures = [
        f"after the loss of {group} (`{scenario}`)" if group else f"without a loss (`{scenario}`)"
        for group, scenario in analysis.departures
        if group or not cautions[0]
    ]
    if departures:
        where = join_with_and(departures)
        cautions.append(f"CAUTION: in closed loop the ship leaves its station {where}.")
    return [*filter(None, cautions)]


def describe_analysed_ship(analysis: ConsequenceAnalysis) -> str:
    """Return a caution on an analysis of a ship that was not held; "" where it was."""
    if math.isnan(analysis.ship_left_s):
        return ""
    return (
        "CAUTION: this analysis is of a ship that was not held: it leaves its station at "
        f"{significant(analysis.ship_left_s)} s. Its forces are not those that hold the station."
    )


def describe_analysed_window(analysis: ConsequenceAnalysis) -> str:
    """Return in words the scenario of an analysis, and its steps where they are a part."""
    name = f"`{analysis.name.partition('[')[0]}`"
    steps = re.search(r"\[(\d+):(\d+)\]$", analysis.name)
    return f"steps {steps[1]} to {int(steps[2]) - 1} of {name}" if steps else name


def _describe_analysed_loop(analysis: ConsequenceAnalysis) -> str:
    """Return in brackets the steps of an analysis, and its wind or weather direction; or ""."""
    facts = []
    if steps := re.search(r"\[(\d+):(\d+)\]$", analysis.name):
        facts.append(f"steps {steps[1]} to {int(steps[2]) - 1}")
    files = (analysis.run.scenario_documents if analysis.run else None) or {}
    wind = (files.get("scenario", {}).get("environment") or {}).get("wind")
    from_deg = find_weather_direction([analysis.run] if analysis.run else [])
    if wind:
        facts.append(f"wind {wind['speed_mps']:g} m/s from {wind['from_deg']:g}°")
    elif not math.isnan(from_deg):
        facts.append(f"weather from {from_deg:g}°")
    return f" ({', '.join(facts)})" if facts else ""


def describe_answers_at_edge(plot: CapabilityResult) -> str:
    """Return a sentence on solvers right on all QPs at the largest winds held; "" without runs."""
    if not plot.answers:
        return ""
    right = sorted(a.solver for a in plot.answers if a.has_only_right_answers)
    qps = f"all {plural(plot.qp_count, 'QP')} at the edge of the plot"
    names = f": {join_with_and(right)}" if right else ""
    who = count_answering(len(right), len(plot.answers), "solver")
    return f"{who} {qps} correctly{names}."


def count_answering(right: int, count: int, noun: str) -> str:
    """Return how many solvers or configurations of some answer QPs, with the verb."""
    verb = "answers" if 1 in (right, count) else "answer"
    return f"{right} of {plural(count, noun)} {verb}"


def describe_consequence_solver(records: Records, solver: str) -> str:
    """Return a sentence on a solver for the consequence analysis; "" where the MPC's will do.

    The configuration that answers all QPs rightly and takes the least share of a sample counts, if
    its solver also answers those at the edge of every capability plot. None is named where all of
    these QPs are feasible or all infeasible: one answer to everything would then be right.
    """
    own = select_configurations_in_all_analyses(build_consequence_analyses(records))
    if not own:
        return ""
    at_edge = [plot.answers for plot in build_capability_results(records, None) if plot.answers]
    right_at_edge = [{a.solver for a in of if a.has_only_right_answers} for of in at_edge]
    right = {
        name: of_it
        for name, of_it in own.items()
        if all(a.has_only_right_answers for a in of_it)
        and all(of_it[0].solver in solvers for solvers in right_at_edge)
    }
    asked, edges = ([a for of in each for a in of] for each in (own.values(), at_edge))
    kinds = _list_kinds(asked)
    one_kind = kinds[0] if len(kinds) == 1 else ""
    same = [name for name in right if right[name][0].solver == solver]
    if same and not one_kind:
        return ""
    deployable = [name for name in right if not explain_deployment_blocker(right[name][0].solver)]
    shares = {name: find_largest_solve_time_share(right[name]) for name in same or deployable}
    best = min(shares, key=lambda name: (math.isnan(shares[name]), shares[name]), default="")
    edge = " and those at the edge of the capability plot" if at_edge else ""
    other = best or f"no solver that was run answers all its QPs{edge} correctly"
    if one_kind and _list_kinds([*asked, *edges]) == kinds:
        fit = join_with_and([*dict.fromkeys(right[name][0].solver for name in right)])
        who = f"; correct on all of them: {fit}" if fit and one_kind == "feasible" else ""
        other = f"none named, as all its QPs are {one_kind}{who}"
    elif one_kind and best:
        but = "but not all at the edge of the capability plot"
        other += f" (all QPs of the analysis are {one_kind}, {but})"
    return f"MPC: {solver}; consequence analysis: {other}."


def _list_kinds(answers: Sequence[Answers | BatchAnswers]) -> list[str]:
    """Return the kinds of QPs that solvers reached: feasible, infeasible or both."""
    return [kind for kind in ("feasible", "infeasible") if any(getattr(a, kind) for a in answers)]


def describe_required_force(analysis: ConsequenceAnalysis) -> str:
    """Return in words the force that the thrusters must make after a loss."""
    return f"required force: filtered over 60 s, times a dynamic margin of {analysis.margin:g}"


def describe_unanswered_qps(records: Records, solver: str) -> str:
    """Return a text on a solver's missed alarms and QPs without an answer; "" for none.

    In the folder's consequence analyses, of the solver's best configuration.
    """
    best = [
        a.best_answers_by_solver[solver]
        for a in build_consequence_analyses(records)
        if solver in a.best_answers_by_solver
    ]
    silent, asked = sum(a.unanswered_count for a in best), sum(a.asked for a in best)
    missed = sum(a.missed for a in best)
    infeasible = sum(a.infeasible - a.refused - a.missed for a in best)
    where = " where a loss cannot be held" if silent == infeasible else ""
    qps = f"{silent} of {asked} QPs of the consequence analysis"
    counts = {
        f"misses {plural(missed, 'alarm')} of the consequence analysis": missed,
        f"leaves {qps} unanswered{where}": silent,
    }
    said = join_with_and([text for text, count in counts.items() if count])
    return said and f"`{solver}` {said}"
