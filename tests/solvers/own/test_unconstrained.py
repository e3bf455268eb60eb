"""The baseline law."""

import numpy as np
import pytest

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import solve_next, solve_qp


@pytest.mark.parametrize("policy", ["fresh", "reuse"])
def test_it_minimises_the_cost_and_claims_nothing(sequence, policy):
    """Its answer makes the gradient vanish, whatever the limits; status UNKNOWN, no multipliers."""
    workspace = open_workspace("unconstrained_clipped", policy=policy)
    workspace.setup(sequence.base)
    for step in sequence.steps:
        answer = solve_next(workspace, step)
        # Two triangular solves with a condition number below 100 leave some 1e-14.
        np.testing.assert_allclose(sequence.base.P @ answer.z, -step.q, rtol=0, atol=1e-12)
        assert answer.status is Status.UNKNOWN
        assert not answer.y.any()
        assert not answer.y_box.any()


def test_new_matrices_are_factorised_again(sequence):
    """A step that brings another P is solved with it, and so is the step after it."""
    workspace = open_workspace("unconstrained_clipped", policy="reuse")
    workspace.setup(sequence.base)
    first, second = sequence.steps[:2]
    workspace.update(QPStep(first.q, first.l, first.u, P=4.0 * sequence.base.P))
    z = solve_next(workspace, second).z
    np.testing.assert_allclose(4.0 * sequence.base.P @ z, -second.q, rtol=0, atol=1e-12)


def test_a_cost_without_a_minimum_is_an_error():
    """A P that is not positive definite gives ERROR and no answer."""
    workspace = open_workspace("unconstrained_clipped")
    eye = np.eye(2)
    answer = solve_qp(
        workspace,
        QuadraticProgram(np.diag([1.0, -1.0]), [1, 1], eye, [-1, -1], [1, 1], [-1, -1], [1, 1]),
    )
    assert answer.status is Status.ERROR
    assert np.isnan(answer.z).all()
