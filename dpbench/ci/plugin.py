"""Pytest plug-in: replay a sequence of QPs as a benchmark, and compare with a stored run.

Every pytest run of an environment with dpbench loads this module, so it imports nothing but pytest;
the rest follows where a test or an option needs it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from dpbench.ci import MARGIN

if TYPE_CHECKING:
    from dpbench.ci.replays import ReplayBenchmark


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that compare benchmarks with a stored run to pytest."""
    group = parser.getgroup("dpbench", "benchmarks of QP solvers")
    group.addoption(
        "--dpbench-compare",
        metavar="FILE",
        help="compare with the file of an earlier --benchmark-json; fail on a regression",
    )
    group.addoption(
        "--dpbench-margin",
        metavar="SHARE",
        type=float,
        default=MARGIN,
        help=f"how much slower is no regression ({MARGIN})",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Read the stored run before any test; UsageError for bad input."""
    if config.getoption("dpbench_compare") and not hasattr(config, "workerinput"):
        from dpbench.ci.session import SessionComparison

        config.pluginmanager.register(SessionComparison(config), "dpbench-comparison")


@pytest.fixture
def dpbench_reference_kernel(request: pytest.FixtureRequest) -> Iterator[None]:
    """Time the machine's reference kernel before and after a benchmark of any kind."""
    from dpbench.ci.replays import time_reference_kernel

    with time_reference_kernel(request.getfixturevalue("benchmark")):
        yield


@pytest.fixture
def dpbench_replay(
    request: pytest.FixtureRequest, dpbench_reference_kernel: None
) -> ReplayBenchmark:
    """Benchmark the replay of a sequence with a solver: `dpbench_replay("paper-30-5", "daqp")`."""
    from dpbench.ci.replays import ReplayBenchmark

    return ReplayBenchmark(request.getfixturevalue("benchmark"))
