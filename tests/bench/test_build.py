"""Building: condensing once, emitting every step. Read the ratios within each group."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest
import qpmpc
from pytest_benchmark.fixture import BenchmarkFixture

from dpbench.mpc.condense import ControlProblem, affine_map, condense_matrices
from dpbench.mpc.condensed_qp import CondensedQP


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_condense(
    benchmark: BenchmarkFixture, exactly: Callable[..., None], problem: ControlProblem
) -> None:
    """The whole CondensedQP: E, F, Φ, the affine map, scaling."""
    A = CondensedQP(problem).A
    exactly(lambda: CondensedQP(problem), rows=A.shape[0], variables=A.shape[1])
    benchmark(CondensedQP, problem)


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_condense_matrices_and_map(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    """The algebra alone: what a re-linearised step needs."""
    benchmark(lambda: affine_map(problem, condense_matrices(problem), "scaled"))


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_qpmpc_builds(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    """qpmpc 3.3 on the same horizon: states [x; u(k−1)], the same amplitude and rate rows."""
    model = problem.model
    n_x, n_u = model.n_x, model.n_u
    A = np.block([[model.A, np.zeros((n_x, n_u))], [np.zeros((n_u, n_x)), np.eye(n_u)]])
    B = np.vstack([model.B, np.eye(n_u)])
    select = np.hstack([np.zeros((n_u, n_x)), np.eye(n_u)])
    C_rows = np.vstack([select, -select, np.zeros((2 * n_u, n_x + n_u))])
    D_rows = np.vstack([np.eye(n_u), -np.eye(n_u), np.eye(n_u), -np.eye(n_u)])
    e_rows = np.concatenate([problem.u_max, -problem.u_min, problem.du_max, problem.du_max])
    logging.disable(logging.WARNING)

    def build() -> qpmpc.MPCQP:
        mpc = qpmpc.MPCProblem(
            transition_state_matrix=A,
            transition_input_matrix=B,
            ineq_state_matrix=C_rows,
            ineq_input_matrix=D_rows,
            ineq_vector=e_rows,
            nb_timesteps=problem.N_p,
            terminal_cost_weight=1.0,
            stage_state_cost_weight=1.0,
            stage_input_cost_weight=1e-10,
            initial_state=np.zeros(n_x + n_u),
            goal_state=np.zeros(n_x + n_u),
            target_states=np.zeros(problem.N_p * (n_x + n_u)),
        )
        return qpmpc.MPCQP(mpc)

    benchmark(build)


@pytest.mark.benchmark(group="emit one step")
def test_emit(
    benchmark: BenchmarkFixture, exactly: Callable[..., None], problem: ControlProblem
) -> None:
    """θ → q, l, u in memory of its own."""
    builder = CondensedQP(problem)
    x, y_ref, u_prev = np.full(9, 0.1), np.zeros(3), np.ones(3)
    exactly(lambda: builder.emit(x, y_ref, u_prev), rows=builder.A.shape[0])
    benchmark(builder.emit, x, y_ref, u_prev)


@pytest.mark.benchmark(group="emit one step")
def test_bare_product(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    """numpy.dot of the same matrix with out=: the least that emitting could cost."""
    builder = CondensedQP(problem)
    theta, out = np.full(builder.Z.shape[1], 0.1), np.empty(builder.Z.shape[0])
    benchmark(lambda: np.dot(builder.Z, theta, out=out))
