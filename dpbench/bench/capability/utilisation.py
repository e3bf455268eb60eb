"""The least share of their thrust with which thrusters balance a load: a cone program.

    min u   subject to   T_e f = −load,   |f_i| ≤ u T_i,   f_i within u times its piece

The load is balanced where u ≤ 1. Circles are second-order cones; with a number of sides they are
the polygons of the QPs.

Few thrusters, or ones in line, leave a set without interior, on which an interior-point method may
stop. A load outside its span is seen at once; what else is left open is solved by linear programs
that add the tangent of a circle wherever the force is outside it (Kelley 1960).
"""

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from dpbench.arrays import Matrix, Vector
from dpbench.mpc.thrusters.static_allocation import (
    build_balance_matrix,
    compute_balance_units,
    compute_sector_normals,
)
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import Thruster, ThrusterSet

SPAN = 1e-9
"""Share of a load that may lie outside the span of the thrusters' forces: rounding."""
TANGENTS = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
"""Directions of the first tangents of a circle [rad]."""
OUTSIDE = 1e-10
"""Relative distance outside a circle at which a tangent is added."""
ROUNDS = 100
"""Most linear programs; each adds a tangent, and some ten are enough."""
_PRECISE = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


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
        self, load: Vector, shares: Vector, chosen: tuple[Piece, ...], lost: frozenset[int]
    ) -> float:
        """Return the least share of full thrust that balances a load (3,) [N, N, N·m]; inf if none.

        `shares` (p,) is effective over nominal thrust; `chosen` (p,) pieces are kept by this
        object.
        """
        key = lost, tuple(map(id, chosen))
        if key not in self._cones:
            self._cones[key] = _Cones(self._thrusters, self._sides, chosen, lost)
        cones = self._cones[key]
        if not cones.entries.size:
            return np.inf if load.any() else 0.0
        balance = (self._thrusters.per_entry(shares) * self._balance)[:, cones.entries]
        wanted = -load / self._units
        if not _is_in_span(balance, wanted):
            return np.inf
        A, b = cones.insert_balance(balance), cones.zeros.copy()
        b[:AXES] = wanted
        problem = cones.quadratic, cones.cost, A, b, cones.kinds
        solution = _import_clarabel().DefaultSolver(*problem, self._settings).solve()
        status = str(solution.status)
        if status == "Solved":
            return float(solution.x[-1])
        return np.inf if status == "PrimalInfeasible" else cones.least_use_by_tangents(wanted)


def _is_in_span(balance: Matrix, wanted: Vector) -> bool:
    """Return whether a force (3,) lies in the span of the thrusters' forces, balance (3, e)."""
    U, size, _ = np.linalg.svd(balance, full_matrices=False)
    basis = U[:, size > SPAN * size[0]]
    outside = wanted - basis @ (basis.T @ wanted)
    return bool(np.linalg.norm(outside) <= SPAN * np.linalg.norm(wanted))


class _Cones:
    """Cone program for the least thrust share in one choice of convex thrust areas, but the load.

    x = (f_i/T_i of the thrusters that are not lost, u). A begins with the balance, the only part of
    it that changes.
    """

    def __init__(
        self,
        thrusters: ThrusterSet,
        sides: int | None,
        chosen: tuple[Piece, ...],
        lost: frozenset[int],
    ) -> None:
        self.chosen = chosen
        alive = [i for i in range(len(chosen)) if i not in lost]
        places = [np.arange(thrusters.n_f)[thrusters.slices[i]] for i in alive]
        self.entries = np.concatenate([*places, np.zeros(0, dtype=np.intp)]).astype(np.intp)
        width = len(self.entries) + 1
        kinds, first, height = [_import_clarabel().ZeroConeT(AXES)], 0, AXES
        blocks: list[Matrix] = []
        self._circles: list[int] = []
        round_rows: list[int] = []
        for i, place in zip(alive, places, strict=True):
            rows, cones = _cone_rows(thrusters.thrusters[i], chosen[i], sides)
            if thrusters.thrusters[i].kind == "azimuth" and sides is None:
                self._circles.append(first)
                round_rows += range(height, height + 3)
            wide = np.zeros((len(rows), width))
            wide[:, first : first + len(place)], wide[:, -1] = rows[:, :-1], rows[:, -1]
            blocks.append(wide)
            kinds += cones
            first, height = first + len(place), height + len(rows)
        balance = np.hstack([np.ones((AXES, width - 1)), np.zeros((AXES, 1))])
        whole = np.vstack([balance, *(-block for block in blocks)])
        self.kinds, self.zeros = kinds, np.zeros(len(whole))
        self.quadratic, self.cost = csc_matrix((width, width)), np.eye(width)[-1]
        self._flat = np.setdiff1d(np.arange(AXES, len(whole)), round_rows)
        self._matrix = csc_matrix(whole)
        self._of_balance = self._matrix.indices < AXES

    def insert_balance(self, balance: Matrix) -> csc_matrix:
        """Return the constraint matrix with the force-balance rows (3, entries) filled in."""
        self._matrix.data[self._of_balance] = balance.T.ravel()
        return self._matrix

    def least_use_by_tangents(self, wanted: Vector) -> float:
        """Return the least share of thrust for a force (3,) by linear programs; inf if none."""
        size = float(np.abs(wanted).max())
        if size == 0.0:
            return 0.0
        A = self._matrix.toarray()
        posed: dict[str, Any] = {"A_eq": A[:AXES], "b_eq": wanted / size, "bounds": (None, None)}
        tangents = [self._tangent(at, angle) for at in self._circles for angle in TANGENTS]
        for _ in range(ROUNDS):
            rows = np.vstack([A[self._flat], *tangents])
            posed |= {"A_ub": rows, "b_ub": np.zeros(len(rows)), "options": _PRECISE}
            answer = linprog(self.cost, **posed)
            if answer.x is None:
                return np.inf
            x, use = answer.x, float(answer.x[-1])
            beyond = [at for at in self._circles if np.hypot(*x[at : at + 2]) > use * (1 + OUTSIDE)]
            if not beyond:
                break
            tangents += [self._tangent(at, np.arctan2(x[at + 1], x[at])) for at in beyond]
        return size * use

    def _tangent(self, at: int, angle_rad: float) -> Matrix:
        """Return the row (1, width) of a circle's tangent: (cos, sin)·f/T − u ≤ 0."""
        row = np.zeros((1, len(self.cost)))
        row[0, at], row[0, at + 1], row[0, -1] = np.cos(angle_rad), np.sin(angle_rad), -1.0
        return row


def _cone_rows(thruster: Thruster, piece: Piece, sides: int | None) -> tuple[Matrix, list[Any]]:
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
