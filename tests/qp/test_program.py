"""The language of QPs: what a step changes, what a sequence replays, which variables are moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dpbench.errors import ShapeError
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram, Refresh
from dpbench.qp.stacked import stack

K, N, M = 4, 6, 4


def program(seed: int, **more: Any) -> QuadraticProgram:
    """A convex QP with random numbers everywhere."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    return QuadraticProgram(
        root @ root.T,
        rng.normal(size=N),
        rng.normal(size=(M, N)),
        -rng.uniform(1, 2, M),
        rng.uniform(1, 2, M),
        -rng.uniform(1, 2, N),
        rng.uniform(1, 2, N),
        **more,
    )


def sequence(problems: list[QuadraticProgram], *matrices: str) -> QPSequence:
    """The problems as a sequence that brings these matrices."""
    stacked = {name: np.array([getattr(p, name) for p in problems]) for name in matrices}
    vectors = {name: np.array([getattr(p, name) for p in problems]) for name in ("q", "l", "u")}
    return QPSequence(name="random", base=problems[0], **vectors, **stacked)


@pytest.mark.parametrize("matrices", [(), ("P",), ("A",), ("P", "A")], ids="".join)
def test_a_sequence_replays_the_problem_of_every_step(matrices: tuple[str, ...]) -> None:
    """problem(k) has the vectors of step k, its matrices where the sequence brings them and those
    of the base elsewhere, however the steps are visited."""
    problems = [program(k) for k in range(K)]
    recorded = sequence(problems, *matrices)
    for k in (2, 0, 3, 1):
        step, found = recorded.step(k), recorded.problem(k)
        changed = Refresh.VECTORS | (Refresh.MATRICES if matrices else Refresh.VECTORS)
        assert step.refresh == changed
        for name in ("q", "l", "u", *matrices):
            np.testing.assert_array_equal(getattr(found, name), getattr(problems[k], name))
        for name in {"P", "A", "lb", "ub"} - set(matrices):
            np.testing.assert_array_equal(getattr(found, name), getattr(problems[0], name))


@pytest.mark.parametrize(("name", "shape"), [("P", (K, N, M)), ("A", (K, N, N)), ("P", (K, N))])
def test_a_sequence_names_the_matrices_that_do_not_fit(name: str, shape: tuple[int, ...]) -> None:
    """P must be (K, n, n) and A (K, m, n)."""
    base = program(0)
    vectors = {"q": np.zeros((K, N)), "l": np.zeros((K, M)), "u": np.zeros((K, M))}
    with pytest.raises(ShapeError) as caught:
        QPSequence(name="bad", base=base, **vectors, **{name: np.zeros(shape)})
    assert caught.value.key == name


def test_the_number_of_moves_survives_steps_and_stacking() -> None:
    """Which variables are moves is a fact of the problem that neither a step nor its one-sided form
    loses."""
    qp = program(0, block=3, moves=2)
    step = QPStep(2.0 * qp.q, qp.l, qp.u, P=3.0 * qp.P)
    assert (qp.at(step).block, qp.at(step).moves) == (3, 2)
    assert stack(qp).moves == 2
    assert program(0, block=3).moves == 0


@pytest.mark.parametrize(("block", "moves"), [(3, 4), (3, -1), (0, N + 1)])
def test_more_moves_than_variables_of_a_block_are_refused(block: int, moves: int) -> None:
    """A block cannot hold more moves than variables."""
    with pytest.raises(ShapeError) as caught:
        program(0, block=block, moves=moves)
    assert caught.value.key == "moves"
