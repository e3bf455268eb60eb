"""Building: condensing once, emitting every step. Read the ratios within each group."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from dpbench import load_scenario
from dpbench.bench.run.exact_loop import build_problem_at_rest
from dpbench.bench.run.formulation import BoxFormulation, QPBuilder
from dpbench.mpc.condense import ControlProblem, build_affine_map, condense_mpc_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.kernels import write_condensed_hessian
from dpbench.scenario.scenario import Scenario, condense

SIZES = (75, 150, 300, 600, 900)


def qpmpc_build(problem: ControlProblem) -> Callable[[], Any]:
    """A call that builds qpmpc's QP of the same horizon, its best form; skipped without qpmpc."""
    qpmpc = pytest.importorskip("qpmpc", reason="qpmpc is not installed")
    model = problem.model
    n_x, n_u = model.n_x, model.n_u
    A = np.block([[model.A, np.zeros((n_x, n_u))], [np.zeros((n_u, n_x)), np.eye(n_u)]])
    B = np.vstack([model.B, np.eye(n_u)])
    select = np.hstack([np.zeros((n_u, n_x)), np.eye(n_u)])
    C_rows = np.vstack([select, -select, np.zeros((2 * n_u, n_x + n_u))])
    D_rows = np.vstack([np.eye(n_u), -np.eye(n_u), np.eye(n_u), -np.eye(n_u)])
    e_rows = np.concatenate([problem.u_max, -problem.u_min, problem.du_max, problem.du_max])
    logging.disable(logging.WARNING)

    def build() -> Any:
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

    return build


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_condense(
    benchmark: BenchmarkFixture, exactly: Callable[..., None], problem: ControlProblem
) -> None:
    A = CondensedQP(problem).A
    exactly(lambda: CondensedQP(problem), rows=A.shape[0], variables=A.shape[1])
    benchmark(CondensedQP, problem)


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_condense_matrices_and_map(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    benchmark(lambda: build_affine_map(problem, condense_mpc_matrices(problem), "scaled"))


@pytest.mark.benchmark(group="condense 30/5 from given (A, B, C)")
def test_qpmpc_builds(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    """qpmpc 3.3 on the same horizon."""
    benchmark(qpmpc_build(problem))


@pytest.mark.benchmark(group="condense 300/300 (n = 900), by turns with qpmpc")
def test_condense_long(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    long = replace(problem, N_p=300, N_c=300)
    build, times = qpmpc_build(long), []

    def before() -> None:
        start = time.perf_counter()
        build()
        times.append(time.perf_counter() - start)

    benchmark.pedantic(CondensedQP, (long,), setup=before, rounds=7, warmup_rounds=1)
    # Without --benchmark-disable; the first one warmed up.
    if benchmark.stats is not None:
        theirs, ours = float(np.median(times[1:])), float(benchmark.stats.stats.median)
        benchmark.extra_info["qpmpc_median_s"] = theirs
        benchmark.extra_info["times_faster_than_qpmpc"] = theirs / ours


@pytest.mark.benchmark(group="growth: P by the block recursion, N_p = N_c = n/3")
@pytest.mark.parametrize("n", SIZES)
def test_hessian_grows(benchmark: BenchmarkFixture, problem: ControlProblem, n: int) -> None:
    horizon = n // problem.model.n_u
    h = condense_mpc_matrices(replace(problem, N_p=horizon, N_c=horizon)).h
    benchmark.extra_info["n"] = n
    E = np.empty((n, n))
    benchmark(write_condensed_hessian, np.ascontiguousarray(h), problem.Q, problem.R, horizon, E)


@pytest.mark.benchmark(group="growth: the whole CondensedQP, N_p = N_c = n/3")
@pytest.mark.parametrize("n", SIZES)
def test_condense_grows(benchmark: BenchmarkFixture, problem: ControlProblem, n: int) -> None:
    horizon = n // problem.model.n_u
    benchmark.extra_info["n"] = n
    benchmark(CondensedQP, replace(problem, N_p=horizon, N_c=horizon))


@pytest.mark.benchmark(group="emit one step")
def test_emit(
    benchmark: BenchmarkFixture, exactly: Callable[..., None], problem: ControlProblem
) -> None:
    builder = CondensedQP(problem)
    x, y_ref, u_prev = np.full(9, 0.1), np.zeros(3), np.ones(3)
    exactly(lambda: builder.emit(x, y_ref, u_prev), rows=builder.A.shape[0])
    benchmark(builder.emit, x, y_ref, u_prev)


@pytest.mark.benchmark(group="emit one step")
def test_emit_as_timed(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    builder = QPBuilder(scenario)
    box, x, u_prev = (
        BoxFormulation(build_problem_at_rest(builder.condensed)),
        np.full(9, 0.1),
        np.ones(3),
    )
    benchmark(lambda: box.step(builder.emit(0, x, u_prev)))


@pytest.mark.benchmark(group="emit one step")
def test_bare_product(benchmark: BenchmarkFixture, problem: ControlProblem) -> None:
    """numpy.dot of the same matrix with out=: the least that emitting could cost."""
    builder = CondensedQP(problem)
    theta, out = np.full(builder.Z.shape[1], 0.1), np.empty(builder.Z.shape[0])
    benchmark(lambda: np.dot(builder.Z, theta, out=out))


@pytest.fixture(scope="module", params=[(30, 5), (60, 10)], ids=["30/5", "60/10"])
def loss(request: pytest.FixtureRequest) -> Scenario:
    """A ship that loses thrusters on the way."""
    return load_scenario("thrusters_loss").with_horizons(*request.param)


@pytest.mark.benchmark(group="emit one step with thrusters")
@pytest.mark.parametrize("behind", [-1, 1], ids=["intact", "lost"])
def test_emit_with_thrusters(benchmark: BenchmarkFixture, loss: Scenario, behind: int) -> None:
    builder, fault = QPBuilder(loss), min(k for k, _ in loss.controller.changes)
    x, f = np.full(9, 0.1), np.full(loss.controller.thruster_force_count, 5e3)
    benchmark(builder.emit, fault + behind, x, f)


@pytest.mark.benchmark(group="emit one step with thrusters")
def test_bare_product_with_thrusters(benchmark: BenchmarkFixture, loss: Scenario) -> None:
    Z = condense(loss).Z
    theta, out = np.full(Z.shape[1], 0.1), np.empty(Z.shape[0])
    benchmark(lambda: np.dot(Z, theta, out=out))
