"""A certified optimum, and the form of a QP in which its certificate is made.

Rows and bounds are one list of rows there:

    minimise ½ zᵀPz + qᵀz   subject to   L ≤ C z ≤ U,   C = [A; I],  L = [l; lb],  U = [u; ub]
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
