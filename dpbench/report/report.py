"""Contents of a report: results, data made of them, recommendation and topics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import (
    build_capability_results,
    build_consequence_analyses,
)
from dpbench.analysis.times.machine import (
    find_largest_median_by_test_solver,
    select_delayed_loops,
    select_timed_replays,
    sum_disturbances,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.bench.design import Designs
from dpbench.bench.record.result_folder import Results
from dpbench.report.charts.render import NOT_DRAWN, can_draw
from dpbench.report.csv_tables import build_tables
from dpbench.report.embedded_text import yield_uncounted_sentences
from dpbench.report.formats import strip_markdown
from dpbench.report.open_losses import find_open_losses
from dpbench.report.page.data import PageData
from dpbench.report.page.live import draw_section_charts, select_static_charts
from dpbench.report.page.recommendation import Recommendation, build_recommendation
from dpbench.report.page.section import Topic
from dpbench.report.topics.all import build_topics
from dpbench.report.verdict_text import (
    describe_calibration,
    describe_disturbance,
    describe_own_settings,
    describe_which_solvers_pass,
)

TERMINAL_NOTES = ("counted", "slower", "faster", "inconclusive", "next", "unanswered", "stopped")
"""Notes of the recommendation on a terminal."""
BESIDE = ("embedded", "slowdown", "random", "consequence")
"""Topics with a line of their own on a terminal where they are not the answer."""


@dataclass(frozen=True, eq=False)
class Report:
    """Report on a result folder: results, recommended solver, topics, charts and tables."""

    results: Results
    data: PageData
    recommendation: Recommendation
    topics: Sequence[Topic]

    @classmethod
    def from_results(
        cls,
        results: Results,
        designs: Designs | None = None,
        baseline: str | None = None,
        capability: pd.DataFrame | None = None,
        counted: pd.DataFrame | None = None,
    ) -> "Report":
        """Build the report on the results of a folder; write no file.

        baseline : solver to compare with; designs, capability, counted : stored tables of the
        folder, see `load_stability_records`, `load_capability_plots` and
        `load_counted_steps_of_folder`.
        """
        records, requirements = Records(results), Requirements.from_suite(results.suite)
        data = PageData.from_verdicts(records, judge_solvers(records, requirements), counted)
        named = results.suite.get("report", {}).get("baseline")
        if named not in {v.configuration.solver for v in data.verdicts.all_verdicts if v.steps}:
            named = None  # a part of the suite was run, without it
        recommendation = build_recommendation(data, results.machine, baseline or named)
        plots = build_capability_results(records, capability)
        analyses = build_consequence_analyses(records)
        losses, ship = find_open_losses(records, data.ships, plots, analyses), recommendation.ship
        caution = " ".join(filter(None, [ship.caution, losses.summary]))
        recommendation = replace(recommendation, ship=replace(ship, caution=caution))
        topics = build_topics(
            records, data.verdicts, designs, capability, data.studies, data.counts
        )
        if not can_draw():
            topics = [replace(topic, figures=()) for topic in topics]
        return cls(results, data, recommendation, topics)

    @cached_property
    def charts(self) -> Mapping[str, dict[str, Any]]:
        """Charts that follow the reader's selection, by section of the page and name."""
        return draw_section_charts(self.data) if can_draw() else {}

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables of the report as data frames, by name."""
        return build_tables(self.results, self.data, self.recommendation, self.topics)

    @property
    def figures(self) -> dict[str, Any]:
        """Charts that are written to files of their own, by name."""
        own = select_static_charts(self.charts)
        return own | {f.name: f.chart for topic in self.topics for f in topic.figures}

    def summary_rows(self) -> list[tuple[str, str]]:
        """List the summary that a run prints last on the terminal, as keyword and text."""
        lead = next((topic for topic in self.topics if topic.leads), None)
        ship = self.recommendation.ship
        rows = [("warning", ship.warning), ("ship", ship.text), ("caution", ship.caution)]
        rows = [(about, strip_markdown(text)) for about, text in rows if text]
        rows += [("answer", lead.lines[0])] if lead else []
        headline, verdicts = self.recommendation, self.data.verdicts
        if headline.sentence and not (lead and lead.id == "loops"):
            rows.append(("solver" if lead else "answer", headline.sentence))
        rows += [note for note in headline.notes if note[0] in TERMINAL_NOTES]
        beside = (topic for topic in self.topics if topic.id in BESIDE and not topic.leads)
        rows += [(topic.id, topic.lines[0]) for topic in beside]
        if self.data.counts.sequences:
            missing = yield_uncounted_sentences(self.data.counts.not_counted)
            rows += [("not counted", line.removeprefix("Not counted: ")) for line in missing]
        if verdicts.of:
            rows.append(("solvers", f"{describe_which_solvers_pass(verdicts)}."))
            rows += [("options", line) for line in describe_own_settings(verdicts)]
        records = self.data.records
        disturbance = sum_disturbances(
            select_timed_replays(records) or select_delayed_loops(records)
        )
        if disturbance.seconds > 0:
            rows.append(("machine", f"{describe_disturbance(disturbance)}."))
        if medians := find_largest_median_by_test_solver(records.calibration):
            rows.append(("harness", f"{describe_calibration(medians)}."))
        return rows if can_draw() else [*rows, ("figures", f"{NOT_DRAWN}.")]
