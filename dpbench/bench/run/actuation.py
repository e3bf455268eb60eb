"""The command of the ship and the force on it, from the limited u of a step.

A controller of forces commands u itself. One of thrusters commands their forces; T_e u is the force
on the ship. A cascade allocates u to its thrusters; what they make of it becomes u.
"""

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.formulation import QPBuilder
from dpbench.bench.run.timed_solver import Clock, TimedSolver, is_usable, record_answer
from dpbench.scenario.controllers.commanded import ThrusterControl
from dpbench.scenario.controllers.controller import Controller
from dpbench.scenario.controllers.thrusters import CascadeController
from dpbench.ship.layout import AXES


class Actuation:
    """Actuation where the controller commands the force itself: its limited u acts on the ship.

    `command` is the ship's, `tau` (3,) the force on it without losses; the log records u in
    `applied`.
    """

    def __init__(self, command: Vector, tau: Vector, applied: Matrix) -> None:
        self.command, self.tau, self.applied = command, tau, applied

    def prepare(self) -> None:
        """Set up the allocation solver, if any, before the first step."""

    def set_tripped_forces_to_zero(self, entries: Indices) -> None:
        """Set the commands of thrusters that stop at once to zero, and the force they made."""

    def apply_input_of_step(self, k: int) -> int:
        """Set command and force from step k's limited u; return the allocation's time [ns]."""
        return 0


class ThrusterActuation(Actuation):
    """Actuation where the controller commands thruster forces u: T_e u acts on the ship."""

    def __init__(self, control: ThrusterControl, log: RawLog, u: Vector) -> None:
        super().__init__(u, np.zeros(AXES), log.thrust)
        self._T_e, self._log = control.thrusters.T_e, log

    def set_tripped_forces_to_zero(self, entries: Indices) -> None:
        """Set the commanded forces u of thrusters that stop at once to zero."""
        self.command[entries] = 0.0

    def apply_input_of_step(self, k: int) -> int:
        """Set the force on the ship to T_e u, from the thruster forces u of step k."""
        self._T_e.dot(self.command, out=self.tau)
        self._log.tau[k] = self.tau
        return 0


class Allocator(Actuation):
    """Thrust allocation of a cascade: distributes force u (3,) to thrusters.

    A pseudo-inverse acts without a `solver`, or a usable answer of it. After
    `apply_input_of_step` u is what the thrusters make of it.
    """

    def __init__(
        self,
        cascade: CascadeController,
        builder: QPBuilder,
        log: RawLog,
        solver: TimedSolver | None,
        clock: Clock,
        u: Vector,
    ) -> None:
        problem = cascade.allocation
        super().__init__(np.zeros(len(problem.df_max)), u, log.demand)
        self._builder, self._log, self._solver, self._clock = builder, log, solver, clock
        self._T_e, self._limit = problem.T_e, cascade.control.make_increment_limiter(problem.df_max)
        losses = (
            (k, problem.compute_weighted_pseudo_inverse(limits.lost))
            for k, limits in cascade.losses
        )
        self._inverses: list[tuple[int, Matrix]] = [
            (0, problem.compute_weighted_pseudo_inverse()),
            *losses,
        ]

    def prepare(self) -> None:
        """Set up the allocation solver before the first step."""
        answers = self._log.allocation
        if self._solver is not None and answers is not None:
            answers.setup_once_ns[0] = self._solver.prepare()

    def set_tripped_forces_to_zero(self, entries: Indices) -> None:
        """Set the forces of thrusters that stop to zero, and u to what the others give."""
        self.command[entries] = 0.0
        self._T_e.dot(self.command, out=self.tau)

    def apply_input_of_step(self, k: int) -> int:
        """Allocate force u to the thrusters, set u to what they make; return the QP's time [ns]."""
        log, f, demand, spent_ns = self._log, self.command, self.tau, 0
        missing = unfinished = False
        if self._solver is None:
            move = self._allocate_by_pseudo_inverse(k, demand)
        else:
            answer, unfinished, spent_ns = self._solve_allocation(k, demand, self._solver)
            missing = answer is None
            move = self._allocate_by_pseudo_inverse(k, demand) if answer is None else answer
        clipped = self._limit(f, move, self._builder.thruster_limits[k], log.thrust[k])
        f[...] = log.thrust[k]
        log.flags[k] |= np.array((missing, unfinished, clipped), dtype=np.uint8)
        self._T_e.dot(f, out=self.tau)
        log.tau[k] = self.tau
        return spent_ns

    def _solve_allocation(
        self, k: int, demand: Vector, solver: TimedSolver
    ) -> tuple[Vector | None, bool, int]:
        """Solve a thrust-allocation QP; return Δf (n_f,) or None, if unfinished, time [ns]."""
        builder, answers = self._builder.allocation, self._log.allocation
        assert builder is not None and answers is not None, "a QP allocates"
        t0 = self._clock()
        step = solver.formulate(self._builder.emit_allocation(k, demand, self.command))
        t1 = self._clock()
        solution = solver.answer(step)
        spent_ns = self._clock() - t1
        answers.times[0, k] = (t1 - t0, *solver.phases_ns, -1)
        record_answer(answers, 0, k, solution, solver.waited_ns)
        answers.matrix_updates[0] = solver.matrix_updates
        if is_usable(solution):
            return builder.moves(solution.z), solution.status.is_applied_though_unfinished, spent_ns
        solver.reset()
        return None, False, spent_ns

    def _allocate_by_pseudo_inverse(self, k: int, demand: Vector) -> Vector:
        """Return Δf (n_f,): pseudo-inverse forces for a demand (3,), less the last command."""
        inverse = [inverse for since, inverse in self._inverses if since <= k][-1]
        move: Vector = inverse @ demand - self.command
        return move


def build_actuation(
    controller: Controller,
    builder: QPBuilder,
    log: RawLog,
    solver: TimedSolver | None,
    clock: Clock,
    u: Vector,
) -> Actuation:
    """Return how a controller's output acts on the ship: as force, by thrusters, or allocated."""
    if isinstance(controller, CascadeController):
        return Allocator(controller, builder, log, solver, clock, u)
    if controller.commanded_thrusters is not None:
        return ThrusterActuation(controller.commanded_thrusters, log, u)
    return Actuation(u, u, log.tau)
