"""The closed loop: one solver steers the ship (method.md section 3).

Order at t_k: measure x_m; Δx_m(k) = x_m(k) − x_m(k−1), zero at k = 0; emit the QP; solve; limit
the first move by rate, then by amplitude; hold the force over [t_k, t_{k+1}). u(k−1) is the force
that was *applied*. Only the solver's call stands between two clock reads of its phases.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from dpbench.bench.cell import Fallback, Formulation
from dpbench.bench.rawlog import RawLog
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import gains
from dpbench.qp.program import Matrix, QPStep, QuadraticProgram, Vector
from dpbench.qp.solution import Solution, Status
from dpbench.qp.stacked import stack, stack_step, unstack
from dpbench.scenario import Scenario
from dpbench.ship.plant import SUBSTEPS, Plant
from dpbench.solvers.contract import Workspace

Clock = Callable[[], int]
CLIP_TOLERANCE = 1e-9
"""In rate-limit steps: below it a violation is rounding, above it `clipped` is recorded."""


@njit(cache=True)
def limit_move(u, du, du_max, u_min, u_max, applied):  # type: ignore[no-untyped-def] # numba
    """applied = clip(u + clip(Δu, ±Δu_max), reachable limits); true if that changed anything.

    The reachable limits of the first move are max(u_max, u − Δu_max) and min(u_min, u + Δu_max):
    rate before amplitude, so no actuator limit is ever violated by an inexact answer. A force
    within rounding of a limit ends exactly on it.
    """
    clipped = False
    for i in range(u.shape[0]):
        move = min(max(du[i], -du_max[i]), du_max[i])
        high = max(u_max[i], u[i] - du_max[i])
        low = min(u_min[i], u[i] + du_max[i])
        force = min(max(u[i] + move, low), high)
        if abs(force - u[i] - du[i]) > CLIP_TOLERANCE * du_max[i]:
            clipped = True
        applied[i] = force
    return clipped


class FallbackLaw:
    """What moves the ship when a solve left no usable answer.

    `shifted_plan` follows the last usable plan, one move further for every step since, and holds
    when it is used up; `hold` keeps the force; `clip` is the unconstrained law (eq. 33), which the
    loop clips.
    """

    def __init__(self, kind: Fallback, builder: CondensedQP) -> None:
        problem = builder.control
        self._kind = kind
        self._plan: Matrix = np.zeros((problem.N_c, problem.model.n_u))
        self._age = problem.N_c
        self._law = gains(problem, builder.matrices)

    def remember(self, plan: Matrix) -> Vector:
        """Keep a usable plan (N_c, n_u) and return its first move."""
        self._plan, self._age = plan, 0
        first: Vector = plan[0]
        return first

    def move(self, x: Vector, y_ref: Vector) -> Vector:
        """Δu (n_u,) in place of the missing answer."""
        if self._kind == "clip":
            return self._law.K_y @ y_ref - self._law.K_mpc @ x
        self._age += 1
        if self._kind == "hold" or self._age >= len(self._plan):
            return np.zeros(self._plan.shape[1])
        next_move: Vector = self._plan[self._age]
        return next_move


class SolverPort:
    """The harness's side of a workspace: formulation, phases and failures of one solver.

    `times` holds the phases of the last step in ns (−1: did not take place) after `answer`.
    """

    def __init__(
        self, workspace: Workspace, formulation: Formulation, base: QuadraticProgram, clock: Clock
    ) -> None:
        self._workspace, self._clock = workspace, clock
        self._base = base
        self._m = base.m
        self._stacked = stack(base) if formulation == "condensed_stacked" else None
        self.setup_ns = self.update_ns = self.solve_ns = self.read_ns = -1
        self.details: dict[str, int] = {}

    def prepare(self) -> int:
        """Set up before the first step; the time it took [ns], −1 when steps do it themselves."""
        if self._workspace.setup_every_step:
            return -1
        started = self._clock()
        self._workspace.setup(self._stacked or self._base)
        return self._clock() - started

    def formulate(self, step: QPStep) -> QPStep:
        """The step in the formulation the solver gets; part of emitting it.

        New matrices become those of the base problem, so that a later step without any is solved
        with the same ones.
        """
        formulated = step if self._stacked is None else stack_step(step, self._stacked)
        if not (step.P is None and step.A is None and step.lb is None and step.ub is None):
            self._base = self._base.at(step)
            if self._stacked is not None:
                self._stacked = self._stacked.at(formulated)
        return formulated

    def answer(self, step: QPStep) -> Solution:
        """Solve one step and map the answer to the two-sided form; never raises for a solver."""
        workspace, clock = self._workspace, self._clock
        t1 = t2 = t3 = t0 = -1
        setup_every_step = workspace.setup_every_step
        qp = (self._stacked or self._base).at(step) if setup_every_step else self._base
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
        # An adapter that raises is a failed solve of that solver, which is data of the run.
        except Exception as error:
            now = clock()
            t1, t2, t3 = (now if t < 0 else t for t in (t1, t2, t3))
            qp = self._stacked or self._base
            detail = f"{type(error).__name__}: {error}"
            solution = Solution.missing(qp.n, qp.m, Status.ERROR, detail)
        prepared = t1 - t0
        self.setup_ns, self.update_ns = (prepared, -1) if setup_every_step else (-1, prepared)
        self.solve_ns, self.read_ns = t2 - t1, t3 - t2
        if solution.detail:
            self.details[solution.detail] = self.details.get(solution.detail, 0) + 1
        return solution if self._stacked is None else unstack(solution, self._m)

    def reset(self) -> None:
        """Make the workspace forget an answer that was not usable."""
        try:
            self._workspace.reset()
        except Exception as error:
            detail = f"reset: {type(error).__name__}: {error}"
            self.details[detail] = self.details.get(detail, 0) + 1


def closed_loop(
    scenario: Scenario,
    builder: CondensedQP,
    port: SolverPort,
    log: RawLog,
    *,
    fallback: Fallback,
    limit_ns: int,
    clock: Clock,
) -> bool:
    """Run the scenario with the solver behind `port` and record every step in `log`.

    Returns
    -------
    True when all steps were done, False when the time limit stopped the run after a step.
    """
    ship = scenario.vessel
    plant = Plant(ship, np.concatenate([np.zeros(3), scenario.start]), scenario.sample_s)
    sea = scenario.environment.stage_table(scenario.steps, scenario.sample_s, SUBSTEPS)
    y_ref = nearest_reference(scenario)
    du_max, u_min, u_max = scenario.du_max, ship.tau_min, ship.tau_max
    law = FallbackLaw(fallback, builder)
    state, measured_before = plant.state, plant.state.copy()
    x, u, applied = np.zeros(9), np.zeros(3), np.zeros(3)
    times, theta, done = log.times[0], log.theta, log.done
    emit, formulate, answer = builder.emit, port.formulate, port.answer
    log.setup_once_ns[0] = port.prepare()
    began = clock()
    log.started[0] = 1
    for k in range(scenario.steps):
        t0 = clock()
        np.subtract(state, measured_before, out=x[:6])
        x[6:] = state[3:]
        measured_before[...] = state
        t1 = clock()
        step = formulate(emit(x, y_ref, u))
        t2 = clock()
        solution = answer(step)
        t3 = clock()
        record = theta[k]
        record[:9], record[9:12], record[12:15], record[15] = x, y_ref, u, 1.0
        log.state[k] = state
        usable = solution.status.usable and math.isfinite(solution.z.sum())
        if usable:
            du = law.remember(builder.moves(solution.z))
        else:
            du = law.move(x, y_ref)
            port.reset()
        clipped = limit_move(u, du, du_max, u_min, u_max, applied)
        np.add(u, du, out=log.command[k])
        u[...] = applied
        log.tau[k] = applied
        log.flags[k] = (not usable, usable and solution.status in _UNFINISHED, clipped)
        record_answer(log, 0, k, solution)
        plant.advance(u, sea[k])
        log.state[k + 1] = state
        t4 = clock()
        inside = t3 - t2
        times[k] = (
            t2 - t1,
            port.setup_ns,
            port.update_ns,
            port.solve_ns,
            port.read_ns,
            t4 - t0 - inside,
        )
        done[0] = k + 1
        if t4 - began > limit_ns and k + 1 < scenario.steps:
            return False
    return True


_UNFINISHED = frozenset({Status.INACCURATE, Status.MAX_ITERATIONS})


def record_answer(log: RawLog, r: int, k: int, solution: Solution) -> None:
    """Copy an answer into row (r, k) of the log."""
    log.status[r, k] = solution.status
    log.iterations[r, k] = solution.iterations
    log.reported_ns[r, k] = solution.reported_ns
    log.z[r, k] = solution.z
    log.y[r, k] = solution.y
    log.y_box[r, k] = solution.y_box


def nearest_reference(scenario: Scenario) -> Vector:
    """The reference with its heading within π of the start's, so that the error is wrapped once."""
    reference = scenario.reference.copy()
    turn = 2 * np.pi
    reference[2] += turn * np.round((scenario.start[2] - reference[2]) / turn)
    return reference
