"""Guesses of the active set from whatever QP library is at hand; a certificate judges them.

A library that is missing, refuses the problem or answers nonsense only costs time: the exact
active-set method needs no guess.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from types import ModuleType

import numpy as np

from dpbench.qp.joint import JointQP, Signs
from dpbench.qp.program import Vector

FREE = 1e30
"""Stands for an infinite limit in DAQP, which documents this value."""
_EQUALITY = 5
"""DAQP's mark of a row that is always active."""
_INFEASIBLE = -1
"""DAQP's exit flag for an empty feasible set."""


def guesses(problem: JointQP) -> Iterator[Signs | None]:
    """Active sets worth trying, best first; None where a library says there is no feasible point.

    Lazy: the next library is asked only when the guess before failed.
    """
    asked: tuple[tuple[str, Callable[[ModuleType, JointQP], Signs | None]], ...] = (
        ("daqp", _ask_daqp),
        ("quadprog", _ask_quadprog),
    )
    for name, ask in asked:
        library = _library(name)
        if library is not None:
            try:
                yield ask(library, problem)
            except (ArithmeticError, ValueError, TypeError, RuntimeError):
                continue


def _library(name: str) -> ModuleType | None:
    try:
        return import_module(name)
    except ImportError:
        return None


def _ask_daqp(daqp: ModuleType, problem: JointQP) -> Signs | None:
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
    return _signs(problem, np.roll(np.asarray(info["lam"], dtype=np.float64), -n))


def _ask_quadprog(quadprog: ModuleType, problem: JointQP) -> Signs | None:
    N = len(problem.L)
    equal = problem.L == problem.U
    upper, lower = np.isfinite(problem.U) & ~equal, np.isfinite(problem.L) & ~equal
    C = np.vstack((problem.C[equal], -problem.C[upper], problem.C[lower]))
    b = np.concatenate((problem.L[equal], -problem.U[upper], problem.L[lower]))
    if not len(b):
        return np.zeros(N, dtype=np.int8)
    answer = quadprog.solve_qp(
        problem.P.copy(), -problem.q, np.asfortranarray(C.T), b, int(equal.sum())
    )
    lam = answer[4]
    k, kk = int(equal.sum()), int(equal.sum() + upper.sum())
    y = np.zeros(N)
    y[equal] = -lam[:k]
    y[upper] = lam[k:kk]
    y[lower] -= lam[kk:]
    return _signs(problem, y)


def _signs(problem: JointQP, y: Vector) -> Signs:
    """The sides that the multipliers name, where there is a limit; equalities are always active."""
    signs = np.sign(np.nan_to_num(y))
    signs[(signs == 0.0) & (problem.L == problem.U)] = 1.0
    limit = np.where(signs > 0, problem.U, problem.L)
    return np.where(np.isfinite(limit), signs, 0).astype(np.int8)
