"""The exactly solved loop at a step that is infeasible by rounding."""

from __future__ import annotations

import numpy as np

from dpbench.bench.run.exact_loop import ExactWorkspace
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Status


def test_step_infeasible_by_rounding_is_answered_by_the_fallback() -> None:
    """An undecided step has no feasible point as it stands: the loop falls back, and goes on."""
    A, free = np.array([[0.0], [1.0]]), np.full(1, np.inf)
    limits = np.array([-1e-17, 1.0])
    qp = QuadraticProgram(np.eye(1), [-2.0], A, [-np.inf] * 2, limits, -free, free)
    workspace = ExactWorkspace()
    workspace.setup(qp)
    workspace.solve()
    assert workspace.optima[-1].kind == "undecided"
    assert workspace.read().status is Status.PRIMAL_INFEASIBLE
