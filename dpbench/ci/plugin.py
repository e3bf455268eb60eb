"""Pytest plug-in: replay a sequence of QPs as a benchmark, and compare with a stored run.

Every pytest run of an environment with dpbench loads this module, so it imports nothing but pytest;
the rest follows where a test or an option needs it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from dpbench.ci import ALLOW, DISTURBED_OR_STORED_EXIT, MARGIN_SHARE

if TYPE_CHECKING:
    from dpbench.ci.replays import BenchmarkFixture, ReplayBenchmark

NOT_UNDER_XDIST = "benchmarks are not timed under xdist: run with -n0"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that compare benchmarks with a stored run to pytest."""
    group = parser.getgroup("dpbench", "benchmarks of QP solvers")
    group.addoption(
        "--dpbench-compare",
        metavar="FILE",
        help="compare with a file that an earlier --benchmark-json wrote; fail on a regression",
    )
    group.addoption("--dpbench-margin", **MARGIN_SHARE)
    group.addoption(
        "--dpbench-allow-gone",
        action="store_true",
        help="pass even if a benchmark of that file is missing",
    )
    group.addoption("--dpbench-allow", **ALLOW)
    group.addoption("--dpbench-disturbed-exit", **DISTURBED_OR_STORED_EXIT)


def pytest_configure(config: pytest.Config) -> None:
    """Read the stored run of benchmarks before any test; UsageError for bad input."""
    if hasattr(config, "workerinput") or not config.pluginmanager.hasplugin("benchmark"):
        if config.getoption("dpbench_compare") and not hasattr(config, "workerinput"):
            raise pytest.UsageError("--dpbench-compare: needs pip install 'dpbench[ci]'")
        return
    from dpbench.ci.failures import FailedBenchmarks

    failures = FailedBenchmarks(config)
    config.pluginmanager.register(failures, "dpbench-failures")
    if config.getoption("dpbench_compare"):
        if config.getoption("numprocesses", None):
            raise pytest.UsageError(f"--dpbench-compare: {NOT_UNDER_XDIST}")
        from dpbench.ci.gate import SessionComparison

        comparison = SessionComparison(config, failures)
        config.pluginmanager.register(comparison, "dpbench-comparison")


@pytest.fixture
def dpbench_reference_kernel(benchmark: BenchmarkFixture) -> Iterator[None]:
    """Store the machine's state during a benchmark of any kind, and its kernel's time, in it."""
    from dpbench.ci.machine_state import watch_machine

    with watch_machine(benchmark):
        yield


@pytest.fixture
def dpbench_replay(request: pytest.FixtureRequest, benchmark: BenchmarkFixture) -> ReplayBenchmark:
    """Benchmark the replay of a sequence with a solver: `dpbench_replay("paper-30-5", "daqp")`."""
    from dpbench.ci.replays import ReplayBenchmark

    if hasattr(request.config, "workerinput"):
        request.node.warn(pytest.PytestWarning(NOT_UNDER_XDIST))
    return ReplayBenchmark(benchmark, request.path.parent, request.config.rootpath)
