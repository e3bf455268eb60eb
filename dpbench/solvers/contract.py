"""The workspace contract every solver is driven through.

    setup(qp)      prepare the problem; the only call that may be slow
    update(step)   hand over what changed
    solve()        the solver's work, and nothing else
    read()         copy the answer out, map signs and status

The time of each call is measured, so each must do its own duty only. A workspace turns the
library's failures into a `Status`; it raises only for a person's mistake.

The harness hands over arrays for this workspace alone. The vectors of a step never change later;
where every step is set up, the matrices come in the same memory each time, restored before.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Literal

from dpbench.arrays import Vector
from dpbench.errors import DpbenchError, ShapeError, SituationError
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution

Route = Literal["qpsolvers", "native"]
Policy = Literal["fresh", "reuse", "warm"]
Options = Mapping[str, object]
Settings = str | Options
Form = Literal["dense", "csc"]


class Workspace(ABC):
    """Interface that every QP solver implements: set up, update, solve, read, for QPs of one shape.

    Attributes
    ----------
    form : the form of the library's matrices.
    setup_every_step : the harness calls `setup` with the whole problem at every step instead of
        `update` (policy fresh on route native).
    matrix_updates : updates so far that brought new P, A, lb or ub.
    reopen : makes another workspace of the same solver, route, policy and settings.
    requested_settings : those it was opened with by name; "" where it was not.

    Examples
    --------
    >>> import numpy as np
    >>> from dpbench import QuadraticProgram, open_workspace
    >>> workspace = open_workspace("quadprog", route="native")
    >>> workspace
    <Workspace of quadprog (native, fresh)>
    >>> none = np.zeros((0, 1)), np.zeros(0), np.zeros(0)
    >>> workspace.setup(QuadraticProgram(np.eye(1), [-2.0], *none, [-9.0], [1.0]))
    >>> workspace.solve()
    >>> workspace.read().z
    array([1.])
    """

    setup_every_step: bool = False
    matrix_updates: int = 0
    form: Form = "dense"
    reopen: "Callable[[], Workspace] | None" = None
    requested_settings: Settings = ""

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        self.solver, self.route, self.policy = solver, route, policy

    def __repr__(self) -> str:
        return f"<Workspace of {self.solver} ({self.route}, {self.policy})>"

    @abstractmethod
    def setup(self, qp: QuadraticProgram) -> None:
        """Prepare the whole problem `qp`, so that the next `solve` solves it."""

    @abstractmethod
    def update(self, step: QPStep) -> None:
        """Take over the vectors and matrices of the next QP; ShapeError on wrong shapes."""

    @abstractmethod
    def solve(self) -> None:
        """Solve the current problem; a failure of the library becomes a status, no exception."""

    @abstractmethod
    def read(self) -> Solution:
        """Return a copy of the answer: status, solution z and multipliers."""

    def open_again_with_equal_settings(self) -> "Workspace":
        """Open the same solver again with equal settings; SituationError unless opened by name."""
        if self.reopen is None:
            sentence = "a cascade needs two workspaces; open this one by open_workspace"
            raise SituationError(f"solver {self.solver}", sentence)
        return self.reopen()

    def reset(self) -> None:  # noqa: B027 - a workspace without memory has nothing to forget
        """Discard earlier answers and warm-start data, after a step that was not solved."""


def check_step(step: QPStep, n: int, m: int) -> None:
    """Raise ShapeError unless a step's arrays fit a QP of n variables and m rows."""
    rows = (m,)
    fits = step.q.shape == (n,) and step.l.shape == rows and step.u.shape == rows
    if fits and step.refresh is Refresh.VECTORS:
        return
    expected = {"q": (n,), "l": (m,), "u": (m,), "P": (n, n), "A": (m, n), "lb": (n,), "ub": (n,)}
    for name, shape in expected.items():
        array = getattr(step, name)
        if array is not None and array.shape != shape:
            raise ShapeError.from_shapes("QPStep", name, array.shape, f"shape {shape}")


def describe_exception_unless_interrupt(error: BaseException) -> str:
    """Return class and message of a solver library's exception as text; re-raise an interrupt."""
    if isinstance(error, (KeyboardInterrupt, SystemExit)):
        raise error
    return f"{type(error).__name__}: {error}"


def make_error_for_missing_setup(call: str) -> DpbenchError:
    """Return the error for calling a solver's method before its set-up."""
    return DpbenchError(f"{call} before setup: call setup with the whole problem first")


def shift_into(target: Vector, source: Vector, block: int) -> None:
    """Write a vector shifted by one control increment for a warm start; the last block is zero."""
    if block == 0:
        target[:] = source
    elif target.size:
        target[:-block] = source[block:]
        target[-block:] = 0.0
