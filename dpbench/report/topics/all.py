"""The topics of a result folder, in the order of the page."""

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.anytime import is_about_limits
from dpbench.analysis.suites.embedded import EmbeddedResults
from dpbench.analysis.suites.study import Study, find_studies
from dpbench.analysis.verdict.verdict import Verdicts
from dpbench.bench.design import Designs
from dpbench.report.page.section import Topic
from dpbench.report.topics.anytime import build_anytime_topic
from dpbench.report.topics.capability import build_capability_topic, build_consequence_topic
from dpbench.report.topics.embedded import build_embedded_topic
from dpbench.report.topics.paper import build_paper_topic, build_stability_topic
from dpbench.report.topics.random import build_random_topic
from dpbench.report.topics.replays import (
    build_formulations_topic,
    build_levels_topic,
    build_loops_topic,
    build_race_topic,
    build_routes_topic,
    build_settings_topic,
    build_worst_case_topic,
)
from dpbench.report.topics.study import build_study_topic
from dpbench.report.topics.sweeps import build_horizon_topic, build_slowdown_topic
from dpbench.report.topics.thrusters import build_conclusion_topic, build_thrusters_topic
from dpbench.report.topics.trust import build_trust_topic


def build_topics(
    records: Records,
    verdicts: Verdicts,
    designs: Designs | None = None,
    capability: pd.DataFrame | None = None,
    known: Sequence[Study] | None = None,
    counts: EmbeddedResults = EmbeddedResults(()),  # noqa: B008 - frozen, so safe to share
) -> list[Topic]:
    """Return the report page's parts, one per question on the results, the suite's question first.

    designs, capability : of `load_stability_records` and `load_capability_plots`.
    known : the studies of these records, if they are already read; counts : of their folder.
    """
    requirements = verdicts.requirements
    replays, loops = (_is_all_in_mode(records, mode) for mode in ("replay", "closed_loop"))
    candidates = (
        build_conclusion_topic(records, verdicts),
        build_worst_case_topic(records),
        build_horizon_topic(records, requirements),
        build_slowdown_topic(records),
        build_anytime_topic(records, requirements),
        build_study_topic(find_studies(records) if known is None else known),
        build_random_topic(records),
        build_consequence_topic(records),
        build_capability_topic(records, capability),
        build_formulations_topic(records, requirements),
        build_loops_topic(records, requirements) if loops else None,
        build_race_topic(records, requirements) if replays else None,
        build_settings_topic(records, verdicts),
        build_routes_topic(records) if replays else None,
        build_levels_topic(records, requirements) if replays else None,
        build_thrusters_topic(records, requirements),
        build_embedded_topic(counts, requirements),
        build_paper_topic(records, designs) or build_stability_topic(records, designs),
        build_trust_topic(records),
    )
    topics = [topic for topic in candidates if topic is not None]
    question = _find_id_of_leading_topic(records, [topic.id for topic in topics])
    topics = [replace(topic, leads=topic.id == question) for topic in topics]
    hidden = ["loops", *(_CONTRASTS if replays else ())]
    if question == "anytime":
        hidden.append("settings")
    shown = [topic for topic in topics if topic.leads or topic.id not in hidden]
    return sorted(shown, key=lambda topic: not topic.leads)


_CONTRASTS = ("formulations", "race", "routes", "levels")
"""Questions about the same replays, in their order of precedence; a page answers one."""


def _find_id_of_leading_topic(records: Records, topics: Sequence[str]) -> str:
    """Return the id of the page's part that answers the suite's question; or ""."""
    for name in ("worst-case", "conclusion"):
        if name in topics:
            return name
    if "anytime" in topics and is_about_limits(records):
        return "anytime"
    if not records.runs:
        requested = ("study", "slowdown", "random", "consequence", "capability", "trust")
        return next((id for id in requested if id in topics), "")
    if records.delayed or records.random:
        return ""
    if _is_all_in_mode(records, "replay"):
        return next((id for id in ("horizon", *_CONTRASTS) if id in topics), "")
    ships = [
        run for run in records.all_runs if not run.is_outside_verdicts and not run.slowdown > 0.0
    ]
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
