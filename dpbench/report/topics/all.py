"""The topics of a result folder, in the order of the page."""

from __future__ import annotations

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.bench.design import Designs
from dpbench.report.page.topic import Topic
from dpbench.report.topics.paper import paper_topic
from dpbench.report.topics.random import random_topic
from dpbench.report.topics.sweeps import (
    formulations_topic,
    horizon_topic,
    routes_topic,
    slowdown_topic,
)
from dpbench.report.topics.trust import trust_topic


def topics_of(records: Records, demand: Demand, designs: Designs | None) -> list[Topic]:
    """Those that have something to say; what nobody asked for is not mentioned."""
    found = (
        horizon_topic(records, demand),
        slowdown_topic(records),
        random_topic(records),
        formulations_topic(records, demand),
        routes_topic(records) if not records.scenarios or _only_replays(records) else None,
        paper_topic(records, designs),
        trust_topic(records),
    )
    return [topic for topic in found if topic is not None]


def _only_replays(records: Records) -> bool:
    return all(run.mode == "replay" for run in records.runs)
