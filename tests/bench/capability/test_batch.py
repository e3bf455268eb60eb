"""The QPs at the edge: certified, of one shape, feasible before it and infeasible beyond."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dpbench.bench.capability.batch import (
    EDGE,
    Point,
    all_points,
    allocation_sequence,
    points_at_edge,
)
from dpbench.bench.capability.frontier import Case, Frontier, Held
from dpbench.bench.capability.study import FROM_DEG, Capability
from dpbench.bench.capability.table import COLUMNS, load_capability, table_of, write_capability
from dpbench.bench.plan.suite import load_suite
from dpbench.bench.sequences.capability_boundary import write_batch
from dpbench.bench.sequences.sequence_file import load_recorded
from dpbench.errors import ResultsError
from dpbench.qp.referee.referee import certified
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.conditions import DP_CONDITIONS

pytestmark = pytest.mark.slow
SOME = (0.0, 20.0, 100.0, 200.0)


@pytest.fixture(scope="module")
def frontier() -> Frontier:
    """Of Ratownik, with polygons."""
    return Frontier(load_vessel("ratownik"), 24)


@pytest.fixture(scope="module")
def points(frontier: Frontier) -> list[Point]:
    """Four directions, intact and after three failures."""
    return [
        point
        for case in frontier.cases
        for from_rad in map(math.radians, SOME)
        for point in points_at_edge(case, from_rad, frontier.held(case, from_rad))
    ]


def test_a_direction_has_four_points_around_its_edge() -> None:
    """The two rows of the table and a thousandth of the wind to either side, by rising wind."""
    points = points_at_edge(Case("intact", frozenset()), 0.1, Held(15.0, 6))
    winds = [DP_CONDITIONS[6][0], (1 - EDGE) * 15.0, (1 + EDGE) * 15.0, DP_CONDITIONS[7][0]]
    assert [point.wind_mps for point in points] == winds
    assert [point.held for point in points] == [True, True, False, False]
    top = points_at_edge(Case("intact", frozenset()), 0.1, Held(32.6, 11))
    assert [point.wind_mps for point in top] == [DP_CONDITIONS[row][0] for row in (8, 9, 10, 11)]
    assert all(point.held for point in top)
    nothing = points_at_edge(Case("intact", frozenset()), 0.1, Held(1.0, 0))
    assert [point.wind_mps for point in nothing] == [0.5, 1 - EDGE, 1 + EDGE, DP_CONDITIONS[1][0]]


def test_the_referee_proves_what_the_cone_program_found(
    frontier: Frontier, points: list[Point]
) -> None:
    """Every QP has a certified optimum where the wind is held, and else a proof of none."""
    sequence = allocation_sequence(frontier, points)
    assert len(sequence) == len(points) == 4 * len(SOME) * 4
    for point, optimum in zip(points, certified(sequence), strict=True):
        assert (optimum.kind == "infeasible") is not point.held
        assert not point.held or optimum.bound < 1e-10


def made_up(frontier: Frontier) -> Capability:
    """Edges that cost nothing to find."""
    known = {
        case.name: tuple(Held(10.0 + k % 3, 4) for k in range(len(FROM_DEG)))
        for case in frontier.cases
    }
    return Capability("ratownik", 24, known, dict.fromkeys(known, ("bow 1",)), ())


def test_a_plot_of_a_suite_is_a_row_a_qp(frontier: Frontier, tmp_path: Path) -> None:
    """In the order of the QPs; a folder without it has none, a damaged one is named."""
    capability = made_up(frontier)
    points = all_points(frontier, capability)
    assert load_capability(tmp_path) is None
    write_capability(tmp_path, [table_of("some name", capability, points)])
    table = load_capability(tmp_path)
    assert table is not None
    assert list(table) == list(COLUMNS)
    assert table["k"].tolist() == list(range(len(points)))
    assert table["wind_mps"].tolist() == [point.wind_mps for point in points]
    assert table["from_deg"].iloc[:8].tolist() == 4 * [0.0] + 4 * [10.0]
    assert table["edge_mps"].iloc[4] == 11.0
    (tmp_path / "capability.parquet").write_bytes(b"nothing")
    with pytest.raises(ResultsError, match=r"capability\.parquet"):
        load_capability(tmp_path)


def test_a_batch_is_a_suite_that_runs_as_it_stands(frontier: Frontier, tmp_path: Path) -> None:
    """Its sequence is read back with all certificates, and the suite names it."""
    capability = made_up(frontier)
    path, suite = load_suite(write_batch(frontier, capability, tmp_path / "new"))
    assert path.parent == tmp_path / "new"
    assert suite.recorded[0].sequence == "capability.npz"
    recorded = load_recorded(path.parent / "capability.npz")
    assert recorded.optima is not None
    assert len(recorded.optima) == 4 * len(frontier.cases) * len(FROM_DEG)
    assert np.isfinite(recorded.sequence.l).all()
