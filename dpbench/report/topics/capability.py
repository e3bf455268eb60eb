"""Thruster capability: wind held by direction, losses held over time, answers of solvers there."""

from collections.abc import Iterator, Sequence
from math import isnan

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import (
    BatchAnswers,
    CapabilityResult,
    ConsequenceAnalysis,
    build_capability_results,
    build_consequence_analyses,
)
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.report.charts.capability import (
    ANSWERS,
    NOTHING,
    RIGHT_HELD,
    RIGHT_NOT,
    WRONG,
    draw_answer_shares,
    draw_capability_rose,
    draw_loss_spans,
    draw_sample_shares,
)
from dpbench.report.formats import (
    Table,
    format_sample_share,
    join_with_and,
    join_with_counts,
    plural,
)
from dpbench.report.page.section import Figure, Topic
from dpbench.report.ship.capability_text import (
    count_answering,
    describe_answers_at_edge,
    describe_capability,
    describe_losses_held,
    describe_required_force,
)


def build_capability_topic(records: Records, table: pd.DataFrame | None) -> Topic | None:
    """Return the report's part on largest winds held by thrusters; None without such results."""
    plots = [p for p in build_capability_results(records, table) if len(p.edges) or p.answers]
    if not plots:
        return None
    return Topic(
        id="capability",
        title="Capability",
        lines=tuple(
            " ".join(
                [
                    *describe_capability(records, plot),
                    *(_describe_answers(plot) if plot.answers else ()),
                ]
            )
            for plot in plots
        ),
        figures=tuple(figure for plot in plots for figure in _draw_capability_figures(plot)),
    )


def _describe_answers(plot: CapabilityResult) -> Iterator[str]:
    """Yield sentences: solvers right on all QPs at largest winds held, those with untrue claims."""
    yield describe_answers_at_edge(plot)
    wrong = [a for a in plot.answers if a.wrong]
    if wrong:
        yield f"False claims: {join_with_counts((a.solver, a.wrong) for a in wrong)}."
    else:
        yield "No solver makes a false claim."
    if silent := [(a.solver, a.unanswered_count) for a in plot.answers if a.unanswered_count]:
        yield f"No answer (given up or out of time): {join_with_counts(silent)}."


def _draw_capability_figures(plot: CapabilityResult) -> Iterator[Figure]:
    """Yield the figures of a capability plot: its rose, and a chart of right and wrong claims."""
    if len(plot.edges):
        hollow = bool((plot.edges["untrue"] > 0).any())
        note = "; hollow: a solver made a false claim" if hollow else ""
        yield Figure(
            f"capability-{plot.vessel}",
            draw_capability_rose(plot.edges, f"{plot.vessel}: largest wind held"),
            "Mark: largest wind held from one direction; the referee checks QPs on both sides of it"
            + note
            + ".",
        )
    if plot.answers:
        rows = [
            (a.solver, answer, 100.0 * count / a.asked, count)
            for a in plot.answers
            for answer, count in (
                *((RIGHT_HELD, a.balanced), (RIGHT_NOT, a.refused)),
                *((NOTHING, a.unanswered_count), (WRONG, a.wrong)),
            )
        ]
        yield Figure(
            f"capability-answers-{plot.vessel}",
            draw_answer_shares(pd.DataFrame(rows, columns=list(ANSWERS)), "Answers at the edge"),
            f"{plural(plot.qp_count, 'QP')}: the winds of the standard's table around each edge, "
            "and winds 0.1 % below and above it.",
        )


MOST_ROWS = 8
"""A longer table is only a file: the figures show the right solvers."""


def build_consequence_topic(records: Records) -> Topic | None:
    """Return the report's part on whether thruster losses can be held; None without results."""
    analyses = build_consequence_analyses(records)
    if not analyses:
        return None
    tables = [
        (
            [
                make_consequence_row(
                    best, [a.has_only_right_answers for a in analysis.answers if a.solver == solver]
                )
                for solver, best in analysis.best_answers_by_solver.items()
            ],
            analysis.name,
        )
        for analysis in analyses
    ]
    long = max(len(rows) for rows, _ in tables) > MOST_ROWS
    return Topic(
        id="consequence",
        title="Consequence analysis",
        lines=(
            *map(_describe_consequences, analyses),
            "Where a loss cannot be held, work that requires the ship on station must be ended "
            "safely. Do not use a solver that misses such an alarm or gives no answer."
            + (" tables/consequence*.csv has the counts of every solver." if long else ""),
        ),
        figures=tuple(
            figure for analysis in analyses for figure in _draw_consequence_figures(analysis)
        ),
        tables=tuple(
            Table.from_rows(rows, name, shown=0 if long else None) for rows, name in tables
        ),
    )


def _draw_consequence_figures(analysis: ConsequenceAnalysis) -> Iterator[Figure]:
    """Yield charts of the losses held over time and of the time that takes."""
    names = [join_with_and(lost) for _, lost in list_losses(analysis.run)] if analysis.run else []
    after = ["", *(f" after {join_with_and(names[: k + 1])}" for k in range(len(names)))]
    spans = analysis.spans.assign(
        group=analysis.spans["group"] + analysis.spans["losses"].map(after.__getitem__)
    )
    if not spans.empty:
        yield Figure(
            f"consequence-{_name_file_of_analysis(analysis)}",
            draw_loss_spans(spans, f"Losses held, {analysis.name}"),
            "Each state is proved: an optimum exists (held) or none does (not held); "
            f"{describe_required_force(analysis)}.",
        )
    timed = [
        answers
        for answers in analysis.best_answers_by_solver.values()
        if not isnan(answers.largest)
    ]
    marks = [
        {"name": a.name, "percent": 100.0 * a.largest, "right": a.has_only_right_answers}
        for a in sorted(timed, key=lambda a: a.largest)
    ]
    if marks:
        yield Figure(
            f"consequence-time-{_name_file_of_analysis(analysis)}",
            draw_sample_shares(pd.DataFrame(marks), f"Solve time, {analysis.name}"),
            "Best configuration of each solver; time of the QPs of all groups at one sample.",
        )


def _name_file_of_analysis(analysis: ConsequenceAnalysis) -> str:
    """Return the name of an analysis as part of a file name."""
    return analysis.name.rstrip("]").replace("[", "-").replace(":", "-")


def _describe_consequences(analysis: ConsequenceAnalysis) -> str:
    """Return sentences: losses held, solvers right on all QPs, the fastest, missed alarms."""
    answers = analysis.answers
    right = [a for a in answers if a.has_only_right_answers]
    who = count_answering(len(right), len(answers), "configuration")
    head = f"{who} all QPs correctly"
    timed = [a for a in right if not isnan(a.largest)]
    if timed:
        best = min(timed, key=lambda a: a.largest)
        share, batch = format_sample_share(best.largest), plural(len(analysis.groups), "QP")
        head += f"; the fastest, {best.name}, takes at most {share} of a sample for {batch}"
    silent = join_with_counts((a.name, a.unanswered_count) for a in answers if a.unanswered_count)
    unanswered = f"; no answer to some QPs: {silent}" if silent else ""
    missed = join_with_counts((a.name, a.missed) for a in answers if a.missed)
    alarms = "no solver misses an alarm"
    if missed:
        alarms = f"missed alarms: {missed}"
    elif not analysis.is_alarm_due:
        alarms = "no alarm was due, as every QP that a solver reached is feasible"
    return f"{describe_losses_held(analysis)} {head}; {alarms}{unanswered}."


def make_consequence_row(best: BatchAnswers, right: Sequence[bool]) -> dict[str, str]:
    """Return the table row of a configuration's answers on thruster losses."""
    return {
        "configuration": best.name,
        "p99, share of a sample": format_sample_share(best.p99),
        "largest share of a sample": format_sample_share(best.largest),
        "feasible, correct": f"{best.held} of {best.feasible}",
        "infeasible, correct": f"{best.refused} of {best.infeasible}",
        "missed alarms": str(best.missed),
        "other false claims": str(best.untrue - best.missed),
        "no answer": str(best.unanswered_count),
        "configurations correct on all QPs": f"{sum(right)} of {len(right)}",
    }
