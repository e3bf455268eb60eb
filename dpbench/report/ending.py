"""What a run ends with on a terminal: a few lines, each with a word for what it is about."""

from __future__ import annotations

from collections.abc import Sequence

from dpbench.analysis.times.machine import (
    calibration_medians,
    delayed_runs,
    disturbance_of,
    timed_runs,
)
from dpbench.report.charts.render import NOT_DRAWN, can_draw
from dpbench.report.machine_verdict import calibration_text, verdict_text
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation
from dpbench.report.page.topic import Topic
from dpbench.report.verdict_text import counted

TERMINAL_NOTES = ("slower", "faster", "open", "next")
"""The notes of the answer that are worth a line there."""
BESIDE = ("slowdown", "random", "consequence")
"""Topics that have a line of their own where they are not the recommendation."""


def ending(
    data: PageData, recommendation: Recommendation, topics: Sequence[Topic]
) -> list[tuple[str, str]]:
    """The recommendation, the notes to it, the count of the solvers, then machine and harness."""
    records = data.records
    lead = next((topic for topic in topics if topic.leads), None)
    rows = [("answer", lead.lines[0])] if lead else []
    if recommendation.sentence and not (lead and lead.id == "loops"):
        rows.append(("solver" if lead else "answer", recommendation.sentence))
    rows += [note for note in recommendation.notes if note[0] in TERMINAL_NOTES]
    beside = (topic for topic in topics if topic.id in BESIDE and not topic.leads)
    rows += [(topic.id, topic.lines[0]) for topic in beside]
    if data.verdicts.of:
        rows.append(("solvers", f"{counted(data.verdicts)}."))
    disturbance = disturbance_of(timed_runs(records) or delayed_runs(records))
    if disturbance.seconds > 0:
        rows.append(("machine", f"{verdict_text(disturbance)}."))
    if medians := calibration_medians(records.calibration):
        rows.append(("harness", f"{calibration_text(medians)}."))
    if not can_draw():
        rows.append(("figures", f"{NOT_DRAWN}."))
    return rows
