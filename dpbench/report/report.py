"""What a report is made of: the results, what is known of them, the recommendation, the topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.verdict.demand import Demand
from dpbench.analysis.verdict.verdict import verdicts_of
from dpbench.bench.design import Designs
from dpbench.bench.record.result_folder import Results
from dpbench.report.charts.render import can_draw
from dpbench.report.csv_tables import tables_of
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import Recommendation, build_recommendation
from dpbench.report.page.topic import Topic
from dpbench.report.page.write import DRAWN, charts_of
from dpbench.report.topics.all import topics_of


@dataclass(frozen=True, eq=False)
class Report:
    """What a report is made of."""

    results: Results
    data: PageData
    recommendation: Recommendation
    topics: Sequence[Topic]

    @classmethod
    def of(
        cls,
        results: Results,
        designs: Designs | None = None,
        baseline: str | None = None,
        capability: pd.DataFrame | None = None,
    ) -> Report:
        """The report on some results, nothing written.

        Parameters
        ----------
        designs, capability : what lies beside them, see `topics_of`; baseline : as in
            `write_report`.
        """
        records, demand = Records(results), Demand.of(results.suite)
        data = PageData.of(records, verdicts_of(records, demand))
        named = results.suite.get("report", {}).get("baseline")
        if named not in {v.configuration.solver for v in data.verdicts.all if v.steps}:
            named = None  # a part of the suite was run, without it
        recommendation = build_recommendation(data, results.machine, baseline or named)
        topics = topics_of(records, data.verdicts, designs, capability, data.studies)
        if not can_draw():
            topics = [replace(topic, figures=()) for topic in topics]
        return cls(results, data, recommendation, topics)

    @cached_property
    def charts(self) -> Mapping[str, Any]:
        """The figures of the page that follow what is chosen there, by name."""
        return charts_of(self.data) if can_draw() else {}

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables, by name: see `csv_tables.tables_of`."""
        return tables_of(self.results, self.data, self.recommendation, self.topics)

    @property
    def figures(self) -> dict[str, Any]:
        """The figures that stand alone, by name."""
        own = {name: chart for name, chart in self.charts.items() if name in DRAWN}
        return own | {f.name: f.chart for topic in self.topics for f in topic.figures}
