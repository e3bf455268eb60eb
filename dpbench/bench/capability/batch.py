"""The static allocations at the edge of what a ship holds, as a sequence of QPs.

For each case and direction there are four: the two winds of the standard's table around the edge,
and a thousandth of the wind before and beyond it. Below the first row half of the edge is taken,
beyond the last row the last four rows. The choice of azimuth pieces is that of least thrust.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.bench.capability.frontier import FROM_DEG, Capability, CapabilityPlot, Case, WindLimit
from dpbench.mpc.thrusters.static_allocation import StaticAllocation
from dpbench.qp.program import QPSequence
from dpbench.ship.capability.conditions import DP_CONDITIONS

EDGE = 1e-3
"""Share of the wind by which a QP lies before or beyond the edge."""
POINTS = 4
"""QPs of one direction."""


@dataclass(frozen=True)
class Point:
    """A capability QP: failure case, weather direction [rad], wind [m/s], whether it is held."""

    case: Case
    from_rad: float
    wind_mps: float
    held: bool


def list_points_at_all_limits(frontier: CapabilityPlot, capability: Capability) -> list[Point]:
    """Return the capability QPs around the wind limit of every failure case and direction."""
    return [
        point
        for case in frontier.intact_and_failure_cases
        for from_deg, edge in zip(FROM_DEG, capability.held[case.name], strict=True)
        for point in list_points_at_limit(case, math.radians(from_deg), edge)
    ]


def list_points_at_limit(case: Case, from_rad: float, edge: WindLimit) -> list[Point]:
    """Return the capability QPs at `POINTS` winds around one direction's and failure's limit."""
    number, wind_mps = edge.number, edge.wind_mps
    if number == max(DP_CONDITIONS):
        rows = range(number + 1 - POINTS, number + 1)
        return [Point(case, from_rad, DP_CONDITIONS[row][0], True) for row in rows]
    # A ship that holds no wind holds that of no row: calm and half of the first one.
    beyond = (1.0 + EDGE) * wind_mps if wind_mps > EDGE else 0.5 * DP_CONDITIONS[1][0]
    winds = [
        (DP_CONDITIONS[number][0] if number else 0.5 * wind_mps, True),
        ((1.0 - EDGE) * wind_mps, True),
        (beyond, False),
        (DP_CONDITIONS[number + 1][0], False),
    ]
    # By rising wind: the edge may lie within a thousandth of a row of the table.
    return [Point(case, from_rad, *wind) for wind in sorted(winds)]


def build_allocation_sequence(frontier: CapabilityPlot, points: Sequence[Point]) -> QPSequence:
    """Return the static allocation QP of each capability point, in their order."""
    assert frontier.sides is not None, "a QP has polygons"
    allocation = _build_static_allocation(
        frontier, {point.case for point in points}, frontier.sides
    )
    problems = []
    for point in points:
        weather = frontier.weather(point.from_rad, point.wind_mps)
        _, chosen = frontier.find_least_use_and_pieces(point.case, point.from_rad, point.wind_mps)
        lost = frontier.find_unusable_thrusters(point.case)
        problems.append(
            allocation.build_qp_for_static_load(weather.load, weather.shares, chosen, lost)
        )
    q, low, high = (np.array([getattr(qp, name) for qp in problems]) for name in ("q", "l", "u"))
    rows = np.array([qp.A for qp in problems])
    changed = None if (rows == rows[0]).all() else rows
    return QPSequence(f"{frontier.vessel.id} capability", problems[0], q, low, high, A=changed)


def _build_static_allocation(
    frontier: CapabilityPlot, cases: set[Case], sides: int
) -> StaticAllocation:
    """Return an allocation QP with rows for the thrusters' convex areas in any failure case."""
    every = [frontier.pieces_of(case) for case in cases]
    count = len(frontier.thrusters.thrusters)
    pieces = [[piece for of_case in every for piece in of_case[i]] for i in range(count)]
    sectors = [any(piece.sector is not None for piece in some) for some in pieces]
    chords = [max((len(piece.chords) for piece in some), default=0) for some in pieces]
    return StaticAllocation(frontier.thrusters, sides, sectors, chords)
