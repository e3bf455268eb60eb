"""The stages of a QP: all of it in one stage each, and those it was made of."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dpbench.solvers.libraries.hpipm.stages import Stage, find_stages

Array = NDArray[np.float64]


class Made:
    """A QP put together stage by stage, each with its inputs, its states and some rows."""

    def __init__(self, rng: np.random.Generator, sizes: list[tuple[int, int, int]]) -> None:
        starts = np.cumsum([0, *(u + x for u, x, _ in sizes)])
        n = int(starts[-1])
        self.P = np.zeros((n, n))
        self.stages: list[tuple[set[int], set[int]]] = []
        rows: list[Array] = []
        equal: list[bool] = []
        before = range(0)
        for (n_u, n_x, n_rows), first in zip(sizes, starts, strict=False):
            here = range(first, first + n_u + n_x)
            # States and inputs of a stage in any order.
            places = rng.permutation(here)
            inputs, states = places[:n_u], np.sort(places[n_u:])
            self.stages.append((set(inputs.tolist()), set(states.tolist())))
            root = rng.uniform(0.5, 1.0, size=(len(here), len(here)))
            self.P[np.ix_(here, here)] = root @ root.T
            for state in states:
                row = np.zeros(n)
                row[list(before)] = rng.uniform(0.5, 1.0, size=len(before))
                row[state] = rng.choice([-2.0, 1.0, 0.5])
                rows.append(row)
                equal.append(True)
            for _ in range(n_rows):
                row = np.zeros(n)
                row[list(here)] = rng.uniform(0.5, 1.0, size=len(here))
                rows.append(row)
                equal.append(False)
            before = here
        order = rng.permutation(len(rows))
        self.A = np.reshape(rows, (len(rows), n))[order]
        self.equal = np.array(equal, dtype=bool)[order]


def reassembled(stages: list[Stage], P: Array, A: Array) -> tuple[Array, Array]:
    """The matrices put together from what HPIPM is given of each stage, and no other entry."""
    cost, rows = np.zeros_like(P), np.zeros_like(A)
    for k, stage in enumerate(stages):
        here = stage.variables
        cost[np.ix_(here, here)] = P[np.ix_(here, here)]
        rows[np.ix_(stage.rows, here)] = A[np.ix_(stage.rows, here)]
        for row, state in zip(stage.dynamics, stage.states, strict=True):
            rows[row, state] = A[row, state]
            rows[row, stages[k - 1].variables] = A[row, stages[k - 1].variables]
    return cost, rows


def assert_whole(stages: list[Stage], P: Array, A: Array, equal: NDArray[np.bool_]) -> None:
    """Each variable and each row is in one stage, and no entry is lost between them."""
    variables = np.concatenate([stage.variables for stage in stages])
    dynamics = np.concatenate([stage.dynamics for stage in stages])
    rows = np.concatenate([dynamics, *(stage.rows for stage in stages)])
    np.testing.assert_array_equal(np.sort(variables), np.arange(P.shape[0]))
    np.testing.assert_array_equal(np.sort(rows), np.arange(A.shape[0]))
    assert stages[0].states.size == 0 and equal[dynamics].all()
    cost, rows = reassembled(stages, P, A)
    np.testing.assert_array_equal(cost, P)
    np.testing.assert_array_equal(rows, A)


SIZES = st.tuples(
    st.tuples(st.integers(1, 3), st.just(0), st.integers(0, 2)),
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(1, 3), st.integers(0, 2)), min_size=1, max_size=6
    ),
)


@settings(max_examples=60, deadline=None)
@given(sizes=SIZES, seed=st.integers(0, 2**32 - 1))
def test_the_stages_a_problem_was_made_of_are_found(
    sizes: tuple[tuple[int, int, int], list[tuple[int, int, int]]], seed: int
) -> None:
    """Any number of stages of any sizes, rows in any order, inputs at the last stage too."""
    made = Made(np.random.default_rng(seed), [sizes[0], *sizes[1]])
    stages = find_stages(made.P, made.A, made.equal)
    variables = [(set(stage.inputs.tolist()), set(stage.states.tolist())) for stage in stages]
    assert variables == made.stages
    assert_whole(stages, made.P, made.A, made.equal)


@settings(max_examples=60, deadline=None)
@given(sizes=SIZES, seed=st.integers(0, 2**32 - 1))
def test_nothing_is_lost_whatever_the_order_and_the_pattern(
    sizes: tuple[tuple[int, int, int], list[tuple[int, int, int]]], seed: int
) -> None:
    """Variables in an order that is not that of time, with some more coupling here and there."""
    rng = np.random.default_rng(seed)
    made = Made(rng, [sizes[0], *sizes[1]])
    order = rng.permutation(made.P.shape[0])
    P, A = made.P[np.ix_(order, order)], made.A[:, order]
    A[rng.uniform(size=A.shape) < rng.choice([0.0, 0.02, 0.5])] = 0.3
    assert_whole(find_stages(P, A, made.equal), P, A, made.equal)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 6), m=st.integers(0, 5), seed=st.integers(0, 2**32 - 1))
def test_a_dense_problem_is_one_stage_of_inputs(n: int, m: int, seed: int) -> None:
    """Whichever of its rows are equalities, but for a single variable that one of them fixes."""
    rng = np.random.default_rng(seed)
    P, A = rng.uniform(0.5, 1.0, size=(n, n)), rng.uniform(0.5, 1.0, size=(m, n))
    equal = rng.uniform(size=m) < 0.5
    stages = find_stages(P + P.T, A, equal)
    assert_whole(stages, P + P.T, A, equal)
    if n > 1:
        assert len(stages) == 1 and stages[0].inputs.size == n


def test_two_rows_that_define_one_variable_are_no_dynamics() -> None:
    """The first defines it, the second is a row that spans two stages: there are no stages."""
    A = np.array([[1.0, -1.0], [2.0, -1.0]])
    stages = find_stages(np.eye(2), A, np.array([True, True]))
    assert [stage.inputs.tolist() for stage in stages] == [[0, 1]]
    assert stages[0].rows.tolist() == [0, 1]
