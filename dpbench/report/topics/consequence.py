"""Consequence analysis: which loss can be held, and which solvers say so in time."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

import pandas as pd

from dpbench.analysis.consequence import HELD, LOST, Analysis, BatchAnswers, consequence_analyses
from dpbench.analysis.records import Records
from dpbench.report.charts.spans import spans
from dpbench.report.formats import and_list, plural, significant
from dpbench.report.page.topic import Figure, SmallTable, Topic

HEAD = (
    "configuration",
    "share of the sample, p99",
    "largest",
    "held, rightly",
    "cannot be held, rightly",
    "missed alarms",
    "false alarms",
    "untrue claims",
    "no answer",
)


def consequence_topic(records: Records) -> Topic | None:
    """The topic; None of records without such an analysis."""
    analyses = consequence_analyses(records)
    if not analyses:
        return None
    return Topic(
        id="consequence",
        title="Consequence analysis: could the ship hold after a failure?",
        lines=(
            *(f"{_when(analysis)} {_who(analysis)}" for analysis in analyses),
            "Where a loss cannot be held, work that may not lose position has to be ended safely; "
            "no solver that misses an alarm, or has no answer then, should be asked.",
        ),
        figures=tuple(_figure(analysis) for analysis in analyses),
        tables=tuple(
            SmallTable(HEAD, tuple(map(_row, analysis.answers)), analysis.name)
            for analysis in analyses
        ),
    )


def _figure(analysis: Analysis) -> Figure:
    title = f"Which loss the other thrusters hold, {analysis.name}"
    caption = "Proven for the mean force of each sample: an optimum, or that there is none."
    return Figure(f"consequence-{analysis.name}", spans(analysis.spans, title), caption)


def _when(analysis: Analysis) -> str:
    """Which losses can be held when, those of the same answer together."""
    said: dict[str, list[str]] = {}
    for group, of_group in analysis.spans.groupby("group", sort=False):
        said.setdefault(_time(of_group), []).append(str(group))
    parts = [f"the loss of {and_list(groups)} can be held {when}" for when, groups in said.items()]
    return f"In {analysis.name} {'; '.join(parts)}."


def _time(of_group: pd.DataFrame) -> str:
    """When the loss of one group can be held."""
    states, change_s = of_group["state"].tolist(), of_group["from_s"].iloc[-1]
    if states == [HELD]:
        return "throughout"
    if HELD not in states:
        return "at no time"
    if states == [HELD, LOST]:
        return f"until {change_s:.0f} s and not after"
    if states == [LOST, HELD]:
        return f"from {change_s:.0f} s on"
    long_s = of_group["to_s"] - of_group["from_s"]
    share = long_s[of_group["state"] == HELD].sum() / long_s.sum()
    return f"in {100.0 * share:.0f} % of the time"


def _who(analysis: Analysis) -> str:
    """Who answers all of it rightly, who is the fastest of them, and who misses alarms."""
    answers = analysis.answers
    right = [a for a in answers if a.all_right]
    head = f"{len(right)} of {plural(len(answers), 'configuration')} answer all QPs rightly"
    timed = [a for a in right if not isnan(a.largest)]
    if timed:
        best = min(timed, key=lambda a: a.largest)
        batch = plural(len(analysis.groups), "QP")
        head += f", the fastest {best.name} with at most {_share(best.largest)} of the sample for "
        head += f"its {batch}"
    return f"{head}; {_liars(answers)}."


def _liars(answers: Sequence[BatchAnswers]) -> str:
    """Whose alarms are missing, the most first."""
    missed = sorted((a for a in answers if a.missed), key=lambda a: -a.missed)
    if not missed:
        return "nobody calls a loss held that is not"
    return "alarms are missed by " + and_list([f"{a.name} ({a.missed})" for a in missed])


def _row(answers: BatchAnswers) -> tuple[str, ...]:
    silent = answers.asked - answers.held - answers.refused - answers.untrue
    return (
        answers.name,
        _share(answers.p99),
        _share(answers.largest),
        f"{answers.held} of {answers.feasible}",
        f"{answers.refused} of {answers.infeasible}",
        str(answers.missed),
        str(answers.false_alarms),
        str(answers.untrue),
        str(silent),
    )


def _share(share: float) -> str:
    return "–" if isnan(share) else f"{significant(100.0 * share, 2)} %"
