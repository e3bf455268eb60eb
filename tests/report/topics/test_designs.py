"""Stability and the sway offset held, beside the claims of the paper; from records made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dpbench.bench.design import Bracket, DesignRecord, Designs, MissingDesign
from dpbench.report.topics.paper import paper_topic

PAPER = DesignRecord(
    vessel="tug",
    controller="paper",
    tuning="paper",
    N_p=30,
    N_c=5,
    eigenvalues=((0.9, 0.1), (0.9, -0.1), (0.5, 0.0)),
    held={"still water": Bracket(1.0, 1.046875), "calm": Bracket(0.5, 0.515625)},
)
ROBUST = replace(
    PAPER,
    controller="rough",
    tuning="robust",
    N_p=60,
    N_c=10,
    eigenvalues=((1.02, 0.0),),
    held={"still water": Bracket(64.0, None), "calm": Bracket(0.0, 0.25)},
)
MISSING = MissingDesign("tug", "turn", "killed by SIGKILL")


def _rows(designs: Designs | None, records: Any) -> list[tuple[str, ...]]:
    """The rows of the table on stability; none where there is no such table."""
    records.loop("daqp", steps=1000)
    topic = paper_topic(records.view(), designs)
    assert topic is not None
    return [row for table in topic.tables if "Stability" in table.title for row in table.rows]


def test_the_table_shows_the_numbers_of_the_records(records: Any) -> None:
    none = replace(PAPER, held={})
    paper, robust, unknown = _rows(Designs((PAPER, ROBUST, none), (MISSING,)), records)
    assert paper == ("paper 30/5 in tug", "0.9055", "1.00 – 1.05", "0.500 – 0.516")
    assert robust == ("robust 60/10 in tug", "1.0200", "≥ 64", "< 0.250")
    assert unknown[2:] == ("–", "–")


def test_without_designs_there_is_no_such_table(records: Any) -> None:
    assert _rows(None, records) == []
