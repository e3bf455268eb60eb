"""The condensed QP against simulation of the model and against a naive second construction."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.errors import InputError, ShapeError
from dpbench.mpc.condense import (
    ControlProblem,
    build_affine_map,
    build_rows_of_summed_increments,
    condense_mpc_matrices,
    scale_amplitude_limit_rows,
)
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import StateSpace
from dpbench.mpc.thruster_rows import ThrusterRows
from tests.mpc.conftest import assert_close, naive_build, rolled_out_cost, ship_problem


def test_predicted_outputs_are_those_of_the_stepped_model(case: Any) -> None:
    """F x + Φ ΔU is what stepping the model N_p times under ΔU gives (eq. 15)."""
    problem, state, outputs = case.problem, case.x, []
    moves = case.rng.uniform(-1, 1, (problem.N_c, problem.model.n_u)) * problem.du_max
    for du in (*moves, *np.zeros((problem.N_p - problem.N_c, problem.model.n_u))):
        state = problem.model.A @ state + problem.model.B @ du
        outputs.append(problem.model.C @ state)
    matrices = condense_mpc_matrices(problem)
    assert_close(matrices.F @ case.x + matrices.Phi @ moves.reshape(-1), np.concatenate(outputs))


def test_matrices_agree_with_the_naive_construction(case: Any) -> None:
    """F, Φ, E and the linear cost of eq. 15-24 agree with the ones written out block by block."""
    expected = naive_build(case.problem, case.x, case.held, case.u_prev)
    eye, N_p = np.eye(case.problem.model.n_y), case.problem.N_p
    found = condense_mpc_matrices(case.problem)
    for name in ("F", "Phi", "E"):
        assert_close(getattr(found, name), getattr(expected, name))
    np.testing.assert_array_equal(found.E, found.E.T)
    assert_close(found.F_held, -expected.Phi.T @ expected.Q_bar @ np.tile(eye, (N_p, 1)))
    assert_close(found.F_x @ case.x + found.F_y @ case.held.reshape(-1), expected.F_k, 1e-10)


@pytest.mark.parametrize("preview", [False, True], ids=["held", "preview"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_problem_agrees_with_the_naive_construction(case: Any, units: Any, preview: bool) -> None:
    Y_d = case.preview() if preview else case.held
    expected = naive_build(case.problem, case.x, Y_d, case.u_prev)
    T = expected.move if units == "scaled" else np.ones_like(expected.move)
    builder = CondensedQP(case.problem, units=units)
    step = builder.emit(case.x, Y_d if preview else case.y_ref, case.u_prev)
    qp = builder.problem(step)
    assert_close(qp.P, np.diag(T) @ expected.E @ np.diag(T))
    assert_close(qp.q, T * expected.F_k, 1e-10)
    np.testing.assert_array_equal(qp.A, expected.C2)
    np.testing.assert_allclose(qp.l, expected.lower / T, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(qp.u, expected.upper / T, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(qp.ub, expected.move / T, rtol=1e-15)
    np.testing.assert_array_equal(qp.lb, -qp.ub)
    assert (qp.n, qp.m, qp.block) == (len(T), len(T), case.problem.model.n_u)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_objective_and_constant_are_the_predicted_cost(case: Any, units: Any) -> None:
    """½zᵀPz + qᵀz + J0 is the cost of Algorithm 1 by stepping the model, held or previewed."""
    problem = case.problem
    builder = CondensedQP(problem, units=units)
    moves = case.rng.uniform(-1, 1, (problem.N_c, problem.model.n_u)) * problem.du_max
    for y_ref, Y_d in ((case.y_ref, case.held), ((preview := case.preview()), preview)):
        step = builder.emit(case.x, y_ref, case.u_prev)
        cost = builder.problem(step).objective(builder.convert_increments_to_variables(moves))
        cost += builder.constant_part_of_cost(case.x, y_ref)
        # All three terms are below the cost at ΔU = 0, which sizes the rounding.
        size = rolled_out_cost(problem, case.x, Y_d, 0 * moves) + rolled_out_cost(
            problem, case.x, Y_d, moves
        )
        assert cost == pytest.approx(rolled_out_cost(problem, case.x, Y_d, moves), abs=1e-12 * size)


@pytest.mark.parametrize("N_c", [11, 22, 35])
def test_many_moves_condense_like_the_naive_construction(N_c: int) -> None:
    """n = 33, 66, 105: just above one and two tiles of the kernel, and not a multiple of them."""
    problem = ship_problem("supply_fs99", N_p=40, N_c=N_c)
    expected = naive_build(problem, np.zeros(9), np.zeros((40, 3)), np.zeros(3))
    found = condense_mpc_matrices(problem)
    assert_close(found.E, expected.E)
    np.testing.assert_array_equal(found.E, found.E.T)
    assert_close(found.F_x, expected.Phi.T @ expected.Q_bar @ expected.F)


def test_cost_matrix_is_symmetric_and_positive_definite(case: Any) -> None:
    for units in ("scaled", "si"):
        P = CondensedQP(case.problem, units=units).P
        diagonal = np.sqrt(np.diag(P))
        normed = P / np.outer(diagonal, diagonal)
        np.testing.assert_allclose(normed, normed.T, rtol=0, atol=1e-14)
        assert np.linalg.eigvalsh(normed)[0] > 0.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"N_c": 31}, InputError, "N_c"),
        ({"N_c": 0}, InputError, "N_c"),
        ({"N_p": 0, "N_c": 0}, InputError, "N_c"),
        ({"terminal": "lqr"}, InputError, '\'lqr\'; allowed: "none" or "riccati"'),
        ({"Q": np.eye(2)}, ShapeError, "Q"),
        ({"R": np.eye(4)}, ShapeError, "R"),
        ({"W": np.eye(2)}, ShapeError, "W"),
        ({"u_min": np.zeros(2)}, ShapeError, "u_min"),
        ({"du_max": np.zeros((3, 1))}, ShapeError, "du_max"),
    ],
)
def test_a_control_problem_names_what_does_not_fit(
    change: dict[str, Any], error: type[InputError], message: str
) -> None:
    with pytest.raises(error, match=message) as caught:
        replace(ship_problem("supply_fs99"), **change)
    assert caught.value.key == next(iter(reversed(change)))


def test_other_forms_are_refused() -> None:
    with pytest.raises(InputError, match='\'SI\'; allowed: "scaled" or "si"'):
        CondensedQP(ship_problem("supply_fs99"), units="SI")  # type: ignore[arg-type] # the mistake that is tested
    with pytest.raises(InputError, match='\'firm\'; allowed: "reachable", "hard" or "soft"'):
        CondensedQP(ship_problem("supply_fs99"), amplitude="firm")  # type: ignore[arg-type] # the mistake that is tested


def test_any_number_of_moves_up_to_the_horizon_is_allowed() -> None:
    for N_p, N_c in ((1, 1), (3, 3), (3, 1)):
        matrices = condense_mpc_matrices(replace(small_thrusters(), N_p=N_p, N_c=N_c))
        assert matrices.Phi.shape == (N_p, 2 * N_c)


def small_thrusters() -> ControlProblem:
    """One state driven by two forces, limited along (0.6, 0.8) and (0, 1); two of three moves."""
    limits = np.array([-2.0, -3.0]), np.array([4.0, 5.0])
    rows = ThrusterRows(np.array([[0.6, 0.8], [0.0, 1.0]]), *limits, np.arange(2), np.arange(2))
    model = StateSpace([[1.0]], [[1.0, 2.0]], [[1.0]])
    weights = np.eye(1), np.diag([7.0, 11.0])
    return ControlProblem(model, 3, 2, *weights, *limits, np.array([5.0, 10.0]), thrusters=rows)


def test_rows_of_thrusters_by_hand() -> None:
    """A full step (5, 10) moves the first row by √(3² + 8²), the second by 10: their units."""
    problem = small_thrusters()
    unit = np.sqrt(73.0)
    np.testing.assert_array_equal(problem.G, [[0.6, 0.8], [0.0, 1.0]])
    np.testing.assert_allclose(problem.row_max, [unit, 10.0], rtol=1e-15)
    np.testing.assert_array_equal(scale_amplitude_limit_rows(problem, "si"), problem.G)
    expected = [[3.0 / unit, 8.0 / unit], [0.0, 1.0]]
    np.testing.assert_allclose(scale_amplitude_limit_rows(problem, "scaled"), expected, rtol=1e-15)
    # Both forces of the second move are those of the first one and its own.
    both = [[0.6, 0.8, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.6, 0.8, 0.6, 0.8], [0.0, 1.0, 0.0, 1.0]]
    np.testing.assert_array_equal(build_rows_of_summed_increments(2, problem.G), both)


def test_without_thrusters_the_rows_are_the_forces() -> None:
    problem = ship_problem("supply_fs99")
    for units in ("scaled", "si"):
        np.testing.assert_array_equal(scale_amplitude_limit_rows(problem, units), np.eye(3))
    assert problem.row_max is problem.du_max


def test_a_small_problem_by_hand() -> None:
    """x⁺ = x + f1 + 2 f2: outputs after the first move see it thrice, after the second twice."""
    matrices = condense_mpc_matrices(small_thrusters())
    h, zero = [1.0, 2.0], [0.0, 0.0]
    np.testing.assert_array_equal(matrices.Phi, [[*h, *zero], [*h, *h], [*h, *h]])
    expected = np.kron([[3.0, 2.0], [2.0, 2.0]], np.outer(h, h)) + np.diag([7.0, 11.0] * 2)
    np.testing.assert_array_equal(matrices.E, expected)
    np.testing.assert_array_equal(matrices.F_x[:, 0], [3.0, 6.0, 2.0, 4.0])
    np.testing.assert_array_equal(matrices.F_held, -matrices.F_x)
    np.testing.assert_array_equal(matrices.F_y, -matrices.Phi.T)
    assert matrices.F_u.shape == (4, 0)
    assert matrices.end is None


def test_a_weight_of_the_forces_by_hand() -> None:
    """½ Σ fᵀ W f of two moves: the first one counts in both forces, the second in the last."""
    problem = small_thrusters()
    W = np.array([[2.0, 1.0], [1.0, 5.0]])
    plain, weighed = condense_mpc_matrices(problem), condense_mpc_matrices(replace(problem, W=W))
    np.testing.assert_array_equal(weighed.E - plain.E, np.kron([[2.0, 1.0], [1.0, 1.0]], W))
    np.testing.assert_array_equal(weighed.F_u, np.kron([[2.0], [1.0]], W))
    np.testing.assert_array_equal(weighed.F_x, plain.F_x)


@pytest.mark.parametrize(("units", "unit"), [("si", (1.0, 1.0)), ("scaled", (5.0, 10.0))])
def test_the_affine_map_by_hand(units: Any, unit: tuple[float, float]) -> None:
    """q of θ = [x; y_ref; f; 1] in the units of the moves, l and u in those of the rows."""
    W = np.diag([2.0, 5.0])
    problem = replace(small_thrusters(), W=W)
    Z = build_affine_map(problem, condense_mpc_matrices(problem), units)
    row = np.array([1.0, 1.0]) if units == "si" else np.array([np.sqrt(73.0), 10.0])
    linear = np.array([3.0, 6.0, 2.0, 4.0])
    of_force = [[4.0, 0.0], [0.0, 10.0], [2.0, 0.0], [0.0, 5.0]]
    q = np.column_stack((linear, -linear, of_force, np.zeros(4))) * np.tile(unit, 2)[:, np.newaxis]
    lower, upper = (
        np.column_stack((np.zeros((2, 2)), [[-0.6, -0.8], [0.0, -1.0]], limit)) / row[:, np.newaxis]
        for limit in (problem.u_min, problem.u_max)
    )
    np.testing.assert_allclose(Z, np.vstack((q, lower, lower, upper, upper)), rtol=1e-15)
