"""The closed loop: one solver controls the ship (docs/method.md, section Control).

Order at t_k: measure or estimate x_m; Δx_m(k) = x_m(k) − x_m(k−1), zero at k = 0; emit the QP;
solve; limit the first move by rate, then by amplitude; hold the force over [t_k, t_{k+1}). u(k−1)
is the force that was *applied*. Only the solver's call stands between two clock reads of its
phases.

A controller of forces commands u itself. One of thrusters commands their forces; T_e u is the force
on the ship. A cascade allocates u to its thrusters; what they make of it becomes u.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.backup import FALLBACKS, Backup, FallbackPolicy, LoopWithBackup
from dpbench.bench.run.formulation import Case, QPBuilder
from dpbench.bench.run.slow_computer import (
    ComputationalDelay,
    SlowComputer,
    Usage,
    return_zero_usage,
)
from dpbench.bench.run.steered import Steered, build_steered_system
from dpbench.bench.run.timed_solver import Clock, RunLimit, TimedSolver, is_usable, record_answer
from dpbench.mpc.law import UnconstrainedLaw
from dpbench.qp.program import QPStep
from dpbench.scenario.controllers.controller import Controller, ThrusterControl
from dpbench.scenario.controllers.kinds import CascadeController
from dpbench.scenario.plants.contract import PlantMaker
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.layout import AXES

Emit = Callable[[int, Vector, Vector], QPStep]
SolverReplacement = LoopWithBackup | SlowComputer


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
        """Set commands and forces of tripped thrusters to zero; nothing without thrusters."""

    def apply_input_of_step(self, k: int) -> int:
        """Set the ship's command and force from step k's u; return the allocation's time [ns]."""
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
        """Set the force on the ship to T_e u of thruster forces u in step k; return 0 [ns]."""
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
    """Return what applies a controller's output to the ship: as force, by thrusters, allocated."""
    if isinstance(controller, CascadeController):
        return Allocator(controller, builder, log, solver, clock, u)
    if controller.commanded_thrusters is not None:
        return ThrusterActuation(controller.commanded_thrusters, log, u)
    return Actuation(u, u, log.tau)


@dataclass(slots=True, eq=False)
class ClosedLoopSetup:
    """The parts of a closed loop: scenario, QP builder, solver, fallback, log and limits.

    `fallback` acts without a usable answer; `limit_ns` of run time, without waits for the core, end
    the run. `delay` is that of a slow computer, None where the ship waits for each answer; `usage`
    counts preemptions there.
    `allocating` is the solver of a cascade's second QP; `drawn` the precomputed weather; `backup`
    the second solver; `plant` makes a custom plant in place of the scenario's ship.
    """

    scenario: Case
    builder: QPBuilder
    solver: TimedSolver
    log: RawLog
    fallback: str
    limit_ns: int
    clock: Clock
    delay: ComputationalDelay | None = None
    usage: Usage = return_zero_usage
    allocating: TimedSolver | None = None
    drawn: WeatherDraw | None = None
    backup: Backup | None = None
    plant: PlantMaker | None = None


def record_closed_loop(setup: ClosedLoopSetup) -> bool:
    """Run a closed loop and record every step; return False when the time limit stopped it.

    PlantError where a custom plant fails.
    """
    steered, own = build_steered_system(setup.scenario, setup.plant, setup.drawn)
    try:
        return _record_steps(setup, steered)
    finally:
        if own is not None:
            own.close()


def _record_steps(setup: ClosedLoopSetup, steered: Steered) -> bool:
    """Steer a system through all steps and record each; return False at the time limit."""
    scenario, builder, log = setup.scenario, setup.builder, setup.log
    clock, steps = setup.clock, scenario.steps
    solver, law, emit = _choose_solver_fallback_and_emitter(setup)
    formulate, answer, moves = solver.formulate, solver.answer, builder.condensed.moves
    reference, model = builder.reference, builder.condensed.control.model
    theta = model.theta
    at_x, at_u = theta.x, theta.u_prev
    x, u = np.zeros(model.n_x), steered.first_input.copy()
    limit, limits = scenario.controller.make_increment_limiter(), builder.limits
    actuation = build_actuation(scenario.controller, builder, log, setup.allocating, clock, u)
    tau, command, applied = actuation.tau, actuation.command, actuation.applied
    act, commanded = actuation.apply_input_of_step, scenario.controller.commanded_thrusters
    trips = {} if commanded is None else dict(commanded.trips)
    actuation.prepare()
    measure, advance = steered.write_model_state, steered.advance
    log.counters[:] = np.nan
    log.setup_once_ns[0] = solver.prepare()
    log.theta[:, theta.y_ref], log.theta[:, theta.one] = reference[:steps], 1.0
    log.state[0] = steered.state
    run_limit = RunLimit(clock(), setup.limit_ns)
    log.started[0] = 1
    for k in range(steps):
        t0 = clock()
        measure(k, tau, x)
        if k in trips:
            actuation.set_tripped_forces_to_zero(trips[k])
        log.theta[k, at_x], log.theta[k, at_u] = x, u
        t1 = clock()
        step = formulate(emit(k, x, u))
        t2 = clock()
        solution = answer(step)
        t3 = clock()
        usable = is_usable(solution)
        if usable:
            du = law.remember(moves(solution.z))
        else:
            du = law.move(x, reference[k], u)
            solver.reset()
        np.add(u, du, out=log.command[k])
        clipped = limit(u, du, limits[k], applied[k])
        u[...] = applied[k]
        log.flags[k] = (law.acted, usable and solution.status.is_applied_though_unfinished, clipped)
        record_answer(log, 0, k, solution, solver.waited_ns)
        # As the overhead is what neither solver takes.
        t3 += act(k)
        advance(k, command)
        log.state[k + 1] = steered.state
        t4 = clock()
        log.times[0, k] = (t2 - t1, *solver.phases_ns, t4 - t0 - (t3 - t2))
        log.matrix_updates[0] = setup.solver.matrix_updates
        log.done[0] = k + 1
        if run_limit.is_exceeded(t4) and k + 1 < steps:
            return False
    return True


def _choose_solver_fallback_and_emitter(
    setup: ClosedLoopSetup,
) -> tuple[TimedSolver | SolverReplacement, FallbackPolicy | SolverReplacement, Emit]:
    """Return a loop's solver, its fallback policy, and the function that makes each step's QP."""
    builder, solver, backup = setup.builder, setup.solver, setup.backup
    control = builder.condensed.control
    law = FALLBACKS[setup.fallback](
        control.N_c, control.model.n_u, UnconstrainedLaw(builder.condensed)
    )
    if setup.delay is not None and setup.delay.is_simulated:
        latency_ns = setup.log.latency_ns
        computer = SlowComputer(
            setup.delay, solver, builder, law, latency_ns, setup.usage, backup=backup
        )
        return computer, computer, computer.emit
    if backup is None:
        return solver, law, builder.emit
    both = LoopWithBackup(solver, backup, law, builder.emit)
    return both, both, both.emit
