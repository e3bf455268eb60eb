"""Rows and bounds of a QP as one list of rows, the form in which certificates are made.

minimise ½ zᵀPz + qᵀz   subject to   L ≤ C z ≤ U,   C = [A; I],  L = [l; lb],  U = [u; ub]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.dyadic import Dyadic

Kind = Literal["linear", "gap", "rational", "infeasible", "none", "undecided"]
Signs = NDArray[np.int8]
"""One entry per row of C: +1 active at its upper limit, −1 at its lower one, 0 inactive."""


@dataclass(frozen=True, slots=True, eq=False)
class JointQP:
    """QP with rows and bounds joined: P (n, n), q (n,), C = [A; I] (N, n), limits L and U (N,)."""

    P: Matrix
    q: Vector
    C: Matrix
    L: Vector
    U: Vector

    @classmethod
    def of(cls, qp: QuadraticProgram) -> JointQP:
        """Join the rows and bounds of a QP."""
        return cls(qp.P, qp.q, np.vstack((qp.A, np.eye(qp.n))), *qp.limits())


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
    def of(cls, P: Matrix, C: Matrix) -> ExactMatrices:
        """Convert Hessian P and constraint rows C from float64 to exact arithmetic."""
        return cls(Dyadic.of(P), Dyadic.of(C))
