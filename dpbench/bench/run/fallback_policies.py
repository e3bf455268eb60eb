"""Fallback policies: the move without a usable answer (method.md section 3)."""

from collections.abc import Callable

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import DEFAULT_FALLBACK

Law = Callable[[Vector, Vector, Vector], Vector]
"""Δu (n_u,) of the unconstrained law at x (n_x,), y_ref (n_y,) and u(k−1) (n_u,)."""


class FallbackPolicy:
    """Policy for the move of a step without a usable answer; this one holds the force.

    `acted` is whether the last move was one; `follows_plans` whether a late plan is followed too.
    """

    follows_plans = False

    def __init__(self, N_c: int, n_u: int, law: Law) -> None:
        self.acted = False
        self._plan: Matrix = np.zeros((N_c, n_u))
        self._age, self._law = N_c, law

    def remember(self, plan: Matrix) -> Vector:
        """Store a usable plan (N_c, n_u) and return its first move."""
        self._plan, self._age, self.acted = plan, 0, False
        first: Vector = plan[0]
        return first

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) for a step without a usable answer: zero, which holds the force."""
        self.acted = True
        return np.zeros(self._plan.shape[1])


class ShiftedPlan(FallbackPolicy):
    """A fallback that plays on the last usable plan's increments, then holds the force."""

    follows_plans = True

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,): the next move of the last usable plan, zero after its end."""
        hold = super().move(x, y_ref, u_prev)
        self._age += 1
        return self._plan[self._age] if self._age < len(self._plan) else hold


class Clip(FallbackPolicy):
    """A fallback that applies the unconstrained control law; the loop clips it to the limits."""

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) of the unconstrained law, for a step without a usable answer."""
        self.acted = True
        return self._law(x, y_ref, u_prev)


FALLBACKS: dict[str, type[FallbackPolicy]] = {
    DEFAULT_FALLBACK: ShiftedPlan,
    "hold": FallbackPolicy,
    "clip": Clip,
}
