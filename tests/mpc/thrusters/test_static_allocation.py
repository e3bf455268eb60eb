"""Static allocation: the QP against forces by hand, and its one shape for all pieces."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dpbench.mpc.thrusters.static_allocation import StaticAllocation
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Thruster, ThrusterSet

WHOLE = (Piece(), Piece(), Piece())
NOBODY: frozenset[int] = frozenset()
FULL = np.ones(3)


@pytest.fixture
def thrusters() -> ThrusterSet:
    """Two stern azimuths of 100 kN, 5 m off the centre line, and a bow tunnel of 80 kN."""
    port = Thruster("port", "azimuth", -30.0, -5.0, 1e5, 10.0)
    starboard = Thruster("starboard", "azimuth", -30.0, 5.0, 1e5, 10.0)
    return ThrusterSet((port, starboard, Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0)))


def allocation(thrusters: ThrusterSet, *, room: bool = False, sides: int = 16) -> StaticAllocation:
    return StaticAllocation(thrusters, sides, [room, room, False], [3 * room, 3 * room, 0])


def forces(thrusters: ThrusterSet, qp: QuadraticProgram) -> np.ndarray:
    """The certified optimum in N."""
    optimum = certify(qp)
    assert optimum.kind != "infeasible"
    return optimum.z * thrusters.per_entry(thrusters.thrust_N)


def test_the_optimum_balances_the_load_with_the_least_effort(thrusters: ThrusterSet) -> None:
    """T_e f = −load, and f is the weighted pseudo-inverse where no limit is met."""
    load = np.array([-4e4, 3e4, -2e5])
    f = forces(thrusters, allocation(thrusters).qp(load, FULL, WHOLE, NOBODY))
    np.testing.assert_allclose(thrusters.T_e @ f, -load, rtol=1e-9, atol=1e-6)
    W_inverse = np.diag(thrusters.per_entry(thrusters.thrust_N) ** 2)
    T_e = thrusters.T_e
    expected = W_inverse @ T_e.T @ np.linalg.solve(T_e @ W_inverse @ T_e.T, -load)
    np.testing.assert_allclose(f, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("sides", [8, 16, 36])
def test_the_most_ahead_is_full_thrust_times_its_share(thrusters: ThrusterSet, sides: int) -> None:
    """Corners lie ahead: 2 · 100 kN · β is held and no more."""
    shares = np.array([0.9, 0.9, 0.5])
    program = allocation(thrusters, sides=sides)
    for load_N, kind in ((1.8e5 * (1 - 1e-9), False), (1.8e5 * (1 + 1e-9), True)):
        qp = program.qp(np.array([-load_N, 0.0, 0.0]), shares, WHOLE, NOBODY)
        assert (certify(qp).kind == "infeasible") is kind


def test_what_is_lost_gives_nothing(thrusters: ThrusterSet) -> None:
    load = np.array([-4e4, 0.0, 0.0])
    f = forces(thrusters, allocation(thrusters).qp(load, FULL, WHOLE, frozenset({0})))
    np.testing.assert_allclose(f[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(thrusters.T_e @ f, -load, rtol=1e-9, atol=1e-6)


def test_a_piece_keeps_a_force_in_its_sector_and_behind_its_chord(thrusters: ThrusterSet) -> None:
    """The port azimuth may push from 10° to 60° to port only, and there 40 % along a chord."""
    chord = np.array([[math.cos(-0.5), math.sin(-0.5), 0.4]])
    chosen = Piece((-1.0, -0.2), chord), Piece(), Piece()
    load = np.array([-1.2e5, 0.0, 0.0])
    qp = allocation(thrusters, room=True).qp(load, FULL, chosen, NOBODY)
    f = forces(thrusters, qp)
    angle, size = math.atan2(f[1], f[0]), math.hypot(f[0], f[1])
    assert -1.0 - 1e-9 <= angle <= -0.2 + 1e-9
    assert size * math.cos(angle + 0.5) <= 0.4e5 * (1 + 1e-9)
    assert size > 1e4


def test_room_for_pieces_changes_the_shape_and_not_the_answer(thrusters: ThrusterSet) -> None:
    load = np.array([-1.5e5, 4e4, 1e6])
    narrow, wide = (
        allocation(thrusters, room=room).qp(load, FULL, WHOLE, NOBODY) for room in (False, True)
    )
    assert wide.m == narrow.m + 2 * (2 + 3)
    np.testing.assert_allclose(certify(wide).z, certify(narrow).z, atol=1e-12)
