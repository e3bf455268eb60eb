"""The colour of a solver's family: every family has one, known here or not."""

from __future__ import annotations

from typing import get_args

from dpbench.report.style import FAMILIES, GREY, colour_of, family_colours, family_of
from dpbench.solvers.record import Family
from dpbench.solvers.table import TABLE


def test_every_family_of_a_record_has_a_name_and_a_colour() -> None:
    """None is forgotten, and no solver of the table is without a family."""
    assert set(FAMILIES) == set(get_args(Family))
    assert "not stated" not in {row.family for row in TABLE.values()}


def test_a_legend_names_the_families_present_in_one_order() -> None:
    """Two families of a kind share an entry; a solver that is not known here is said to be so."""
    legend = family_colours(["osqp", "somebody_elses", "qpalm", "daqp"])
    assert list(legend) == ["active set", "first order, augmented Lagrangian", "family not stated"]
    assert legend[family_of("qpalm")] == colour_of("osqp")
    assert colour_of("somebody_elses") == GREY
