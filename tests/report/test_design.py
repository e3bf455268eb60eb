"""Stability and the sway offset held, beside the claims of the paper; from records made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dpbench.bench.design import Bracket, DesignRecord, Designs, MissingDesign
from dpbench.report.blocks import Tabular
from dpbench.report.tables_design import design_table
from dpbench.report.write import build_page

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


def test_the_table_shows_the_numbers_of_the_records() -> None:
    """Brackets are rounded outwards, an unstable loop is marked, what is missing is named."""
    table = design_table(Designs((PAPER, ROBUST), (MISSING,)))
    paper, robust = ([cell.text for cell in row] for row in table.rows)
    assert paper == ["paper 30/5 (`paper`)", "`tug`", "0.9055", "1.00 – 1.05", "0.500 – 0.516"]
    assert robust == ["robust 60/10 (`rough`)", "`tug`", "1.0200", "≥ 64", "< 0.250"]
    assert [cell.text for cell in table.rows[1] if cell.mark == "bad"] == ["1.0200"]
    assert "Missing: `turn` in `tug`: killed by SIGKILL." in table.note


def test_the_table_stands_beside_the_claims_of_the_paper(records: Any) -> None:
    """With designs the section on the paper shows them; without there is no such table."""
    records.loop("daqp")

    def titles(designs: Designs | None) -> list[str]:
        page = build_page(records.results(), designs)
        (section,) = (one for one in page.sections if one.key == "paper")
        return [block.table.title for block in section.blocks if isinstance(block, Tabular)]

    assert "Stability and sway offset held" in titles(Designs((PAPER,)))
    assert "Stability and sway offset held" not in titles(None)
