"""Limits of thrusters as rows of a QP: circles become regular polygons inside them.

    −T cos(π/s) ≤ (cos a_k, sin a_k)·f_i ≤ T cos(π/s),   a_k = (2k + 1) π/s,   k = 0 … s/2 − 1

        a_1   ╱‾‾╲   a_0        s = 8: four rows in two-sided pairs, sides facing a_k and a_k + π;
             │    │             corners ahead, abeam and between, where full thrust T is allowed,
        …     ╲__╱   …          and T cos(π/s) at least anywhere else

Between corners the polygon gives away 1 − cos(π/s) ≈ ½ (π/s)² of the thrust. Opposite sides share
a row, because one-sided rows bring infinite limits that some solvers take badly. A sector adds two
rows through the origin, whose other side is T, which no force exceeds; a half turn, whose edges are
one line, adds one. Every other thruster has one row of its own.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.linalg

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.ship.thrusters import Thruster, ThrusterSet, is_half_turn

NOTHING_LOST: Flags = np.zeros(0, dtype=np.bool_)  # Of limits that belong to no thrusters


class Limits(NamedTuple):
    """Lower and upper limits (r,) of r linear force constraints, and flags of lost thrusters."""

    low: Vector
    high: Vector
    lost: Flags = NOTHING_LOST


@dataclass(frozen=True, eq=False)
class ThrusterRows:
    """Linear limits low ≤ G f ≤ high on the forces f of all thrusters, grouped by thruster.

    G (r, n_f) : rows, each of unit length on the entries of one thruster.
    low, high (r,) : limits [N]; zero lies within. intact : these limits with no thruster lost.
    thruster (r,) : the number of the thruster a row belongs to; entry (n_f,) : that of an entry.
    """

    G: Matrix
    low: Vector
    high: Vector
    thruster: Indices
    entry: Indices
    intact: Limits = field(init=False)

    def __post_init__(self) -> None:
        intact = Limits(self.low, self.high, np.zeros(self.entry[-1] + 1, dtype=np.bool_))
        object.__setattr__(self, "intact", intact)

    def largest_row_changes_per_step(self, df_max: Vector) -> Vector:
        """Return each force constraint's unit (r,): its change by a maximum increment."""
        largest: Vector = np.sqrt(((self.G * df_max) ** 2).sum(axis=1))
        return largest

    def row_and_entry_maxima_by_thruster(
        self, of_row: Vector, of_entry: Vector
    ) -> tuple[Vector, Vector]:
        """Return two vectors by thruster: largest value of its rows, and of its entries of f."""
        numbers = range(int(self.entry[-1]) + 1)
        rows = np.array([of_row[self.thruster == i].max() for i in numbers])
        return rows, np.array([of_entry[self.entry == i].max() for i in numbers])

    def limits_after_loss_of_thrusters(self, lost: Collection[int]) -> Limits:
        """Return the limits after the loss of thrusters, given by index: those give no force.

        As many rows of a thruster become zero as it has entries, of an azimuth two that lie across
        each other: more would be redundant. The edges of a sector, which meet at zero force, open.
        """
        low, high = self.low.copy(), self.high.copy()
        for i in lost:
            rows = np.flatnonzero(self.thruster == i)
            sides = np.count_nonzero(self.low[rows] < 0.0)
            edges = rows[self.low[rows] == 0.0]
            low[edges] = -high[edges]
            zero = rows[np.array([0, sides // 2])[: np.count_nonzero(self.entry == i)]]
            low[zero] = high[zero] = 0.0
        return Limits(low, high, np.isin(np.arange(self.entry[-1] + 1), list(lost)))


def build_limit_rows_of_thrusters(thrusters: ThrusterSet, sides: int) -> ThrusterRows:
    """Return linear limits of a ship's thrusters: polygons of `sides` sides for azimuths."""
    normals, lows, highs = zip(
        *(_build_limit_rows_of_one_thruster(t, sides) for t in thrusters.thrusters), strict=True
    )
    numbers = np.arange(len(lows))
    thruster = np.repeat(numbers, [len(low) for low in lows])
    entry = np.repeat(numbers, [t.component_count for t in thrusters.thrusters])
    G: Matrix = scipy.linalg.block_diag(*normals)
    return ThrusterRows(G, np.concatenate(lows), np.concatenate(highs), thruster, entry)


def _build_limit_rows_of_one_thruster(
    thruster: Thruster, sides: int
) -> tuple[Matrix, Vector, Vector]:
    """Return one thruster's linear force limits: normals (r_i, components), low and high (r_i,)."""
    if thruster.kind != "azimuth":
        most = np.array([thruster.thrust_N])
        return np.ones((1, 1)), -thruster.astern * most, most
    angle = (2.0 * np.arange(sides // 2) + 1.0) * np.pi / sides
    normals = np.column_stack((np.cos(angle), np.sin(angle)))
    most = np.full(len(angle), thruster.thrust_N * np.cos(np.pi / sides))
    if thruster.convex_sector_rad is None:
        return normals, -most, most
    start, end = thruster.convex_sector_rad
    edges = [(-np.sin(start), np.cos(start)), (np.sin(end), -np.cos(end))]
    if is_half_turn(thruster.convex_sector_rad):
        # A second row, a rounding apart, would leave open which of the two is active.
        edges = edges[:1]
    beside = np.full(len(edges), thruster.thrust_N)
    low, high = np.concatenate((-most, 0.0 * beside)), np.concatenate((most, beside))
    return np.vstack((normals, edges)), low, high


# Share of the rate at which limits of a lost thruster close in: plans keep some freedom, so that no
# rounding decides whether there is one.
RAMP_DOWN_SHARE = 0.9
NEGLIGIBLE_STEPS = 0.05  # A smaller rest of a force counts as zero, well within that freedom


class LimitRampDown:
    """Gradual tightening of limits below the present force, so that they stay reachable.

        λ_i = 1 − 0.9 i Δf_max / |f| at move i, zero where hardly anything is left
        lost thruster:  all its rows at λ_i g of their intact limits, g the share that holds f now
        other limits:   row k no further than λ_i G_k f

    The straight way λ_i f lies within them at every move and keeps to the rate of each entry. The
    polygon of a lost thruster shrinks as a whole, with room inside until it is nothing: rows that
    end at zero alone would let its force go round their corners for ever.

    rows : of the intact thrusters; du_max : (n_f,) rate limits of a sample; row_max : (r,) unit of
    a row; N_c : moves; factor : (r,) multiplies limits in units of rows, None for 1.
    """

    def __init__(
        self,
        rows: ThrusterRows,
        du_max: Vector,
        row_max: Vector,
        N_c: int,
        *,
        factor: Vector | None = None,
    ) -> None:
        (r, n_f), p = rows.G.shape, int(rows.entry[-1]) + 1
        self._shape = N_c, r
        # One array, because most of the time of a call goes to its arguments.
        table = np.zeros((G_FROM + n_f, max(r, n_f, p + 1)))
        table[LOW, :r], table[HIGH, :r] = rows.low, rows.high
        table[ROW_MAX, :r] = row_max
        table[FACTOR, :r] = 1.0 if factor is None else factor
        table[DU_MAX, :n_f] = du_max
        table[ROW_FROM, : p + 1] = np.searchsorted(rows.thruster, np.arange(p + 1))
        table[ENTRY_FROM, : p + 1] = np.searchsorted(rows.entry, np.arange(p + 1))
        table[G_FROM:, :r] = rows.G.T
        self._table: Matrix = table

    def compute_gradually_tightened_limits(
        self, f: Vector, limits: Limits
    ) -> tuple[Matrix, Matrix]:
        """Return lower and upper limits (N_c, r) on the summed force change, tightened slowly."""
        l, u = np.empty(self._shape), np.empty(self._shape)  # noqa: E741 - of l ≤ Az ≤ u
        self.write_limits(f, limits, l.reshape(-1), u.reshape(-1))
        return l, u

    def write_limits(self, f: Vector, limits: Limits, l: Vector, u: Vector) -> None:  # noqa: E741 - of l ≤ Az ≤ u
        """Write each move's force limits, lowered ones tightened gradually, into l and u."""
        _write_tightened_limits(self._table, f, *limits, l, u, self._shape[0])


# Rows of the table of `_write_tightened_limits`; its columns are rows k, entries or thrusters.
LOW, HIGH, ROW_MAX, FACTOR, ALONG, DU_MAX, ROW_FROM, ENTRY_FROM, G_FROM = range(9)


@njit(cache=True, error_model="numpy")
def _write_tightened_limits(table, f, low, high, lost, l, u, N_c):  # type: ignore[no-untyped-def] # noqa: E741 - compiled: numba finds the types; of l ≤ Az ≤ u
    """Write each move's force limits into l and u, tightened gradually if f is outside them."""
    r, n_f, stride = low.shape[0], f.shape[0], l.shape[0] // N_c
    for k in range(r):
        table[ALONG, k] = 0.0
    for j in range(n_f):
        for k in range(r):
            table[ALONG, k] += table[G_FROM + j, k] * f[j]
    t, first = 0, 0
    while first < r:
        end = int(table[ROW_FROM, t + 1])
        gauge = _compute_used_share_of_limits(table, first, end)
        steps = 0.0
        for j in range(int(table[ENTRY_FROM, t]), int(table[ENTRY_FROM, t + 1])):
            steps += (f[j] / table[DU_MAX, j]) ** 2
        steps = np.sqrt(steps)
        for i in range(N_c):
            left = steps - RAMP_DOWN_SHARE * (i + 1)
            share = left / steps if left > NEGLIGIBLE_STEPS else 0.0
            shrunk = lost[t] and share > 0.0
            for k in range(first, end):
                along, least, most = table[ALONG, k], low[k], high[k]
                if shrunk:
                    least, most = share * gauge * table[LOW, k], share * gauge * table[HIGH, k]
                elif not lost[t]:
                    least, most = min(least, share * along), max(most, share * along)
                unit, factor = table[ROW_MAX, k], table[FACTOR, k]
                l[i * stride + k] = (least - along) / unit * factor
                u[i * stride + k] = (most - along) / unit * factor
        t, first = t + 1, end


@njit(cache=True, error_model="numpy")
def _compute_used_share_of_limits(table, first, end):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Return the share of its intact limits that a thruster's force uses."""
    gauge = 0.0
    for k in range(first, end):
        along = table[ALONG, k]
        # A sector's edge has zero for a limit, of which f is no share.
        limit = table[HIGH if along > 0.0 else LOW, k]
        if limit != 0.0:
            gauge = max(gauge, along / limit)
    return gauge
