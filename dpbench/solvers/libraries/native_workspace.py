"""The common base of native workspaces: data, life cycle and failures.

    setup     copies the problem and makes a new library object from the copies
    update    fresh: the same; else the vectors go to the library
    solve     the library's own call
    read      one `Solution`, copied out of the library's memory

A library object that raised, or left no usable answer, is made anew before the next step.
"""

from __future__ import annotations

from abc import abstractmethod
from importlib import import_module
from math import isfinite
from typing import Any

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import CONSTANT, QPStep, QuadraticProgram, rows_per_block
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import Claim
from dpbench.solvers.contract import (
    Options,
    Policy,
    Workspace,
    check_step,
    describe_exception,
    missing_setup_error,
    shift_into,
)
from dpbench.solvers.one_sided import OneSidedForm
from dpbench.solvers.record import SolverRecord

Point = tuple[Vector, Vector, Vector]
NOT_SOLVED = "read before solve"
SOLVED = Status.SOLVED  # looking it up in its class takes 50 ns


class NativeWorkspace(Workspace):
    """A library through its own interface.

    Whatever a method of a subclass raises becomes the status ERROR with the library's words. Where
    a warm start is made of vectors, `_start` holds the previous answer.

    Parameters
    ----------
    record : its row in the table; the module it names is imported as `_library`.
    policy : "fresh", "reuse" or "warm", already checked against the table.
    options : the library's own settings, already validated.
    """

    _solver: Any
    _result: Any = None
    _start: Start

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record.name, "native", policy)
        self.form = record.form
        self._library: Any = import_module(record.module)
        self.setup_every_step = policy == "fresh"
        self._warm = policy == "warm"
        self._given_start = self._warm and record.on("native").start != "active set"
        self._options = dict(options)
        self._n, self._m, self._block = -1, -1, 0
        self._stages: tuple[tuple[int, int], ...] = ()
        self._converted = self._used = False
        self._matrices_given: tuple[Matrix, ...] = ()
        self._done = self._unread = self._unusable = False
        self._failure = ""

    def _convert(self) -> None:
        """Bring new matrices `_P, _A, _lb, _ub` into the library's form."""

    @abstractmethod
    def _build(self) -> None:
        """Make a new library object of the converted matrices and `_q, _l, _u`."""

    @abstractmethod
    def _hand_over(self, q: Vector, low: Vector, high: Vector) -> None:
        """Give the library the vectors of a step; nothing else has changed."""

    def _call(self) -> None:
        """Let the library solve."""
        self._result = self._solver.solve()

    @abstractmethod
    def _read_claim(self) -> Claim:
        """Read the library's claim about its last answer."""

    @abstractmethod
    def _read_point(self) -> Point | None:
        """Return z, y and y_box of a usable answer in new memory; None if there are none."""

    def _configure(self, settings: Any) -> None:
        """Write the options into a settings object of the library."""
        for name, value in self._options.items():
            setattr(settings, name, value)

    def _limits_of_all(self) -> tuple[Vector, Vector]:
        """Return buffers for the limits of [A; I], with the bounds filled in."""
        rows = np.empty(self._m)
        return np.concatenate([rows, self._lb]), np.concatenate([rows, self._ub])

    def _build_for(self, q: Vector, low: Vector, high: Vector) -> None:
        """Store the vectors of a step and make a new library object for them."""
        self._q[:], self._l[:], self._u[:] = q, low, high
        self._renew()

    def _renew(self) -> None:
        if self._given_start:
            self._start = Start(self._n, self._m, self._block)
        self._build()

    def _has_start(self) -> bool:
        """Move `_start` on to this step; return whether there is one."""
        return self._given_start and self._start.advance()

    def setup(self, qp: QuadraticProgram) -> None:
        """Copy the problem, make a new library object and forget every earlier answer."""
        self._forget()
        self._q, self._l, self._u = qp.q.copy(), qp.l.copy(), qp.u.copy()
        order = (self._block, self._stages) == (qp.block, qp.stages)
        if not (self._converted and order and self._has_matrices(qp)):
            self._n, self._m, self._block, self._stages = qp.n, qp.m, qp.block, qp.stages
            self._P, self._A = qp.P.copy(), qp.A.copy()
            self._lb, self._ub = qp.lb.copy(), qp.ub.copy()
            self._matrices_given = qp.P, qp.A, qp.lb, qp.ub
            self._converted = False
        self._rebuild()

    def _has_matrices(self, qp: QuadraticProgram) -> bool:
        """Return whether the matrices are equal to the own copies."""
        old, new = self._matrices_given, (qp.P, qp.A, qp.lb, qp.ub)
        if old and all(a is b and not b.flags.writeable for a, b in zip(old, new, strict=True)):
            return True
        own = self._P, self._A, self._lb, self._ub
        # Comparing bytes is the cheapest way.
        return all(
            a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(own, new, strict=True)
        )

    def update(self, step: QPStep) -> None:
        """Hand over the vectors; for new matrices make the library object anew."""
        n, m = self._n, self._m
        if n < 0:
            raise missing_setup_error("update")
        q, low, high = step.q, step.l, step.u
        matrices = not (step.P is None and step.A is None and step.lb is None and step.ub is None)
        if matrices or q.shape != (n,) or low.shape != (m,) or high.shape != (m,):
            check_step(step, n, m)
        if self._unread:
            self.read()
        self._done = False
        if matrices:
            self.matrix_updates += 1
            self._converted, self._matrices_given = False, ()
            for name in CONSTANT:
                value = getattr(step, name)
                if value is not None:
                    setattr(self, f"_{name}", np.array(value, dtype=np.float64, order="C"))
        if matrices or self._unusable or self.setup_every_step:
            self._q[:], self._l[:], self._u[:] = q, low, high
            self._rebuild()
            return
        try:
            self._hand_over(q, low, high)
        except BaseException as error:
            self._fail(error)

    def _rebuild(self) -> None:
        self._unusable = self._used = False
        self._failure = ""
        try:
            if not self._converted:
                self._convert()
                self._converted = True
            self._renew()
        except BaseException as error:
            self._fail(error)

    def _fail(self, error: BaseException) -> None:
        self._failure, self._unusable = describe_exception(error), True

    def solve(self) -> None:
        """Solve; store whatever the library raises for `read`."""
        if self._failure:
            return
        self._done = self._unread = self._used = True
        try:
            self._call()
        except BaseException as error:
            self._fail(error)

    def read(self) -> Solution:
        """Return the answer; after an unusable one the next update starts from nothing."""
        if self._n < 0:
            raise missing_setup_error("read")
        if self._failure:
            self._unread = False
            return self._missing(Status.ERROR, -1, -1, self._failure)
        if not self._done:
            return self._missing(Status.ERROR, -1, -1, NOT_SOLVED)
        status, iterations, reported_ns, detail = self._read_claim()
        detail = "" if status is SOLVED else detail
        point = self._read_point() if status.is_usable else None
        if point is None:
            solution = self._missing(status, iterations, reported_ns, detail)
        else:
            solution = Solution(status, *point, iterations, reported_ns, detail)
        if self._unread:
            self._unread = False
            # The square of z is finite if z has neither a NaN nor an infinity.
            z = solution.z
            self._unusable = not (solution.status.is_usable and isfinite(z.dot(z)))
            if self._warm and not self._unusable:
                self._remember(solution)
        return solution

    def _remember(self, solution: Solution) -> None:
        """Store the next start; nothing where the library keeps it itself."""
        if self._given_start:
            self._start.remember(solution)

    def _missing(self, status: Status, iterations: int, reported_ns: int, detail: str) -> Solution:
        solution = Solution.missing(self._n, self._m, status, detail)
        solution.iterations, solution.reported_ns = iterations, reported_ns
        return solution

    def reset(self) -> None:
        """Make the library object anew, unless it is unused."""
        stale = self._used or self._unusable
        self._forget()
        if stale and not self.setup_every_step:
            self._rebuild()

    def _forget(self) -> None:
        self._done = self._unread = self._unusable = False
        self._failure = ""


class OneSidedWorkspace(NativeWorkspace):
    """A library that takes one side of a limit only: A z = b and G z ≤ h.

    Rows with l = u are equalities and infinite sides are left out, by the pattern at setup; a step
    of another pattern makes the library object anew.
    """

    _form: OneSidedForm

    @abstractmethod
    def _create(self) -> None:
        """Make a new library object from `_form`."""

    @abstractmethod
    def _send(self) -> None:
        """Give the library the vectors in `_form`."""

    def _arrange(self) -> None:
        """Prepare the matrices of a new `_form` for `_create`."""

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
            self._build_for(q, low, high)

    def _rows(self) -> tuple[Matrix, int, int]:
        """Return [A; G], the number of equalities and that of inequalities."""
        parts = [M for M in (self._form.A, self._form.G) if M is not None]
        rows = np.vstack(parts) if parts else np.empty((0, self._n))
        equalities = 0 if self._form.b is None else self._form.b.size
        return rows, equalities, rows.shape[0] - equalities


class Start:
    """The previous answer, one move later, as the start of the next solve.

    Moves shift by a block of variables, multipliers of rows by the rows of a move; those of the
    last move are zero. Block 0 shifts nothing.
    """

    def __init__(self, n: int, m: int, block: int) -> None:
        rows = rows_per_block(n, m, block)
        self.z = np.zeros(n)
        self.dual = np.zeros(m + n)
        self.y, self.y_box = self.dual[:m], self.dual[m:]
        shifted = (self.z, block), (self.y, rows), (self.y_box, block)
        self._last = [(array, array.copy(), by) for array, by in shifted]
        self.known = False

    def remember(self, solution: Solution) -> None:
        """Store a copy of an answer."""
        answer = (solution.z, solution.y, solution.y_box)
        for (_, last, _), value in zip(self._last, answer, strict=True):
            last[:] = value
        self.known = True

    def advance(self) -> bool:
        """Fill `z`, `y`, `y_box` with the stored answer one move later; false if there is none."""
        if self.known:
            for target, last, by in self._last:
                shift_into(target, last, by)
        return self.known


def stacked(A: Matrix, n: int) -> Matrix:
    """Stack bounds as rows, [A; I], for a library that has rows only."""
    return np.vstack([A, np.eye(n)])
