"""The memory of active sets in front of the paper's method."""

import numpy as np
import pytest

from dpbench import load_sequence, open_workspace
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Status
from dpbench.solvers.own.active_set_memory import ActiveSetMemoryWorkspace, make_law


def test_the_law_of_a_corner_by_hand() -> None:
    """The point nearest (3, 2) under z₀ ≤ 1 and z₀ + z₁ ≤ 2 is (1, 1), with λ = (1, 1)."""
    C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    law = make_law(C, C, np.array([0, 2]), np.ones(2))
    lam = law.gain @ np.array([3.0, 2.0, 1.0, 2.0])
    assert lam == pytest.approx([1.0, 1.0])
    assert np.array([3.0, 2.0]) - law.back @ lam == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("name", ["move-30-5", "thrusters_move-30-5", "thruster_loss-60-10"])
def test_answers_are_the_certified_optima(name: str) -> None:
    """With and without a stored law; a step of a stored law has no iterations."""
    sequence = load_sequence(name)
    workspace = open_workspace("active_set_memory", route="native", policy="warm")
    plain = open_workspace("paper_active_set", route="native", policy="fresh")
    assert isinstance(workspace, ActiveSetMemoryWorkspace)
    for opened in (workspace, plain):
        opened.setup(sequence.problem(0))
    for k in range(40):
        hits = workspace.hits
        for opened in (workspace, plain):
            opened.update(sequence.step(k))
            opened.solve()
        answer, expected = workspace.read(), plain.read()
        assert answer.status is expected.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, expected.z, atol=1e-9)
        np.testing.assert_allclose(answer.y, expected.y, atol=1e-6)
        if workspace.hits > hits:
            assert answer.iterations == 0
    assert workspace.hits > 5


def test_new_matrices_and_a_reset_empty_the_memory() -> None:
    """The same step is solved anew after either, and answered from memory in between."""
    sequence = load_sequence("move-30-5")
    workspace = open_workspace("active_set_memory", route="native", policy="warm")
    assert isinstance(workspace, ActiveSetMemoryWorkspace)
    workspace.setup(sequence.problem(3))

    def solve_again(step: QPStep) -> bool:
        """Solve a step; return whether it is answered from memory."""
        hits = workspace.hits
        workspace.update(step)
        workspace.solve()
        return workspace.hits > hits

    step = sequence.step(3)
    assert [solve_again(step), solve_again(step)] == [False, True]
    changed = QPStep(step.q, step.l, step.u, A=sequence.base.A.copy())
    assert [solve_again(changed), solve_again(step)] == [False, True]
    workspace.reset()
    assert not solve_again(step)
