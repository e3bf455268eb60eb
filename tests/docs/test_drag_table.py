"""The tables of `docs/guide/drag.md`, by the formulas of the page and another digitised curve."""

import math
from pathlib import Path

import numpy as np
import pytest

from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import load_vessel
from dpbench.scenario.tables.vessel_file import CapabilityTable
from dpbench.ship.vessel import HullDrag
from dpbench.ship.weather import Windage

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "drag.md"
SPEEDS = (0.05, 0.1, 0.2, 0.5, 0.75, 1.0, 1.5)
SCALE = {"cybership2": 70.0}
AREAS_M2 = {"ratownik": 440.9}
HOERNER = (
    [0.988, 1.308, 1.639, 1.860, 2.313, 2.600],
    [0.8284, 0.7599, 0.6914, 0.6571, 0.6307, 0.5962],
)
"""B/2T and C_d as MSS has them digitised, `Hoerner.m`."""


def table_rows() -> dict[str, list[str]]:
    """The cells of the table of the library's ships, by name."""
    text = PAGE.read_text(encoding="utf-8").split("| ship | B, T [m] ")[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]
    return {row[0].strip("`"): row[1:] for row in rows}


def test_the_table_has_every_ship_of_the_library() -> None:
    assert set(table_rows()) == set(list_shipped_problem_names("vessels"))


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
def test_a_row_of_the_table_is_that_of_the_formulas(name: str) -> None:
    """Cells have three digits, and the two curves of Hoerner differ by up to 2 %."""
    dimensions, linear, *cells, cross_flow, difference = table_rows()[name]
    breadth, draught = map(float, dimensions.split(","))
    ship, ratio = load_vessel(name), SCALE.get(name, 1.0)
    # At full size, a length in m and damping in N s/m.
    length, damping = ship.length_m * ratio, ship.D[1, 1] * ratio**2.5
    assert float(linear) == pytest.approx(0.5 * damping / 1e3, rel=5e-3)
    area = AREAS_M2.get(name, length * draught)
    slowest = 0.004 * math.sqrt(9.81 * length)
    square = 0.5 * 1026.0 * area * np.interp(0.5 * breadth / draught, *HOERNER)
    for speed, cell in zip(SPEEDS, cells, strict=True):
        left = math.exp(-speed / slowest)
        # The force falls nowhere: 2 · 13.2 · a V₀ is the most that its slope allows.
        force = left * min(damping, 26.4 * square * slowest) * speed + square * speed**2
        assert float(cell) == pytest.approx(force / 1e3, rel=0.025)
    assert float(cross_flow) == pytest.approx(0.25 * square / 1e3, rel=0.025)
    ratio_of_cells = float(cells[3]) / float(cross_flow)
    assert float(difference.removesuffix(" %")) == pytest.approx(
        100.0 * (ratio_of_cells - 1.0), abs=1.0
    )
    assert ratio_of_cells <= 1.3


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
def test_a_row_of_the_table_is_what_dpbench_computes(name: str) -> None:
    """With the dimensions of the row, and the areas of the file where it has them."""
    dimensions, _, *cells, _, _ = table_rows()[name]
    ship, ratio = load_vessel(name), SCALE.get(name, 1.0)
    breadth, draught = (float(part) / ratio for part in dimensions.split(","))
    hull = ship.capability
    if hull is None:
        table = CapabilityTable(breadth_m=breadth, draught_m=draught)
        hull = table.build_capability_hull(ship.length_m, Windage(1.0, 1.0))
    drag = HullDrag.from_hull(hull)
    for speed, cell in zip(SPEEDS, cells, strict=True):
        force = drag.compute_drag_force(ship.D, np.array([0.0, speed / math.sqrt(ratio), 0.0]))[1]
        assert float(cell) == pytest.approx(force * ratio**3 / 1e3, rel=6e-3)


def test_cybership2_has_the_published_square_law() -> None:
    """Skjetne, Smogeli & Fossen (2004), in N of the model, at speeds of the full-size ship."""
    cells = table_rows()["cybership2"][2:-2]
    for cell, speed in zip(cells[3:], SPEEDS[3:], strict=True):
        v = speed / math.sqrt(70.0)
        published = (0.88965 * v + 36.47287 * v * v) * 70.0**3 / 1e3
        assert float(cell) == pytest.approx(published, rel=0.14)
