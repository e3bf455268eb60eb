"""Static thrust allocation: thrusters that balance a mean load with the least effort.

    min ½ Σ |f_i/T_i|²   subject to   T_e f = −load,   f_i in its piece of what thruster i may give

Scaled: z = f/T with the nominal thrusts T, the balance over ΣT and ΣT·arm. The rows are

    balance (3)    T_e T z = −load                     as equalities
    thrusters      of `thruster_rows.py`, ± β_i           circles as polygons with `sides` sides
    sectors        0 ≤ n·z_i ≤ 2                       of an azimuth's piece, two each
    chords         −2 ≤ n·z_i ≤ β_i h                  in which losses cut the circle

Where a piece has no sector or fewer chords than another of the same batch, rows that never bind
(−2 ≤ n·z ≤ 2) stand in, so that all QPs of a batch have one shape; |z_i| ≤ 1 keeps them away. A
lost thruster has no part in the balance; that it gives nothing is then the cost's doing, and no
limit of it is degenerate.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.thruster_rows import ThrusterRows, build_limit_rows_of_thrusters
from dpbench.qp.program import QuadraticProgram
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import ThrusterSet

NEVER = 2.0  # A limit no thruster reaches: in units of its nominal thrust it gives 1 at most


class StaticAllocation:
    """Builder of the QPs that test whether thrusters can balance a static load.

    thrusters : p of them; their own sectors are ignored, as pieces carry them.
    sides : of the polygon of an azimuth, even.
    sectors, chords : (p,) whether any piece of a thruster has a sector, and its most chords.
    """

    def __init__(
        self, thrusters: ThrusterSet, sides: int, sectors: Sequence[bool], chords: Sequence[int]
    ) -> None:
        round_ones = tuple(replace(t, sector_rad=None) for t in thrusters.thrusters)
        self._thrusters = thrusters
        self._rows = build_limit_rows_of_thrusters(ThrusterSet(round_ones, thrusters.where), sides)
        self._extra = [2 * int(has) + count for has, count in zip(sectors, chords, strict=True)]
        self._sectors = list(sectors)
        self.units = compute_balance_units(thrusters)
        self._balance = build_balance_matrix(thrusters)

    def build_qp_for_static_load(
        self, load: Vector, shares: Vector, chosen: Sequence[Piece], lost: frozenset[int]
    ) -> QuadraticProgram:
        """Return the QP that allocates a static load to thrusters, each in one convex force region.

        load : (3,) mean load times its factor [N, N, N·m]; chosen : (p,) a piece of each thruster;
        shares : (p,) effective over nominal thrust; lost : indices of those that give nothing.
        """
        T, rows = self._thrusters.largest_thrusts_N, self._rows
        given = [i not in lost for i in range(len(T))]
        over = shares[rows.thruster] / T[rows.thruster]
        blocks = [self._build_sector_and_chord_rows(i, chosen[i], shares[i]) for i in range(len(T))]
        balance = self._balance * self._thrusters.repeat_for_each_force_entry(
            np.array(given, dtype=np.float64)
        )
        A = np.vstack([balance, rows.G, *(block[0] for block in blocks)])
        right = -load / self.units
        low = np.concatenate([right, rows.low * over, *(block[1] for block in blocks)])
        high = np.concatenate([right, rows.high * over, *(block[2] for block in blocks)])
        n = self._thrusters.n_f
        return QuadraticProgram(np.eye(n), np.zeros(n), A, low, high, -np.ones(n), np.ones(n))

    def _build_sector_and_chord_rows(
        self, i: int, piece: Piece, share: float
    ) -> tuple[Matrix, Vector, Vector]:
        """Return rows, low and high that keep an azimuth in its sector and inside loss chords."""
        count = self._extra[i]
        normals = np.tile([1.0, 0.0], (count, 1))
        low, high = np.full(count, -NEVER), np.full(count, NEVER)
        first = 0
        if self._sectors[i]:
            first = 2
            if piece.sector is not None:
                normals[:2], low[:2] = compute_sector_normals(*piece.sector), 0.0
        cut = slice(first, first + len(piece.chords))
        normals[cut], high[cut] = piece.chords[:, :2], share * piece.chords[:, 2]
        A = np.zeros((count, self._thrusters.n_f))
        if count:
            A[:, self._thrusters.slices_in_force_vector[i]] = normals
        return A, low, high


class AllocationAfterLoss:
    """Builder of the QPs that allocate a force after thruster losses, with constant matrices.

        min ½ Σ |f_i/T_i|²   subject to   T_e f = τ,   low ≤ G f ≤ high,   lost ones f_i = 0

    Scaled as above. A loss is a limit, so that a workspace goes on from one load or loss to the
    next; without a slack an unattainable force leaves no feasible point. rows : r limits.
    """

    def __init__(self, thrusters: ThrusterSet, rows: ThrusterRows) -> None:
        self._units = compute_balance_units(thrusters)
        self._thrust = thrusters.largest_thrusts_N[rows.thruster]
        self._A = np.vstack([build_balance_matrix(thrusters), rows.G])

    def stack_row_limits_of_demands(
        self, force: Matrix, low: Matrix, high: Matrix
    ) -> tuple[Matrix, Matrix]:
        """Return QP row limits (K, 3 + r) for K demanded forces and thruster limits (K, r) [N]."""
        balance = force / self._units
        return (np.hstack([balance, low / self._thrust]), np.hstack([balance, high / self._thrust]))

    def make_qp_with_row_limits(self, l: Vector, u: Vector) -> QuadraticProgram:  # noqa: E741 - of l ≤ Az ≤ u
        """Return the allocation QP with row limits l and u (3 + r,)."""
        n = self._A.shape[1]
        return QuadraticProgram(np.eye(n), np.zeros(n), self._A, l, u, -np.ones(n), np.ones(n))


def compute_sector_normals(start: float, end: float) -> Matrix:
    """Return inward normals (2, 2) of the sector between two directions [rad]."""
    return np.array([(-np.sin(start), np.cos(start)), (np.sin(end), -np.cos(end))])


def compute_balance_units(thrusters: ThrusterSet) -> Vector:
    """Return the units (3,) of the force balance: ΣT [N], ΣT [N], ΣT times longest arm [N·m]."""
    total = float(thrusters.largest_thrusts_N.sum())
    return np.array([total, total, total * thrusters.longest_arm_m])


def build_balance_matrix(thrusters: ThrusterSet) -> Matrix:
    """Return the scaled matrix (3, n_f) from relative thruster forces to force and moment."""
    thrust = thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N)
    matrix: Matrix = thrusters.T_e * thrust / compute_balance_units(thrusters)[:, np.newaxis]
    return matrix
