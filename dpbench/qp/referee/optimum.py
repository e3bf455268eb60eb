"""A certified optimum: the point, its multipliers, a bound of its error and the kind of proof."""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.display import fields_html, numbers_text
from dpbench.qp.referee.joint import Kind

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

    Examples
    --------
    >>> Optimum(np.array([1.0]), np.zeros(0), np.array([2.0]), bound=0.0, kind="exact")
    <Optimum of 1 variables: z within 0.0e+00 of the exact one, 1 limits active>
    """

    z: Vector
    y: Vector
    y_box: Vector
    bound: float
    kind: Kind

    def __repr__(self) -> str:
        return f"<Optimum of {len(self.z)} variables: {self._proven_statement}>"

    def _repr_html_(self) -> str:
        fields = {"certificate": f"{self.kind}: {self._proven_statement}"}
        fields |= {name: numbers_text(getattr(self, name)) for name in ("z", "y", "y_box")}
        return fields_html(f"Optimum of {len(self.z)} variables", fields)

    @property
    def _proven_statement(self) -> str:
        """Statement of what is proven, with the error bound, in words."""
        if not np.isfinite(self.bound):
            proofs = {
                "infeasible": "no point is feasible",
                "undecided": "feasible or infeasible by rounding alone",
            }
            return proofs.get(self.kind, "nothing certified")
        active = np.count_nonzero(self.y) + np.count_nonzero(self.y_box)
        return f"z within {self.bound:.1e} of the exact one, {active} limits active"
