"""A solver that answers right, and writes over everything it was ever given."""

import numpy as np

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.solvers.contract import Workspace
from dpbench.solvers.libraries.quadprog import NATIVE
from dpbench.solvers.plugins import solver_record

ARRAYS = ("P", "q", "A", "l", "u", "lb", "ub")


class Spoiling(Workspace):
    """Solves copies with `inside`, and leaves zeros in what it was given: at once and later.

    `spoil` false makes it an honest solver of the same answers.
    """

    def __init__(self, inside: Workspace, *, spoil: bool = True) -> None:
        super().__init__("spoiling", inside.route, inside.policy)
        self.setup_every_step = inside.setup_every_step
        self.form = inside.form
        self._inside, self._spoil = inside, spoil
        self._seen: dict[int, np.ndarray] = {}

    def _take(self, given: QuadraticProgram | QPStep) -> None:
        for name in ARRAYS:
            array = getattr(given, name)
            while self._spoil and isinstance(array, np.ndarray):
                self._seen[id(array)] = array
                array = array.base

    def _zero(self) -> None:
        for array in self._seen.values():
            array.fill(0.0)

    def setup(self, qp: QuadraticProgram) -> None:
        """Take a copy, spoil the rest."""
        self._inside.setup(qp.copy())
        self._take(qp)
        self._zero()

    def update(self, step: QPStep) -> None:
        self._inside.update(step.copy())
        self.matrix_updates = self._inside.matrix_updates
        self._take(step)
        self._zero()
        for name in ARRAYS if self._spoil else ():
            array = getattr(step, name)
            setattr(step, name, None if array is None else np.zeros_like(array))

    def solve(self) -> None:
        self._inside.solve()

    def read(self) -> Solution:
        """The answer, once more after everything was disturbed."""
        self._zero()
        return self._inside.read()

    def reset(self) -> None:
        """Forget, and spoil between the steps too."""
        self._zero()
        self._inside.reset()


def open(policy, options):
    """A workspace; one that is `fresh` is set up at every step."""
    return Spoiling(NATIVE.workspace(NATIVE.record, policy, options))


RECORD = solver_record(
    "spoiling",
    method="none",
    module="quadprog",
    distribution="quadprog",
    policies=("fresh", "reuse"),
)
