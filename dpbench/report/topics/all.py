"""The topics of a result folder, in the order of the page."""

from __future__ import annotations

from dataclasses import replace

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.bench.design import Designs
from dpbench.report.page.topic import Topic
from dpbench.report.topics.paper import paper_topic
from dpbench.report.topics.random import random_topic
from dpbench.report.topics.replays import (
    formulations_topic,
    levels_topic,
    race_topic,
    routes_topic,
)
from dpbench.report.topics.sweeps import horizon_topic, slowdown_topic
from dpbench.report.topics.trust import trust_topic
from dpbench.report.topics.worst_case import worst_case_topic


def topics_of(records: Records, demand: Demand, designs: Designs | None) -> list[Topic]:
    """Those that have something to say, the suite's own question first; what nobody asked for is
    not mentioned."""
    question = question_of(records)
    found = (
        worst_case_topic(records),
        horizon_topic(records, demand),
        slowdown_topic(records),
        random_topic(records),
        formulations_topic(records, demand),
        routes_topic(records) if _only_replays(records) else None,
        levels_topic(records, demand) if question == "levels" else None,
        race_topic(records) if question == "race" else None,
        paper_topic(records, designs),
        trust_topic(records),
    )
    topics = [replace(t, leads=t.id == question) for t in found if t is not None]
    return sorted(topics, key=lambda topic: not topic.leads)


def question_of(records: Records) -> str:
    """The id of the topic that is what the suite asks; empty where that is which solver to use."""
    if records.suite.get("report", {}).get("step") is not None:
        return "worst-case"
    if not records.runs:
        kinds = {"slowdown": records.delayed, "random": records.random}
        return next((id for id, runs in kinds.items() if runs), "trust")
    if not _only_replays(records) or records.delayed or records.random:
        return ""
    replays = [run for run in records.all_runs if not run.is_baseline_law]
    if len({(run.N_p, run.N_c) for run in replays}) > 1:
        return "horizon"
    if len({run.formulation for run in replays}) > 1:
        return "formulations"
    if len(records.solvers) == 2:
        return "race"
    if len({(run.solver, run.route, run.policy) for run in replays}) > len(records.solvers):
        return "routes"
    return "levels" if len({run.settings for run in replays}) > 2 else ""


def _only_replays(records: Records) -> bool:
    return all(run.mode == "replay" for run in records.runs)
