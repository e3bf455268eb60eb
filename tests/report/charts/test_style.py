"""The colour of a solver's family: every family has one."""

from __future__ import annotations

from typing import get_args

from dpbench.report.charts.style import FAMILY_COLOURS
from dpbench.solvers.record import Family
from dpbench.solvers.table import TABLE


def test_every_family_of_a_record_has_a_colour_of_its_own() -> None:
    assert set(get_args(Family)) <= set(FAMILY_COLOURS)
    assert len(set(FAMILY_COLOURS.values())) == len(FAMILY_COLOURS)
    assert "not stated" not in {row.family for row in TABLE.values()}
