"""ElastiQP: limits that it gives up, and its penalty."""

import numpy as np
import pytest

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import find_solver_availability
from tests.solvers.conftest import solve_next, solve_qp

METHODS = ["elastiqp", "elastiqp_pdal"]
pytestmark = pytest.mark.skipif(
    not find_solver_availability("elastiqp").ok, reason="elastiqp is not installed"
)
# min ½ z² − 3 z, z ≥ 0 as a row, z ≤ 1 as a bound: z = 1, multiplier 2 of the bound.
HARD = QuadraticProgram([[1]], [-3], [[1]], [0], [np.inf], [-np.inf], [1])


@pytest.mark.parametrize("solver", METHODS)
def test_a_limit_that_is_given_up_is_no_solution(solver: str) -> None:
    """With z ≥ 2 against z ≤ 1 and equal penalties the cost alone decides: z = 2, its optimum."""
    workspace = open_workspace(solver, policy="warm", settings="high")
    assert solve_qp(workspace, HARD).status is Status.SOLVED
    answer = solve_next(workspace, QPStep(HARD.q, np.array([2.0]), HARD.u))
    assert answer.status is Status.INACCURATE
    assert answer.detail == "saturated rows: 1"
    np.testing.assert_allclose(answer.z, [2.0], atol=1e-8)
    again = solve_next(workspace, QPStep(HARD.q, HARD.l, HARD.u))
    assert again.status is Status.SOLVED
    np.testing.assert_allclose(again.z, [1.0], atol=1e-8)


@pytest.mark.parametrize("solver", METHODS)
def test_a_penalty_below_a_multiplier_gives_its_limit_up(solver: str) -> None:
    """At penalty 1 the multiplier 2 of z ≤ 1 is out of reach: z − 3 + 1 = 0."""
    qp = QuadraticProgram([[1]], [-3], np.zeros((0, 1)), [], [], [-np.inf], [1])
    for penalty, status, z in ((1.0, Status.INACCURATE, 2.0), (2.5, Status.SOLVED, 1.0)):
        workspace = open_workspace(solver, settings={"penalty": penalty, "eps_abs": 1e-9})
        answer = solve_qp(workspace, qp)
        assert answer.status is status
        np.testing.assert_allclose(answer.z, [z], atol=1e-8)
