"""Stages of a QP: the ones it is built of, or a single one where the sizes do not fit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dpbench.solvers.libraries.hpipm_ocp import Stage, split_stages

Array = NDArray[np.float64]


class StagedCase:
    """A QP put together stage by stage, each with its inputs, its states and some rows."""

    def __init__(self, rng: np.random.Generator, sizes: list[tuple[int, int, int]]) -> None:
        self.sizes = [(x, u) for u, x, _ in sizes]
        starts = np.cumsum([0, *(sum(size) for size in self.sizes)])
        n = int(starts[-1])
        self.P = np.zeros((n, n))
        rows: list[Array] = []
        equal: list[bool] = []
        before = range(0)
        for (n_u, n_x, n_rows), first in zip(sizes, starts, strict=False):
            here = range(first, first + n_u + n_x)
            root = rng.uniform(0.5, 1.0, size=(len(here), len(here)))
            self.P[np.ix_(here, here)] = root @ root.T
            for state in [*range(first, first + n_x), *[None] * n_rows]:
                row = np.zeros(n)
                others = list(here if state is None else before)
                row[others] = rng.uniform(0.5, 1.0, size=len(others))
                if state is not None:
                    row[state] = rng.choice([-2.0, 1.0, 0.5])
                rows.append(row)
                equal.append(state is not None)
            before = here
        order = rng.permutation(len(rows))
        self.A = np.reshape(rows, (len(rows), n))[order]
        self.equal = np.array(equal, dtype=bool)[order]


def assert_complete(stages: list[Stage], P: Array, A: Array, equal: NDArray[np.bool_]) -> None:
    """Each variable and each row is in one stage, and no entry is lost between them."""
    variables = np.concatenate([stage.variables for stage in stages])
    dynamics = np.concatenate([stage.dynamics for stage in stages])
    rows = np.concatenate([dynamics, *(stage.rows for stage in stages)])
    np.testing.assert_array_equal(np.sort(variables), np.arange(P.shape[0]))
    np.testing.assert_array_equal(np.sort(rows), np.arange(A.shape[0]))
    assert stages[0].states.size == 0 and equal[dynamics].all()
    cost, linear = np.zeros_like(P), np.zeros_like(A)
    for k, stage in enumerate(stages):
        here = stage.variables
        cost[np.ix_(here, here)] = P[np.ix_(here, here)]
        linear[np.ix_(stage.rows, here)] = A[np.ix_(stage.rows, here)]
        for row, state in zip(stage.dynamics, stage.states, strict=True):
            linear[row, state] = A[row, state]
            linear[row, stages[k - 1].variables] = A[row, stages[k - 1].variables]
    np.testing.assert_array_equal(cost, P)
    np.testing.assert_array_equal(linear, A)


SIZES = st.tuples(
    st.tuples(st.integers(1, 3), st.just(0), st.integers(0, 2)),
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(1, 3), st.integers(0, 2)), min_size=1, max_size=6
    ),
)


@settings(max_examples=60, deadline=None)
@given(SIZES, st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.02, 0.5]))
def test_stages_are_the_given_ones_and_lose_no_entry(sizes, seed: int, coupling: float) -> None:
    """Stages of any sizes, rows in any order; with entries in other places, at most one stage."""
    rng = np.random.default_rng(seed)
    case = StagedCase(rng, [sizes[0], *sizes[1]])
    case.A[rng.uniform(size=case.A.shape) < coupling] = 0.3
    stages = split_stages(case.sizes, case.P, case.A, case.equal)
    if not coupling or len(stages) > 1:
        assert [(s.states.size, s.inputs.size) for s in stages] == case.sizes
    assert_complete(stages, case.P, case.A, case.equal)


def test_sizes_that_do_not_fit_leave_a_single_stage() -> None:
    """No sizes, a wrong sum, a state in the first stage, and a state that no row defines."""
    A, equal = np.array([[1.0, -1.0], [2.0, -1.0]]), np.array([True, True])
    for sizes in ([], [(0, 1)], [(1, 0), (1, 0)], [(0, 1), (1, 0)]):
        stages = split_stages(sizes, np.eye(2), A, equal if sizes != [(0, 1), (1, 0)] else ~equal)
        assert [stage.inputs.tolist() for stage in stages] == [[0, 1]]
        assert stages[0].rows.tolist() == [0, 1]
