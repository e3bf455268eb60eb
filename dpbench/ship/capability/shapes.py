"""The forces an azimuth may give after losses, as a union of convex pieces.

In directions without loss the edge is the circle of radius 1, times T. A forbidden zone takes a
sector out, and a loss a notch, so what remains is not convex: it is cut, at the bottom of each
notch and wherever a sector would be wider than half a turn, into pieces that are.

        ╭───╮        a piece: start ≤ direction ≤ end, |f| ≤ T, and a row n·f ≤ h T for each chord
       ╱  ╲╱ notch   of the notch; its corners lie on the true edge, so that chords give away no
       ╲  ╱          more than the second order of the angle between them
        ╰╯ zone
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from dpbench.arrays import Matrix
from dpbench.ship.capability.losses import TURN, Loss

_ROUNDING = 1e-9  # Angles [rad] that are the same
_THROUGH_ORIGIN = 1e-6  # A chord as near bounds nothing along itself but for rounding


@dataclass(frozen=True, eq=False)
class Piece:
    """Convex part of the forces that an azimuth can give after losses, relative to its thrust.

    sector : (start, end) [rad], at most half a turn; None for all round.
    chords : (c, 3) rows (n_x, n_y, h) of n·f ≤ h, in which a loss cuts the circle.
    """

    sector: tuple[float, float] | None = None
    chords: Matrix = field(default_factory=lambda: np.zeros((0, 3)))


def split_force_set_into_convex_pieces(
    sector: tuple[float, float] | None,
    zones: Sequence[tuple[float, float]],
    dead: Sequence[Loss],
    skegs: Sequence[Loss],
    step_rad: float,
) -> list[Piece]:
    """Return an azimuth's attainable forces as convex pieces; none if all is forbidden.

    sector, zones : where it may push, and where not, (from, to) [rad].
    dead, skegs : losses; of several of one kind the largest counts, of both kinds the product.
    step_rad : the largest angle between corners on the edge of a notch.
    """
    edge = _ThrustEdge(dead, skegs)
    if sector is None and not zones and not edge.kinks:
        return [Piece()]
    allowed: list[Piece] = []
    for start, end in _find_allowed_direction_ranges(sector, zones, edge):
        allowed += edge.cut_sector_into_convex_pieces(start, end, step_rad)
    return allowed


class _ThrustEdge:
    """Largest thrust of an azimuth in each direction, relative to its nominal thrust."""

    def __init__(self, dead: Sequence[Loss], skegs: Sequence[Loss]) -> None:
        self._both = dead, skegs
        losses = [*dead, *skegs]
        self.kinks = [angle for loss in losses for angle in (loss.start, loss.worst, loss.end)]

    def thrust_share_in_direction(self, direction: float) -> float:
        """Return the share of thrust left in a direction [rad] after all losses."""
        dead, skegs = (
            min((loss.thrust_share_in_direction(direction) for loss in losses), default=1.0)
            for losses in self._both
        )
        return dead * skegs

    def cut_sector_into_convex_pieces(
        self, start: float, end: float, step_rad: float
    ) -> list[Piece]:
        """Return an azimuth's attainable forces between two directions [rad] as convex pieces."""
        corners = self._choose_polygon_corner_directions(start, end, step_rad)
        points = [self._largest_thrust_vector_in_direction(corner) for corner in corners]
        sides = zip(pairwise(corners), pairwise(points), strict=True)
        tangents = [self._compute_end_tangents_and_chord(a, b, p, q) for (a, b), (p, q) in sides]
        cuts, first = [], 0
        for i in range(1, len(tangents)):
            wide = corners[i + 1] - corners[first] > math.pi + _ROUNDING
            (x, y), (to_x, to_y) = tangents[i - 1][1], tangents[i][0]
            if wide or x * to_y - y * to_x < -_ROUNDING:
                cuts.append((first, i))
                first = i
        cuts.append((first, len(tangents)))
        chords = [[chord for _, _, chord in tangents[a:b] if chord] for a, b in cuts]
        for (a, b), rows in zip(cuts, chords, strict=True):
            if len(rows) == b - a and min(row[2] for row in rows) < _THROUGH_ORIGIN:
                rows.append(
                    _compute_supporting_halfplane(
                        0.5 * (corners[a] + corners[b]), points[a : b + 1]
                    )
                )
        return [
            Piece((corners[a], corners[b]), np.array(rows, dtype=np.float64).reshape(-1, 3))
            for (a, b), rows in zip(cuts, chords, strict=True)
        ]

    def _choose_polygon_corner_directions(
        self, start: float, end: float, step_rad: float
    ) -> list[float]:
        """Return directions [rad] of polygon corners that approximate the thrust limit."""
        between = {start + (kink - start) % TURN for kink in self.kinks}
        main = [start, *sorted(a for a in between if start + _ROUNDING < a < end - _ROUNDING), end]
        corners = [start]
        for a, b in pairwise(main):
            lossy = self.thrust_share_in_direction(0.5 * (a + b)) < 1.0
            count = math.ceil((b - a) / (step_rad if lossy else math.pi) - _ROUNDING)
            corners += np.linspace(a, b, max(count, 1) + 1)[1:].tolist()
        return corners

    def _largest_thrust_vector_in_direction(self, direction: float) -> tuple[float, float]:
        """Return the largest thrust vector in a direction [rad], relative to nominal thrust."""
        # At a kink where a loss ends abruptly the lesser thrust counts.
        share = min(
            self.thrust_share_in_direction(direction - _ROUNDING),
            self.thrust_share_in_direction(direction + _ROUNDING),
        )
        return share * math.cos(direction), share * math.sin(direction)

    def _compute_end_tangents_and_chord(
        self, a: float, b: float, p: tuple[float, float], q: tuple[float, float]
    ) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float, float] | None]:
        """Return tangents at both ends of a thrust-limit segment; its chord if thrust is lost."""
        if self.thrust_share_in_direction(0.5 * (a + b)) >= 1.0:
            return (-math.sin(a), math.cos(a)), (-math.sin(b), math.cos(b)), None
        length = math.hypot(q[0] - p[0], q[1] - p[1])
        along = (q[0] - p[0]) / length, (q[1] - p[1]) / length
        normal = along[1], -along[0]
        return along, along, (*normal, normal[0] * p[0] + normal[1] * p[1])


def _compute_supporting_halfplane(
    direction: float, points: Sequence[tuple[float, float]]
) -> tuple[float, float, float]:
    """Return n_x, n_y and h of the closest row n·f ≤ h on points, n in a direction [rad]."""
    normal = math.cos(direction), math.sin(direction)
    return (*normal, max(normal[0] * x + normal[1] * y for x, y in points))


def _find_allowed_direction_ranges(
    sector: tuple[float, float] | None, zones: Sequence[tuple[float, float]], edge: _ThrustEdge
) -> list[tuple[float, float]]:
    """Return the ranges of directions [rad] inside the sector and outside all forbidden zones."""
    if sector is None:
        # A turn begins at the bottom of a notch, where it is cut anyway, or behind a zone.
        start = min(edge.kinks, key=edge.thrust_share_in_direction) if not zones else zones[0][1]
        sector = start, start + TURN
    left = [sector]
    for low, high in zones:
        for turn in (-2, -1, 0, 1, 2):
            at = low + turn * TURN, high + turn * TURN
            left = [part for arc in left for part in _subtract_zone_from_direction_range(arc, at)]
    return left


def _subtract_zone_from_direction_range(
    arc: tuple[float, float], zone: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return the parts of a range of directions that lie outside a forbidden zone."""
    parts = (arc[0], min(arc[1], zone[0])), (max(arc[0], zone[1]), arc[1])
    return [part for part in parts if part[1] - part[0] > _ROUNDING]
