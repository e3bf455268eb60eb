"""The tables in `docs/paper.md` on how results of the paper depend on the assumed values."""

import re
import tomllib
from functools import cache

import numpy as np
import pytest

from dpbench import Run, load_scenario, open_workspace, run_closed_loop
from tests.docs.markdown_blocks import DOCS

TEXT = (DOCS / "paper.md").read_text(encoding="utf-8")
SECTION = TEXT.split("### Sensitivity to the assumptions")[1].split("\n## ")[0]
TABLES = [
    [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[2:]]
    for table in re.findall(r"(?:^\|.*\|\n)+", SECTION, re.M)
]
SMALLEST_DIFFERENCE = 1e-9
"""Relative difference of two laws that are equal but for rounding."""


@cache
def _run_both_laws(changed: str, keys: str) -> tuple[Run, Run]:
    values: dict[str, object] = {}
    for text in re.findall(r"`([^`]+)`", keys):
        key, value = text.split(" = ")
        values[key] = tomllib.loads(f"value = {value}")["value"]
    assert bool(values) == (changed != "nothing")
    scenario = load_scenario("paper")
    scenario = scenario.with_keys(values) if values else scenario
    return (
        run_closed_loop(scenario, open_workspace("daqp")),
        run_closed_loop(scenario, open_workspace("unconstrained_clipped"), formulation="none"),
    )


@pytest.mark.parametrize(("changed", "keys", "entered", "clipped", "steady", "wound"), TABLES[0])
def test_each_row_is_where_both_laws_take_the_ship(
    changed: str, keys: str, entered: str, clipped: str, steady: str, wound: str
) -> None:
    found = []
    for run in _run_both_laws(changed, keys):
        to_origin = run.steps[["n_m", "e_m"]].to_numpy()
        radial = np.hypot(to_origin[:, 0], to_origin[:, 1])
        found.append((radial[np.argmax(radial <= 1.0) :].max(), radial[len(radial) // 2 :].max()))
    texts = [f"{value:#.3g}" for pair in zip(*found, strict=True) for value in pair]
    assert texts == [entered, clipped, steady, wound]


@pytest.mark.parametrize(("changed", "keys", "constrained", "clipped", "claim"), TABLES[1])
def test_each_row_is_the_heading_of_both_laws(
    changed: str, keys: str, constrained: str, clipped: str, claim: str
) -> None:
    found = [run.summary["heading_max_deg"] for run in _run_both_laws(changed, keys)]
    assert [f"{value:#.3g}" for value in found] == [constrained, clipped]
    if abs(found[0] - found[1]) < SMALLEST_DIFFERENCE * found[0]:
        assert claim == "not reproduced"
    else:
        assert claim == ("reproduced" if found[0] < found[1] else "contradicted")


def test_the_tables_are_complete() -> None:
    assert [len(table) for table in TABLES] == [8, 7]
