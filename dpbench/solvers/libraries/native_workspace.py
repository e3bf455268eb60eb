"""The common base of native workspaces: data, life cycle and failures.

    setup     copies the problem and makes a new library object from the copies
    update    fresh: the same; else the vectors go to the library
    solve     the library's own call
    read      one `Solution`, copied out of the library's memory

A library object that raised, or left no usable answer, is made anew before the next step.
"""

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
    SolverRecord,
    Workspace,
    check_step,
    describe_exception_unless_interrupt,
    make_error_for_missing_setup,
    shift_into,
)
from dpbench.solvers.one_sided import OneSidedForm

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
    _start: "WarmStart"

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record.name, "native", policy)
        self.form = record.form
        self._library: Any = import_module(record.module)
        self.setup_every_step = policy == "fresh"
        self._warm = policy == "warm"
        self._given_start = self._warm and record.get_route_record("native").start != "active set"
        self._options = dict(options)
        self._n, self._m, self._block = -1, -1, 0
        self._stages: tuple[tuple[int, int], ...] = ()
        self._converted = self._used = False
        self._matrices_given: tuple[Matrix, ...] = ()
        self._done = self._unread = self._unusable = False
        self._failure = ""

    def _prepare_matrices_for_library(self) -> None:
        """Store new matrices P, A and bounds lb, ub in the library's form."""

    @abstractmethod
    def _create_library_solver(self) -> None:
        """Store a new library object made of the converted matrices, linear cost and limits."""

    @abstractmethod
    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's linear cost q and row limits to the library, in place."""

    def _send_new_matrices_to_library(self) -> bool:
        """Pass changed P, A, lb or ub to the library in place; return whether it takes them."""
        return False

    def _call_library_solve(self) -> None:
        """Call the library's solve function."""
        self._result = self._solver.solve()

    @abstractmethod
    def _read_status_iterations_and_time(self) -> Claim:
        """Return the status, iterations and time [ns] that the library reports."""

    @abstractmethod
    def _copy_solution_and_multipliers(self) -> Point | None:
        """Return copies of solution z and multipliers y, y_box; None if there are none."""

    def _set_options_on_library_settings(self, settings: Any) -> None:
        """Set each option as an attribute of the library's settings object, in place."""
        for name, value in self._options.items():
            setattr(settings, name, value)

    def _allocate_limits_of_rows_and_bounds(self) -> tuple[Vector, Vector]:
        """Return new limits (m + n,) of rows and bounds together, with the bounds written in."""
        rows = np.empty(self._m)
        return np.concatenate([rows, self._lb]), np.concatenate([rows, self._ub])

    def _create_library_solver_for_step(self, q: Vector, low: Vector, high: Vector) -> None:
        """Store a step's vectors and a new library object made of them."""
        self._q[:], self._l[:], self._u[:] = q, low, high
        self._create_library_solver_unstarted()

    def _create_library_solver_unstarted(self) -> None:
        """Discard the warm start and store a new library object."""
        if self._given_start:
            self._start = WarmStart(self._n, self._m, self._block)
        self._create_library_solver()

    def _shift_warm_start_if_any(self) -> bool:
        """Shift the stored warm start by one increment in place; return whether there is one."""
        return self._given_start and self._start.shift_stored_answer_if_any()

    def setup(self, qp: QuadraticProgram) -> None:
        """Store a copy of the QP and a new library object; discard earlier answers."""
        self._clear_answer_state()
        self._q, self._l, self._u = qp.q.copy(), qp.l.copy(), qp.u.copy()
        order = (self._block, self._stages) == (qp.block, qp.stages)
        if not (self._converted and order and self._has_same_matrices_and_bounds(qp)):
            self._n, self._m, self._block, self._stages = qp.n, qp.m, qp.block, qp.stages
            self._P, self._A = qp.P.copy(), qp.A.copy()
            self._lb, self._ub = qp.lb.copy(), qp.ub.copy()
            self._matrices_given = qp.P, qp.A, qp.lb, qp.ub
            self._converted = False
        self._recreate_solver_or_record_failure()

    def _has_same_matrices_and_bounds(self, qp: QuadraticProgram) -> bool:
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
        """Pass new vectors and matrices to the library, or make a new object that takes them.

        A start that is passed to the library outlives its object.
        """
        n, m = self._n, self._m
        if n < 0:
            raise make_error_for_missing_setup("update")
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
            is_taken = not (self._unusable or self.setup_every_step) and self._try_new_matrices()
            if not is_taken and not self._recreate_solver_with_known_start():
                return
        try:
            self._send_step_vectors_to_library(q, low, high)
        except BaseException as error:
            self._record_exception_and_mark_unusable(error)

    def _try_new_matrices(self) -> bool:
        """Pass new matrices to the library object; return whether it has taken them."""
        try:
            self._converted = self._send_new_matrices_to_library()
        except BaseException as error:
            self._record_exception_and_mark_unusable(error)
        return self._converted

    def _recreate_solver_with_known_start(self) -> bool:
        """Store a new library object; return whether it gets the start of the one before."""
        start = self._start if self._given_start and not self._unusable else None
        self._recreate_solver_or_record_failure()
        if self._failure or start is None:
            return False
        self._start.copy_answer_of(start)
        return True

    def _recreate_solver_or_record_failure(self) -> None:
        """Store a new library object, or an exception of the library as the solve's failure."""
        self._unusable = self._used = False
        self._failure = ""
        try:
            if not self._converted:
                self._prepare_matrices_for_library()
                self._converted = True
            self._create_library_solver_unstarted()
        except BaseException as error:
            self._record_exception_and_mark_unusable(error)

    def _record_exception_and_mark_unusable(self, error: BaseException) -> None:
        """Store an exception's text and mark the library object as unusable."""
        self._failure, self._unusable = describe_exception_unless_interrupt(error), True

    def solve(self) -> None:
        """Call the library's solver; store an exception, for `read` to report."""
        if self._failure:
            return
        self._done = self._unread = self._used = True
        try:
            self._call_library_solve()
        except BaseException as error:
            self._record_exception_and_mark_unusable(error)

    def read(self) -> Solution:
        """Return the solver's answer; after a failure, have a new library object made next."""
        if self._n < 0:
            raise make_error_for_missing_setup("read")
        if self._failure:
            self._unread = False
            return Solution.without_point(self._n, self._m, Status.ERROR, self._failure)
        if not self._done:
            return Solution.without_point(self._n, self._m, Status.ERROR, NOT_SOLVED)
        status, iterations, reported_ns, detail = self._read_status_iterations_and_time()
        detail = "" if status is SOLVED else detail
        point = self._copy_solution_and_multipliers() if status.is_usable else None
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
                self._store_answer_as_warm_start(solution)
        return solution

    def _store_answer_as_warm_start(self, solution: Solution) -> None:
        """Store an answer as the next warm start, unless the library keeps it itself."""
        if self._given_start:
            self._start.store_copy_of_answer(solution)

    def reset(self) -> None:
        """Discard the warm start by a new library object, unless the present one was not used."""
        stale = self._used or self._unusable
        self._clear_answer_state()
        if stale and not self.setup_every_step:
            self._recreate_solver_or_record_failure()

    def _clear_answer_state(self) -> None:
        """Discard the state of the latest answer and its failure."""
        self._done = self._unread = self._unusable = False
        self._failure = ""


class OneSidedWorkspace(NativeWorkspace):
    """Base of solvers of A z = b, G z ≤ h, made anew where other rows are equal or infinite."""

    _form: OneSidedForm

    @abstractmethod
    def _create_one_sided_library_solver(self) -> None:
        """Store a new library object made of the QP with A z = b, G z ≤ h."""

    @abstractmethod
    def _send_one_sided_vectors_to_library(self) -> None:
        """Pass the linear cost q and right-hand sides b, h to the library."""

    def _prepare_one_sided_matrices(self) -> None:
        """Store P, A and G of a QP with A z = b, G z ≤ h in the library's form."""

    def _prepare_matrices_for_library(self) -> None:
        """Store the QP with two-sided limits as A z = b, G z ≤ h."""
        qp = QuadraticProgram(
            self._P, self._q, self._A, self._l, self._u, self._lb, self._ub, self._block
        )
        self._form = OneSidedForm(qp, "dense", "rows")
        self._prepare_one_sided_matrices()

    def _create_library_solver(self) -> None:
        """Store a new library object; convert the QP again if other limits are infinite."""
        if not self._form.has_same_equal_and_infinite_limits(self._l, self._u):
            self._prepare_matrices_for_library()
        self._form.write_step_vectors_as_one_sided(self._q, self._l, self._u)
        self._create_one_sided_library_solver()

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass a step's vectors to the library; make a new object if other limits are infinite."""
        if self._form.has_same_equal_and_infinite_limits(low, high):
            self._form.write_step_vectors_as_one_sided(q, low, high)
            self._send_one_sided_vectors_to_library()
        else:
            self._create_library_solver_for_step(q, low, high)

    def _stack_equality_and_inequality_rows(self) -> tuple[Matrix, int, int]:
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

    def store_copy_of_answer(self, solution: Solution) -> None:
        """Store a copy of an answer's solution and multipliers for the next warm start."""
        answer = (solution.z, solution.y, solution.y_box)
        for (_, last, _), value in zip(self._last, answer, strict=True):
            last[:] = value
        self.known = True

    def copy_answer_of(self, other: "WarmStart") -> None:
        """Take over the stored answer of another start of the same sizes."""
        for (_, last, _), (_, value, _) in zip(self._last, other._last, strict=True):
            last[:] = value
        self.known = other.known

    def shift_stored_answer_if_any(self) -> bool:
        """Shift the stored answer by a control increment in place; return whether there is one."""
        if self.known:
            for target, last, by in self._last:
                shift_into(target, last, by)
        return self.known


def append_identity_rows_for_bounds(A: Matrix, n: int) -> Matrix:
    """Return [A; I] (m + n, n): bounds as rows, for a library without bounds."""
    return np.vstack([A, np.eye(n)])
