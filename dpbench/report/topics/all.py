"""The topics of a result folder, in the order of the page."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.embedded import EmbeddedResults
from dpbench.analysis.suites.study import Study, find_studies
from dpbench.analysis.verdict.verdict import Verdicts
from dpbench.bench.design import Designs
from dpbench.report.page.section import Topic
from dpbench.report.topics.capability import capability_topic, consequence_topic
from dpbench.report.topics.embedded import embedded_topic
from dpbench.report.topics.paper import paper_topic
from dpbench.report.topics.random import random_topic
from dpbench.report.topics.replays import (
    formulations_topic,
    levels_topic,
    loops_topic,
    race_topic,
    routes_topic,
    worst_case_topic,
)
from dpbench.report.topics.study import study_topic
from dpbench.report.topics.sweeps import horizon_topic, slowdown_topic
from dpbench.report.topics.thrusters import conclusion_topic, thrusters_topic
from dpbench.report.topics.trust import trust_topic


def build_topics(
    records: Records,
    verdicts: Verdicts,
    designs: Designs | None = None,
    capability: pd.DataFrame | None = None,
    known: Sequence[Study] | None = None,
    counts: EmbeddedResults = EmbeddedResults(()),  # noqa: B008 - frozen, so safe to share
) -> list[Topic]:
    """Build the report page's parts, one per question on the results, the suite's question first.

    designs, capability : of `load_stability_records` and `load_capability_plots`.
    known : the studies of these records, if they are already read; counts : of their folder.
    """
    requirements = verdicts.requirements
    replays, loops = (_is_all_in_mode(records, mode) for mode in ("replay", "closed_loop"))
    candidates = (
        conclusion_topic(records, verdicts),
        worst_case_topic(records),
        horizon_topic(records, requirements),
        slowdown_topic(records),
        study_topic(find_studies(records) if known is None else known),
        random_topic(records),
        consequence_topic(records),
        capability_topic(records, capability),
        formulations_topic(records, requirements),
        loops_topic(records, requirements) if loops else None,
        race_topic(records) if replays else None,
        routes_topic(records) if replays else None,
        levels_topic(records, requirements) if replays else None,
        thrusters_topic(records, requirements),
        embedded_topic(counts, requirements),
        paper_topic(records, designs),
        trust_topic(records),
    )
    topics = [topic for topic in candidates if topic is not None]
    question = _leading_topic(records, [topic.id for topic in topics])
    topics = [replace(topic, leads=topic.id == question) for topic in topics]
    hidden = ("loops", *(_CONTRASTS if replays else ()))
    shown = [topic for topic in topics if topic.leads or topic.id not in hidden]
    return sorted(shown, key=lambda topic: not topic.leads)


_CONTRASTS = ("formulations", "race", "routes", "levels")
"""Questions about the same replays, in their order of precedence; a page answers one."""


def _leading_topic(records: Records, topics: Sequence[str]) -> str:
    """Return the id of the page's part that answers the suite's question; or ""."""
    for name in ("worst-case", "conclusion"):
        if name in topics:
            return name
    if not records.runs:
        requested = ("study", "slowdown", "random", "consequence", "capability", "trust")
        return next((id for id in requested if id in topics), "")
    if records.delayed or records.random:
        return ""
    if _is_all_in_mode(records, "replay"):
        return next((id for id in ("horizon", *_CONTRASTS) if id in topics), "")
    ships = [run for run in records.all_runs if not run.has_topic and not run.slowdown > 0.0]
    is_mostly_uncommon = 3 * (len(ships) - len(records.runs)) > len(ships)
    if "formulations" in topics and is_mostly_uncommon:
        return "formulations"
    if not _is_all_in_mode(records, "closed_loop"):
        return ""
    of_the_paper = {"paper", "paper_tight"} >= {run.scenario for run in records.runs}
    return next((id for id in ("paper",) * of_the_paper + ("loops",) if id in topics), "")


def _is_all_in_mode(records: Records, mode: str) -> bool:
    """Return whether all runs of a folder have this mode, closed loop or replay."""
    return all(run.mode == mode for run in records.runs)
