"""A certified optimum, and the form of a QP in which its certificate is made.

Rows and bounds are one list of rows there:

    minimise ½ zᵀPz + qᵀz   subject to   L ≤ C z ≤ U,   C = [A; I],  L = [l; lb],  U = [u; ub]

Equilibration by powers of two keeps the problem to the last bit:

    z = D z',  P' = c D P D,  q' = c D q,  A' = R A D,  [l'; lb'] = [R l; D⁻¹ lb],  likewise u

D, R and c come from Ruiz's equilibration of [P Aᵀ; A 0] (A scaling algorithm to equilibrate both
rows and columns norms in matrices, RAL-TR-2001-034), rounded to powers of two.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.display import format_numbers_with_units, make_html_field_table
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic

Kind = Literal["linear", "gap", "rational", "infeasible", "none", "undecided"]
Signs = NDArray[np.int8]
"""One entry per row of C: +1 active at its upper limit, −1 at its lower one, 0 inactive."""
ACTIVE_MULTIPLIER = 1e-9  # Scaled multipliers above it count as active limits in `n_active`
SWEEPS = 10
RANGE = 1e250  # Numbers beyond it, or below its inverse, could leave float64 where they are scaled


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """Certified optimum of a QP with a rigorous error bound, or proof of infeasibility.

    Parameters
    ----------
    z : (n,), y : (m,), y_box : (n,) optimum and its multipliers; of an infeasible problem z is
        NaN and (y, y_box) the Farkas vector; NaN where nothing could be certified.
    bound : rigorous bound of max_i |z_i − z*_i|; inf unless there is an optimum.
    kind : the certificate; "undecided" for a problem that is infeasible by no more than rounding,
        "none" where nothing is proven.
    reason : why nothing could be certified, where the data are the reason; "" otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> Optimum(np.array([1.0]), np.zeros(0), np.array([2.0]), bound=0.0, kind="linear")
    <Optimum of 1 variable: z within 0.0e+00 of the exact one, 1 limit active>
    """

    z: Vector
    y: Vector
    y_box: Vector
    bound: float
    kind: Kind
    reason: str = ""

    def __repr__(self) -> str:
        return f"<{self._size_title}: {self._proven_statement}>"

    def _repr_html_(self) -> str:
        """Show the optimum as a table in a notebook."""
        fields = {"certificate": f"{self.kind}: {self._proven_statement}"}
        fields |= {
            name: format_numbers_with_units(getattr(self, name)) for name in ("z", "y", "y_box")
        }
        return make_html_field_table(self._size_title, fields)

    @property
    def _size_title(self) -> str:
        """Size of the certified QP, in words."""
        return f"Optimum of {len(self.z)} variable{'s' * (len(self.z) != 1)}"

    @property
    def _proven_statement(self) -> str:
        """Statement of what is proven, with the error bound, in words."""
        if not np.isfinite(self.bound):
            proofs = {
                "infeasible": "no point is feasible",
                "undecided": "feasible or infeasible by rounding alone",
            }
            why = f": {self.reason}" if self.reason else ""
            return proofs.get(self.kind, f"nothing certified{why}")
        active = int(np.count_nonzero(self.y) + np.count_nonzero(self.y_box))
        limits = f"{active} limit{'s' * (active != 1)} active"
        return f"z within {self.bound:.1e} of the exact one, {limits}"


@dataclass(frozen=True, slots=True, eq=False)
class JointQP:
    """QP with rows and bounds joined: P (n, n), q (n,), C = [A; I] (N, n), limits L and U (N,)."""

    P: Matrix
    q: Vector
    C: Matrix
    L: Vector
    U: Vector

    @classmethod
    def from_qp(cls, qp: QuadraticProgram) -> "JointQP":
        """Join the rows and bounds of a QP into rows C with limits L and U."""
        return cls(qp.P, qp.q, np.vstack((qp.A, np.eye(qp.n))), *qp.stack_row_and_bound_limits())


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """Certified point with a rigorous error bound max_i |z_i − z*_i| and multipliers."""

    z: Vector
    y: Vector
    bound: float
    kind: Kind


@dataclass(frozen=True, slots=True, eq=False)
class ExactMatrices:
    """Hessian P and constraint rows C of a QP in exact arithmetic."""

    P: Dyadic
    C: Dyadic

    @classmethod
    def from_float_matrices(cls, P: Matrix, C: Matrix) -> "ExactMatrices":
        """Convert Hessian P and constraint rows C from float64 to exact arithmetic."""
        return cls(Dyadic.from_floats(P), Dyadic.from_floats(C))


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Equilibration factors D (n,), R (N,) and c, powers of two, of a QP's matrices P and C."""

    D: Vector
    R: Vector
    cost: float

    @classmethod
    def compute_ruiz_scales(cls, P: Matrix, C: Matrix) -> "Scales":
        """Compute the equilibration factors of P (n, n) and C (N, n) by Ruiz's method."""
        n = len(P)
        A = np.abs(C[:-n])
        D, R = np.ones(n), np.ones(len(A))
        for _ in range(SWEEPS):
            rows, cost = A * R[:, np.newaxis] * D, np.abs(P) * D[:, np.newaxis] * D
            D = D / _take_square_roots_or_one_at_zero(
                np.maximum(rows.max(axis=0, initial=0.0), cost.max(axis=0, initial=0.0))
            )
            R = R / _take_square_roots_or_one_at_zero(rows.max(axis=1, initial=0.0))
        D, R = _round_to_powers_of_two(D), _round_to_powers_of_two(R)
        largest = float((np.abs(P) * D[:, np.newaxis] * D).max(initial=0.0))
        cost_scale = float(_round_to_powers_of_two(np.array(1.0 / (largest or 1.0))))
        return cls(D, np.concatenate((R, 1.0 / D)), cost_scale)

    def scale_cost_matrix(self, P: Matrix) -> Matrix:
        """Return the equilibrated cost matrix c D P D (n, n)."""
        return self.cost * P * self.D[:, np.newaxis] * self.D

    def scale_constraint_rows(self, C: Matrix) -> Matrix:
        """Return the equilibrated constraint rows R C D (N, n)."""
        return C * self.R[:, np.newaxis] * self.D

    def scale_problem(self, problem: JointQP, P: Matrix, C: Matrix) -> JointQP:
        """Return a QP with equilibrated vectors q, L and U, and the given equilibrated P and C."""
        q = self.cost * problem.q * self.D
        return JointQP(P, q, C, problem.L * self.R, problem.U * self.R)

    def unscale_multipliers(self, y: Vector) -> Vector:
        """Convert multipliers y (N,) of the equilibrated problem to those of the original."""
        return y * self.R / self.cost


def is_exact_after_power_of_two_scaling(*arrays: Matrix) -> bool:
    """Return whether all finite entries stay exact when scaled by moderate powers of two."""
    sizes = np.concatenate([np.abs(array[np.isfinite(array)]).ravel() for array in arrays])
    sizes = sizes[sizes > 0.0]
    return not len(sizes) or bool(sizes.max() < RANGE and sizes.min() > 1.0 / RANGE)


def scale_to_unit_diagonal(P: Matrix) -> Matrix:
    """Return P (n, n) scaled by powers of two to a diagonal of about 1."""
    D = _round_to_powers_of_two(1.0 / _take_square_roots_or_one_at_zero(np.diagonal(P)))
    return np.asarray(P * D[:, np.newaxis] * D, dtype=np.float64)


def _take_square_roots_or_one_at_zero(size: Vector) -> Vector:
    """Return the square roots of the sizes, 1 where a size is zero."""
    return np.sqrt(np.where(size > 0.0, size, 1.0))


def _round_to_powers_of_two(size: Vector) -> Vector:
    """Return the nearest power of two of each positive number."""
    return np.asarray(np.exp2(np.round(np.log2(size))), dtype=np.float64)
