"""Native workspaces of libraries that take one side of a limit only: A z = b and G z ≤ h.

Rows with l = u are equalities and infinite sides are left out, by the pattern at setup; a step of
another pattern makes the library object anew.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QuadraticProgram
from dpbench.solvers.native.base import NativeWorkspace
from dpbench.solvers.one_sided import OneSidedForm


class OneSidedWorkspace(NativeWorkspace):
    """A subclass gives `_create` (a new library object) and `_send` (the vectors in `_form`)."""

    _form: OneSidedForm

    @abstractmethod
    def _create(self) -> None:
        """Make a new library object from `_form`."""

    @abstractmethod
    def _send(self) -> None:
        """Give the library the vectors in `_form`."""

    def _arrange(self) -> None:
        """Bring the matrices of a new `_form` into what `_create` needs; by default nothing."""

    def _convert(self) -> None:
        qp = QuadraticProgram(
            self._P, self._q, self._A, self._l, self._u, self._lb, self._ub, self._block
        )
        self._form = OneSidedForm(qp, "dense", "rows")
        self._arrange()

    def _build(self) -> None:
        if not self._form.fits(self._l, self._u):
            self._convert()
        self._form.fill(self._q, self._l, self._u)
        self._create()

    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        if self._form.fits(low, high):
            self._form.fill(q, low, high)
            self._send()
        else:
            self._q[:], self._l[:], self._u[:] = q, low, high
            self._build()

    def _rows(self) -> tuple[Matrix, int, int]:
        """[A; G], the number of equalities and that of inequalities."""
        parts = [M for M in (self._form.A, self._form.G) if M is not None]
        rows = np.vstack(parts) if parts else np.empty((0, self._n))
        equalities = 0 if self._form.b is None else self._form.b.size
        return rows, equalities, rows.shape[0] - equalities
