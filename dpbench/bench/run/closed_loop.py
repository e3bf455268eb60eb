"""The closed loop: one solver controls the ship (method.md section 3).

Order at t_k: measure or estimate x_m; Δx_m(k) = x_m(k) − x_m(k−1), zero at k = 0; emit the QP;
solve; limit the first move by rate, then by amplitude; hold the force over [t_k, t_{k+1}). u(k−1)
is the force that was *applied*. Only the solver's call stands between two clock reads of its
phases.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.actuation import build_actuation
from dpbench.bench.run.backup import Backup, LoopWithBackup
from dpbench.bench.run.fallback_policies import FALLBACKS, FallbackPolicy
from dpbench.bench.run.formulation import QPBuilder
from dpbench.bench.run.run_delay import RunLimit
from dpbench.bench.run.slow_computer import (
    ComputationalDelay,
    SlowComputer,
    Usage,
    return_zero_usage,
)
from dpbench.bench.run.timed_solver import Clock, TimedSolver, is_usable, record_answer
from dpbench.mpc.law import UnconstrainedLaw
from dpbench.qp.program import QPStep
from dpbench.scenario.scenario import Scenario
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.layout import POSE
from dpbench.ship.plant import SUBSTEPS, Plant, Sensors

Emit = Callable[[int, Vector, Vector], QPStep]
SolverReplacement = LoopWithBackup | SlowComputer


@dataclass(slots=True, eq=False)
class ClosedLoopSetup:
    """The parts of a closed loop: scenario, QP builder, solver, fallback, log and limits.

    `fallback` acts without a usable answer; `limit_ns` of run time, without waits for the core, end
    the run. `delay` is that of a slow computer, None where the ship waits for each answer; `usage`
    counts preemptions there.
    `allocating` is the solver of a cascade's second QP; `drawn` the precomputed weather; `backup`
    the second solver.
    """

    scenario: Scenario
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


def record_closed_loop(setup: ClosedLoopSetup) -> bool:
    """Run a closed loop and record every step; return False when the time limit stopped it."""
    scenario, builder, log = setup.scenario, setup.builder, setup.log
    clock, steps = setup.clock, scenario.steps
    plant = _build_plant(scenario)
    weather = scenario.environment
    sea = weather.build_weather_table_at_stages(steps, scenario.sample_s, SUBSTEPS, setup.drawn)
    sensors, estimator = Sensors(weather, steps, scenario.sample_s), scenario.estimator()
    solver, law, emit = _choose_solver_fallback_and_emitter(setup)
    formulate, answer, moves = solver.formulate, solver.answer, builder.condensed.moves
    state, reference = plant.state, builder.reference
    model = builder.condensed.control.model
    theta, pose = model.theta, slice(model.n_x - model.n_y, model.n_x)
    # The augmented state [Δν, Δη, y]: what changed in the ship's state, and the pose itself.
    change, at_x, at_u = slice(0, pose.start), theta.x, theta.u_prev
    x, u = np.zeros(model.n_x), np.zeros(model.n_u)
    limit, limits = scenario.controller.make_increment_limiter(), builder.limits
    actuation = build_actuation(scenario.controller, builder, log, setup.allocating, clock, u)
    tau, command, applied = actuation.tau, actuation.command, actuation.applied
    act, commanded = actuation.apply_input_of_step, scenario.controller.commanded_thrusters
    trips = {} if commanded is None else dict(commanded.trips)
    actuation.prepare()
    sense, estimate = sensors.measure_state, estimator.update_and_return_state
    log.counters[:] = np.nan
    log.setup_once_ns[0] = solver.prepare()
    log.theta[:, theta.y_ref], log.theta[:, theta.one] = reference[:steps], 1.0
    log.state[0] = state
    run_limit = RunLimit(clock(), setup.limit_ns)
    log.started[0] = 1
    for k in range(steps):
        t0 = clock()
        x[pose] = estimate(sense(state, k), tau)[POSE]
        x[change] = estimator.change
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
        plant.advance_by_one_sample(command, sea[k])
        log.state[k + 1] = state
        t4 = clock()
        log.times[0, k] = (t2 - t1, *solver.phases_ns, t4 - t0 - (t3 - t2))
        log.matrix_updates[0] = solver.matrix_updates
        log.done[0] = k + 1
        if run_limit.is_exceeded(t4) and k + 1 < steps:
            return False
    return True


def _choose_solver_fallback_and_emitter(
    setup: ClosedLoopSetup,
) -> tuple[TimedSolver | SolverReplacement, FallbackPolicy | SolverReplacement, Emit]:
    """Return what solves the QPs, what moves without an answer, and what makes each QP."""
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


def _build_plant(scenario: Scenario) -> Plant:
    """Return the simulated ship of a scenario in its initial state, with weather and actuators."""
    return Plant(
        scenario.true_ship,
        scenario.first_state,
        scenario.sample_s,
        loads=scenario.environment.wind_and_drift_coefficients(scenario.vessel),
        actuators=scenario.actuators,
    )
