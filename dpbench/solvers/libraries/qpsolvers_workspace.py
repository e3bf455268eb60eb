"""The route through qpsolvers: one workspace for every library that qpsolvers has.

`setup` converts the constant matrices, `update` fills the vectors and builds the
`qpsolvers.Problem`, `solve` is `qpsolvers.solve_problem` and nothing else, `read` maps signs and
status. qpsolvers sets the library up anew at every solve.
"""

import warnings
from typing import Any

import numpy as np
from qpsolvers import Problem, solve_problem

from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.adapter import QpsolversAdapter
from dpbench.solvers.contract import (
    Options,
    Policy,
    Workspace,
    check_step,
    describe_exception_unless_interrupt,
    make_error_for_missing_setup,
    shift_into,
)
from dpbench.solvers.one_sided import OneSidedForm

IGNORE_ALL = ("ignore", None, Warning, None, 0)


class QpsolversWorkspace(Workspace):
    """A QP solver called through qpsolvers, which sets the library up anew at every solve."""

    def __init__(self, adapter: QpsolversAdapter, policy: Policy, options: Options) -> None:
        super().__init__(adapter.record.name, "qpsolvers", policy)
        self.form = adapter.record.form
        self._adapter, self._name = adapter, adapter.qpsolvers_key
        self._options: dict[str, Any] = {**adapter.fixed, **options}
        self._base: QuadraticProgram | None = None
        self._answer: Any = None
        self._failure, self._unread = "read before solve", False
        self._start: np.ndarray | None = None
        self._last: np.ndarray | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Store a QP in the library's form and discard earlier answers."""
        self.reset()
        self._store_qp_as_one_sided(qp.copy())

    def _store_qp_as_one_sided(self, qp: QuadraticProgram) -> None:
        """Store a QP, also with its two-sided limits as G z ≤ h, A z = b."""
        self._base = qp
        self._form = OneSidedForm(qp, self.form, self._adapter.box)
        self._create_qpsolvers_problem_of_step(qp.q, qp.l, qp.u)

    def _create_qpsolvers_problem_of_step(
        self, q: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> None:
        """Store a new problem of qpsolvers made of a step's vectors."""
        form = self._form
        form.write_step_vectors_as_one_sided(q, low, high)
        self._problem = Problem(form.P, form.q, form.G, form.h, form.A, form.b, form.lb, form.ub)

    def update(self, step: QPStep) -> None:
        """Store a step's vectors; convert again if matrices or infinite limits change."""
        base = self._base
        if base is None:
            raise make_error_for_missing_setup("update")
        check_step(step, base.n, base.m)
        if self.policy == "warm":
            self._start = self._shift_last_point_as_start(base.block)
        vectors_only = step.refresh is Refresh.VECTORS
        self.matrix_updates += not vectors_only
        if vectors_only and self._form.has_same_equal_and_infinite_limits(step.l, step.u):
            self._create_qpsolvers_problem_of_step(step.q, step.l, step.u)
        else:
            self._store_qp_as_one_sided(base.at(step).copy())

    def _shift_last_point_as_start(self, block: int) -> np.ndarray | None:
        """Return the previous z shifted by one control increment, as a start; None without one."""
        if self._unread:
            self.read()
        if self._last is None or block == 0:
            return self._last
        start = np.empty_like(self._last)
        shift_into(start, self._last, block)
        return start

    def solve(self) -> None:
        """Call qpsolvers and store its answer, or whatever it raises, for `read` to report."""
        self._answer, self._unread = None, True
        try:
            # Where all warnings are ignored already, as in a worker, a context costs time.
            if warnings.filters[:1] == [IGNORE_ALL]:
                self._answer = self._call_library_solve()
            else:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    self._answer = self._call_library_solve()
        except BaseException as error:
            self._failure = describe_exception_unless_interrupt(error)

    def _call_library_solve(self) -> Any:
        """Return the answer of qpsolvers' `solve_problem` with the start and all options."""
        return solve_problem(self._problem, self._name, initvals=self._start, **self._options)

    def read(self) -> Solution:
        """Return the answer, with multipliers converted to those of two-sided limits."""
        if self._base is None:
            raise make_error_for_missing_setup("read")
        n, m = self._base.n, self._base.m
        self._last, self._unread = None, False
        answer = self._answer
        if answer is None:
            return Solution.without_point(n, m, Status.ERROR, self._failure)
        status, iterations, reported_ns, detail = self._adapter.read_claim_from_qpsolvers_solution(
            answer, self._options
        )
        if status is Status.SOLVED:
            detail = ""
        absent = answer.x is None or np.shape(answer.x) != (n,)
        if absent or not (answer.found or self._adapter.iterate_when_not_found):
            return Solution.without_point(n, m, status, detail, (iterations, reported_ns))
        z = np.array(answer.x, dtype=np.float64)
        pair = self._form.convert_qpsolvers_multipliers(answer.z, answer.y, answer.z_box)
        y, y_box = (np.full(m, np.nan), np.full(n, np.nan)) if pair is None else pair
        if self.policy == "warm" and status.is_usable and np.isfinite(z).all():
            self._last = z.copy()
        return Solution(status, z, y, y_box, iterations, reported_ns, detail)

    def reset(self) -> None:
        """Discard the answer and the warm start."""
        self._answer, self._failure, self._unread = None, "read before solve", False
        self._start = self._last = None
