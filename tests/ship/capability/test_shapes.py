"""Attainable forces of an azimuth: the pieces are convex, and together what zones and losses
leave."""

import math
from itertools import pairwise

import numpy as np
import pytest

from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.capability.losses import (
    TURN,
    Loss,
    find_forbidden_thrust_directions,
    list_losses_at_dead_thrusters,
    list_losses_at_skegs,
)
from dpbench.ship.capability.shapes import Piece, split_force_set_into_convex_pieces
from dpbench.ship.thrusters import ThrusterSet

STEP = math.radians(1.0)


def within(piece: Piece, f: np.ndarray) -> bool:
    """True where a force (2,) lies in a piece, by its rows alone."""
    inside = math.hypot(*f) <= 1.0 + 1e-9
    if piece.sector is not None:
        start, end = piece.sector
        rows = [(-math.sin(start), math.cos(start)), (math.sin(end), -math.cos(end))]
        inside &= all(np.dot(row, f) >= -1e-9 for row in rows)
    return bool(inside and (piece.chords[:, :2] @ f <= piece.chords[:, 2] + 1e-9).all())


def reach(shape: list[Piece], direction: float) -> float:
    """The largest force in a direction, by bisection over the pieces."""
    along = np.array([math.cos(direction), math.sin(direction)])
    low, high = 0.0, 1.0
    if any(within(piece, along) for piece in shape):
        return 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        held = any(within(piece, middle * along) for piece in shape)
        low, high = (middle, high) if held else (low, middle)
    return low


def forbidden(direction: float, zones: list[tuple[float, float]]) -> bool:
    return any((direction - low) % TURN < high - low for low, high in zones)


@pytest.mark.parametrize("dead", [(), (0,), (2,), (0, 2)], ids=str)
def test_the_pieces_are_what_zones_and_losses_leave(
    thrusters: ThrusterSet, hull: CapabilityHull, dead: tuple[int, ...]
) -> None:
    """The starboard stern azimuth of Ratownik in 180 directions, the port one working or dead."""
    every = thrusters.thrusters
    working = [every[i] for i in range(len(every)) if i not in dead]
    zones = find_forbidden_thrust_directions(every[1], working)
    losses = (
        list_losses_at_dead_thrusters(every[1], [every[i] for i in dead]),
        list_losses_at_skegs(every[1], hull),
    )
    shape = split_force_set_into_convex_pieces(None, zones, *losses, STEP)
    assert bool(zones) == (0 not in dead)
    for direction in np.linspace(0.001, TURN, 180):
        shares = [
            min((loss.thrust_share_in_direction(direction) for loss in kind), default=1.0)
            for kind in losses
        ]
        wanted = 0.0 if forbidden(direction, zones) else shares[0] * shares[1]
        assert reach(shape, direction) == pytest.approx(wanted, abs=1e-4)


@pytest.mark.slow
def test_corners_lie_on_the_edge_and_chords_inside(
    thrusters: ThrusterSet, hull: CapabilityHull
) -> None:
    starboard = thrusters.thrusters[1]
    losses = list_losses_at_skegs(starboard, hull)
    angle = np.linspace(losses[0].start, losses[0].end, 160)
    true = np.array([losses[0].thrust_share_in_direction(a) for a in angle])
    gaps = []
    for step in (16.0, 8.0, 4.0, 2.0):
        shape = split_force_set_into_convex_pieces(None, [], [], losses, math.radians(step))
        gap = true - np.array([reach(shape, a) for a in angle])
        assert gap.min() > -1e-8
        gaps.append(gap.max())
    assert all(a / b == pytest.approx(4.0, rel=0.35) for a, b in pairwise(gaps))


def test_every_piece_is_convex_and_at_most_half_a_turn(
    thrusters: ThrusterSet, hull: CapabilityHull
) -> None:
    starboard = thrusters.thrusters[1]
    zones = find_forbidden_thrust_directions(starboard, thrusters.thrusters)
    shape = split_force_set_into_convex_pieces(
        None, zones, [], list_losses_at_skegs(starboard, hull), STEP
    )
    assert len(shape) == 3
    for piece in shape:
        assert piece.sector is not None
        assert 0.0 < piece.sector[1] - piece.sector[0] <= math.pi + 1e-9


def test_without_losses_it_is_the_circle_and_a_sector_stays_one() -> None:
    (whole,) = split_force_set_into_convex_pieces(None, [], [], [], STEP)
    assert whole.sector is None
    assert len(whole.chords) == 0
    (sector,) = split_force_set_into_convex_pieces((0.5, 2.0), [], [], [], STEP)
    assert sector.sector == (0.5, 2.0)
    assert split_force_set_into_convex_pieces((0.5, 2.0), [(0.4, 2.1)], [], [], STEP) == []
    left = split_force_set_into_convex_pieces(
        (0.5, 2.0), [(1.0, 1.2), (1.9 - TURN, 2.2 - TURN)], [], [], STEP
    )
    np.testing.assert_allclose([p.sector for p in left], [(0.5, 1.0), (1.2, 1.9)])


def test_a_piece_that_ends_where_no_thrust_is_left_is_bounded() -> None:
    """From an edge to directions without thrust a chord leads through the origin."""
    tent = Loss(0.0, 0.5 * math.pi, math.pi, lambda angle: abs(2.0 * angle / math.pi - 1.0))
    start = math.radians(87.86)
    shape = split_force_set_into_convex_pieces(None, [(0.3, start)], [], [tent], math.radians(15.0))
    assert reach(shape, start) == pytest.approx(tent.thrust_share_in_direction(start), abs=1e-6)
