"""The least share of their thrust with which thrusters balance a load: cone programs.

    min u   subject to   T_e f = −load,   |f_i| ≤ u T_i,   f_i within u times its piece

The load is balanced where u ≤ 1. Circles are second-order cones; with a number of sides they are
the polygons of the QPs. Where a thruster has several pieces, its force is a sum of one from each,
f_i = Σ_k f_ik with f_ik within u_k times piece k and Σ_k u_k ≤ u: the convex hull of the pieces,
which bounds the use of every choice of one from below.

Few thrusters, or ones in line, leave a set without interior, on which an interior-point method may
stop. A load outside its span is seen at once; what else is left open is solved by linear programs
that add the tangent of a circle wherever the force is outside it (Kelley 1960).

The best choice of one piece for each thruster is found by branch and bound on these hulls: eight
azimuths near each other have 11 664 choices. A balance has three rows only, so few thrusters of an
optimum lie between pieces (Shapley-Folkman): a few bounds are enough.
"""

import heapq
import math
from collections.abc import Callable, Collection, Sequence
from functools import cache, partial
from importlib import import_module
from itertools import count
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.mpc.thrusters.allocation_qp import (
    build_balance_matrix,
    compute_balance_units,
    compute_sector_normals,
)
from dpbench.ship.capability.shapes import Piece, split_force_set_into_convex_pieces
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import Thruster, ThrusterSet

Combination = tuple[Piece, ...]
"""A piece for each thruster."""
Choices = tuple[tuple[Piece, ...], ...]
"""Pieces of each thruster between which there is a choice."""
MOST_USE = 1e8
"""Use for a load of all thrust beyond which the solvers' 1e-10 decides, and not the thrusters."""
SPAN = 1e-9
"""Share of a load that may lie outside the span of the thrusters' forces: rounding."""
RANK = 1e-13
"""Share of the largest singular value below which another is rounding, and no direction."""
TANGENTS = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
"""Directions of the first tangents of a circle [rad]."""
OUTSIDE = 1e-10
"""Relative distance outside a circle at which a tangent is added."""
ROUNDS = 100
"""Most linear programs; each adds a tangent, and some ten are enough."""
_PRECISE = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
GAP = 1e-9
"""Difference of uses that are the same, relative and of full thrust."""
Relax = Callable[[Choices], tuple[float, list[Vector]]]
"""Least use in the convex hulls of pieces, and the use of each piece."""
_CHORD_RAD = math.radians(1.0)


@cache
def _import_clarabel() -> Any:
    """Import and return the cone solver Clarabel, only when it is first needed."""
    return import_module("clarabel")


class Utilisation:
    """Solver for the least share of full thrust that balances a load, by cone programs."""

    def __init__(self, thrusters: ThrusterSet, sides: int | None = None) -> None:
        self._thrusters, self._sides = thrusters, sides
        self._balance, self._units = (
            build_balance_matrix(thrusters),
            compute_balance_units(thrusters),
        )
        self._cones: dict[tuple[frozenset[int], tuple[int, ...]], _Cones] = {}
        settings = _import_clarabel().DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
        self._settings = settings

    def least_use(
        self, load: Vector, shares: Vector, chosen: Combination, lost: frozenset[int]
    ) -> float:
        """Return the least share of full thrust that balances a load (3,) [N, N, N·m]; inf if none.

        `shares` (p,) is effective over nominal thrust; `chosen` (p,) pieces are kept by this
        object.
        """
        return self.relax_to_convex_hulls(load, shares, tuple((piece,) for piece in chosen), lost)[
            0
        ]

    def relax_to_convex_hulls(
        self, load: Vector, shares: Vector, choices: Choices, lost: frozenset[int]
    ) -> tuple[float, list[Vector]]:
        """Return the least use in the convex hulls of pieces, and the use u_k of each piece.

        Parameters
        ----------
        shares : (p,) effective over nominal thrust; choices : (p,) pieces of each thruster, kept by
            this object; lost : indices of those that give nothing.
        """
        unused = [np.zeros(len(pieces)) for pieces in choices]
        key = lost, tuple(id(piece) for pieces in choices for piece in (*pieces, None))
        if key not in self._cones:
            self._cones[key] = _Cones(self._thrusters, self._sides, choices, lost)
        cones = self._cones[key]
        if not cones.entries.size:
            return np.inf if load.any() else 0.0, unused
        balance = (self._thrusters.repeat_for_each_force_entry(shares) * self._balance)[
            :, cones.entries
        ]
        wanted = -load / self._units
        if not _is_in_span(balance, wanted):
            return np.inf, unused
        # A use is proportional to its load: solved for a load of 1, it is as exact for a small one.
        size = float(np.abs(wanted).max())
        if size == 0.0:
            return 0.0, unused
        x = self._solve_cone_program(cones, balance, wanted / size)
        if x is None or x[-1] > MOST_USE:
            return np.inf, unused
        x *= size
        return float(x[-1]), [x[at] for at in cones.sizes]

    def _solve_cone_program(
        self, cones: "_Cones", balance: Matrix, wanted: Vector
    ) -> Vector | None:
        """Return the optimum of a cone program for a force (3,); None where there is none."""
        A, b = cones.make_matrix_with_balance(balance), cones.zeros.copy()
        b[:AXES] = wanted
        problem = cones.quadratic, cones.cost, A, b, cones.kinds
        solution = _import_clarabel().DefaultSolver(*problem, self._settings).solve()
        status = str(solution.status)
        if status == "Solved":
            x: Vector = np.array(solution.x)
            return x
        return None if status == "PrimalInfeasible" else cones.solve_by_linear_programs(wanted)


def _is_in_span(balance: Matrix, wanted: Vector) -> bool:
    """Return whether a force (3,) lies in the span of the thrusters' forces, balance (3, e)."""
    U, size, _ = np.linalg.svd(balance, full_matrices=False)
    basis = U[:, size > RANK * size[0]]
    outside = wanted - basis @ (basis.T @ wanted)
    return bool(np.linalg.norm(outside) <= SPAN * np.linalg.norm(wanted))


class _Cones:
    """Cone program for the least thrust share in given choices of thrust areas, but the load.

    x = (f_ik/T_i of each piece k of the thrusters that are not lost, its u_k where there are
    several, u). A begins with the balance, the only part of it that changes. `entries` are those of
    f in x, and `sizes` (p,) the places of u_k.
    """

    def __init__(
        self,
        thrusters: ThrusterSet,
        sides: int | None,
        choices: Choices,
        lost: frozenset[int],
    ) -> None:
        self.choices = choices
        alive = [i for i in range(len(choices)) if i not in lost]
        several = [i for i in alive if len(choices[i]) > 1]
        width = 1 + sum(
            len(choices[i]) * (thrusters.thrusters[i].component_count + (i in several))
            for i in alive
        )
        rows = _ConeRows(width)
        self.sizes = [np.zeros(len(pieces), dtype=np.intp) for pieces in choices]
        entries: list[int] = []
        for i in alive:
            thruster, own = thrusters.thrusters[i], thrusters.slices_in_force_vector[i]
            is_round = thruster.kind == "azimuth" and sides is None
            for k, piece in enumerate(choices[i]):
                entries += range(own.start, own.stop)
                blocks, cones = _make_rows_and_cones(thruster, piece, sides)
                self.sizes[i][k] = rows.add_rows_of_piece(
                    blocks, cones, i in several, is_round=is_round
                )
            if i in several:
                rows.add_row_of_sum(self.sizes[i])
        self.entries = np.array(entries, dtype=np.intp)
        whole = rows.stack_rows_to_matrix()
        self.kinds, self.zeros = rows.kinds, np.zeros(len(whole))
        self.quadratic, self.cost = csc_matrix((width, width)), np.eye(width)[-1]
        self._circles = rows.circles
        self._flat = np.setdiff1d(np.arange(AXES, len(whole)), rows.round_rows)
        self._matrix = csc_matrix(whole)
        self._of_balance = self._matrix.indices < AXES

    def make_matrix_with_balance(self, balance: Matrix) -> csc_matrix:
        """Return the constraint matrix with the force-balance rows (3, entries) filled in."""
        self._matrix.data[self._of_balance] = balance.T.ravel()
        return self._matrix

    def solve_by_linear_programs(self, wanted: Vector) -> Vector | None:
        """Return the optimum for a force (3,) by linear programs; None where there is none."""
        A = self._matrix.toarray()
        posed: dict[str, Any] = {"A_eq": A[:AXES], "b_eq": wanted, "bounds": (None, None)}
        tangents = [
            self._make_tangent_row(*at, angle) for at in self._circles for angle in TANGENTS
        ]
        for _ in range(ROUNDS):
            rows = np.vstack([A[self._flat], *tangents])
            posed |= {"A_ub": rows, "b_ub": np.zeros(len(rows)), "options": _PRECISE}
            answer = linprog(self.cost, **posed)
            if answer.x is None:
                return None
            x: Vector = answer.x
            beyond = [
                (at, own)
                for at, own in self._circles
                if np.hypot(*x[at : at + 2]) > x[own] + OUTSIDE * x[-1]
            ]
            if not beyond:
                break
            tangents += [
                self._make_tangent_row(at, own, np.arctan2(x[at + 1], x[at])) for at, own in beyond
            ]
        return x

    def _make_tangent_row(self, at: int, own: int, angle_rad: float) -> Matrix:
        """Return the row (1, width) of a circle's tangent: (cos, sin)·f/T − u_k ≤ 0."""
        row = np.zeros((1, len(self.cost)))
        row[0, at], row[0, at + 1], row[0, own] = np.cos(angle_rad), np.sin(angle_rad), -1.0
        return row


class _ConeRows:
    """Rows of a cone program as they are collected, of x with `width` entries.

    circles : places of f and of its u_k; round_rows : rows of circles; kinds : the cones.
    """

    def __init__(self, width: int) -> None:
        self._blocks: list[Matrix] = []
        self._width, self._first, self._height = width, 0, AXES
        self._forces = np.zeros(width)
        self.kinds: list[Any] = [_import_clarabel().ZeroConeT(AXES)]
        self.circles: list[tuple[int, int]] = []
        self.round_rows: list[int] = []

    def add_rows_of_piece(
        self, rows: Matrix, cones: list[Any], has_size: bool, *, is_round: bool
    ) -> int:
        """Add constraint rows of a convex thrust area; return the index of its u_k, else of u."""
        at, count = self._first, rows.shape[1] - 1
        own = at + count if has_size else self._width - 1
        if is_round:
            self.circles.append((at, own))
            self.round_rows += range(self._height, self._height + 3)
        wide = np.zeros((len(rows), self._width))
        wide[:, at : at + count], wide[:, own] = rows[:, :-1], rows[:, -1]
        self._forces[at : at + count] = 1.0
        self._append_rows(wide, cones)
        self._first = at + count + has_size
        return own

    def add_row_of_sum(self, sizes: Indices) -> None:
        """Add the constraint row Σ u_k ≤ u of a thruster with several convex thrust areas."""
        row = np.zeros((1, self._width))
        row[0, sizes], row[0, -1] = -1.0, 1.0
        self._append_rows(row, [_import_clarabel().NonnegativeConeT(1)])

    def _append_rows(self, rows: Matrix, cones: list[Any]) -> None:
        """Append constraint rows and the cones that they belong to."""
        self._blocks.append(rows)
        self.kinds += cones
        self._height += len(rows)

    def stack_rows_to_matrix(self) -> Matrix:
        """Return the matrix A: rows that mark the forces in the balance, then the cones' rows."""
        return np.vstack([np.tile(self._forces, (AXES, 1)), *(-block for block in self._blocks)])


def _make_rows_and_cones(
    thruster: Thruster, piece: Piece, sides: int | None
) -> tuple[Matrix, list[Any]]:
    """Return the cone constraints of one thruster's force by its thrust share: rows and cones."""
    if thruster.kind != "azimuth":
        return np.array([[-1.0, 1.0], [1.0, thruster.astern]]), [
            _import_clarabel().NonnegativeConeT(2)
        ]
    if sides is None:
        circle = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        cones = [_import_clarabel().SecondOrderConeT(3)]
    else:
        angle = (2.0 * np.arange(sides) + 1.0) * np.pi / sides
        most = np.full(sides, np.cos(np.pi / sides))
        circle = np.column_stack((-np.cos(angle), -np.sin(angle), most))
        cones = [_import_clarabel().NonnegativeConeT(sides)]
    cuts = np.column_stack((-piece.chords[:, :2], piece.chords[:, 2:]))
    if piece.sector is not None:
        cuts = np.vstack(
            [np.column_stack((compute_sector_normals(*piece.sector), np.zeros(2))), cuts]
        )
    if len(cuts):
        cones.append(_import_clarabel().NonnegativeConeT(len(cuts)))
    return np.vstack([circle, cuts]), cones


def find_least_use_and_pieces(relax: Relax, choices: Choices) -> tuple[float, Combination]:
    """Return the least use of thrust over all choices of a piece each, and the choice.

    Parameters
    ----------
    relax : bounds the use of all choices between some pieces; exact where each thruster has one.
    choices : (p,) pieces of each thruster, at least one.
    """
    best, chosen = np.inf, tuple(pieces[0] for pieces in choices)
    order = count()
    bound, uses = relax(choices)
    queue = [(bound, next(order), choices, uses)]
    while queue:
        bound, _, some, uses = heapq.heappop(queue)
        if _is_no_better(bound, best):
            break
        rounded = tuple(pieces[int(np.argmax(use))] for pieces, use in zip(some, uses, strict=True))
        use = (
            bound
            if all(len(pieces) == 1 for pieces in some)
            else relax(tuple((piece,) for piece in rounded))[0]
        )
        if use < best:
            best, chosen = use, rounded
        if _is_no_better(bound, best):
            break
        for part in _branch_on_thruster(some, uses):
            bound, uses = relax(part)
            if not _is_no_better(bound, best):
                heapq.heappush(queue, (bound, next(order), part, uses))
    return best, chosen


def _is_no_better(bound: float, best: float) -> bool:
    """Return whether a lower bound on the use of thrust rules out a better one than `best`."""
    return bound * (1.0 + GAP) + GAP >= best


def _branch_on_thruster(choices: Choices, uses: Sequence[Vector]) -> list[Choices]:
    """Return choices of convex areas, split by those of the thruster most between two of them."""
    between = [float(np.sort(use)[-2]) if len(use) > 1 else -1.0 for use in uses]
    at = int(np.argmax(between))
    return [(*choices[:at], (piece,), *choices[at + 1 :]) for piece in choices[at]]


class ThrusterReach:
    """Solver of the share of full thrust that a force on the ship takes of all thrusters together.

    A limit of one axis by itself may need a force in another: a ship with tunnels in the bow alone
    makes no force sideways without turning.
    """

    def __init__(self, thrusters: ThrusterSet) -> None:
        self._utilisation = Utilisation(thrusters)
        self._shares = np.ones(len(thrusters.thrusters))
        self._list_piece_choices = tuple(
            tuple(split_force_set_into_convex_pieces(thruster.sector_rad, [], [], [], _CHORD_RAD))
            if thruster.kind == "azimuth"
            else (Piece(),)
            for thruster in thrusters.thrusters
        )

    def find_least_thrust_share(self, force: Vector, lost: Collection[int] = ()) -> float:
        """Return the least share of full thrust that makes a force (3,) [N, N, N·m]; inf if none.

        The thrusters that are not `lost` make it where the share is at most 1.
        """
        relax = partial(
            self._utilisation.relax_to_convex_hulls, -force, self._shares, lost=frozenset(lost)
        )
        return find_least_use_and_pieces(relax, self._list_piece_choices)[0]

    def find_least_and_largest_pure_forces(self) -> tuple[Vector, Vector]:
        """Return the least and largest force (3,) of each axis with none in the other two."""
        axes = np.eye(AXES)
        low, high = (
            [1.0 / self.find_least_thrust_share(s * axis) for axis in axes] for s in (-1.0, 1.0)
        )
        return -np.array(low), np.array(high)
