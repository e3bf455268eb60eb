"""HPIPM by stages: random optimal control problems against the referee's certified optimum."""

from collections.abc import Iterator

import numpy as np
import pytest

from dpbench import load_scenario, record_sequence
from dpbench.arrays import Flags, Matrix
from dpbench.errors import SettingsError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.libraries.hpipm_ocp import (
    Stage,
    group_stages_into_blocks,
    split_qp_into_stages,
)
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import find_solver_availability
from tests.solvers.conftest import run_program, solve_next

needs_casadi = pytest.mark.skipif(
    not find_solver_availability("hpipm_ocp").ok, reason="casadi is not installed"
)

TIGHT = {
    **dict.fromkeys(("tol_stat", "tol_eq", "tol_ineq", "tol_comp"), 1e-10),
    "iter_max": 100,
    "mode": "BALANCE",
}
INF = np.inf


class Staged:
    """A random optimal control problem in the order u_0 | x_1, u_1 | …, and steps of it.

    Inputs are limited by bounds, by rows of one variable and by rows of several, on both sides or
    one; the cost of the states is semidefinite, of integers, so that rounding leaves it so. The
    last stages, `without_input` of them, have states only.
    """

    def __init__(self, seed: int, stages: int, without_input: int = 0) -> None:
        rng = self._rng = np.random.default_rng(seed)
        n_x = 3
        inputs = [2] * (stages + 1 - without_input) + [0] * without_input
        self._n = n = stages * n_x + sum(inputs)
        P, rows, self._dynamics = np.zeros((n, n)), [], []
        lb, ub = np.full(n, -INF), np.full(n, INF)
        first = 0
        for k, n_u in enumerate(inputs):
            u = slice(first, first + n_u)
            if n_u:
                root = rng.integers(-2, 3, size=(n_u, n_u))
                P[u, u] = np.eye(n_u) + root @ root.T
                lb[first], ub[first] = -1.0, rng.choice([1.0, INF])
                rows.append(np.eye(n)[first + 1] * rng.choice([1.0, -2.0]))
            if k == stages:
                continue
            x = slice(first + n_u, first + n_u + n_x)
            output = rng.integers(-2, 3, size=(1, n_x))
            P[x, x] = output.T @ output
            for i in range(n_x):
                row = np.zeros(n)
                row[x.start + i] = rng.choice([1.0, -1.0, 0.5])
                before = slice(max(first - n_x, 0), first + n_u)
                row[before] = 0.4 * rng.normal(size=row[before].size)
                rows.append(row)
                self._dynamics.append(len(rows) - 1)
            mixed = np.zeros(n)
            mixed[x] = rng.normal(size=n_x)
            rows.append(mixed)
            first = x.stop
        self._A = np.array(rows)
        step = self.step()
        sizes = ((0, inputs[0]), *((n_x, n_u) for n_u in inputs[1:]))
        self.base = QuadraticProgram(P, step.q, self._A, step.l, step.u, lb, ub, stages=sizes)

    def step(self) -> QPStep:
        """Another cost and other limits around a point within the bounds; one side may be open."""
        rng, m = self._rng, len(self._A)
        inside = self._A @ rng.uniform(-0.5, 0.5, size=self._n)
        low, high = inside - rng.uniform(0.1, 1.0, size=m), inside + rng.uniform(0.1, 1.0, size=m)
        low[rng.uniform(size=m) < 0.2] = -INF
        high[rng.uniform(size=m) < 0.2] = INF
        low[self._dynamics] = high[self._dynamics] = inside[self._dynamics]
        return QPStep(3.0 * rng.normal(size=self._n), low, high)


def answers(case: Staged, policy: str, size: int) -> Iterator[tuple[QuadraticProgram, Solution]]:
    """The problems of three steps, whose equal and infinite sides change, and the answers."""
    settings = {**TIGHT, "cond_block_size": size}
    workspace = open_workspace("hpipm_ocp", route="native", policy=policy, settings=settings)
    workspace.setup(case.base)
    for _ in range(3):
        step = case.step()
        yield case.base.at(step), solve_next(workspace, step)


def assert_optimal(qp: QuadraticProgram, answer: Solution) -> None:
    """The certified optimum, and multipliers that fulfil all conditions of optimality."""
    # An interior point is as near as the square root of its gap where limits are weakly active.
    np.testing.assert_allclose(answer.z, certify(qp).z, rtol=0, atol=1e-5)
    gradient = qp.P @ answer.z + qp.q + qp.A.T @ answer.y + answer.y_box
    assert np.abs(gradient).max() < 1e-8
    for value, low, high, y in (
        (qp.A @ answer.z, qp.l, qp.u, answer.y),
        (answer.z, qp.lb, qp.ub, answer.y_box),
    ):
        assert (value - high).max() < 1e-8 and (low - value).max() < 1e-8
        for side, slack in ((y, high - value), (-y, value - low)):
            # An equality is without slack, whatever the sign of its multiplier.
            acting = (side > 1e-9) & (low < high)
            assert (side[acting] * slack[acting] < 1e-8).all()


@needs_casadi
@pytest.mark.parametrize("size", [1, 2, 9])
@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
def test_random_optimal_control_problems(policy: str, size: int) -> None:
    stalls = 0
    for seed in range(20):
        case = Staged(seed, 1 + seed % 4, seed % 3 if seed % 4 > 1 else 0)
        for qp, answer in answers(case, policy, size):
            if answer.status is Status.SOLVED:
                assert_optimal(qp, answer)
            else:
                assert answer.status is Status.MAX_ITERATIONS
                stalls += 1
    assert stalls <= 2  # of 60


@needs_casadi
@pytest.mark.parametrize("size", [2, 5, 99])
def test_blocks_of_stages_of_any_size_leave_the_ship_the_same_move(size: int) -> None:
    sequence = record_sequence(load_scenario("rough").truncate(12)).sparse_equivalent().sequence
    plans = []
    for block in (1, size):
        settings = {**TIGHT, "cond_block_size": block}
        workspace = open_workspace("hpipm_ocp", route="native", policy="reuse", settings=settings)
        workspace.setup(sequence.base)
        steps = [sequence.step(k) for k in range(len(sequence))]
        plans.append([solve_next(workspace, step).z for step in steps])
    np.testing.assert_allclose(plans[1], plans[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("size", [0, -1, 1.5])
@needs_casadi
def test_a_block_has_at_least_one_stage(size: float) -> None:
    with pytest.raises(SettingsError, match=r"cond_block_size: found .*; allowed: a whole number"):
        open_workspace("hpipm_ocp", route="native", settings={"cond_block_size": size})


@pytest.mark.parametrize(
    ("size", "counts"),
    [(1, [1] * 7), (2, [2, 2, 3]), (3, [3, 4]), (4, [4, 3]), (5, [7, 1]), (99, [7, 1])],
)
def test_stages_without_inputs_join_the_block_before(size: int, counts: list[int]) -> None:
    inputs = [2, 2, 2, 2, 2, 0, 0]
    nothing = np.empty(0, dtype=np.intp)
    stages = [Stage(np.arange(n), nothing, nothing, nothing) for n in inputs]
    grouped, found = group_stages_into_blocks(stages, size)
    assert found == counts and sum(found) == len(grouped)


@needs_casadi
def test_it_leaves_the_factorisation_of_piqp_alone() -> None:
    program = """
import numpy as np
from dpbench import load_scenario, open_workspace, record_sequence
sequence = record_sequence(load_scenario("paper").truncate(5)).sparse_equivalent().sequence
answers = []
for solver in ("hpipm_ocp", "hpipm", "piqp_multistage", "hpipm_ocp"):
    workspace = open_workspace(solver, route="native", policy="reuse", settings="high")
    workspace.setup(sequence.base)
    for k in range(len(sequence)):
        workspace.update(sequence.step(k))
        workspace.solve()
    assert workspace.read().claimed
    answers.append(workspace.read().z)
for answer in answers[1:]:
    assert np.abs(answer - answers[0]).max() < 1e-4 * np.abs(answers[0]).max()
"""
    run_program(program)


def assert_complete(stages: list[Stage], P: Matrix, A: Matrix, equal: Flags) -> None:
    """Each variable and each row is in one stage, and no entry is lost between them."""
    variables = np.concatenate([stage.variable_indices for stage in stages])
    dynamics = np.concatenate([stage.dynamics for stage in stages])
    rows = np.concatenate([dynamics, *(stage.rows for stage in stages)])
    np.testing.assert_array_equal(np.sort(variables), np.arange(P.shape[0]))
    np.testing.assert_array_equal(np.sort(rows), np.arange(A.shape[0]))
    assert stages[0].states.size == 0 and equal[dynamics].all()
    cost, linear = np.zeros_like(P), np.zeros_like(A)
    for k, stage in enumerate(stages):
        here = stage.variable_indices
        cost[np.ix_(here, here)] = P[np.ix_(here, here)]
        linear[np.ix_(stage.rows, here)] = A[np.ix_(stage.rows, here)]
        for row, state in zip(stage.dynamics, stage.states, strict=True):
            linear[row, state] = A[row, state]
            linear[row, stages[k - 1].variable_indices] = A[row, stages[k - 1].variable_indices]
    np.testing.assert_array_equal(cost, P)
    np.testing.assert_array_equal(linear, A)


@pytest.mark.parametrize("coupling", [0.0, 0.01, 0.5])
@pytest.mark.parametrize("seed", range(12))
def test_stages_are_those_of_the_builder_and_lose_no_entry(seed: int, coupling: float) -> None:
    rng, qp = np.random.default_rng(seed), Staged(seed, 1 + seed % 6).base
    order = rng.permutation(qp.m)
    A, equal = qp.A[order], (qp.l == qp.u)[order]
    A[rng.uniform(size=A.shape) < coupling] = 0.3
    stages = split_qp_into_stages(qp.stages, qp.P, A, equal)
    if not coupling or len(stages) > 1:
        assert tuple((s.states.size, s.inputs.size) for s in stages) == qp.stages
    assert_complete(stages, qp.P, A, equal)


def test_sizes_that_do_not_fit_leave_a_single_stage() -> None:
    A, equal = np.array([[1.0, -1.0], [2.0, -1.0]]), np.array([True, True])
    for sizes in ([], [(0, 1)], [(1, 0), (1, 0)], [(0, 1), (1, 0)]):
        stages = split_qp_into_stages(
            sizes, np.eye(2), A, equal if sizes != [(0, 1), (1, 0)] else ~equal
        )
        assert [stage.inputs.tolist() for stage in stages] == [[0, 1]]
        assert stages[0].rows.tolist() == [0, 1]
