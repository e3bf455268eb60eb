"""Checks that a step fits the problem a workspace was set up with."""

from __future__ import annotations

from dpbench.errors import ShapeError
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh


def check_step(step: QPStep, n: int, m: int) -> None:
    """Raise ShapeError unless the arrays of `step` fit n variables and m rows."""
    rows = (m,)
    fits = step.q.shape == (n,) and step.l.shape == rows and step.u.shape == rows
    if fits and step.refresh is Refresh.VECTORS:
        return
    expected = {"q": (n,), "l": (m,), "u": (m,), "P": (n, n), "A": (m, n), "lb": (n,), "ub": (n,)}
    for name, shape in expected.items():
        array = getattr(step, name)
        if array is not None and array.shape != shape:
            raise ShapeError.of("QPStep", name, array.shape, f"shape {shape}")


def owned(qp: QuadraticProgram) -> QuadraticProgram:
    """The same problem in memory that nobody else holds."""
    P, q, A, l, u, lb, ub = (  # noqa: E741 - see QuadraticProgram.l
        array.copy() for array in (qp.P, qp.q, qp.A, qp.l, qp.u, qp.lb, qp.ub)
    )
    return QuadraticProgram(P, q, A, l, u, lb, ub, qp.block)
