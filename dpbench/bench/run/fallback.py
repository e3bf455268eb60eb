"""What acts where a solve left no usable answer (method.md section 3)."""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Fallback
from dpbench.mpc.condense import CondensedMatrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import Gains, gains


class FallbackLaw:
    """What moves the ship when a solve left no usable answer.

    `shifted_plan` follows the last usable plan, one move further for every step since, and holds
    when it is used up; `hold` keeps the force; `clip` is the unconstrained law (eq. 33), which the
    loop clips. `acted` is whether the last move was one without an answer.
    """

    def __init__(self, kind: Fallback, builder: CondensedQP) -> None:
        problem = builder.control
        self.kind, self.acted = kind, False
        self._builder = builder
        self._plan: Matrix = np.zeros((problem.N_c, problem.model.n_u))
        self._age = problem.N_c
        self._known: tuple[CondensedMatrices, Gains] | None = None

    def remember(self, plan: Matrix) -> Vector:
        """Keep a usable plan (N_c, n_u) and return its first move."""
        self._plan, self._age, self.acted = plan, 0, False
        first: Vector = plan[0]
        return first

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Δu (n_u,) in place of the missing answer."""
        self.acted = True
        if self.kind == "clip":
            law = self._law(self._builder.matrices)
            move: Vector = law.K_y @ y_ref - law.K_mpc @ x
            return move if law.K_u is None else move - law.K_u @ u_prev
        self._age += 1
        if self.kind == "hold" or self._age >= len(self._plan):
            return np.zeros(self._plan.shape[1])
        next_move: Vector = self._plan[self._age]
        return next_move

    def _law(self, matrices: CondensedMatrices) -> Gains:
        """The gains that go with the builder's matrices, which may turn with the ship."""
        if self._known is None or self._known[0] is not matrices:
            self._known = matrices, gains(self._builder.control, matrices)
        return self._known[1]
