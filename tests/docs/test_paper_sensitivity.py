"""The table in `docs/paper.md` on how the heading result depends on the assumed values."""

import re
import tomllib

import pytest

from dpbench import load_scenario, open_workspace, run_closed_loop
from tests.docs.markdown_blocks import DOCS

TEXT = (DOCS / "paper.md").read_text(encoding="utf-8")
TABLE = re.findall(r"^\|.*\|$", TEXT.split("### Sensitivity of the heading result")[1], re.M)[2:9]
ROWS = [[cell.strip() for cell in row.strip("|").split("|")] for row in TABLE]
SMALLEST_DIFFERENCE = 1e-9
"""Relative difference of two laws that are equal but for rounding."""


@pytest.mark.parametrize(("changed", "keys", "constrained", "clipped", "claim"), ROWS)
def test_each_row_is_what_both_laws_do(
    changed: str, keys: str, constrained: str, clipped: str, claim: str
) -> None:
    values: dict[str, object] = {}
    for text in re.findall(r"`([^`]+)`", keys):
        key, value = text.split(" = ")
        values[key] = tomllib.loads(f"value = {value}")["value"]
    assert bool(values) == (changed != "nothing")
    scenario = load_scenario("paper")
    scenario = scenario.with_keys(values) if values else scenario
    loops = (
        run_closed_loop(scenario, open_workspace("daqp")),
        run_closed_loop(scenario, open_workspace("unconstrained_clipped"), formulation="none"),
    )
    found = [loop.summary["heading_max_deg"] for loop in loops]
    assert [f"{value:#.3g}" for value in found] == [constrained, clipped]
    if abs(found[0] - found[1]) < SMALLEST_DIFFERENCE * found[0]:
        assert claim == "not reproduced"
    else:
        assert claim == ("reproduced" if found[0] < found[1] else "contradicted")


def test_the_table_is_complete() -> None:
    assert len(ROWS) == 7
