"""The move of a step without a usable answer in time: by a backup solver, or a fallback policy.

The backup gets the QP of that very step, is set up from nothing for it, and is timed by itself.
Where it has no usable answer either, the fallback acts (docs/method.md). A late answer is
treated in `slow_computer.py`; of a cascade, the backup is one of its first QP alone.
"""

from collections.abc import Callable, Collection

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import DEFAULT_FALLBACK
from dpbench.bench.record.raw_log import BackupLog
from dpbench.bench.run.timed_solver import TimedSolver, is_usable, record_answer
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Solution

Law = Callable[[Vector, Vector, Vector], Vector]
"""Δu (n_u,) of the unconstrained law at x (n_x,), y_ref (n_y,) and u(k−1) (n_u,)."""
WARM_UP_SOLVES = 3
"""Solves before the first step: work of a library's first call is no latency."""


class FallbackPolicy:
    """Policy for the move of a step without a usable answer; this one holds the force.

    `acted` is whether the last move was one; `follows_plans` whether a late plan is followed too.
    """

    follows_plans = False

    def __init__(self, N_c: int, n_u: int, law: Law) -> None:
        self.acted = False
        self._plan: Matrix = np.zeros((N_c, n_u))
        self._age, self._law = N_c, law

    def remember(self, plan: Matrix) -> Vector:
        """Store a usable plan (N_c, n_u) and return its first move."""
        self._plan, self._age, self.acted = plan, 0, False
        first: Vector = plan[0]
        return first

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) for a step without a usable answer: zero, which holds the force."""
        self.acted = True
        return np.zeros(self._plan.shape[1])


class ShiftedPlan(FallbackPolicy):
    """A fallback that plays on the last usable plan's increments, then holds the force."""

    follows_plans = True

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,): the next move of the last usable plan, zero after its end."""
        hold = super().move(x, y_ref, u_prev)
        self._age += 1
        return self._plan[self._age] if self._age < len(self._plan) else hold


class Clip(FallbackPolicy):
    """A fallback that applies the unconstrained control law; the loop clips it to the limits."""

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) of the unconstrained law, for a step without a usable answer."""
        self.acted = True
        return self._law(x, y_ref, u_prev)


FALLBACKS: dict[str, type[FallbackPolicy]] = {
    DEFAULT_FALLBACK: ShiftedPlan,
    "hold": FallbackPolicy,
    "clip": Clip,
}


class Backup:
    """The backup solver of a closed loop, with the log of its answers.

    `solver` is set up at every step; `moves` maps z to the plan (N_c, n_u). In steps `hung` it hung
    in an earlier process, each for `limit_ns`; `recorded_ready_ns` (K,) is when its answers were
    ready.
    """

    def __init__(
        self,
        solver: TimedSolver,
        moves: Callable[[Vector], Matrix],
        log: BackupLog,
        *,
        hung: Collection[int] = (),
        limit_ns: int = 0,
    ) -> None:
        self.solver, self.log, self._moves = solver, log, moves
        self._hung, self._limit_ns = hung, limit_ns
        self.recorded_ready_ns = log.ready_ns.copy()
        log.times[:], log.ready_ns[:] = -1, -1

    def warm_up(self) -> None:
        """Let the backup solve some unrecorded QPs, so that the first real one is not slow."""
        self.solver.warm_up(WARM_UP_SOLVES)

    def solve_to_moves_or_none(self, k: int, step: QPStep) -> Matrix | None:
        """Solve the QP of step k and return its moves (N_c, n_u); None without a usable answer."""
        return self.log_answer_and_return_moves(k, self.answer(k, step))

    def answer(self, k: int, step: QPStep) -> Solution:
        """Return the backup solver's answer to step k; none where it hung in an earlier process."""
        if k in self._hung:
            return self.solver.answer_hung_step(self._limit_ns)
        return self.solver.answer(step)

    def log_answer_and_return_moves(self, k: int, answer: Solution) -> Matrix | None:
        """Record the backup's answer to step k; return its moves (N_c, n_u), None if unusable."""
        record_answer(self.log, 0, k, answer, self.solver.waited_ns)
        self.log.times[0, k] = (-1, *self.solver.phases_ns, -1)
        if is_usable(answer):
            return self._moves(answer.z)
        self.solver.reset()
        return None


class LoopWithBackup:
    """Solver, backup solver and fallback of a closed loop that waits for every answer."""

    def __init__(
        self,
        solver: TimedSolver,
        backup: Backup,
        law: FallbackPolicy,
        emit: Callable[[int, Vector, Vector], QPStep],
    ) -> None:
        self._solver, self._backup, self._law, self._emit = solver, backup, law, emit
        self.formulate, self.reset = solver.formulate, solver.reset
        self._k, self.acted = 0, False
        self._plan: Matrix | None = None

    @property
    def phases_ns(self) -> tuple[int, ...]:
        """Times of the main solver's set-up, update, solve and read in the last step [ns]."""
        return self._solver.phases_ns

    @property
    def waited_ns(self) -> int:
        """Time waited for the core in the main solver's last answer [ns]; −1 if unknown."""
        return self._solver.waited_ns

    def prepare(self) -> int:
        """Warm up the backup and set up the main solver; return the set-up time [ns]."""
        self._backup.warm_up()
        return self._solver.prepare()

    def emit(self, k: int, x: Vector, u_prev: Vector) -> QPStep:
        """Return the MPC QP of step k for state x (n_x,) and previous input u_prev (n_u,)."""
        self._k = k
        return self._emit(k, x, u_prev)

    def answer(self, step: QPStep) -> Solution:
        """Return the main solver's answer; if it is unusable, let the backup solve the step."""
        solution = self._solver.answer(step)
        self._plan = (
            None if is_usable(solution) else self._backup.solve_to_moves_or_none(self._k, step)
        )
        return solution

    def remember(self, plan: Matrix) -> Vector:
        """Store the main solver's plan (N_c, n_u) and return its first move."""
        self.acted = False
        return self._law.remember(plan)

    def move(self, x: Vector, y_ref: Vector, u_prev: Vector) -> Vector:
        """Return Δu (n_u,) of the backup's plan, or of the fallback where it has none."""
        self.acted = True
        if self._plan is None:
            return self._law.move(x, y_ref, u_prev)
        self._backup.log.acted[self._k] = 1
        return self._law.remember(self._plan)
