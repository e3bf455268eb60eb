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
from dpbench.qp.program import CONSTANT, QPStep, QuadraticProgram, count_rows_per_block
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
    """Base of solvers called through their library's own interface: QP data, calls and failures.

    Whatever a method of a subclass raises becomes the status ERROR with the library's words. Where
    a warm start is made of vectors, `_start` holds the previous answer.

    record : its row in the table; the module it names is imported as `_library`.
    policy : "fresh", "reuse" or "warm", already checked against the table.
    options : the library's own settings, already validated.
    """

    _solver: Any
    _result: Any = None
    _start: WarmStart

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

    def _convert_matrices(self) -> None:
        """Convert new matrices P, A and bounds lb, ub into the library's form."""

    @abstractmethod
    def _build_solver(self) -> None:
        """Make a new library object from the converted matrices, linear cost and limits."""

    @abstractmethod
    def _update_vectors(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's linear cost q and row limits to the library, in place."""

    def _run_solver(self) -> None:
        """Call the library's solve function."""
        self._result = self._solver.solve()

    @abstractmethod
    def _read_reported_status(self) -> Claim:
        """Read status, iterations and time [ns] that the library reports."""

    @abstractmethod
    def _read_solution_vectors(self) -> Point | None:
        """Return copies of solution z and multipliers y, y_box; None if there are none."""

    def _apply_options(self, settings: Any) -> None:
        """Set each option as an attribute of the library's settings."""
        for name, value in self._options.items():
            setattr(settings, name, value)

    def _allocate_joint_limits(self) -> tuple[Vector, Vector]:
        """Allocate limits (m + n,) of rows and bounds together, with the bounds written in."""
        rows = np.empty(self._m)
        return np.concatenate([rows, self._lb]), np.concatenate([rows, self._ub])

    def _build_solver_for_step(self, q: Vector, low: Vector, high: Vector) -> None:
        """Store a step's vectors and make a new library object from them."""
        self._q[:], self._l[:], self._u[:] = q, low, high
        self._build_with_empty_start()

    def _build_with_empty_start(self) -> None:
        """Discard the warm start and make a new library object."""
        if self._given_start:
            self._start = WarmStart(self._n, self._m, self._block)
        self._build_solver()

    def _advance_start(self) -> bool:
        """Shift the stored warm start by a control increment; return whether there is one."""
        return self._given_start and self._start.advance()

    def setup(self, qp: QuadraticProgram) -> None:
        """Copy the QP, make a new library object and discard earlier answers."""
        self._clear_answer_state()
        self._q, self._l, self._u = qp.q.copy(), qp.l.copy(), qp.u.copy()
        order = (self._block, self._stages) == (qp.block, qp.stages)
        if not (self._converted and order and self._has_same_matrices(qp)):
            self._n, self._m, self._block, self._stages = qp.n, qp.m, qp.block, qp.stages
            self._P, self._A = qp.P.copy(), qp.A.copy()
            self._lb, self._ub = qp.lb.copy(), qp.ub.copy()
            self._matrices_given = qp.P, qp.A, qp.lb, qp.ub
            self._converted = False
        self._rebuild_solver()

    def _has_same_matrices(self, qp: QuadraticProgram) -> bool:
        """Return whether P, A, lb and ub of `qp` equal those already stored."""
        old, new = self._matrices_given, (qp.P, qp.A, qp.lb, qp.ub)
        if old and all(a is b and not b.flags.writeable for a, b in zip(old, new, strict=True)):
            return True
        own = self._P, self._A, self._lb, self._ub
        # Comparing bytes is the cheapest way.
        return all(
            a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(own, new, strict=True)
        )

    def update(self, step: QPStep) -> None:
        """Pass new vectors to the library; make a new library object for new matrices."""
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
            self._rebuild_solver()
            return
        try:
            self._update_vectors(q, low, high)
        except BaseException as error:
            self._record_failure(error)

    def _rebuild_solver(self) -> None:
        """Make a new library object; store an exception of the library as the solve's failure."""
        self._unusable = self._used = False
        self._failure = ""
        try:
            if not self._converted:
                self._convert_matrices()
                self._converted = True
            self._build_with_empty_start()
        except BaseException as error:
            self._record_failure(error)

    def _record_failure(self, error: BaseException) -> None:
        """Store an exception's text and mark the library object as unusable."""
        self._failure, self._unusable = describe_exception(error), True

    def solve(self) -> None:
        """Call the library's solver; store an exception, for `read` to report."""
        if self._failure:
            return
        self._done = self._unread = self._used = True
        try:
            self._run_solver()
        except BaseException as error:
            self._record_failure(error)

    def read(self) -> Solution:
        """Return the solver's answer; after a failure, have a new library object made next."""
        if self._n < 0:
            raise missing_setup_error("read")
        if self._failure:
            self._unread = False
            return Solution.without_point(self._n, self._m, Status.ERROR, self._failure)
        if not self._done:
            return Solution.without_point(self._n, self._m, Status.ERROR, NOT_SOLVED)
        status, iterations, reported_ns, detail = self._read_reported_status()
        detail = "" if status is SOLVED else detail
        point = self._read_solution_vectors() if status.is_usable else None
        if point is None:
            counters = iterations, reported_ns
            solution = Solution.without_point(self._n, self._m, status, detail, counters)
        else:
            solution = Solution(status, *point, iterations, reported_ns, detail)
        if self._unread:
            self._unread = False
            # The square of z is finite if z has neither a NaN nor an infinity.
            z = solution.z
            self._unusable = not (solution.status.is_usable and isfinite(z.dot(z)))
            if self._warm and not self._unusable:
                self._store_start(solution)
        return solution

    def _store_start(self, solution: Solution) -> None:
        """Store an answer as the next warm start, unless the library keeps it itself."""
        if self._given_start:
            self._start.remember(solution)

    def reset(self) -> None:
        """Discard the warm start by making a new library object, unless it has not been used."""
        stale = self._used or self._unusable
        self._clear_answer_state()
        if stale and not self.setup_every_step:
            self._rebuild_solver()

    def _clear_answer_state(self) -> None:
        """Discard the state of the latest answer and its failure."""
        self._done = self._unread = self._unusable = False
        self._failure = ""


class OneSidedWorkspace(NativeWorkspace):
    """Base of solvers of A z = b, G z ≤ h, made anew where other rows are equal or infinite."""

    _form: OneSidedForm

    @abstractmethod
    def _create_solver_from_form(self) -> None:
        """Make a new library object from the QP with A z = b, G z ≤ h."""

    @abstractmethod
    def _send_form_vectors(self) -> None:
        """Pass the linear cost q and right-hand sides b, h to the library."""

    def _prepare_form_matrices(self) -> None:
        """Convert P, A and G of a QP with A z = b, G z ≤ h for the library."""

    def _convert_matrices(self) -> None:
        """Convert the QP with two-sided limits into A z = b, G z ≤ h."""
        qp = QuadraticProgram(
            self._P, self._q, self._A, self._l, self._u, self._lb, self._ub, self._block
        )
        self._form = OneSidedForm(qp, "dense", "rows")
        self._prepare_form_matrices()

    def _build_solver(self) -> None:
        """Make a new library object; convert the QP again if other limits are infinite."""
        if not self._form.has_same_pattern(self._l, self._u):
            self._convert_matrices()
        self._form.fill(self._q, self._l, self._u)
        self._create_solver_from_form()

    def _update_vectors(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass on a step's vectors; make a new library object if other limits are infinite."""
        if self._form.has_same_pattern(low, high):
            self._form.fill(q, low, high)
            self._send_form_vectors()
        else:
            self._build_solver_for_step(q, low, high)

    def _stack_form_rows(self) -> tuple[Matrix, int, int]:
        """Return equality and inequality rows stacked, [A; G], and the number of each."""
        parts = [M for M in (self._form.A, self._form.G) if M is not None]
        rows = np.vstack(parts) if parts else np.empty((0, self._n))
        equalities = 0 if self._form.b is None else self._form.b.size
        return rows, equalities, rows.shape[0] - equalities


class WarmStart:
    """The previous answer shifted by one move, to start the next solve; block 0 shifts nothing."""

    def __init__(self, n: int, m: int, block: int) -> None:
        rows = count_rows_per_block(n, m, block)
        self.z = np.zeros(n)
        self.dual = np.zeros(m + n)
        self.y, self.y_box = self.dual[:m], self.dual[m:]
        shifted = (self.z, block), (self.y, rows), (self.y_box, block)
        self._last = [(array, array.copy(), by) for array, by in shifted]
        self.known = False

    def remember(self, solution: Solution) -> None:
        """Store a copy of an answer's solution and multipliers for the next warm start."""
        answer = (solution.z, solution.y, solution.y_box)
        for (_, last, _), value in zip(self._last, answer, strict=True):
            last[:] = value
        self.known = True

    def advance(self) -> bool:
        """Shift the stored answer by one control increment; return whether there is one."""
        if self.known:
            for target, last, by in self._last:
                shift_into(target, last, by)
        return self.known


def stack_bound_rows(A: Matrix, n: int) -> Matrix:
    """Return [A; I] (m + n, n): bounds as rows, for a library without bounds."""
    return np.vstack([A, np.eye(n)])
