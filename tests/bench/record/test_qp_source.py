"""Descriptions of QP sources: as campaigns have written them, so that run ids stay."""

from dataclasses import replace
from typing import Any

import pytest

from dpbench.bench.record.cell import CONTROLLER, SOURCES, Cell, parse_qp_source
from dpbench.errors import InputError

CELL = Cell("replay", {"name": "turn"}, "daqp", "native", "fresh", "default", 20, first=100)
RECIPE = {"family": "plain", "n": 4, "m": 6, "seed": 1, "steps": 24, "block": 0, "cond": 0.0}
# Kind, description, whether its times are compared, whether verdicts are about it.
KINDS: list[tuple[dict[str, Any], bool, bool]] = [
    ({"kind": "random", "name": "plain-n4-m6-s1", "recipe": RECIPE}, False, False),
    ({"kind": "recorded", "name": "a", "path": "a.npz", "sha256": "0f"}, True, True),
    ({"kind": "hardest", "name": "turn hardest 20", "of": 450}, True, True),
    (
        {"kind": "consequence", "name": "turn, bus lost", "group": "bus", "margin": 1.25},
        True,
        False,
    ),
    (
        {"kind": "capability", "name": "c", "sides": 8, "vessel_name": "osv", "vessel": {"a": 1}},
        False,
        False,
    ),
]


@pytest.mark.parametrize(("described", "timed", "judged"), KINDS)
def test_descriptions_of_sources(described: dict[str, Any], timed: bool, judged: bool) -> None:
    source = parse_qp_source(described)
    assert source.to_dict() == described
    assert (source.is_timed, source.is_judged) == (timed, judged)
    cell = replace(CELL, source=source)
    assert Cell.from_json(cell.to_json()) == cell and cell.sequence == described["name"]
    assert cell.is_timed is timed
    assert cell.steps_needed_in_file == 100 + described.get("of", 20)


def test_every_kind_is_described_above() -> None:
    assert {described["kind"] for described, _, _ in KINDS} == set(SOURCES)


def test_the_controller_needs_no_description() -> None:
    assert parse_qp_source({}) is CONTROLLER
    assert '"source"' not in CELL.to_json()
    assert (CELL.sequence, CELL.steps_needed_in_file) == ("turn[100:120]", 120)


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="dice"):
        parse_qp_source({"kind": "dice"})
