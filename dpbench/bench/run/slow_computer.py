"""A slow computer, and answers that come late (method.md section 3); time is simulated.

An answer computed from the state at t_k has the latency L = slow-down × measured step time
(set-up + update + solve + read). Where the kernel meanwhile gave the processor to others, which is
this machine's doing and would be slowed down with it, the processor time stands for it. Within the
budget the answer is applied at t_k itself, over [t_k, t_{k+1}): the convention of the ordinary
loop, in which every answer is. Beyond the budget its deadline is missed, and it arrives at the
first sample instant at or after t_k + L, that is at step k + ⌈L / T_s⌉ and never before k + 1.
Until then the fallback steers, and no other computation begins: there is one processor. A step
without an answer in time is a miss, whether its own computation was late or none could begin.

A plan that arrives i samples late is entered at the force it has after its move number i + 1, as a
planned input trajectory is in delayed predictive control (Findeisen & Allgöwer 2004, "Computational
delay in nonlinear model predictive control"): its moves before were planned from a force that other
moves have meanwhile changed, so that move alone would not lead to the force it was planned for.
After N_c moves the planned force stays. If the answer to the QP of that very step is in time too,
it supersedes the late one.
"""

from __future__ import annotations

import resource
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.bench.record.cell import SLOWEST, Cell
from dpbench.bench.record.raw_log import spent_ns
from dpbench.bench.run.fallback import FallbackLaw
from dpbench.bench.run.qp_builder import QPBuilder
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.errors import InputError
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Solution, Status

Usage = Callable[[], tuple[int, int]]
"""Counts so far: how often the kernel took the processor away, and processor time used [ns]."""
WARM_UP_SOLVES = 3
"""Solves before the first step: what a library does once, when first called, is no latency."""
NOT_RUN = (-1, -1, -1, -1)
NO_STEP = QPStep(np.empty(0), np.empty(0), np.empty(0))
"""Stands for the QP of a step in which the processor is busy."""


@dataclass(frozen=True)
class ComputationalDelay:
    """How slow the computer is, and how long it may take.

    slowdown : ≥ 1; budget_ns : of a step; sample_ns : between two steps.
    """

    slowdown: float
    budget_ns: int
    sample_ns: int

    @property
    def simulated(self) -> bool:
        """Whether answers may arrive late; without a slow-down the loop waits for each."""
        return self.slowdown > 0.0

    def latency_ns(self, spent_ns: int) -> int:
        """Latency of an answer that took so long here; at most what 64 bits hold."""
        return round(min(self.slowdown * spent_ns, 2.0**62))

    def samples_late(self, latency_ns: int) -> int:
        """Samples until an answer can be applied; 0 for one in time."""
        if latency_ns <= self.budget_ns:
            return 0
        return max(1, -(-latency_ns // self.sample_ns))


def usage_of_process() -> tuple[int, int]:
    """Involuntary context switches and processor time [ns] of this process (getrusage)."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_nivcsw, round(1e9 * (usage.ru_utime + usage.ru_stime))


def never_preempted() -> tuple[int, int]:
    """Nobody else wants the processor."""
    return 0, 0


def delay_of(cell: Cell, sample_s: float) -> ComputationalDelay:
    """The delay of a closed-loop cell; InputError for one that cannot be."""
    slowdown, deadline_s = cell.slowdown, cell.deadline_s
    if not (slowdown == 0.0 or 1.0 <= slowdown <= SLOWEST):
        raise InputError("closed loop", "slowdown", slowdown, f"0 (off), or 1 to {SLOWEST:g}")
    if not 0.0 <= deadline_s <= sample_s:
        allowed = f"a budget within the sample of {sample_s:g} s; 0 for the sample itself"
        raise InputError("closed loop", "deadline_s", deadline_s, allowed)
    return ComputationalDelay(
        slowdown, round((deadline_s or sample_s) * 1e9), round(sample_s * 1e9)
    )


class SlowComputer:
    """Solver and fallback of a loop on one slow processor; stands in for both in the loop.

    Parameters
    ----------
    delay : how slow; solver : timed; builder : of the run; law : what acts without an answer.
    latency_ns : (K,) where the latency of each answer goes, −1 where no computation began.
    usage : what the kernel says of this process.

    Attributes
    ----------
    phases_ns : as of `TimedSolver`, all −1 in a step in which no computation began.
    acted : whether the last move was the fallback's, and not one of an answer that is in time or
        arrived just now.
    """

    def __init__(
        self,
        delay: ComputationalDelay,
        solver: TimedSolver,
        builder: QPBuilder,
        law: FallbackLaw,
        latency_ns: Ints,
        usage: Usage,
    ) -> None:
        self._delay, self._solver, self._builder, self._law = delay, solver, builder, law
        self._usage, self._latency_ns = usage, latency_ns
        latency_ns[:] = -1
        n, m, *_ = builder.sizes
        self._nothing = Solution.missing(n, m, Status.UNKNOWN)
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
        self.phases_ns, self.acted = NOT_RUN, False

    @property
    def matrix_updates(self) -> int:
        """Those of the solver."""
        return self._solver.matrix_updates

    def prepare(self) -> int:
        """Set up as `TimedSolver.prepare`, then solve without a record until nothing is cold."""
        spent = self._solver.prepare()
        self._solver.warm_up(WARM_UP_SOLVES)
        return spent

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """The QP of step k; `NO_STEP` while the processor is busy. A plan that is due arrives."""
        self._k, self._x, self._u = k, x, u_prev
        self._busy = k < self._free
        self._arrived = not self._busy and self._coming is not None
        if self._arrived:
            self._plan, self._since, self._coming = self._coming, self._started, None
        return NO_STEP if self._busy else self._builder.emit(k, x, u_prev)

    def formulate(self, step: QPStep) -> QPStep:
        """The step in the formulation of the solver."""
        return step if self._busy else self._solver.formulate(step)

    def answer(self, step: QPStep) -> Solution:
        """Solve, however long it takes; without a computation, no answer."""
        if self._busy:
            self.phases_ns = NOT_RUN
            return self._nothing
        switches, used_ns = self._usage()
        solution = self._solver.answer(step)
        switches_after, used_after_ns = self._usage()
        self.phases_ns = self._solver.phases_ns
        step_ns = spent_ns(self.phases_ns)
        if switches_after > switches:
            step_ns = min(step_ns, used_after_ns - used_ns)
        latency_ns = self._delay.latency_ns(step_ns)
        samples = self._delay.samples_late(latency_ns)
        self._latency_ns[self._k] = latency_ns
        self._late = samples > 0
        self._started, self._free = self._k, self._k + max(1, samples)
        return solution

    def remember(self, moves: Matrix) -> Vector:
        """Take the usable plan (N_c, n_u) of this step; Δu (n_u,) of what is at hand by now."""
        if self._late:
            self._coming = self._u + np.cumsum(moves, axis=0)
            return self._go_on()
        self._plan, self.acted = None, False
        return self._law.remember(moves)

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Δu (n_u,) in a step that has no usable answer of its own."""
        del x, y_ref, u_prev  # those of the step are known from `emit`
        return self._go_on()

    def reset(self) -> None:
        """As `TimedSolver.reset`, unless the solver was not asked."""
        if not self._busy:
            self._solver.reset()

    def _go_on(self) -> Vector:
        """Δu (n_u,) without an answer in time: of the plan that arrives now, or the fallback's."""
        self.acted = not self._arrived
        if self._plan is not None and (self._arrived or self._law.kind == "shifted_plan"):
            age = min(self._k - self._since, len(self._plan) - 1)
            to_plan: Vector = self._plan[age] - self._u
            return to_plan
        return self._law.move(self._x, self._builder.reference[self._k], self._u)
