"""The closed loop: one solver steers the ship (method.md section 3).

Order at t_k: measure x_m; Δx_m(k) = x_m(k) − x_m(k−1), zero at k = 0; emit the QP; solve; limit
the first move by rate, then by amplitude; hold the force over [t_k, t_{k+1}). u(k−1) is the force
that was *applied*. Only the solver's call stands between two clock reads of its phases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dpbench.bench.actuation import FallbackLaw, limit_move
from dpbench.bench.cell import Fallback
from dpbench.bench.port import Clock, SolverPort, record_answer
from dpbench.bench.rawlog import RawLog
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import Vector
from dpbench.qp.solution import Status
from dpbench.scenario import Scenario
from dpbench.ship.plant import SUBSTEPS, Plant

_UNFINISHED = frozenset({Status.INACCURATE, Status.MAX_ITERATIONS})


@dataclass(slots=True, eq=False)
class Voyage:
    """What a closed loop is made of: the run, its QP builder, the solver, where steps go.

    `fallback` acts without a usable answer; `limit_ns` of own run time end the voyage; `clock`
    tells nanoseconds.
    """

    scenario: Scenario
    builder: CondensedQP
    port: SolverPort
    log: RawLog
    fallback: Fallback
    limit_ns: int
    clock: Clock


def closed_loop(voyage: Voyage) -> bool:
    """Run the scenario with the solver behind the port and record every step in the log.

    Returns
    -------
    True when all steps were done, False when the time limit stopped the run after a step.
    """
    scenario, builder, port, log = voyage.scenario, voyage.builder, voyage.port, voyage.log
    clock, limit_ns = voyage.clock, voyage.limit_ns
    ship, steps = scenario.vessel, scenario.steps
    plant = Plant(ship, np.concatenate([np.zeros(3), scenario.start]), scenario.sample_s)
    sea = scenario.environment.stage_table(steps, scenario.sample_s, SUBSTEPS)
    y_ref = nearest_reference(scenario)
    du_max, u_min, u_max = scenario.du_max, ship.tau_min, ship.tau_max
    law = FallbackLaw(voyage.fallback, builder)
    state, measured_before = plant.state, plant.state.copy()
    x, u = np.zeros(9), np.zeros(3)
    emit, formulate, answer = builder.emit, port.formulate, port.answer
    log.setup_once_ns[0] = port.prepare()
    log.theta[:, 9:12], log.theta[:, 15] = y_ref, 1.0
    log.state[0] = state
    began = clock()
    log.started[0] = 1
    for k in range(steps):
        t0 = clock()
        np.subtract(state, measured_before, out=x[:6])
        x[6:] = state[3:]
        measured_before[...] = state
        log.theta[k, :9], log.theta[k, 12:15] = x, u
        t1 = clock()
        step = formulate(emit(x, y_ref, u))
        t2 = clock()
        solution = answer(step)
        t3 = clock()
        usable = solution.status.usable and math.isfinite(solution.z.sum())
        if usable:
            du = law.remember(builder.moves(solution.z))
        else:
            du = law.move(x, y_ref)
            port.reset()
        np.add(u, du, out=log.command[k])
        clipped = limit_move(u, du, du_max, u_min, u_max, log.tau[k])
        u[...] = log.tau[k]
        log.flags[k] = (not usable, usable and solution.status in _UNFINISHED, clipped)
        record_answer(log, 0, k, solution)
        plant.advance(u, sea[k])
        log.state[k + 1] = state
        t4 = clock()
        log.times[0, k] = (t2 - t1, *port.phases_ns, t4 - t0 - (t3 - t2))
        log.done[0] = k + 1
        if t4 - began > limit_ns and k + 1 < steps:
            return False
    return True


def nearest_reference(scenario: Scenario) -> Vector:
    """The reference with its heading within π of the start's, so that the error is wrapped once."""
    reference = scenario.reference.copy()
    turn = 2 * np.pi
    reference[2] += turn * np.round((scenario.start[2] - reference[2]) / turn)
    return reference
