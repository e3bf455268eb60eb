"""The QP of a controller that commands thrusters, against other constructions."""

from dataclasses import replace
from typing import Any

import clarabel
import numpy as np
import pytest
import scipy.sparse

from dpbench.mpc.condense import ControlProblem, condense_mpc_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import StateSpace, build_prediction_model
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import build_limit_rows_of_thrusters
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.thrusters import Thruster, ThrusterSet

SAMPLE_S = 0.6
Q = np.diag([1.0, 1.0, 3000.0])
SHIP = load_vessel("supply_fs99")
THRUSTERS = ThrusterSet(
    (
        Thruster("port", "azimuth", -32.0, -5.0, 1.9e5, 8.0),
        Thruster("starboard", "azimuth", -32.0, 5.0, 1.9e5, 8.0),
        Thruster("bow", "azimuth", 26.0, 0.0, 1.4e5, 6.0),
        Thruster("tunnel", "tunnel", 30.0, 0.0, 1.1e5, 5.0),
    )
)
PLAIN = build_prediction_model(SHIP.M, SHIP.D, 0.3, SAMPLE_S)


def problem(
    sides: int = 8, N_p: int = 12, N_c: int = 3, model: StateSpace = PLAIN
) -> ControlProblem:
    rows, du_max = (
        build_limit_rows_of_thrusters(THRUSTERS, sides),
        THRUSTERS.largest_force_changes_per_sample(SAMPLE_S),
    )
    commanded = StateSpace(model.A, model.B @ THRUSTERS.T_e, model.C)
    R = np.diag(0.3 / du_max**2)
    W = np.diag(1e-2 / THRUSTERS.repeat_for_each_force_entry(THRUSTERS.largest_thrusts_N) ** 2)
    return ControlProblem(
        commanded, N_p, N_c, Q, R, rows.low, rows.high, du_max, thrusters=rows, W=W
    )


def situation(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A state some metres off, a reference, and forces that the thrusters give now."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=9) * np.tile([1.0, 1.0, 0.03], 3) * np.repeat([0.02, 0.02, 2.0], 3)
    y_ref = np.array([1.0, -2.0, 0.02])
    f = (
        0.5
        * THRUSTERS.repeat_for_each_force_entry(THRUSTERS.largest_thrusts_N)
        * rng.uniform(-1, 1, THRUSTERS.n_f)
    )
    return x, y_ref, f


def simulated_cost(control: ControlProblem, plan: np.ndarray, seed: int) -> float:
    """J of a plan (N_c, n_f) of moves, by the model of forces, step by step."""
    x, y_ref, f = (part.copy() for part in situation(seed))
    J = 0.0
    for i in range(control.N_p):
        move = plan[i] if i < control.N_c else np.zeros(len(f))
        f = f + move
        x = PLAIN.A @ x + PLAIN.B @ (THRUSTERS.T_e @ move)
        error = PLAIN.C @ x - y_ref
        J += 0.5 * error @ Q @ error
        if i < control.N_c:
            J += 0.5 * move @ control.R @ move + 0.5 * f @ control.W @ f
    return float(J)


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("seed", range(4))
def test_the_cost_is_that_of_a_simulation(units: Any, seed: int) -> None:
    """objective + J0 against the model run step by step with T_e f."""
    control = problem()
    builder = CondensedQP(control, units=units)
    x, y_ref, f = situation(seed)
    qp = builder.problem(builder.emit(x, y_ref, f))
    plan = np.random.default_rng(seed).uniform(-1, 1, (control.N_c, len(f))) * control.du_max
    cost = qp.objective(
        builder.convert_increments_to_variables(plan)
    ) + builder.constant_part_of_cost(x, y_ref, f)
    assert cost == pytest.approx(simulated_cost(control, plan, seed), rel=1e-9)
    np.testing.assert_allclose(
        builder.moves(builder.convert_increments_to_variables(plan)), plan, rtol=1e-12
    )


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_the_rows_are_the_forces_that_a_plan_adds_up_to(units: Any) -> None:
    """l ≤ A z ≤ u holds for a plan exactly if G f_i keeps to the limits at each of its moves."""
    control = problem()
    builder = CondensedQP(control, units=units)
    x, y_ref, f = situation(0)
    qp = builder.problem(builder.emit(x, y_ref, f))
    assert (qp.n, qp.m, qp.block) == (3 * 7, 3 * 13, 7)
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(200):
        plan = 12 * rng.uniform(-1, 1, (control.N_c, len(f))) * control.du_max
        along = (f + np.cumsum(plan, axis=0)) @ control.G.T
        allowed = ((along <= control.u_max) & (along >= control.u_min)).reshape(-1)
        rows = qp.A @ builder.convert_increments_to_variables(plan)
        np.testing.assert_array_equal((rows <= qp.u) & (rows >= qp.l), allowed)
        seen |= set(allowed.tolist())
    assert seen == {True, False}


def test_matrices_are_the_paper_s_expanded_by_the_configuration_matrix() -> None:
    """P = (I ⊗ T_e)ᵀ E (I ⊗ T_e) + C2ᵀ W̄ C2 + R̄ with E of the three forces and no weight R."""
    control = problem()
    nothing, three = np.zeros((3, 3)), np.ones(3)
    paper = condense_mpc_matrices(ControlProblem(PLAIN, 12, 3, Q, nothing, -three, three, three))
    expand = np.kron(np.eye(3), THRUSTERS.T_e)
    sums = np.kron(np.tri(3), np.eye(7))
    W, R = np.kron(np.eye(3), control.W), np.kron(np.eye(3), control.R)
    E = expand.T @ paper.E @ expand + sums.T @ W @ sums + R
    matrices = condense_mpc_matrices(control)
    np.testing.assert_allclose(matrices.E, E, rtol=1e-9, atol=1e-12 * np.abs(E).max())
    np.testing.assert_allclose(matrices.F_x, expand.T @ paper.F_x, rtol=1e-9, atol=1e-13)
    first = np.kron(np.ones((3, 1)), np.eye(7))
    np.testing.assert_allclose(matrices.F_u, sums.T @ W @ first, rtol=1e-12, atol=1e-25)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lost", [set(), {0}, {2, 3}], ids=str)
def test_all_forms_of_the_problem_have_one_optimum(seed: int, lost: set[int]) -> None:
    control = problem()
    assert control.thrusters is not None
    limits = control.thrusters.limits_after_loss_of_thrusters(lost) if lost else None
    x, y_ref, f = situation(seed)
    builder = CondensedQP(control)
    qp = builder.problem(builder.emit(x, y_ref, f, limits=limits))
    optimum = certify(qp)
    assert optimum.bound < 1e-9
    si = CondensedQP(control, units="si")
    in_si = certify(si.problem(si.emit(x, y_ref, f, limits=limits)))
    np.testing.assert_allclose(in_si.z / si.scale.z, optimum.z, atol=1e-7)
    staged = StagedQP(control)
    sparse = staged.problem(staged.emit(x, y_ref, f, limits=limits))
    exact = certify(sparse)
    answer = staged.convert_solution_to_condensed(
        Solution(Status.SOLVED, exact.z, exact.y, exact.y_box)
    )
    np.testing.assert_allclose(answer.z, optimum.z, atol=1e-7)
    error = residuals(qp, answer)
    assert max(error.primal, error.dual, error.complementarity) < 1e-6


def test_softened_limits_change_nothing_where_they_can_be_kept() -> None:
    control = problem()
    x, y_ref, f = situation(2)
    hard, soft = CondensedQP(control, amplitude="hard"), CondensedQP(control, amplitude="soft")
    exact = certify(hard.problem(hard.emit(x, y_ref, f)))
    softened = soft.problem(soft.emit(x, y_ref, f))
    assert (softened.block, softened.n, softened.m) == (7 + 4, 3 * 11, 3 * 26)
    np.testing.assert_allclose(soft.moves(certify(softened).z), hard.moves(exact.z), atol=1e-3)
    assert control.thrusters is not None
    gone = control.thrusters.limits_after_loss_of_thrusters({0})
    lost = certify(soft.problem(soft.emit(x, y_ref, f, limits=gone)))
    slack = lost.z.reshape(3, 11)[:, 7:]
    assert lost.bound < 1e-9 and slack[0, 0] > 0.1 and np.abs(slack[:, 1:]).max() < 1e-9


def test_the_mirrored_ship_gets_the_mirrored_plan() -> None:
    level = build_prediction_model(SHIP.M, SHIP.D, 0.0, SAMPLE_S)
    builder = CondensedQP(problem(16, model=level))
    axes = np.array([1.0, -1.0, -1.0])
    swap, sign = [2, 3, 0, 1, 4, 5, 6], np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0])
    for seed in range(3):
        x, y_ref, f = situation(seed)
        plan = builder.moves(certify(builder.problem(builder.emit(x, y_ref, f))).z)
        mirrored = builder.emit(np.tile(axes, 3) * x, axes * y_ref, sign * f[swap])
        other = builder.moves(certify(builder.problem(mirrored)).z)
        np.testing.assert_allclose(other, sign * plan[:, swap], atol=1e-6 * np.abs(plan).max())


def least_cost_within_circles(
    control: ControlProblem, qp: QuadraticProgram, f: np.ndarray
) -> float:
    """The optimum with |f_i| ≤ T_i of every azimuth as a cone, by another solver (Clarabel)."""
    N_c, n_f, n = control.N_c, len(f), qp.n
    du = np.tile(control.du_max, N_c)
    sums = np.kron(np.tri(N_c), np.eye(n_f)) * du
    rows, right, cones = [np.eye(n), -np.eye(n)], [np.ones(n), np.ones(n)], []
    cones.append(clarabel.NonnegativeConeT(2 * n))
    for i in range(N_c):
        for thruster, at in zip(THRUSTERS.thrusters, THRUSTERS.slices_in_force_vector, strict=True):
            of = sums[i * n_f + at.start : i * n_f + at.stop]
            rows.append(np.vstack([np.zeros((1, n)), -of]) / thruster.thrust_N)
            right.append(np.concatenate([[1.0], f[at] / thruster.thrust_N]))
            cones.append(clarabel.SecondOrderConeT(thruster.component_count + 1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    A = scipy.sparse.csc_matrix(np.vstack(rows))
    P = scipy.sparse.csc_matrix(np.triu(qp.P))
    solution = clarabel.DefaultSolver(P, qp.q, A, np.concatenate(right), cones, settings).solve()
    assert str(solution.status) == "Solved"
    return qp.objective(np.array(solution.x))


def test_polygons_converge_to_circles_with_the_square_of_their_sides() -> None:
    sides = [16, 32, 64, 128]
    lost = np.zeros(len(sides))
    # Fast thrusters and far from the reference, so that it is their circles that limit the plan.
    fast = replace(problem(8), Q=50.0 * Q, du_max=10.0 * problem(8).du_max)
    builders = []
    for s in sides:
        rows = build_limit_rows_of_thrusters(THRUSTERS, s)
        builders.append(CondensedQP(replace(fast, u_min=rows.low, u_max=rows.high, thrusters=rows)))
    for seed in range(12):
        theta = situation(seed)
        problems = [builder.problem(builder.emit(*theta)) for builder in builders]
        circle = least_cost_within_circles(fast, problems[0], theta[2])
        for i, qp in enumerate(problems):
            cost = qp.objective(certify(qp).z)
            assert cost >= circle - 1e-6 * abs(circle)
            lost[i] += (cost - circle) / abs(circle)
    order = -np.polyfit(np.log(sides), np.log(lost), 1)[0]
    assert lost[0] > 1e-3 and 1.7 < order < 2.3
