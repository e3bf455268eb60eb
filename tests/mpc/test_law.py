"""The unconstrained law, its gains and eigenvalues, the active-set correction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dpbench.mpc.condense import condense_matrices
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import closed_loop, closed_loop_eigenvalues, gains, unconstrained_plan
from dpbench.mpc.model import prediction_model
from dpbench.qp.stacked import stack
from dpbench.scenario.scenario import load_vessel

VESSELS = ("supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2")


def least_squares_plan(problem: Any, naive: Any, x: np.ndarray, Y_d: np.ndarray) -> np.ndarray:
    """The minimiser of eq. 17 as a least-squares problem with Q^½ and R^½, never forming E."""
    parts = naive(problem, x, Y_d, np.zeros(problem.model.n_u))
    root_Q, root_R = np.linalg.cholesky(parts.Q_bar).T, np.linalg.cholesky(parts.R_bar).T
    du = parts.move
    rows = np.vstack([root_Q @ parts.Phi, root_R]) * du
    right = np.concatenate([root_Q @ (Y_d.reshape(-1) - parts.F @ x), np.zeros(len(du))])
    return du * np.linalg.lstsq(rows, right, rcond=None)[0]


def test_unconstrained_plan_is_the_least_squares_plan(case: Any, naive: Any) -> None:
    """Eq. 27 minimises the cost, held or previewed, as a least-squares solver finds it."""
    matrices = condense_matrices(case.problem)
    du = np.tile(case.problem.du_max, case.problem.N_c)
    for Y_d in (case.held, case.preview()):
        expected = least_squares_plan(case.problem, naive, case.x, Y_d) / du
        found = unconstrained_plan(matrices, case.x, Y_d.reshape(-1)) / du
        # Normal equations square the condition number, up to about 1e4 here in scaled units.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_unconstrained_plan_has_no_gradient(case: Any) -> None:
    """Eq. 26: the slope of the scaled objective vanishes at the plan of eq. 27."""
    builder = CondensedQP(case.problem)
    q = builder.emit(case.x, case.y_ref, case.u_prev).q
    plan = unconstrained_plan(builder.matrices, case.x, case.held.reshape(-1))
    z = builder.plan(plan.reshape(case.problem.N_c, -1))
    np.testing.assert_allclose(builder.P @ z + q, 0.0, atol=1e-11 * np.abs(q).max())


def test_gains_give_the_first_move_of_the_plan(case: Any) -> None:
    """Eq. 33: K_y y_d − K_mpc x is the first block of the unconstrained plan."""
    problem = case.problem
    law = gains(problem)
    assert law.K_y.shape == (problem.model.n_u, problem.model.n_y)
    assert law.K_mpc.shape == (problem.model.n_u, problem.model.n_x)
    plan = unconstrained_plan(condense_matrices(problem), case.x, case.held.reshape(-1))
    first = law.K_y @ case.y_ref - law.K_mpc @ case.x
    expected = plan[: problem.model.n_u]
    size = np.abs(law.K_y @ case.y_ref) + np.abs(law.K_mpc @ case.x)
    np.testing.assert_allclose(first / size, expected / size, rtol=0, atol=1e-9)


def test_the_output_part_of_the_state_gain_is_the_reference_gain(case: Any) -> None:
    """K_mpc = [K_x K_y]: an offset of the output and one of the reference weigh the same."""
    law, n_y = gains(case.problem), case.problem.model.n_y
    size = np.abs(law.K_y).max(axis=1, keepdims=True)
    np.testing.assert_allclose(law.K_mpc[:, -n_y:] / size, law.K_y / size, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("robust", "radius"),
    # Spectral radii from the least-squares loop of this test, to five digits.
    [(False, 0.94949), (True, 0.96726)],
    ids=["paper", "robust"],
)
def test_the_unconstrained_loop_is_stable(
    ship: Any, naive: Any, robust: bool, radius: float
) -> None:
    """Both tunings keep all eigenvalues of eq. 35 inside the unit circle, where a loop built by
    solving a least-squares problem for every unit state has them too."""
    horizons = {"N_p": 60, "N_c": 10} if robust else {"N_p": 30, "N_c": 5}
    problem = ship("supply_fs99", robust=robust, **horizons)
    model, law = problem.model, gains(problem)
    roots = closed_loop_eigenvalues(model, law)
    target = np.zeros((problem.N_p, 3))
    columns = []
    for unit in np.eye(9):
        du = least_squares_plan(problem, naive, unit, target)[:3]
        columns.append(model.A @ unit + model.B @ du)
    expected = np.linalg.eigvals(np.column_stack(columns))
    assert np.abs(roots[0]) == pytest.approx(radius, abs=5e-6)
    assert np.abs(expected).max() == pytest.approx(radius, abs=5e-6)
    assert (np.diff(np.abs(roots)) <= 1e-12).all()
    # Coefficients of the two characteristic polynomials, which do not depend on any pairing.
    np.testing.assert_allclose(np.poly(roots), np.poly(expected), rtol=0, atol=1e-7)


@pytest.mark.parametrize("robust", [False, True], ids=["paper", "robust"])
def test_the_simulated_loop_decays_at_the_dominant_eigenvalue(ship: Any, robust: bool) -> None:
    """Stepping the model under eq. 33 reaches the reference and shrinks by |λ1| a step."""
    horizons = {"N_p": 60, "N_c": 10} if robust else {"N_p": 30, "N_c": 5}
    problem = ship("supply_fs99", robust=robust, **horizons)
    model, law = problem.model, gains(problem)
    y_ref = np.array([0.4, -0.2, 0.05])
    x = np.zeros(9)
    x[6:] = [1.2, 1.3, 0.0]
    away = []
    for _ in range(400):
        x = model.A @ x + model.B @ (law.K_y @ y_ref - law.K_mpc @ x)
        rest = x.copy()
        rest[6:] -= y_ref
        away.append(np.linalg.norm(rest))
    np.testing.assert_allclose(x[6:], y_ref, rtol=0, atol=1e-4)
    np.testing.assert_allclose(x[:6], 0.0, atol=1e-4)
    # A complex pair makes the norm swing; over 250 steps the swing costs under 1e-2 of the rate.
    rate = (away[-1] / away[149]) ** (1.0 / 250)
    radius = np.abs(closed_loop_eigenvalues(model, law)[0])
    assert rate == pytest.approx(radius, abs=0.01)


def test_closed_loop_matrix_is_one_step_of_the_loop(case: Any) -> None:
    """Eq. 34: (A − B K_mpc) x + B K_y y_d is the model stepped under the law of eq. 33."""
    model, law = case.problem.model, gains(case.problem)
    du = law.K_y @ case.y_ref - law.K_mpc @ case.x
    after = closed_loop(model, law) @ case.x + model.B @ law.K_y @ case.y_ref
    np.testing.assert_allclose(after, model.A @ case.x + model.B @ du, rtol=1e-9, atol=1e-9)


def test_constrained_plan_is_the_unconstrained_one_less_the_correction(
    case: Any, by_quadprog: Any
) -> None:
    """Eq. 31, 32, 36: the optimum is eq. 27 less K0 = E⁻¹ M_actᵀ λ_act, its first move less K K0,
    and eq. 31 gives λ_act from the active set alone."""
    builder = CondensedQP(case.problem)
    x, y_ref, n_u = case.x, case.y_ref, case.problem.model.n_u
    active = np.zeros(0, dtype=bool)
    while not active.any():
        x, y_ref = 4.0 * x, 4.0 * y_ref
        qp = builder.problem(builder.emit(x, y_ref, case.u_prev))
        z, y, y_box = by_quadprog(qp)
        lam = np.concatenate([-y, y, -y_box, y_box])
        active = lam > 1e-9 * np.abs(qp.q).max()
    stacked = stack(qp)
    K0 = np.linalg.solve(qp.P, stacked.A[active].T @ lam[active])
    free = np.linalg.solve(qp.P, -qp.q)
    size = 1e-9 * (1.0 + np.abs(free).max())
    np.testing.assert_allclose(free - K0, z, rtol=0, atol=size)
    law = gains(case.problem)
    move = law.K_y @ y_ref - law.K_mpc @ x - case.problem.du_max * K0[:n_u]
    np.testing.assert_allclose(move / case.problem.du_max, z[:n_u], rtol=0, atol=10 * size)
    M, gamma = stacked.A[active], stacked.u[active]
    inverse = np.linalg.inv(qp.P)
    again = -np.linalg.solve(M @ inverse @ M.T, gamma + M @ inverse @ qp.q)
    np.testing.assert_allclose(again, lam[active], rtol=0, atol=1e-8 * (1.0 + lam.max()))


def test_without_active_limits_there_is_no_correction(ship: Any, by_quadprog: Any) -> None:
    """Near the reference the constrained and the unconstrained law give the same plan."""
    problem = ship("supply_fs99", psi0_rad=0.3)
    builder = CondensedQP(problem)
    x = np.zeros(9)
    x[6:] = [0.01, -0.02, 0.001]
    qp = builder.problem(builder.emit(x, np.zeros(3), np.zeros(3)))
    z, y, y_box = by_quadprog(qp)
    assert not y.any()
    assert not y_box.any()
    plan = unconstrained_plan(builder.matrices, x, np.zeros(90))
    np.testing.assert_allclose(builder.moves(z).reshape(-1), plan, rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("psi0_rad", [0.0, 0.7])
@pytest.mark.parametrize("name", VESSELS)
def test_every_ship_is_controllable(name: str, psi0_rad: float) -> None:
    """The nine states of the incremental model are controllable for all vessels and headings."""
    ship = load_vessel(name)
    sample_s = 0.3 if name != "cybership2" else 0.3 / np.sqrt(70.0)
    model = prediction_model(ship.M, ship.D, psi0_rad, sample_s)
    # The Hautus test, eigenvalue by eigenvalue; all are 0.6 … 1 here, and rows are scaled because
    # positions and rates differ in size.
    for root in np.linalg.eigvals(model.A):
        pencil = np.hstack([root * np.eye(9) - model.A, model.B * np.diag(ship.M)])
        assert np.linalg.svd(pencil, compute_uv=False)[-1] > 1e-6
