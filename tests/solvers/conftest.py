"""Problems with a known optimum, and every solver that is installed here."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.solvers.contract import Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.record import RouteRecord
from dpbench.solvers.settings import level_options
from dpbench.solvers.table import TABLE, available

INF = np.inf

# What settings `high` can be held to, as an error of z and as a KKT residual, for P ≥ 1:
# an active set is exact but for rounding; a first-order method ends at residuals of 1e-9, which
# the conditioning of these problems lets grow by some hundred; an interior point ends at a gap of
# 1e-9, which allows |z − z*| ≤ √(2·gap) = 4.5e-5.
EXACT, FIRST_ORDER, INTERIOR = 1e-9, 1e-6, 1e-4
TOLERANCE = {
    "clarabel": INTERIOR,
    "cvxopt": INTERIOR,
    "daqp": EXACT,
    "ecos": INTERIOR,
    "highs": EXACT,
    "hildreth": FIRST_ORDER,
    "hpipm": INTERIOR,
    "hpipm_ocp": INTERIOR,
    "jaxopt": FIRST_ORDER,
    "kvxopt": INTERIOR,
    "osqp": FIRST_ORDER,
    "paper_active_set": EXACT,
    "piqp": INTERIOR,
    "piqp_multistage": INTERIOR,
    "piqp_sparse": INTERIOR,
    "proxqp": FIRST_ORDER,
    "proxqp_sparse": FIRST_ORDER,
    "pyqpmad": EXACT,
    "qoco": INTERIOR,
    "qpalm": FIRST_ORDER,
    "qpoases": EXACT,
    "qpax": 2e-3,  # √(2·gap) for the gap of 1e-6 it can reach
    "qtqp": INTERIOR,
    "quadprog": EXACT,
    "scs": FIRST_ORDER,
    "sip": INTERIOR,
}
# qpax stalls between 1e-6 and 1e-7 in its own measure.
TIGHTEST = {"qpax": {"solver_tol": 1e-6}}

LIMIT_KEY = {
    "cvxopt": "maxiters",
    "daqp": "iter_limit",
    "ecos": "max_iters",
    "hpipm": "iter_max",
    "hpipm_ocp": "iter_max",
    "kvxopt": "maxiters",
    "qoco": "max_iters",
    "scs": "max_iters",
    "sip": "max_iterations",
}
"""The key of the iteration limit where it is not `max_iter`."""
# HiGHS and qpOASES have a limit, but count the same for the two problems of the test.
UNLIMITED = {"highs", "qpoases", "paper_active_set", "pyqpmad", "quadprog", "qpax"}
# Where qpsolvers passes no status or no count on.
SILENT = {(name, "qpsolvers") for name in ("clarabel", "daqp", "qtqp")}


class Configuration(NamedTuple):
    """One way to run one solver."""

    solver: str
    route: str
    policy: str

    @property
    def tolerance(self) -> float:
        return TOLERANCE[self.solver]

    @property
    def limit_key(self) -> str:
        return LIMIT_KEY.get(self.solver, "max_iter")

    @property
    def record(self) -> RouteRecord:
        return TABLE[self.solver].on(self.route)

    @property
    def exact_again(self) -> bool:
        """Whether nothing of an earlier solve is left that could change a later one's rounding."""
        return self.policy == "fresh" or (self.route == "qpsolvers" and self.policy != "warm")

    def open(self, settings: object = None, **further: object) -> Workspace:
        """A workspace at settings `high`, or the tightest that the library can claim to reach."""
        if settings is None:
            settings = TIGHTEST.get(self.solver, "high")
        if further:
            settings = {**level_options(str(settings), self.solver), **further}
        return open_workspace(self.solver, route=self.route, policy=self.policy, settings=settings)


# The baseline law solves another problem and has tests of its own.
INSTALLED = [n for n in TABLE if n != "unconstrained_clipped" and available(n).ok]
ARMS = [
    Configuration(name, route, policy)
    for name in INSTALLED
    for route, policies in TABLE[name].policies.items()
    for policy in policies
]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test that takes an `configuration` or an `installed` solver for each there is."""
    limited = [a for a in ARMS if a.solver not in UNLIMITED and (a.solver, a.route) not in SILENT]
    for name, configurations in (("configuration", ARMS), ("limited_configuration", limited)):
        if name in metafunc.fixturenames:
            metafunc.parametrize(
                name,
                configurations,
                ids=["-".join(configuration) for configuration in configurations],
            )
    if "installed" in metafunc.fixturenames:
        metafunc.parametrize("installed", INSTALLED)


class Sequence(NamedTuple):
    """A problem and the steps that follow it."""

    base: QuadraticProgram
    steps: list[QPStep]


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


@pytest.fixture
def solve_at_once() -> Callable[..., object]:
    """Set a new workspace up with a problem, solve it and read."""

    def run(workspace: Workspace, qp: QuadraticProgram) -> object:
        workspace.setup(qp)
        workspace.solve()
        return workspace.read()

    return run
