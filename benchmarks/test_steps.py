"""One step of every installed solver on a recorded sequence, and one step of the closed loop."""

import time
import warnings
from collections.abc import Callable

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from dpbench import open_workspace
from dpbench.bench.plan.configurations import BASELINE_LAW
from dpbench.bench.record.raw_log import RawLog, make_loop_layout
from dpbench.bench.run.closed_loop import ClosedLoopSetup, record_closed_loop
from dpbench.bench.run.exact_loop import (
    ExactLoop,
    ExactWorkspace,
    build_problem_at_rest,
    rebuild_sequence,
)
from dpbench.bench.run.formulation import BoxFormulation, QPBuilder
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Workspace
from dpbench.solvers.table import find_solver_availability, list_all_solver_names

INSTALLED = [
    name
    for name in list_all_solver_names()
    if find_solver_availability(name).ok and name != BASELINE_LAW
]


@pytest.mark.benchmark(group="update + solve + read, mean over 120 steps of `paper`", min_rounds=3)
@pytest.mark.parametrize("solver", INSTALLED)
def test_step(
    benchmark: BenchmarkFixture,
    exactly: Callable[..., None],
    scenario: Scenario,
    exact: ExactLoop,
    solver: str,
) -> None:
    """A whole pass over the sequence; divide by 120 for a step."""
    sequence = rebuild_sequence(scenario, exact)
    workspace = open_workspace(solver)
    workspace.setup(sequence.base)
    steps = [sequence.step(k) for k in range(len(sequence))]

    def replay(count: int = len(steps)) -> int:
        iterations = 0
        for step in steps[:count]:
            workspace.update(step)
            workspace.solve()
            iterations += workspace.read().iterations
        return iterations

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = sequence.base.m + sequence.base.n
        # Under tracemalloc a solver in Python is slow; what a step holds, any few steps show.
        exactly(lambda: replay(10), iterations=replay(), rows=rows)
        benchmark(replay)


class _Stored(Workspace):
    """Answers zero at once: what remains is the harness."""

    def __init__(self) -> None:
        super().__init__("stored", "native", "reuse")
        self._answer = Solution.without_point(1, 1, Status.ERROR)

    def setup(self, qp: QuadraticProgram) -> None:
        zero = 0.0 * qp.q
        self._answer = Solution(Status.SOLVED, zero, 0.0 * qp.l, zero, 0)

    def update(self, step: QPStep) -> None:
        pass

    def solve(self) -> None:
        pass

    def read(self) -> Solution:
        return self._answer


@pytest.mark.benchmark(group="closed loop, 120 steps")
@pytest.mark.parametrize("kind", ["harness alone", "certified optimum"])
def test_closed_loop(benchmark: BenchmarkFixture, scenario: Scenario, kind: str) -> None:
    """Plant, emit, records and bookkeeping of 120 steps; divide by 120 for a step."""
    builder = QPBuilder(scenario)
    log = RawLog.in_memory(make_loop_layout(scenario.steps, *builder.sizes))
    workspace = _Stored() if kind == "harness alone" else ExactWorkspace()
    base = build_problem_at_rest(builder.condensed)
    timed_solver = TimedSolver(workspace, BoxFormulation(base), time.perf_counter_ns)
    setup = ClosedLoopSetup(
        scenario, builder, timed_solver, log, "hold", 2**62, time.perf_counter_ns
    )
    benchmark(record_closed_loop, setup)
