"""Problems with a known optimum, and every solver that is installed here."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import dpbench
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.solvers.contract import Family, RouteRecord, Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.settings import find_options_of_preset
from dpbench.solvers.table import TABLE, find_solver_availability

INF = np.inf

# What settings `high` can be held to, as an error of z and as a KKT residual, for P ≥ 1:
# an active set is exact but for rounding; a first-order method ends at residuals of 1e-9, which
# the conditioning of these problems lets grow by some hundred; an interior point ends at a gap of
# 1e-9, which allows |z − z*| ≤ √(2·gap) = 4.5e-5.
TOLERANCE: dict[Family, float] = {
    "active set": 1e-9,
    "interior point": 1e-4,
    "first order": 1e-6,
    "augmented Lagrangian": 1e-6,
}
# qpax stalls between 1e-6 and 1e-7 in its own measure, and √(2·gap) is that much larger.
TIGHTEST = {"qpax": {"solver_tol": 1e-6}}
LARGEST = {"qpax": 2e-3}

# They count the same for the two problems that the test of recovery tells apart by their count.
COUNTS_ALIKE = {"highs", "qpax", "qpoases"}
# Where qpsolvers passes no status or no count on.
SILENT = {(name, "qpsolvers") for name in ("clarabel", "daqp", "highs", "qtqp")}


class Configuration(NamedTuple):
    """One way to run one solver."""

    solver: str
    route: str
    policy: str

    @property
    def tolerance(self) -> float:
        return LARGEST.get(self.solver, TOLERANCE[TABLE[self.solver].family])

    @property
    def limit_key(self) -> str:
        """The option that limits its iterations; "" where there is none."""
        return TABLE[self.solver].iteration_limit

    @property
    def record(self) -> RouteRecord:
        return TABLE[self.solver].get_route_record(self.route)

    @property
    def exact_again(self) -> bool:
        """True where nothing of an earlier solve is left that could change a later one's
        rounding."""
        return self.policy == "fresh" or (self.route == "qpsolvers" and self.policy != "warm")

    def open(self, settings: object = None, **further: object) -> Workspace:
        """A workspace at settings `high`, or the tightest that the library can claim to reach."""
        if settings is None:
            settings = TIGHTEST.get(self.solver, "high")
        if further:
            preset = find_options_of_preset("high", self.solver)
            settings = {**(preset if settings == "high" else settings), **further}
        return open_workspace(self.solver, route=self.route, policy=self.policy, settings=settings)


# The baseline law solves another problem and has tests of its own.
INSTALLED = [n for n in TABLE if n != "unconstrained_clipped" and find_solver_availability(n).ok]
ARMS = [
    Configuration(name, route, policy)
    for name in INSTALLED
    for route, policies in TABLE[name].policies_by_route.items()
    for policy in policies
]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test that takes a `configuration` or an `installed` solver for each there is."""
    limited = [a for a in ARMS if a.limit_key and (a.solver, a.route) not in SILENT]
    warm = [a for a in ARMS if a.policy == "warm"]
    kinds = {"configuration": ARMS, "limited_configuration": limited, "warm_configuration": warm}
    kinds["recovering_configuration"] = [a for a in limited if a.solver not in COUNTS_ALIKE]
    for name in kinds.keys() & metafunc.fixturenames:
        metafunc.parametrize(name, kinds[name], ids=["-".join(a) for a in kinds[name]])
    if "installed" in metafunc.fixturenames:
        metafunc.parametrize("installed", INSTALLED)


def solve_qp(workspace: Workspace, qp: QuadraticProgram) -> Solution:
    workspace.setup(qp)
    workspace.solve()
    return workspace.read()


def solve_next(workspace: Workspace, step: QPStep) -> Solution:
    workspace.update(step)
    workspace.solve()
    return workspace.read()


def run_program(program: str) -> str:
    """Run a program in a process of its own; return its output."""
    path = os.pathsep.join([str(Path(dpbench.__file__).parents[1]), *sys.path])
    command, environment = [sys.executable, "-c", program], {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        command, env=environment, check=True, timeout=200, capture_output=True, text=True
    )
    return done.stdout


class Sequence(NamedTuple):
    """A problem and the steps that follow it."""

    base: QuadraticProgram
    steps: list[QPStep]

    def answers(self, workspace: Workspace) -> list[Solution]:
        """Those of a workspace that is set up with the problem and then follows the steps."""
        workspace.setup(self.base)
        return [solve_next(workspace, step) for step in self.steps]


def mpc_like() -> Sequence:
    """Increments of two inputs over three moves, amplitude limits that drift, P ≥ 1."""
    rng = np.random.default_rng(7)
    n, block = 6, 2
    B = rng.normal(size=(n, n))
    P = np.eye(n) + B @ B.T / n
    A = np.kron(np.tril(np.ones((3, 3))), np.eye(2))
    q = 3.0 * rng.normal(size=n)
    base = QuadraticProgram(
        P, q, A, -1.2 * np.ones(n), 1.5 * np.ones(n), -np.ones(n), np.ones(n), block
    )
    steps = []
    for _ in range(12):
        q = 0.9 * q + rng.normal(size=n)
        offset = np.tile(rng.uniform(-0.4, 0.4, size=block), n // block)
        steps.append(QPStep(q.copy(), base.l - offset, base.u - offset))
    return Sequence(base, steps)


@pytest.fixture
def sequence() -> Sequence:
    return mpc_like()


# For tests that also run in a copy of their folder, without this package.
@pytest.fixture(name="solve_qp")
def _solve_qp() -> Callable[..., Solution]:
    return solve_qp


@pytest.fixture(name="solve_next")
def _solve_next() -> Callable[..., Solution]:
    return solve_next
