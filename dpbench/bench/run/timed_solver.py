"""The harness's side of a solver: its phases between two clock reads, its failures as data."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dpbench.bench.record.raw_log import AnswerLog
from dpbench.bench.run.formulation import Formulated
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status, is_plain, received
from dpbench.solvers.contract import Workspace

Clock = Callable[[], int]
UNFINISHED = frozenset({Status.INACCURATE, Status.MAX_ITERATIONS})
"""Of the usable answers those that are applied and marked."""


def is_usable(solution: Solution) -> bool:
    """Whether a closed loop can apply an answer: by its status, and all of z is finite."""
    return solution.status.usable and math.isfinite(solution.z.sum())


class TimedSolver:
    """The harness's side of a workspace: formulation, phases and failures of one solver.

    After `answer`, `phases_ns` holds set-up, update, solve and read of that step; −1 where a phase
    did not take place.
    """

    def __init__(self, workspace: Workspace, formulated: Formulated, clock: Clock) -> None:
        self._workspace, self._formulated, self._clock = workspace, formulated, clock
        # Nothing the solver gets is what it is judged against, nor what a later step is made of.
        self._whole, self._given = formulated.base, formulated.base.copy()
        # An emitted step in the formulation the solver gets; part of emitting it.
        self.formulate = formulated.step
        # n and m of the QP in that formulation.
        self.size = formulated.base.n, formulated.base.m
        self.phases_ns = (-1, -1, -1, -1)
        self.details: dict[str, int] = {}

    @property
    def matrix_updates(self) -> int:
        """Updates so far with which the workspace took over new matrices."""
        return self._workspace.matrix_updates

    def prepare(self) -> int:
        """Set up before the first step; the time it took [ns], −1 when steps do it themselves."""
        if self._workspace.setup_every_step:
            return -1
        started = self._clock()
        self._workspace.setup(self._given)
        return self._clock() - started

    def warm_up(self, times: int) -> None:
        """Solve the problem of the set-up so often, and forget it."""
        base = self._formulated.base
        for _ in range(times):
            self.answer(QPStep(base.q, base.l, base.u).copy())
        self.reset()
        self.details.clear()

    def answer(self, step: QPStep) -> Solution:
        """Solve one step and map the answer to the condensed QP; never raises for a solver.

        An answer that is malformed is none, with the status ERROR.
        """
        workspace, clock, formulated = self._workspace, self._clock, self._formulated
        t1 = t2 = t3 = t0 = -1
        setup_every_step, (n, m) = workspace.setup_every_step, self.size
        qp = self._problem(step) if setup_every_step else self._given
        try:
            t0 = clock()
            if setup_every_step:
                workspace.setup(qp)
            else:
                workspace.update(step)
            t1 = clock()
            workspace.solve()
            t2 = clock()
            solution = workspace.read()
            t3 = clock()
            # Looking at a plain answer is no work of the solver's; what any other does is.
            if not is_plain(solution, n, m):
                solution = received(solution, n, m)
                t3 = clock()
        # An adapter that raises is a failed solve of that solver, which is data of the run.
        except Exception as error:
            now = clock()
            t1, t2, t3 = (now if t < 0 else t for t in (t1, t2, t3))
            detail = f"{type(error).__name__}: {error}"
            solution = Solution.missing(n, m, Status.ERROR, detail)
        prepared = t1 - t0
        handed_over = (prepared, -1) if setup_every_step else (-1, prepared)
        self.phases_ns = (*handed_over, t2 - t1, t3 - t2)
        if solution.detail:
            self.details[solution.detail] = self.details.get(solution.detail, 0) + 1
        return formulated.solution(solution)

    def _problem(self, step: QPStep) -> QuadraticProgram:
        """The whole problem of a step, with matrices as they were before a solver wrote to them."""
        if self._formulated.base is not self._whole:
            self._whole = self._formulated.base
            self._given = self._whole.copy()
        whole, given = self._whole, self._given
        np.copyto(given.P, whole.P)
        np.copyto(given.A, whole.A)
        np.copyto(given.lb, whole.lb)
        np.copyto(given.ub, whole.ub)
        return given.at(step)

    def reset(self) -> None:
        """Make the workspace forget an answer that was not usable."""
        try:
            self._workspace.reset()
        except Exception as error:
            detail = f"reset: {type(error).__name__}: {error}"
            self.details[detail] = self.details.get(detail, 0) + 1


def record_answer(log: AnswerLog, r: int, k: int, solution: Solution) -> None:
    """Copy an answer into row (r, k) of the log."""
    log.status[r, k] = solution.status
    log.iterations[r, k] = solution.iterations
    log.reported_ns[r, k] = solution.reported_ns
    log.z[r, k] = solution.z
    log.y[r, k] = solution.y
    log.y_box[r, k] = solution.y_box
