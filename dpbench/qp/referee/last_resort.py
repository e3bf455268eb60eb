"""Where every certificate in the units of the problem as posed has failed.

The problem is equilibrated by powers of two, the active set guessed anew in those units (with a
proximal term where P is singular), completed by the rows that are weakly active, and certified by
the linear certificate or by the enclosure of a feasible point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog, nnls

from dpbench.arrays import Matrix, Vector
from dpbench.qp.referee.enclosure import WEIGHT, enclosure_certificate
from dpbench.qp.referee.equilibrated import Scales, safe
from dpbench.qp.referee.feasibility.implied import with_implied, without_empty
from dpbench.qp.referee.gap import independent, met
from dpbench.qp.referee.joint import ExactMatrices, JointQP, Kind, Proof, Signs
from dpbench.qp.referee.kkt import OUTWARD, KKTSystem, positive_definite
from dpbench.qp.referee.linear import Geometry, linear_certificate
from dpbench.qp.referee.oracle import guesses

PROXIMAL = 10.0 ** -np.arange(4.0, 9.0)
"""Weights of the proximal term where P is singular, of its largest entry, one after another."""
PROXIMAL_STEPS = 6
"""With each of them."""
SETTLED = 1e-9
"""Relative change of the proximal point at which its active set is taken."""
ENOUGH = 1e-10
"""A bound no better than it asks for another guess."""
USEFUL = 1e-6
"""A bound above it, of the size of the optimum, is no optimum to judge anybody by."""
LARGEST = 1e6
"""Inward amounts beyond it would need more room than the limits moved by τ leave."""


@dataclass(frozen=True, slots=True, eq=False)
class _Guess:
    """An active set, and the point it is from where that is not the one of its KKT system."""

    signs: Signs
    z: Vector | None


class LastResort:
    """For the QPs of one P and C = [A; I]; not to be shared between threads."""

    def __init__(self, P: Matrix, C: Matrix, *, convex: bool) -> None:
        self._scales = Scales.of(P, C)
        self._safe = safe(P, C)
        self._P, self._C = self._scales.cost_matrix(P), self._scales.rows(C)
        # In these units it may be seen to be definite where in those it was not.
        self._definite = positive_definite(self._P)
        self._convex = convex or self._definite
        self._geometry = Geometry(self._C)
        self._exact: ExactMatrices | None = None

    def certify(self, problem: JointQP) -> Proof | None:
        """The optimum of `problem`, in its own units, or None.

        Its multipliers are NaN where implied limits took part: those of the equality rows that
        stand for them say nothing of the problem as posed.
        """
        if not (self._safe and safe(problem.q, problem.L, problem.U)):
            return None
        if self._exact is None:
            self._exact = ExactMatrices.of(self._P, self._C)
        best: Proof | None = None
        posed = [without_empty(problem)]
        for at in posed:
            scaled = self._scales.problem(at, self._P, self._C)
            for guess in self._guesses(scaled):
                proof, touched = self._proof(scaled, guess)
                if proof is not None and (best is None or proof.bound < best.bound):
                    implied = at is not posed[0]
                    best = replace(proof, y=np.full_like(proof.y, np.nan)) if implied else proof
                if best is not None and best.bound <= ENOUGH:
                    return best
                tighter = None if touched is None or len(posed) > 1 else with_implied(at, touched)
                if tighter is not None:
                    posed.append(tighter)
                    break
        if best is None or best.bound > USEFUL * max(1.0, float(np.abs(best.z).max())):
            return None
        return best

    def _guesses(self, problem: JointQP) -> Iterator[_Guess]:
        """Active sets in the new units, best first."""
        if self._definite:
            for signs in guesses(problem):
                if signs is not None:
                    yield _Guess(signs, None)
        else:
            yield from self._proximal(problem)

    def _proximal(self, problem: JointQP) -> Iterator[_Guess]:
        """Where the proximal point method ends (Rockafellar, SIAM J. Control 14, 1976)."""
        n = len(problem.q)
        # On the feasible set the squares of equality rows are constant, whatever P is across it.
        E = problem.C[problem.L == problem.U]
        b = problem.U[problem.L == problem.U]
        P_E, q_E = problem.P + WEIGHT * E.T @ E, problem.q - WEIGHT * E.T @ b
        z, signs = np.zeros(n), None
        for weight in np.repeat(PROXIMAL, PROXIMAL_STEPS):
            at = replace(problem, P=P_E + weight * np.eye(n), q=q_E - weight * z)
            answer = next(guesses(at), None)
            moved = None if answer is None else _point(at, answer)
            if moved is None:
                break
            before, z, signs = z, moved, answer
            if np.abs(z - before).max() <= SETTLED * (1.0 + np.abs(z).max()):
                break
        if signs is not None:
            yield _Guess(signs, z)
            explaining = _explaining(problem, z)
            if explaining is not None:
                yield _Guess(explaining, z)

    def _proof(self, problem: JointQP, guess: _Guess) -> tuple[Proof | None, Signs | None]:
        """The proof from one guess; without one, the touched limits if they leave no interior."""
        assert self._exact is not None, "made before any guess is asked for"
        equal = np.where(problem.L == problem.U, 1, 0).astype(np.int8)
        held = independent(problem.C, np.where(equal, equal, guess.signs), equal)
        system = KKTSystem(problem.P, problem.C, held)
        z = guess.z
        if system.proven:
            proof = linear_certificate(problem, self._geometry, system, guess=False)
            if proof is not None and self._convex:
                bound = np.full(len(proof.z), proof.bound)
                return self._back(proof.z, proof.y, bound, "linear"), None
            z = system.X @ system.rhs(problem.q, problem.L, problem.U)
        if z is None:
            return None, None
        touched = np.where(equal, equal, met(problem, z))
        all_held = independent(problem.C, np.where(held, held, touched), held)
        system = KKTSystem(problem.P, problem.C, all_held)
        inward = _inward(problem, system, touched)
        if inward is None:
            return None, touched
        if not system.proven:
            return None, None
        enclosed = enclosure_certificate(problem, self._exact, system, inward, convex=self._convex)
        if enclosed is None:
            return None, None
        return self._back(enclosed.z, enclosed.y, enclosed.bound, "gap"), None

    def _back(self, z: Vector, y: Vector, bound: Vector, kind: Kind) -> Proof:
        """The proof in the units of the problem as posed."""
        D = self._scales.D
        worst = float((D * bound).max()) * OUTWARD
        return Proof(D * z, self._scales.multipliers(y), worst, kind)


def _explaining(problem: JointQP, z: Vector) -> Signs | None:
    """The touched limits whose multipliers explain z: independent ones, of the right sign."""
    touched = met(problem, z)
    equal = problem.L == problem.U
    rows = np.flatnonzero(np.where(equal, 0, touched))
    free = problem.C[equal].T
    columns = np.hstack(((touched[rows, np.newaxis] * problem.C[rows]).T, free, -free))
    # Without a column the library reads what is not there.
    if not columns.shape[1]:
        return None
    try:
        weights, _ = nnls(columns, -(problem.P @ z + problem.q), maxiter=30 * len(touched))
    except RuntimeError:
        return None
    signs: Signs = equal.astype(np.int8)
    used = rows[weights[: len(rows)] > 0.0]
    signs[used] = touched[used]
    return signs


def _point(problem: JointQP, signs: Signs) -> Vector | None:
    """The point of an active set, unproven."""
    held = independent(problem.C, signs, signs)
    rows, n = np.flatnonzero(held), len(problem.q)
    G = problem.C[rows]
    K = np.block([[problem.P, G.T], [G, np.zeros((len(rows), len(rows)))]])
    limits = np.where(held > 0, problem.U, problem.L)[rows]
    try:
        z = np.linalg.solve(K, np.concatenate((-problem.q, limits)))[:n]
    except np.linalg.LinAlgError:
        return None
    return np.asarray(z) if np.isfinite(z).all() else None


def _inward(problem: JointQP, system: KKTSystem, touched: Signs) -> Vector | None:
    """How far to hold the rows of `system` inside their limits, so that all touched limits are met.

    1 for inequality rows where no other row is touched; else by a direction that leads inside all
    of them; None where there is no such direction.
    """
    equal = problem.L == problem.U
    amounts = np.where(equal[system.rows], 0.0, 1.0)
    others = np.zeros(len(equal), dtype=bool)
    others[touched != 0] = True
    others[system.rows] = False
    if (others & equal).any():
        return None
    if not others.any():
        return amounts
    own = ~equal[system.rows]
    G = system.signs[own, np.newaxis] * problem.C[system.rows[own]]
    inside = np.vstack((G, touched[others, np.newaxis] * problem.C[others]))
    n, k = inside.shape[1], len(inside)
    E = problem.C[system.rows[~own]]
    answer = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=np.block([[inside, np.zeros((k, 1))], [-inside, -np.ones((k, 1))]]),
        b_ub=np.concatenate((-np.ones(k), np.zeros(k))),
        A_eq=np.column_stack((E, np.zeros(len(E)))) if len(E) else None,
        b_eq=np.zeros(len(E)) if len(E) else None,
        bounds=[(None, None)] * n + [(0.0, LARGEST)],
    )
    if answer.x is None:
        return None
    amounts[own] = -(G @ answer.x[:n])
    return amounts
