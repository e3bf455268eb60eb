"""Closed loops whose solvers and clocks are simulated."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dpbench.bench.judge.control_metrics import compute_thruster_metrics
from dpbench.bench.record.cell import Formulation
from dpbench.bench.record.raw_log import RawLog, make_loop_layout
from dpbench.bench.run.backup import WARM_UP_SOLVES, Backup
from dpbench.bench.run.closed_loop import ClosedLoopSetup, record_closed_loop
from dpbench.bench.run.exact_loop import build_problem_at_rest
from dpbench.bench.run.formulation import QPBuilder, build_loop_formulation
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Workspace

SAMPLE_NS = 300_000_000
PLAN = (0.5, 0.4, 0.3, 0.2, 0.1)
"""Moves of every axis in maximum increments; the forces reached: 0.5, 0.9, 1.2, 1.4, 1.5."""


class Planned(Workspace):
    """Gives the same plan to every question, after so many samples of a clock of its own."""

    def __init__(
        self,
        samples: Callable[[int], float],
        status: Status = Status.SOLVED,
        plan: Sequence[float] = PLAN,
        now_ns: list[int] | None = None,
    ) -> None:
        super().__init__("planned", "native", "reuse")
        self.now_ns, self.asked, self.resets = now_ns or [0], -WARM_UP_SOLVES, 0
        self._samples, self._status, self._plan = samples, status, plan

    def clock(self) -> int:
        return self.now_ns[0]

    def setup(self, qp: QuadraticProgram) -> None:
        pass

    def update(self, step: QPStep) -> None:
        pass

    def solve(self) -> None:
        if self.asked >= 0:
            self.now_ns[0] += round(self._samples(self.asked) * SAMPLE_NS)
        self.asked += 1

    def read(self) -> Solution:
        return Solution(self._status, np.repeat(self._plan, 3), np.zeros(15), np.zeros(15))

    def reset(self) -> None:
        self.resets += 1


def run_loop(
    scenario: Scenario,
    workspace: Workspace,
    fallback: str = "shifted_plan",
    *,
    clock: Callable[[], int] = time.perf_counter_ns,
    limit_ns: int = 2**62,
    formulation: Formulation = "condensed_box",
    backup: Workspace | None = None,
    **given: Any,
) -> tuple[RawLog, bool]:
    builder = QPBuilder(scenario, sparse=formulation == "sparse")
    log = RawLog.in_memory(
        make_loop_layout(scenario.steps, *builder.sizes, backup=backup is not None)
    )
    formulated = build_loop_formulation(
        formulation, builder, build_problem_at_rest(builder.condensed)
    )
    solver = TimedSolver(workspace, formulated, clock)
    setup = ClosedLoopSetup(scenario, builder, solver, log, fallback, limit_ns, clock, **given)
    if backup is not None and log.backup is not None:
        second = TimedSolver(backup, formulated, clock)
        setup.backup = Backup(second, builder.condensed.moves, log.backup)
    return log, record_closed_loop(setup)


def surge_steps(log: RawLog, scenario: Scenario) -> list[float]:
    return np.round(log.tau[:, 0] / scenario.problem.du_max[0], 9).tolist()


def limit_violations(scenario: Scenario, log: RawLog) -> float:
    limits = QPBuilder(scenario).thruster_limits
    return compute_thruster_metrics(scenario, log.thrust, limits)["limit_violations"]
