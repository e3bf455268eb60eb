"""The two-sided problem in the form of qpsolvers, and its multipliers back.

    l ≤ A z ≤ u  becomes  G z ≤ h, A_eq z = b   with  G = [A_up; −A_lo],  h = [u_up; −l_lo]

Rows with l = u are equalities, infinite sides are left out. Multipliers come back as
y = y_up − y_lo on inequalities and as they are on equalities.
"""

from typing import Any, Literal

import numpy as np
import scipy

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.solvers.contract import Form

Box = Literal["native", "rows"]


class LimitSides:
    """Masks of the constraint rows that are equalities or have a finite upper or lower limit."""

    def __init__(self, low: Vector, high: Vector) -> None:
        equal = low == high
        self.size = low.shape[0]
        self.equal: Indices = np.flatnonzero(equal)
        self.upper: Indices = np.flatnonzero(~equal & (high != np.inf))
        self.lower: Indices = np.flatnonzero(~equal & (low != -np.inf))
        self.full = self.upper.size == self.lower.size == self.size
        self._pattern = self.encode_equal_and_infinite_limits(low, high)

    @staticmethod
    def encode_equal_and_infinite_limits(low: Vector, high: Vector) -> bytes:
        """Return bytes that tell which rows are equalities and which limits infinite."""
        parts: tuple[Flags, ...] = (low == high, high == np.inf, low == -np.inf)
        return b"".join(part.tobytes() for part in parts)

    def has_same_equal_and_infinite_limits(self, low: Vector, high: Vector) -> bool:
        """Return whether the same limits are equal or infinite as when the rows were sorted."""
        return self.encode_equal_and_infinite_limits(low, high) == self._pattern

    def write_limits_as_one_sided(self, low: Vector, high: Vector, h: Vector, b: Vector) -> None:
        """Write two-sided limits as one-sided: [upper; −lower] into `h`, equalities' into `b`."""
        if self.full:
            h[: self.size] = high
            np.negative(low, out=h[self.size :])
            return
        count = self.upper.size
        h[:count] = high[self.upper]
        np.negative(low[self.lower], out=h[count:])
        b[:] = high[self.equal]

    def split_into_one_sided_rows(self, M: Matrix) -> tuple[Matrix, Matrix]:
        """Return rows [M; −M] with a finite limit, as inequalities, and the equality rows of M."""
        return np.vstack([M[self.upper], -M[self.lower]]), M[self.equal]

    def write_multipliers_as_one_sided(self, y: Vector, z: Vector, y_equal: Vector) -> None:
        """Write multipliers of two-sided rows to `z` (inequalities, ≥ 0) and `y_equal`."""
        count = self.upper.size
        np.maximum(y[self.upper], 0.0, out=z[:count])
        np.maximum(-y[self.lower], 0.0, out=z[count:])
        y_equal[:] = y[self.equal]

    def merge_multipliers_to_two_sided(self, z: Vector, y: Vector) -> Vector:
        """Return two-sided rows' multipliers, merged from those of inequalities and equalities."""
        if self.full:
            return z[: self.size] - z[self.size :]
        count = self.upper.size
        out = np.zeros(self.size)
        out[self.upper] = z[:count]
        out[self.lower] -= z[count:]
        out[self.equal] = y
        return out


class OneSidedForm:
    """A QP with two-sided limits rewritten as G z ≤ h, A z = b, updated in place at each step.

    qp : the problem; its matrices are copied.
    form : "dense" (C-contiguous) or "csc" matrices.
    box : "native" for bounds as bounds, "rows" for rows behind those of A.
    """

    def __init__(self, qp: QuadraticProgram, form: Form, box: Box) -> None:
        self._m, self._n = qp.m, qp.n
        self._sides = LimitSides(qp.l, qp.u)
        G, A = self._sides.split_into_one_sided_rows(qp.A)
        self._rows, self._equalities = G.shape[0], A.shape[0]
        self._box: LimitSides | None = None
        bounded = bool(np.isfinite(qp.lb).any() or np.isfinite(qp.ub).any())
        self.lb = qp.lb.copy() if bounded and box == "native" else None
        self.ub = qp.ub.copy() if bounded and box == "native" else None
        if box == "rows":
            self._box = LimitSides(qp.lb, qp.ub)
            G_box, A_box = self._box.split_into_one_sided_rows(np.eye(qp.n))
            G, A = np.vstack([G, G_box]), np.vstack([A, A_box])
        # One array [b; h] for a library that stacks equalities on inequalities.
        self.bh = np.empty(A.shape[0] + G.shape[0])
        b, h = self.bh[: A.shape[0]], self.bh[A.shape[0] :]
        self._h, self._b = h[: self._rows], b[: self._equalities]
        if self._box is not None:
            self._box.write_limits_as_one_sided(
                qp.lb, qp.ub, h[self._rows :], b[self._equalities :]
            )
        self.q = np.empty(qp.n)
        convert: Any = scipy.sparse.csc_matrix if form == "csc" else np.array
        self.P = convert(qp.P)
        self.G: Any = convert(G) if h.size else None
        self.A: Any = convert(A) if b.size else None
        self.h, self.b = h if h.size else None, b if b.size else None

    def has_same_equal_and_infinite_limits(self, l: Vector, u: Vector) -> bool:  # noqa: E741 - l ≤ Az ≤ u, the name of the field
        """Return whether the same row limits are equal or infinite as in the QP first given."""
        return self._sides.has_same_equal_and_infinite_limits(l, u)

    def write_step_vectors_as_one_sided(self, q: Vector, l: Vector, u: Vector) -> None:  # noqa: E741 - l ≤ Az ≤ u
        """Write a step's q and two-sided row limits l, u into the one-sided QP's q, h and b."""
        self.q[:] = q
        self._sides.write_limits_as_one_sided(l, u, self._h, self._b)

    def convert_multipliers_to_two_sided(self, z: Vector, y: Vector) -> tuple[Vector, Vector]:
        """Return y and y_box of two-sided rows and bounds from multipliers of G z ≤ h, A z = b."""
        assert self._box is not None, "bounds have to be rows"
        rows = self._sides.merge_multipliers_to_two_sided(z[: self._rows], y[: self._equalities])
        return rows, self._box.merge_multipliers_to_two_sided(
            z[self._rows :], y[self._equalities :]
        )

    def write_multipliers_as_one_sided(self, y: Vector, y_box: Vector, dual: Vector) -> None:
        """Write multipliers of two-sided rows and bounds into `dual` as one-sided."""
        count = self.bh.size - (0 if self.h is None else self.h.size)
        equal, z = dual[:count], dual[count:]
        self._sides.write_multipliers_as_one_sided(y, z[: self._rows], equal[: self._equalities])
        if self._box is not None:
            self._box.write_multipliers_as_one_sided(
                y_box, z[self._rows :], equal[self._equalities :]
            )

    def convert_qpsolvers_multipliers(
        self, z: Any, y: Any, z_box: Any
    ) -> tuple[Vector, Vector] | None:
        """Return two-sided y and y_box from qpsolvers' multipliers; None if sizes do not fit."""
        z = _convert_to_vector_of_size_or_none(z, 0 if self.h is None else self.h.size)
        y = _convert_to_vector_of_size_or_none(y, 0 if self.b is None else self.b.size)
        if z is None or y is None:
            return None
        if self._box is not None:
            return self.convert_multipliers_to_two_sided(z, y)
        rows = self._sides.merge_multipliers_to_two_sided(z[: self._rows], y[: self._equalities])
        bounds = _convert_to_vector_of_size_or_none(z_box, 0 if self.lb is None else self._n)
        if bounds is None:
            return None
        return rows, bounds.copy() if bounds.size else np.zeros(self._n)


def _convert_to_vector_of_size_or_none(value: Any, size: int) -> Vector | None:
    """Return `value` as a float64 vector of this size; None if it has another size."""
    if size == 0:
        return np.empty(0)
    if value is None:
        return None
    array = np.asarray(value, dtype=np.float64).reshape(-1)
    return array if array.size == size else None
