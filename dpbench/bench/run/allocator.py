"""The second half of a cascade in a closed loop: from a demanded force to forces of thrusters."""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.limits import ThrusterLimit
from dpbench.bench.run.qp_builder import QPBuilder
from dpbench.bench.run.timed_solver import (
    Clock,
    TimedSolver,
    is_usable,
    record_answer,
)
from dpbench.scenario.commanded_thrusters import Allocation


class Allocator:
    """Allocates at each sample, by a QP or by the pseudo-inverse, and keeps to all limits.

    Without a usable answer of the QP the pseudo-inverse acts.

    Parameters
    ----------
    allocation : of the scenario; builder : of the run; log : where answers and forces go.
    solver : of the QPs; None where the pseudo-inverse allocates.

    Attributes
    ----------
    f : (n_f,) forces of the thrusters now, always the same array [N].
    """

    def __init__(
        self,
        allocation: Allocation,
        builder: QPBuilder,
        log: RawLog,
        solver: TimedSolver | None,
        clock: Clock,
    ) -> None:
        problem = allocation.problem
        self.f = np.zeros(len(problem.df_max))
        self._builder, self._log, self._solver, self._clock = builder, log, solver, clock
        self._limit = ThrusterLimit(problem.rows, problem.df_max)
        losses = ((k, problem.pseudo_inverse(lost)) for k, _, _, lost in allocation.faults)
        self._inverses: list[tuple[int, Matrix]] = [(0, problem.pseudo_inverse()), *losses]

    def prepare(self) -> None:
        """Set up the solver before the first step."""
        answers = self._log.allocation
        if self._solver is not None and answers is not None:
            answers.setup_once_ns[0] = self._solver.prepare()

    def allocate(self, k: int, demand: Vector) -> int:
        """Bring f to what makes the demanded force (3,); the time between QP and answer [ns]."""
        log, f, spent_ns = self._log, self.f, 0
        missing = unfinished = False
        if self._solver is None:
            move = self._by_pseudo_inverse(k, demand)
        else:
            answer, unfinished, spent_ns = self._solved(k, demand, self._solver)
            missing = answer is None
            move = self._by_pseudo_inverse(k, demand) if answer is None else answer
        low, high = self._builder.f_min[k], self._builder.f_max[k]
        clipped = self._limit(f, move, low, high, log.thrust[k])
        f[...] = log.thrust[k]
        log.flags[k] |= np.array((missing, unfinished, clipped), dtype=np.uint8)
        return spent_ns

    def _solved(
        self, k: int, demand: Vector, solver: TimedSolver
    ) -> tuple[Vector | None, bool, int]:
        """Δf (n_f,) of the QP, None without a usable answer; if it is unfinished; its time [ns]."""
        builder, answers = self._builder.allocation, self._log.allocation
        assert builder is not None and answers is not None, "a QP allocates"
        t0 = self._clock()
        step = solver.formulate(self._builder.allocate(k, demand, self.f))
        t1 = self._clock()
        solution = solver.answer(step)
        spent_ns = self._clock() - t1
        answers.times[0, k] = (t1 - t0, *solver.phases_ns, -1)
        record_answer(answers, 0, k, solution, solver.waited_ns)
        answers.matrix_updates[0] = solver.matrix_updates
        if is_usable(solution):
            return builder.moves(solution.z), solution.status.is_unfinished, spent_ns
        solver.reset()
        return None, False, spent_ns

    def _by_pseudo_inverse(self, k: int, demand: Vector) -> Vector:
        """Δf (n_f,) to the forces of the pseudo-inverse, whatever the limits."""
        inverse = [inverse for since, inverse in self._inverses if since <= k][-1]
        move: Vector = inverse @ demand - self.f
        return move
