"""Bounds on the outputs as a part of the problem and of the loop, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.errors import ShapeError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.referee.referee import Referee

SAMPLE_S = 0.3


def test_inside_the_polygon_is_inside_the_circle() -> None:
    """Corners of the polygon are at the radius, the middle of a side at cos(π/K) of it."""
    bounds = OutputBounds(SAMPLE_S, radius_m=5.0)
    corners = 5.0 * np.exp(1j * (np.pi / 4 * np.arange(8) + np.pi / 8))
    reach = bounds.directions @ np.array([corners.real, corners.imag])
    np.testing.assert_allclose(reach.max(axis=0), 5.0 * bounds.inside, rtol=1e-14)
    assert bounds.inside == pytest.approx(0.92388, abs=1e-5)


@pytest.mark.parametrize("amplitude", ["reachable", "hard"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_output_bounds_leave_cost_and_amplitude_rows_of_the_moves_alone(
    ship: Any, amplitude: Any, units: Any
) -> None:
    """Over the moves, P, q, bounds and amplitude rows are those of the problem without output
    bounds, and limits other than the vessel's change amplitude rows alone."""
    problem = ship("supply_fs99", psi0_rad=0.3)
    bounds = OutputBounds(SAMPLE_S, 5.0, 0.2)
    plain = CondensedQP(problem, units=units, amplitude=amplitude)
    builder = CondensedQP(problem, units=units, amplitude=amplitude, outputs=bounds)
    x = np.array([0.01, 0.02, 0.0, 0.02, -0.01, 0.0, 3.0, -2.0, 0.1])
    theta = (x, np.zeros(3), 0.9 * problem.u_max)
    limits = Limits(0.4 * problem.u_min, 0.4 * problem.u_max)
    place = np.arange(builder.n).reshape(5, -1)
    moves, sides = place[:, :3].reshape(-1), place[:, 3:].reshape(-1)
    free = builder.problem(builder.emit(*theta))
    for limited in (None, limits):
        found = builder.problem(builder.emit(*theta, limits=limited))
        expected = plain.problem(plain.emit(*theta, limits=limited))
        # SI matrices pass through scaled ones, which costs a rounding or two.
        np.testing.assert_allclose(found.P[np.ix_(moves, moves)], expected.P, rtol=1e-14)
        np.testing.assert_array_equal(found.A[np.ix_(moves, moves)], expected.A)
        assert not found.A[np.ix_(moves, sides)].any()
        for name in ("q", "l", "u", "lb", "ub"):
            part = getattr(found, name)[moves]
            np.testing.assert_allclose(part, getattr(expected, name), rtol=1e-12)
        np.testing.assert_array_equal(found.u[sides], free.u[sides])
        assert np.isneginf(found.l[sides]).all()


@pytest.mark.slow
def test_a_speed_bound_holds_a_large_transfer_back(ship: Any) -> None:
    """On the way to a set-point 10 m off, the exactly solved loop stays at the bounded speed, which
    it passes by far without the bound."""
    problem = ship("supply_fs99", N_p=60, N_c=10, robust=True)
    problem = replace(problem, N_c=5)
    fastest = []
    for bounds in (OutputBounds(SAMPLE_S, speed_mps=0.2, sides=4), None):
        builder = CondensedQP(problem, outputs=bounds)
        referee = Referee(builder.P, builder.A, builder.lb, builder.ub)
        x, u, speeds = np.zeros(9), np.zeros(3), []
        y_ref = np.array([10.0, 0.0, 0.0])
        for _ in range(60):
            step = builder.emit(x, y_ref, u)
            best = referee.certify(step.q, step.l, step.u)
            assert best.bound < 1e-10
            du = builder.moves(best.z)[0]
            x, u = problem.model.A @ x + problem.model.B @ du, u + du
            speeds.append(np.linalg.norm(x[3:5]) / SAMPLE_S)
        fastest.append(max(speeds))
    # Bounded at every twelfth step of a prediction, not between, hence a little over.
    assert fastest[0] < 0.21
    assert fastest[1] > 0.3


def test_bounds_are_for_ships(random_plant: Any) -> None:
    """A plant of two outputs has no north, east and heading."""
    with pytest.raises(ShapeError, match="3 outputs"):
        CondensedQP(random_plant(1, 2, 2, 9, 3), outputs=OutputBounds(SAMPLE_S, 5.0))
