"""What the report says about the abilities of the solvers."""

from dataclasses import replace
from typing import Any

import pytest

from dpbench.report import section_solvers
from dpbench.report.blocks import Tabular
from dpbench.report.section_solvers import solvers_section
from dpbench.report.table import Table
from dpbench.solvers.record import NOT_STATED, Fact
from dpbench.solvers.table import record


def _tables(records: Any) -> dict[str, Table]:
    blocks = solvers_section(records.view()).blocks
    return {b.table.title: b.table for b in blocks if isinstance(b, Tabular)}


def test_each_route_of_a_solver_has_its_row(records: Any) -> None:
    """What a solver can do depends on the route, and a policy it has not comes with the reason."""
    records.replay("piqp", steps=10)
    table = _tables(records)["What each solver can do"]
    assert [row[2].text for row in table.rows] == list(record("piqp").policies)
    policies = [row[3].text for row in table.rows]
    assert policies[0] == "fresh"
    assert all(
        "reuse: qpsolvers sets the library up anew" in row[-1].text for row in table.rows[:1]
    )


def test_a_solver_that_is_not_in_the_table_is_named(records: Any) -> None:
    """Records of a plug-in that is not installed where the report is written are no error."""
    records.replay("somebody_elses", steps=10)
    records.replay("daqp", steps=10)
    texts = [getattr(b, "text", "") for b in solvers_section(records.view()).blocks]
    assert "Not in the table of this installation: somebody_elses." in texts


def test_only_unknown_solvers_leave_the_section_empty(records: Any) -> None:
    """Without a single known solver the section says what is missing."""
    records.replay("somebody_elses", steps=10)
    (block,) = solvers_section(records.view()).blocks
    assert getattr(block, "text", "").startswith("Missing: no solver of these records")


def test_a_statement_carries_its_source(records: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal sources share a number, a statement without one has none, and no link leads out."""
    facts = replace(
        NOT_STATED,
        licence=Fact("MIT", "https://example.org/LICENSE"),
        language=Fact("C", "https://example.org/manual"),
        c_code=Fact("yes", "https://example.org/LICENSE"),
    )
    known = replace(record("daqp"), project=facts)
    monkeypatch.setattr(section_solvers, "record", lambda name: known)
    records.replay("daqp", steps=10)
    tables = _tables(records)
    (row,) = tables["What a controller's author asks next"].rows
    assert [cell.text for cell in row[1:]] == [
        "MIT [1]",
        "C [2]",
        "yes [1]",
        "not stated",
        "not stated",
    ]
    sources = tables["Sources of these statements"].rows
    assert [[cell.text for cell in line] for line in sources] == [
        ["1", "example.org/LICENSE"],
        ["2", "example.org/manual"],
    ]
