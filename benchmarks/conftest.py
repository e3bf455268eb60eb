"""Shared problems of the benchmarks: the paper's scenario, scaled."""

import gc
import tracemalloc
from collections.abc import Callable, Iterator

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from dpbench import load_scenario
from dpbench.bench.run.exact_loop import ExactLoop, solve_loop_exactly
from dpbench.ci.machine_state import watch_machine
from dpbench.mpc.condense import ControlProblem
from dpbench.scenario.scenario import Scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    """The paper's scenario, its first 120 steps: transfer and first steps at rest."""
    return load_scenario("paper").truncate(120)


@pytest.fixture(scope="session")
def problem(scenario: Scenario) -> ControlProblem:
    """Its control problem: 30/5, nine states, three inputs."""
    return scenario.problem


@pytest.fixture(scope="session")
def exact(scenario: Scenario) -> ExactLoop:
    """Its reference loop."""
    return solve_loop_exactly(scenario)


@pytest.fixture(autouse=True)
def no_garbage_collection() -> Iterator[None]:
    """Keep the garbage collector off between two clock reads."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture(autouse=True)
def reference_kernel(benchmark: BenchmarkFixture) -> Iterator[None]:
    """The machine's state and its reference kernel beside each benchmark."""
    with watch_machine(benchmark):
        yield


Exactly = Callable[..., None]
"""Notes exact measures of a call: `exactly(call, iterations=…, rows=…)`."""


@pytest.fixture
def exactly(benchmark: BenchmarkFixture) -> Exactly:
    """Notes what does not depend on the clock: Python memory of a call, and what it is given."""

    def note(call: Callable[[], object], **measures: int) -> None:
        call()
        peaks = []
        tracemalloc.start()
        try:
            for _ in range(3):
                gc.collect()
                tracemalloc.reset_peak()
                held = tracemalloc.get_traced_memory()[0]
                call()
                peaks.append(tracemalloc.get_traced_memory()[1] - held)
        finally:
            tracemalloc.stop()
        benchmark.extra_info["exact"] = measures | {"peak_bytes": min(peaks)}

    return note
