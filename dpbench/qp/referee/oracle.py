"""Guesses of the active set by a library or a method of our own; a certificate judges them.

A failing guesser only costs time: the exact active-set method needs no guess.
"""

from collections.abc import Iterator
from importlib import import_module

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.dual_active_set import Ending, Projection
from dpbench.qp.referee.optimum import JointQP, Signs

FREE = 1e30  # Stands for an infinite limit in DAQP, which documents this value
_EQUALITY = 5  # DAQP's mark of a row that is always active
_INFEASIBLE = -1  # DAQP's exit flag for an empty feasible set


def yield_active_set_guesses(problem: JointQP) -> Iterator[Signs | None]:
    """Yield guesses of a QP's active set, best first; None where a solver finds it infeasible."""
    for guess in GUESSERS:
        try:
            yield guess(problem)
        except (ArithmeticError, ImportError, ValueError, TypeError, RuntimeError):
            continue


def _guess_active_set_by_daqp(problem: JointQP) -> Signs | None:
    """Return the active set that the solver DAQP finds; None where it claims infeasibility."""
    daqp = import_module("daqp")
    n = len(problem.q)
    m = len(problem.L) - n
    # Bounds come first in DAQP, and it may write to what it is given: own copies of all.
    upper = np.clip(np.roll(problem.U, n), -FREE, FREE)
    lower = np.clip(np.roll(problem.L, n), -FREE, FREE)
    sense = np.where(upper == lower, _EQUALITY, 0).astype(np.int32)
    A = problem.C[:m].copy()
    _, _, flag, info = daqp.solve(problem.P.copy(), problem.q.copy(), A, upper, lower, sense)
    if flag == _INFEASIBLE:
        return None
    if flag <= 0:
        raise RuntimeError("no answer")
    return _active_set_from_multiplier_signs(
        problem, np.roll(np.asarray(info["lam"], dtype=np.float64), -n)
    )


def _guess_active_set_by_dual_method(problem: JointQP) -> Signs | None:
    """Return the active set at which the dual method ends, its iterations limited."""
    outcome = Projection.factorise_hessian_and_rows(problem.P, problem.C).solve_for_vectors(
        problem.q, problem.L, problem.U
    )
    if outcome.ending is Ending.INFEASIBLE:
        return None
    signs = np.zeros(len(problem.L))
    signs[outcome.active] = outcome.side[outcome.active]
    return _active_set_from_multiplier_signs(problem, signs)


def _active_set_from_multiplier_signs(problem: JointQP, y: Vector) -> Signs:
    """Return the active set (N,) that the signs of multipliers y name; equalities are active."""
    signs = np.sign(np.nan_to_num(y))
    signs[(signs == 0.0) & (problem.L == problem.U)] = 1.0
    limit = np.where(signs > 0, problem.U, problem.L)
    return np.where(np.isfinite(limit), signs, 0).astype(np.int8)


GUESSERS = (_guess_active_set_by_daqp, _guess_active_set_by_dual_method)  # in this order
