"""Constant matrices of random QPs, on binary grids on which no later sum is rounded.

P = Q Λ Qᵀ with λ = c^−½ … c^½ for a condition c, or P = B Bᵀ of less than full rank, which is
semidefinite to the last bit; A has rows of unit norm to within 1e-4, the spacing of its grid.
"""

from __future__ import annotations

import math

import numpy as np

from dpbench.arrays import Matrix, Vector

POINT = 2.0**-10
"""Grid of z, of multipliers and of slacks."""
ROW = 2.0**-16
"""Grid of the entries of A."""
COST_BITS = 36
"""Bits of an entry of P below the largest eigenvalue: with |z| ≤ 2 on its grid and n ≤ 120 every
partial sum of Pz stays below 2^53 units, and the smallest of 1e8 eigenvalues is kept to 1 %."""
FACTOR = 2.0**-7
"""Grid of the factor of a semidefinite P."""


def on_grid(x: Vector, unit: float) -> Vector:
    """The nearest multiples of a power of two."""
    return np.rint(x / unit) * unit


def definite_cost(rng: np.random.Generator, n: int, cond: float) -> Matrix:
    """A positive definite P (n, n) with eigenvalues from cond^−½ to cond^½."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.geomspace(cond**-0.5, cond**0.5, n)) @ Q.T
    unit = 2.0 ** (math.ceil(0.5 * math.log2(cond)) - COST_BITS)
    return on_grid(0.5 * (P + P.T), unit)


def semidefinite_cost(rng: np.random.Generator, n: int, rank: int) -> Matrix:
    """A positive semidefinite P (n, n) of that rank, exactly."""
    B = on_grid(rng.normal(size=(n, rank)) / math.sqrt(rank), FACTOR)
    return B @ B.T


def unit_rows(rng: np.random.Generator, m: int, n: int) -> Matrix:
    """Rows (m, n) of unit norm; every second one with three entries in four left out."""
    A = rng.normal(size=(m, n))
    sparse = rng.random((m, n)) < 0.75
    sparse[::2] = False
    # One entry stays, so that there is a direction left.
    sparse[np.arange(m), rng.integers(0, n, m)] = False
    A[sparse] = 0.0
    return on_grid(A / np.linalg.norm(A, axis=1, keepdims=True), ROW)
