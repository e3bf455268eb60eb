"""The section on rankings: what accuracy costs, ratios to a baseline, places that hold or flip."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.times.fastest import fastest_at, fastest_on
from dpbench.analysis.times.pooled import CommonSteps, common_steps
from dpbench.analysis.times.ranks import Ranking, rank
from dpbench.analysis.times.ratios import ratios
from dpbench.analysis.times.work_precision import (
    LevelPoint,
    default_route_levels,
    native_route_levels,
)
from dpbench.bench.judge.rules import supports
from dpbench.errors import InputError
from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.figures_ranks import (
    FARTHEST,
    OF_EACH,
    highlighted,
    performance_profiles,
    work_precision,
)
from dpbench.report.formats import and_list, plural
from dpbench.report.tables_levels import levels_of
from dpbench.report.tables_ranks import rank_table, ratio_tables


def check_baseline(view: Records, demand: Demand, solver: str) -> None:
    """Refuse a baseline without a replayed configuration that others can be compared with."""
    pooled = common_steps(view, demand)
    known = (
        list(dict.fromkeys(configuration.configuration.solver for configuration in pooled.pooled))
        if pooled
        else []
    )
    if solver not in known:
        allowed = ", ".join(known) or "none, no replay left a step"
        raise InputError("--baseline", "", repr(solver), f"a solver that was replayed: {allowed}")


def ranks_section(view: Records, demand: Demand, baseline: str | None = None) -> Section:
    """Rankings and what they depend on.

    Parameters
    ----------
    baseline : the solver that others are compared with; None: that of the suite, or the fastest.
    """
    section = Section("ranks", "Rankings")
    pooled = common_steps(view, demand)
    if pooled is None or not pooled.pooled:
        section.add(missing("no replay left a step, so nothing is ranked."))
        return section
    section.add(
        Paragraph(
            "Speed is compared at equal accuracy, on the same steps, and again with other choices: "
            "a place is worth no more than the choices that lead to it. "
            "A place without a mark holds under all of them."
        ),
        *_precision_pictures(view, pooled, demand),
        *_ratios(pooled, baseline),
        *_rankings(pooled, demand),
    )
    return section


def _precision_pictures(view: Records, pooled: CommonSteps, demand: Demand) -> list[Block]:
    usual = default_route_levels(view, pooled.sequences)
    native = native_route_levels(view, pooled.sequences)
    blocks: list[Block] = []
    if usual:
        how = "default route, policy fresh"
        blocks.append(_precision_picture("work_precision", how, pooled, usual, demand))
    if any(point.configuration.policy != "fresh" for points in native.values() for point in points):
        how = "route native, each solver with its fastest policy by p50"
        blocks.append(_precision_picture("work_precision_native", how, pooled, native, demand))
    return blocks


def _precision_picture(
    name: str,
    how: str,
    pooled: CommonSteps,
    levels_by_solver: Mapping[str, Sequence[LevelPoint]],
    demand: Demand,
) -> Picture:
    points = [point for found in levels_by_solver.values() for point in found]
    silent = [
        f"{r.configuration.solver} ({r.configuration.settings})"
        for r in points
        if math.isinf(r.error_move)
    ]
    without = (
        f" Not drawn, as they leave steps without an answer: {and_list(silent)}." if silent else ""
    )
    unknown = [
        f"{r.configuration.solver} ({r.configuration.settings})"
        for r in points
        if math.isnan(r.error_move)
    ]
    without += f" Not drawn for want of an optimum: {and_list(unknown)}." if unknown else ""
    tail = (
        ""
        if any(math.isfinite(point.p99_ns) for point in points)
        else " No sequence has the 1000 steps that a p99 takes."
    )
    return Picture(
        name,
        f"What accuracy costs, {how}",
        f"{plural(len(levels_by_solver), 'solver')}, {plural(len(points), 'configuration')}, "
        f"{_names(pooled)}; a line joins the settings of one solver. Time: the worst over the "
        f"sequences{_long_enough(pooled)}; error: the largest of all, below 1e-15 "
        f"drawn there. Coloured: of each method family the {OF_EACH} of least p50 that meet the "
        f"demand on every step.{tail}{without}",
        work_precision(
            levels_by_solver, highlighted(fastest_at(levels_by_solver, demand.error_move)), demand
        ),
    )


def _long_enough(pooled: CommonSteps) -> str:
    """Which sequences both times are of, where some are too short for a p99."""
    counts = np.bincount(pooled.sequence_of)
    whole = [f"`{name}`" for i, name in enumerate(pooled.sequences) if supports(counts[i], 99)]
    if len(whole) in (0, len(pooled.sequences)):
        return ""
    return f" long enough for a p99 ({and_list(whole)})"


def _names(pooled: CommonSteps) -> str:
    steps = plural(len(pooled.sequence_of), "step")
    return f"{steps} of {and_list(list(pooled.sequences))}"


def _ratios(pooled: CommonSteps, wanted: str | None) -> list[Block]:
    """The paired ratios to the baseline, and how it was chosen."""
    baseline = fastest_on(pooled, wanted)
    chosen = wanted == baseline.configuration.solver
    why = "the fastest way of the solver chosen" if chosen else "the fastest configuration"
    why += " by geometric mean"
    does = "keep to" if baseline.right else "miss"
    right = f"in these replays its answers {does} the demand's accuracy"
    absent = (
        f" The suite names {wanted} as baseline, which was not replayed here."
        if wanted and not chosen
        else ""
    )
    found = ratios(pooled, baseline)
    if not found:
        return [
            Paragraph(
                f"Only {baseline.configuration.label} was replayed, so nothing is compared with it."
            )
        ]
    return [
        Paragraph(f"Baseline: **{baseline.configuration.label}**, {why}; {right}.{absent}"),
        *(Tabular(table) for table in ratio_tables(pooled, baseline, found)),
    ]


def _rankings(pooled: CommonSteps, demand: Demand) -> list[Block]:
    """Profiles and places per accuracy; that of the demand unfolded."""
    found = [rank(pooled, level, demand) for level in levels_of(demand)]
    solving = [ranking for ranking in found if ranking.ranked]
    blocks: list[Block] = []
    if solving:
        blocks.append(_profile_picture(pooled, solving, demand))
    for ranking in found:
        if ranking.ranked:
            folded = ranking.level != demand.error_move
            blocks.append(Tabular(rank_table(pooled, ranking, folded=folded)))
        else:
            blocks.append(missing(f"no step is solved to {ranking.level:g}, so nobody is ranked."))
    return blocks


def _profile_picture(pooled: CommonSteps, found: Sequence[Ranking], demand: Demand) -> Picture:
    judged = next((r for r in found if r.level == demand.error_move), found[0])
    colours = highlighted(
        [ranked_configuration.pooled.configuration.solver for ranked_configuration in judged.ranked]
    )
    return Picture(
        "performance_profiles",
        "Performance profiles",
        f"Dolan-Moré profiles over {_names(pooled)}, every sequence of equal weight; of each "
        "solver the way of the rank table. A step is unsolved if it failed, its answer is not "
        "true or its error is larger than the title says. Left end: how often a solver is "
        f"the fastest; right end: how often it solves the step in at most {FARTHEST:g} times the "
        "best time. Who follows the leader depends on who takes part (Gould & Scott 2016). "
        f"Coloured: the first {OF_EACH} of each method family at {judged.level:g}.",
        performance_profiles(pooled, found, colours),
    )
