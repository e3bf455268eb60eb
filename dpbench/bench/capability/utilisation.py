"""The least share of their thrust with which thrusters balance a load: a cone program.

    min u   subject to   T_e f = −load,   |f_i| ≤ u T_i,   f_i within u times its piece

The load is balanced where u ≤ 1. Circles are second-order cones; with a number of sides they are
the polygons of the QPs.
"""

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
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

_SOLVED = ("Solved", "AlmostSolved")
_EMPTY = ("PrimalInfeasible", "AlmostPrimalInfeasible")


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

        Parameters
        ----------
        shares : (p,) effective over nominal thrust; chosen : (p,) pieces, kept by this object.
        """
        key = lost, tuple(map(id, chosen))
        if key not in self._cones:
            self._cones[key] = _Cones(self._thrusters, self._sides, chosen, lost)
        cones = self._cones[key]
        if not cones.entries.size:
            return np.inf if load.any() else 0.0
        balance = (self._thrusters.per_entry(shares) * self._balance)[:, cones.entries]
        A, b = cones.insert_balance(balance), cones.zeros.copy()
        b[:AXES] = -load / self._units
        problem = cones.quadratic, cones.cost, A, b, cones.kinds
        solution = _import_clarabel().DefaultSolver(*problem, self._settings).solve()
        status = str(solution.status)
        if status in _SOLVED:
            return float(solution.x[-1])
        if status in _EMPTY:
            return np.inf
        raise ArithmeticError(f"utilisation of thrusters: Clarabel ends with {status}")


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
        blocks, kinds, first = [], [_import_clarabel().ZeroConeT(AXES)], 0
        for i, place in zip(alive, places, strict=True):
            rows, cones = _cone_rows(thrusters.thrusters[i], chosen[i], sides)
            wide = np.zeros((len(rows), width))
            wide[:, first : first + len(place)], wide[:, -1] = rows[:, :-1], rows[:, -1]
            blocks.append(wide)
            kinds += cones
            first += len(place)
        balance = np.hstack([np.ones((AXES, width - 1)), np.zeros((AXES, 1))])
        whole = np.vstack([balance, *(-block for block in blocks)])
        self.kinds, self.zeros = kinds, np.zeros(len(whole))
        self.quadratic, self.cost = csc_matrix((width, width)), np.eye(width)[-1]
        self._matrix = csc_matrix(whole)
        self._of_balance = self._matrix.indices < AXES

    def insert_balance(self, balance: Matrix) -> csc_matrix:
        """Return the constraint matrix with the force-balance rows (3, entries) filled in."""
        self._matrix.data[self._of_balance] = balance.T.ravel()
        return self._matrix


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
