"""Capability plots: how much wind is held from where, and which solvers know at that edge."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import Answers, Plot, capability_plots
from dpbench.bench.capability.frontier import INTACT
from dpbench.report.charts.capability import (
    ANSWERS,
    NOTHING,
    RIGHT_HELD,
    RIGHT_NOT,
    WRONG,
    answers,
    rose,
)
from dpbench.report.formats import and_list, counted_list, plural, significant
from dpbench.report.page.section import Figure, Topic


def capability_topic(records: Records, table: pd.DataFrame | None) -> Topic | None:
    """Return the topic on capability plots; None without one; table : of `load_capability`."""
    plots = [p for p in capability_plots(records, table) if len(p.edges) or p.answers]
    if not plots:
        return None
    return Topic(
        id="capability",
        title="Capability",
        lines=tuple(
            " ".join([*_state_winds(plot), *(_name_right_solvers(plot) if plot.answers else ())])
            for plot in plots
        ),
        figures=tuple(figure for plot in plots for figure in _figures(plot)),
    )


def _state_winds(plot: Plot) -> Iterator[str]:
    """State the least wind held all round, intact and after the worst failure."""
    if plot.edges.empty:
        return
    intact = plot.edges[plot.edges["case"] == INTACT]
    failed = plot.edges[plot.edges["case"] != INTACT]
    wording = f"Intact, {plot.vessel} holds at least {_least(intact)}"
    if len(failed):
        worst = failed.nsmallest(1, "wind_mps").iloc[0]
        wording += f"; after the loss of {worst['case']} {_least(failed)}"
    yield f"{wording} (DNV-ST-0111, level 1; azimuths as polygons of {plot.sides} sides)."


def _least(edges: pd.DataFrame) -> str:
    least = edges.nsmallest(1, "wind_mps").iloc[0]
    return f"{significant(least['wind_mps'])} m/s, from {least['from_deg']:.0f}°"


def _name_right_solvers(plot: Plot) -> Iterator[str]:
    """Name the solvers that answer all QPs rightly, and those with untrue claims."""
    right = sorted(a.solver for a in plot.answers if a.all_right)
    qps = f"all {plural(plot.qps, 'QP')} at that edge"
    names = f": {and_list(right)}" if right else ""
    verb = "answers" if len(right) == 1 else "answer"
    yield f"{len(right)} of {plural(len(plot.answers), 'solver')} {verb} {qps} rightly{names}."
    wrong = [a for a in plot.answers if a.wrong]
    if wrong:
        yield f"Untrue claims: {counted_list((a.solver, a.wrong) for a in wrong)}."
    else:
        yield "None makes an untrue claim."
    silent = sum(1 for a in plot.answers if a.silent)
    if silent:
        leave = "leaves" if silent == 1 else "leave"
        yield f"{silent} {leave} some without an answer, or did not get so far in time."


def _figures(plot: Plot) -> Iterator[Figure]:
    if len(plot.edges):
        hollow = bool((plot.edges["untrue"] > 0).any())
        note = "; hollow where a solver made an untrue claim" if hollow else ""
        yield Figure(
            f"capability-{plot.vessel}",
            rose(plot.edges, f"{plot.vessel}: largest wind held"),
            "Each mark is an edge, with QPs before and beyond it that the referee judges"
            + note
            + ".",
        )
    if plot.answers:
        rows = [row for a in plot.answers for row in _shares(a)]
        yield Figure(
            f"capability-answers-{plot.vessel}",
            answers(pd.DataFrame(rows, columns=list(ANSWERS)), "Answers at the edge"),
            f"{plural(plot.qps, 'QP')}: the rows of the standard's table around each edge, and a "
            "thousandth of the wind before and beyond it.",
        )


def _shares(a: Answers) -> Iterator[tuple[str, str, float, int]]:
    counts = {RIGHT_HELD: a.balanced, RIGHT_NOT: a.refused, NOTHING: a.silent, WRONG: a.wrong}
    for answer, count in counts.items():
        yield a.solver, answer, 100.0 * count / a.asked, count
