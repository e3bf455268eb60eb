"""A slow computer, and answers that come late (docs/method.md); time is simulated.

An answer computed from the state at t_k has the latency L = slowdown × measured step time (set-up
+ update + solve + read), or × processor time where the kernel meanwhile gave the processor to
others. Within the budget it is applied at t_k itself; beyond it at step k + ⌈L / T_s⌉, never before
k + 1. Until then the fallback steers and, on one processor, no other computation begins.

A plan that arrives i samples late is entered at the force it has after its move number i + 1, as in
delayed predictive control (Findeisen & Allgöwer 2004, "Computational delay in nonlinear model
predictive control"); after N_c moves the planned force stays. An answer to the QP of that very step
supersedes it.

With a backup nothing is computed beyond the sample; docs/method.md states when it begins.
"""

import resource
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from numbers import Real

import numpy as np

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.bench.record.cell import SLOWEST, Cell
from dpbench.bench.record.raw_log import sum_phases_of_step_ns
from dpbench.bench.run.backup import WARM_UP_SOLVES, Backup, FallbackPolicy
from dpbench.bench.run.formulation import QPBuilder
from dpbench.bench.run.timed_solver import TimedSolver, is_usable
from dpbench.errors import InputError, require_type
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Solution, Status

Usage = Callable[[], tuple[int, int]]
"""Counts so far: involuntary switches, and processor time used [ns]."""
NOT_RUN = (-1, -1, -1, -1)
NO_STEP = QPStep(np.empty(0), np.empty(0), np.empty(0))
"""Placeholder for the QP of a step in which the processor is busy."""


@dataclass(frozen=True)
class ComputationalDelay:
    """Slowdown of a simulated ship's computer, budget of a step and sample time [ns]."""

    slowdown: float
    budget_ns: int
    sample_ns: int

    @property
    def is_simulated(self) -> bool:
        """Return whether a slow computer is simulated, whose answers may arrive late."""
        return self.slowdown > 0.0

    def simulate_latency_ns(self, spent_ns: int) -> int:
        """Return the simulated latency [ns] of an answer computed here in `spent_ns` [ns]."""
        return round(min(self.slowdown * spent_ns, 2.0**62))

    def count_samples_late(self, latency_ns: int) -> int:
        """Return the number of samples until an answer of this latency applies; 0 if in time."""
        if latency_ns <= self.budget_ns:
            return 0
        return max(1, -(-latency_ns // self.sample_ns))


def read_process_usage() -> tuple[int, int]:
    """Return this process's involuntary context switches and processor time [ns]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_nivcsw, round(1e9 * (usage.ru_utime + usage.ru_stime))


def return_zero_usage() -> tuple[int, int]:
    """Return (0, 0), the usage of a process that is never interrupted."""
    return 0, 0


def make_delay_of_cell(cell: Cell, sample_s: float) -> ComputationalDelay:
    """Return a closed-loop run's computer slowdown and deadline; InputError if impossible.

    Raises TypeError for one that is no number.
    """
    slowdown, deadline_s = cell.slowdown, cell.deadline_s
    allowed = f"0 (off), or 1 to {SLOWEST:g}"
    require_type("closed loop: slowdown", slowdown, Real, allowed)
    if not (slowdown == 0.0 or 1.0 <= slowdown <= SLOWEST):
        raise InputError("closed loop", "slowdown", slowdown, allowed)
    most = f"the sample time of {sample_s:g} s; or 0 for the sample time itself"
    allowed = f"above 0 and at most {most}"
    require_type("closed loop: deadline_s", deadline_s, Real, allowed)
    if not 0.0 <= deadline_s <= sample_s:
        raise InputError("closed loop", "deadline_s", deadline_s, allowed)
    return ComputationalDelay(
        slowdown, round((deadline_s or sample_s) * 1e9), round(sample_s * 1e9)
    )


class SlowComputer:
    """Solver and fallback of a loop on one slow processor, whose answers may arrive late.

    `latency_ns` (K,) receives the latency of each answer, −1 where no computation began. `backup`
    acts where the solver fails or is stopped at its deadline. `phases_ns` and `waited_ns` are as of
    `TimedSolver`; `acted` is whether the last move was not of an answer in time or just arrived.
    """

    def __init__(
        self,
        delay: ComputationalDelay,
        solver: TimedSolver,
        builder: QPBuilder,
        law: FallbackPolicy,
        latency_ns: Ints,
        usage: Usage,
        *,
        backup: Backup | None = None,
    ) -> None:
        self._delay, self._solver, self._builder, self._law = delay, solver, builder, law
        self._usage, self._latency_ns, self._backup = usage, latency_ns, backup
        # Of an earlier process, which hung: its answers are repeated, so they come as late again.
        self._recorded_ns = latency_ns.copy()
        latency_ns[:] = -1
        n, m, *_ = builder.sizes
        self._nothing = Solution.without_point(n, m, Status.UNKNOWN)
        model = builder.condensed.control.model
        self._k, self._x, self._u = 0, np.zeros(model.n_x), np.zeros(model.n_u)
        # The step at which the processor is free, and the plan that arrives then.
        self._free = 0
        self._coming: Matrix | None = None
        # Forces (N_c, n_u) of a plan that arrived late, and the step it was computed in; None when
        # a later one was in time, which the fallback follows as it always does.
        self._plan: Matrix | None = None
        self._since = self._started = 0
        self._busy = self._late = self._arrived = False
        # Of the backup: the plan that is there in time, whether the solver was stopped for it, and
        # whether the late plan that comes or has arrived is its.
        self._in_place: Matrix | None = None
        self._stopped = self._of_backup = self._of_backup_arrived = False
        self.phases_ns, self.waited_ns, self.acted = NOT_RUN, 0, False

    def prepare(self) -> int:
        """Set up and warm up solver and backup; return the set-up time [ns]."""
        spent = self._solver.prepare()
        self._solver.warm_up(WARM_UP_SOLVES)
        if self._backup is not None:
            self._backup.warm_up()
        return spent

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """Return step k's QP, or `NO_STEP` while the processor is busy; let a late plan arrive."""
        self._k, self._x, self._u = k, x, u_prev
        self._busy = k < self._free
        self._arrived = not self._busy and self._coming is not None
        if self._arrived:
            self._plan, self._since, self._coming = self._coming, self._started, None
            self._of_backup_arrived = self._of_backup
        return NO_STEP if self._busy else self._builder.emit(k, x, u_prev)

    def formulate(self, step: QPStep) -> QPStep:
        """Return a step's QP in the formulation of the solver."""
        return step if self._busy else self._solver.formulate(step)

    def answer(self, step: QPStep) -> Solution:
        """Solve a step's QP however long it takes; return no answer while the processor is busy."""
        if self._busy:
            self.phases_ns, self.waited_ns = NOT_RUN, 0
            return self._nothing
        solution, latency_ns = self._time_answer(self._solver, self._solver.answer, step)
        self.phases_ns, self.waited_ns = self._solver.phases_ns, self._solver.waited_ns
        samples = self._delay.count_samples_late(latency_ns)
        self._latency_ns[self._k] = latency_ns
        self._late = samples > 0
        self._started, self._free = self._k, self._k + max(1, samples)
        if self._backup is not None:
            self._in_place, self._stopped = None, False
            begins_ns = min(latency_ns, self._delay.budget_ns)
            missing = self._late or not is_usable(solution)
            if missing and begins_ns < self._delay.sample_ns:
                self._solve_by_backup(self._backup, step, begins_ns)
        return solution

    def _time_answer(
        self, solver: TimedSolver, answer: Callable[[QPStep], Solution], step: QPStep
    ) -> tuple[Solution, int]:
        """Return a solver's answer and its simulated latency [ns]."""
        switches, used_ns = self._usage()
        solution = answer(step)
        switches_after, used_after_ns = self._usage()
        step_ns = sum_phases_of_step_ns(solver.phases_ns)
        if solver.repeated:
            recorded_ns = int(self._recorded_ns[self._k])
            # The step that hung has none yet; it took its whole limit.
            return solution, recorded_ns if recorded_ns >= 0 else self._delay.simulate_latency_ns(
                step_ns
            )
        if switches_after > switches:
            step_ns = min(step_ns, used_after_ns - used_ns)
        return solution, self._delay.simulate_latency_ns(step_ns)

    def _solve_by_backup(self, backup: Backup, step: QPStep, begins_ns: int) -> None:
        """Solve a step by the backup, `begins_ns` after t_k; store its plan where it is in time."""
        solve, recorded_ns = partial(backup.answer, self._k), -1
        answer, latency_ns = self._time_answer(backup.solver, solve, step)
        if self._solver.repeated:
            # The step that hung has none yet.
            recorded_ns = int(backup.recorded_ready_ns[self._k])
        ready_ns = recorded_ns if recorded_ns >= 0 else begins_ns + latency_ns
        plan = backup.log_answer_and_return_moves(self._k, answer)
        backup.log.ready_ns[self._k] = ready_ns
        self._stopped, self._free = self._late, self._k + 1
        if plan is None or ready_ns > self._delay.sample_ns:
            return
        if ready_ns <= self._delay.budget_ns:
            self._in_place = plan
        else:
            self._store_late_plan(plan, of_backup=True)

    def _store_late_plan(self, moves: Matrix, *, of_backup: bool) -> None:
        """Store a plan (N_c, n_u) to be applied when the processor is free."""
        self._coming, self._of_backup = self._u + np.cumsum(moves, axis=0), of_backup

    def remember(self, moves: Matrix) -> Vector:
        """Store a usable plan (N_c, n_u) of this step; return the Δu (n_u,) to apply now."""
        if self._stopped:
            self._solver.reset()
            return self._move_without_answer()
        if self._late:
            self._store_late_plan(moves, of_backup=False)
            return self._move_without_answer()
        self._plan, self.acted = None, False
        return self._law.remember(moves)

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) in a step without a usable answer to its own QP."""
        del x, y_ref, u_prev  # those of the step are known from `emit`
        if self._busy or self._in_place is None:
            return self._move_without_answer()
        self._plan = None
        self._record_backup_move()
        return self._law.remember(self._in_place)

    def _record_backup_move(self) -> None:
        """Record that the backup's plan moves the ship in this step."""
        assert self._backup is not None, "a plan of its is at hand"
        self.acted = True
        self._backup.log.acted[self._k] = 1

    def reset(self) -> None:
        """Reset the solver, unless no computation began in this step."""
        if not self._busy:
            self._solver.reset()

    def _move_without_answer(self) -> Vector:
        """Return Δu (n_u,) of the late plan that arrives now, or of the fallback."""
        self.acted = not self._arrived
        if self._arrived and self._of_backup_arrived:
            self._record_backup_move()
        if self._plan is not None and (self._arrived or self._law.follows_plans):
            age = min(self._k - self._since, len(self._plan) - 1)
            to_plan: Vector = self._plan[age] - self._u
            return to_plan
        return self._law.move(self._x, self._builder.reference[self._k], self._u)
