"""Exact arithmetic on float64 data: every double is an integer times a power of two.

    array = whole · 2^exponent,  whole an array of Python integers

Sums and products of such arrays are exact, at some 50 ns a term. Fraction-free elimination
(Bareiss, Math. Comp. 22, 1968) solves linear systems over the integers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Indices, Vector

Whole = NDArray[np.object_]
_SHIFT = 53


@dataclass(frozen=True, slots=True, eq=False)
class Dyadic:
    """Array of exact dyadic numbers: Python integers times one power of two."""

    whole: Whole
    exponent: int

    @classmethod
    def from_floats(cls, array: Floats) -> "Dyadic":
        """Convert a finite float64 array to exact dyadic numbers."""
        mantissa, power = np.frexp(array)
        digits = np.ldexp(mantissa, _SHIFT).astype(np.int64)
        used = digits != 0
        lowest = int(power[used].min()) - _SHIFT if used.any() else 0
        shift = np.where(used, power - _SHIFT - lowest, 0)
        # Python integers on both sides: an int64 shift would overflow silently.
        whole = np.left_shift(digits.astype(object), shift.astype(object))
        return cls(np.asarray(whole, dtype=object), lowest)

    @property
    def T(self) -> "Dyadic":
        """Transpose of the array of exact numbers."""
        return Dyadic(self.whole.T, self.exponent)

    def __getitem__(self, index: slice | Indices | Flags) -> "Dyadic":
        return Dyadic(self.whole[index], self.exponent)

    def integers_at_exponent(self, exponent: int) -> Whole:
        """Return the integers that times a smaller power of two give the same numbers."""
        return np.asarray(self.whole * (1 << (self.exponent - exponent)), dtype=object)

    def __add__(self, other: "Dyadic") -> "Dyadic":
        low = min(self.exponent, other.exponent)
        return Dyadic(
            np.asarray(
                self.integers_at_exponent(low) + other.integers_at_exponent(low), dtype=object
            ),
            low,
        )

    def __sub__(self, other: "Dyadic") -> "Dyadic":
        return self + -other

    def __neg__(self) -> "Dyadic":
        return Dyadic(np.asarray(-self.whole, dtype=object), self.exponent)

    def __mul__(self, other: "Dyadic") -> "Dyadic":
        product = np.asarray(self.whole * other.whole, dtype=object)
        return Dyadic(product, self.exponent + other.exponent)

    def __matmul__(self, other: "Dyadic") -> "Dyadic":
        exponent = self.exponent + other.exponent
        if 0 in self.whole.shape or 0 in other.whole.shape:
            shape = np.zeros(self.whole.shape) @ np.zeros(other.whole.shape)
            return Dyadic(np.asarray(shape.astype(np.int64), dtype=object), exponent)
        return Dyadic(np.asarray(self.whole @ other.whole, dtype=object), exponent)

    def exact_sum(self) -> "Dyadic":
        """Return the exact sum of all entries."""
        return Dyadic(np.asarray(sum(self.whole.ravel().tolist()), dtype=object), self.exponent)

    def entry_signs(self) -> NDArray[np.int8]:
        """Return the sign of each entry: −1, 0 or 1."""
        return np.asarray(np.sign(self.whole), dtype=np.int8)

    def round_to_floats(self) -> Vector:
        """Return each entry rounded to the nearest float64."""
        up, down = 1 << max(self.exponent, 0), 1 << max(-self.exponent, 0)
        values = [(number * up) / down for number in self.whole.ravel().tolist()]
        return np.array(values, dtype=np.float64).reshape(self.whole.shape)


def solve_integer_system_exactly(M: Whole, rhs: Whole) -> tuple[Whole, int] | None:
    """Solve M x = rhs exactly, as integer numerators and one denominator; None if singular.

    M (N, N) must have non-zero leading minors unless it is singular, as a KKT matrix with positive
    definite cost has, so that no pivoting is needed; rhs (N, k).
    """
    N = M.shape[0]
    work = np.concatenate((M, rhs), axis=1)
    previous = 1
    for k in range(N):
        pivot = work[k, k]
        if pivot == 0:
            return None
        if k + 1 < N:
            rest = work[k + 1 :, k + 1 :] * pivot - np.outer(work[k + 1 :, k], work[k, k + 1 :])
            work[k + 1 :, k + 1 :] = rest // previous
        previous = pivot
    det = previous
    x = np.empty((N, rhs.shape[1]), dtype=object)
    for i in range(N - 1, -1, -1):
        known = work[i, i + 1 : N] @ x[i + 1 :] if i + 1 < N else 0
        x[i] = (work[i, N:] * det - known) // work[i, i]
    return (x, det) if det > 0 else (np.asarray(-x, dtype=object), -det)


def is_integer_matrix_semidefinite(S: Whole) -> bool:
    """Return whether a symmetric integer matrix is semidefinite (Golub and Van Loan, 4.2.8)."""
    work = S.copy()
    previous = 1
    while work.shape[0]:
        diagonal = np.diagonal(work)
        if (diagonal < 0).any():
            return False
        live = np.flatnonzero(diagonal > 0)
        if not len(live):
            return not (work != 0).any()
        k = int(live[0])
        rest = np.delete(np.arange(work.shape[0]), k)
        pivot = work[k, k]
        inner = work[np.ix_(rest, rest)] * pivot - np.outer(work[rest, k], work[k, rest])
        work = inner // previous
        previous = pivot
    return True
