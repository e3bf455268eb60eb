"""The condensed QP against simulation of the model and against a naive second construction.

Tolerances: both constructions sum the same products in another order, so they differ by rounding,
about N_p · 1e-16 relative to the largest entry of each matrix; 1e-11 leaves two digits of room for
powers of A taken one by one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.errors import InputError, ShapeError
from dpbench.mpc.condense import (
    ControlProblem,
    affine_map,
    condense_matrices,
    scaled_rows,
    summed_rows,
)
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import StateSpace
from dpbench.mpc.thruster_rows import ThrusterRows

RELATIVE = 1e-11


def close(found: np.ndarray, expected: np.ndarray, relative: float = RELATIVE) -> None:
    """Equal up to `relative` of the largest entry."""
    size = float(np.abs(expected).max()) if expected.size else 0.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * size)


def test_predicted_outputs_are_those_of_the_stepped_model(case: Any) -> None:
    """F x + Φ ΔU is what stepping the model N_p times under ΔU gives (eq. 15)."""
    problem = case.problem
    moves = case.rng.uniform(-1, 1, (problem.N_c, problem.model.n_u)) * problem.du_max
    outputs, state = [], case.x
    for i in range(problem.N_p):
        du = moves[i] if i < problem.N_c else np.zeros(problem.model.n_u)
        state = problem.model.A @ state + problem.model.B @ du
        outputs.append(problem.model.C @ state)
    matrices = condense_matrices(problem)
    predicted = matrices.F @ case.x + matrices.Phi @ moves.reshape(-1)
    close(predicted, np.concatenate(outputs))


def test_matrices_agree_with_the_naive_construction(case: Any, naive: Any) -> None:
    """F, Φ, E and the linear cost of eq. 15-24 agree with the ones written out block by block."""
    expected = naive(case.problem, case.x, case.held, case.u_prev)
    found = condense_matrices(case.problem)
    close(found.F, expected.F)
    close(found.Phi, expected.Phi)
    close(found.E, expected.E)
    close(found.F_x @ case.x + found.F_y @ case.held.reshape(-1), expected.F_k, 1e-10)


@pytest.mark.parametrize("preview", [False, True], ids=["held", "preview"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_problem_agrees_with_the_naive_construction(
    case: Any, naive: Any, units: Any, preview: bool
) -> None:
    """P, q, A, l, u, lb and ub agree with the naive QP in both systems of units."""
    Y_d = case.preview() if preview else case.held
    expected = naive(case.problem, case.x, Y_d, case.u_prev)
    T = expected.move if units == "scaled" else np.ones_like(expected.move)
    builder = CondensedQP(case.problem, units=units)
    step = builder.emit(case.x, Y_d if preview else case.y_ref, case.u_prev)
    qp = builder.problem(step)
    close(qp.P, np.diag(T) @ expected.E @ np.diag(T))
    close(qp.q, T * expected.F_k, 1e-10)
    np.testing.assert_array_equal(qp.A, expected.C2)
    np.testing.assert_allclose(qp.l, expected.lower / T, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(qp.u, expected.upper / T, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(qp.ub, expected.move / T, rtol=1e-15)
    np.testing.assert_array_equal(qp.lb, -qp.ub)
    assert (qp.n, qp.m, qp.block) == (len(T), len(T), case.problem.model.n_u)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_objective_and_constant_are_the_predicted_cost(case: Any, rollout: Any, units: Any) -> None:
    """½zᵀPz + qᵀz + J0 is the cost of Algorithm 1 by stepping the model, held or previewed."""
    problem = case.problem
    builder = CondensedQP(problem, units=units)
    moves = case.rng.uniform(-1, 1, (problem.N_c, problem.model.n_u)) * problem.du_max
    for y_ref, Y_d in ((case.y_ref, case.held), ((preview := case.preview()), preview)):
        step = builder.emit(case.x, y_ref, case.u_prev)
        cost = builder.problem(step).objective(builder.plan(moves))
        cost += builder.constant_cost(case.x, y_ref)
        # All three terms are below the cost at ΔU = 0, which sizes the rounding.
        size = rollout(problem, case.x, Y_d, 0 * moves) + rollout(problem, case.x, Y_d, moves)
        assert cost == pytest.approx(rollout(problem, case.x, Y_d, moves), abs=1e-12 * size)


def test_linear_cost_and_curvature_are_differences_of_the_stepped_cost(
    case: Any, rollout: Any
) -> None:
    """q is the gradient and P the curvature of the stepped cost, by central differences."""
    problem = case.problem
    builder = CondensedQP(problem)
    q = builder.emit(case.x, case.y_ref, case.u_prev).q

    def cost(z: np.ndarray) -> float:
        return float(rollout(problem, case.x, case.held, builder.moves(z)))

    # The cost is quadratic, so central differences are exact for any step; large ones keep the
    # rounding of J, 1e-16 · J(0), small beside the difference.
    h = 10.0
    unit = h * np.eye(builder.n)
    zero = cost(np.zeros(builder.n))
    size = 1e-13 * (abs(zero) + max(cost(e) for e in unit))
    gradient = np.array([(cost(e) - cost(-e)) / (2 * h) for e in unit])
    np.testing.assert_allclose(gradient, q, rtol=0, atol=size)
    for i, j in ((0, 0), (0, builder.n - 1), (builder.n - 1, builder.n - 1)):
        mixed = cost(unit[i] + unit[j]) - cost(unit[i]) - cost(unit[j]) + zero
        assert mixed / h**2 == pytest.approx(builder.P[i, j], abs=4 * size)


def test_cost_matrix_is_symmetric_and_positive_definite(case: Any) -> None:
    """P is symmetric to rounding and strictly convex, in both systems of units."""
    for units in ("scaled", "si"):
        P = CondensedQP(case.problem, units=units).P
        diagonal = np.sqrt(np.diag(P))
        normed = P / np.outer(diagonal, diagonal)
        np.testing.assert_allclose(normed, normed.T, rtol=0, atol=1e-14)
        assert np.linalg.eigvalsh(normed)[0] > 0.0


@settings(max_examples=60, derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n_u=st.integers(1, 3),
    n_y=st.integers(1, 3),
    N_p=st.integers(1, 12),
    data=st.data(),
)
def test_any_plant_and_any_horizons_condense_like_the_naive_construction(
    seed: int, n_u: int, n_y: int, N_p: int, data: st.DataObject, naive: Any, random_plant: Any
) -> None:
    """For random plants of one to three inputs and any N_c ≤ N_p, P, q, l and u are the naive."""
    N_c = data.draw(st.integers(1, N_p))
    problem = random_plant(seed, n_u, n_y, N_p, N_c)
    rng = np.random.default_rng(seed)
    x, y_ref = rng.normal(size=problem.model.n_x), rng.normal(size=n_y)
    u_prev = rng.uniform(problem.u_min, problem.u_max)
    expected = naive(problem, x, np.tile(y_ref, (N_p, 1)), u_prev)
    builder = CondensedQP(problem)
    step = builder.emit(x, y_ref, u_prev)
    du = expected.move
    close(builder.P, du[:, None] * expected.E * du)
    # q cancels between reference and free response, so it is compared at their size.
    size = float(np.abs(expected.Phi.T @ expected.Q_bar).sum(axis=1).max())
    size *= float(np.abs(expected.F @ x).max() + np.abs(y_ref).max())
    np.testing.assert_allclose(step.q, du * expected.F_k, rtol=0, atol=1e-13 * size)
    np.testing.assert_allclose(step.l, expected.lower / du, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(step.u, expected.upper / du, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("N_c", [11, 22, 35])
def test_many_moves_condense_like_the_naive_construction(ship: Any, naive: Any, N_c: int) -> None:
    """n = 33, 66, 105: just above one and two tiles of the kernel, and not a multiple of them."""
    problem = ship("supply_fs99", N_p=40, N_c=N_c)
    rng = np.random.default_rng(N_c)
    x, Y_d = rng.normal(size=9), np.tile(rng.normal(size=3), (40, 1))
    expected, found = naive(problem, x, Y_d, np.zeros(3)), condense_matrices(problem)
    close(found.E, expected.E)
    np.testing.assert_array_equal(found.E, found.E.T)
    close(found.F_x, expected.Phi.T @ expected.Q_bar @ expected.F)
    close(found.F_held @ Y_d[0], -expected.Phi.T @ expected.Q_bar @ Y_d.reshape(-1))


def test_hessian_needs_no_diagonal_weights(random_plant: Any, naive: Any) -> None:
    """Full Q and R are used whole: exchanging two axes of one weight changes the Hessian."""
    problem = random_plant(11, 3, 3, 9, 4)
    diagonal = condense_matrices(replace(problem, Q=np.diag(np.diag(problem.Q)))).E
    full = condense_matrices(problem).E
    x, u_prev = np.zeros(problem.model.n_x), np.zeros(3)
    close(full, naive(problem, x, np.zeros((9, 3)), u_prev).E)
    assert np.abs(full - diagonal).max() > 1e-3 * np.abs(full).max()


@pytest.mark.parametrize(
    ("change", "error", "key"),
    [
        ({"N_c": 31}, InputError, "N_c"),
        ({"N_c": 0}, InputError, "N_c"),
        ({"Q": np.eye(2)}, ShapeError, "Q"),
        ({"R": np.eye(4)}, ShapeError, "R"),
        ({"u_min": np.zeros(2)}, ShapeError, "u_min"),
        ({"du_max": np.zeros((3, 1))}, ShapeError, "du_max"),
    ],
)
def test_control_problem_names_what_does_not_fit(
    ship: Any, change: dict[str, Any], error: type[InputError], key: str
) -> None:
    """A wrong horizon or shape is refused by name, with what was found and what is allowed."""
    good = ship("supply_fs99")
    with pytest.raises(error) as caught:
        replace(good, **change)
    assert caught.value.key == key
    assert caught.value.allowed


def test_unknown_units_are_refused(ship: Any) -> None:
    """Units are "scaled" or "si" and nothing else."""
    with pytest.raises(InputError, match='\'SI\'; allowed: "scaled" or "si"'):
        CondensedQP(ship("supply_fs99"), units="SI")  # type: ignore[arg-type] # bad on purpose


def small_thrusters() -> ControlProblem:
    """One state driven by two forces, limited along (0.6, 0.8) and (0, 1); two of three moves."""
    rows = ThrusterRows(
        np.array([[0.6, 0.8], [0.0, 1.0]]),
        np.array([-2.0, -3.0]),
        np.array([4.0, 5.0]),
        np.array([0, 1]),
        np.array([0, 1]),
    )
    model = StateSpace([[1.0]], [[1.0, 2.0]], [[1.0]])
    weights = np.eye(1), np.diag([7.0, 11.0])
    limits = rows.low, rows.high, np.array([5.0, 10.0])
    return ControlProblem(model, 3, 2, *weights, *limits, thrusters=rows)


def test_rows_of_thrusters_by_hand() -> None:
    """A full step (5, 10) moves the first row by √(3² + 8²), the second by 10: their units."""
    problem = small_thrusters()
    unit = np.sqrt(73.0)
    np.testing.assert_array_equal(problem.G, [[0.6, 0.8], [0.0, 1.0]])
    np.testing.assert_allclose(problem.row_max, [unit, 10.0], rtol=1e-15)
    np.testing.assert_array_equal(scaled_rows(problem, "si"), problem.G)
    expected = [[3.0 / unit, 8.0 / unit], [0.0, 1.0]]
    np.testing.assert_allclose(scaled_rows(problem, "scaled"), expected, rtol=1e-15)
    # Both forces of the second move are those of the first one and its own.
    both = [[0.6, 0.8, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.6, 0.8, 0.6, 0.8], [0.0, 1.0, 0.0, 1.0]]
    np.testing.assert_array_equal(summed_rows(2, problem.G), both)
    ones = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]]
    np.testing.assert_array_equal(summed_rows(2, np.eye(2)), ones)


def test_without_thrusters_the_rows_are_the_forces(ship: Any) -> None:
    """In either unit, as limits and moves have the same unit."""
    problem = ship("supply_fs99")
    for units in ("scaled", "si"):
        np.testing.assert_array_equal(scaled_rows(problem, units), np.eye(3))
    assert problem.row_max is problem.du_max


def test_a_small_problem_by_hand() -> None:
    """x⁺ = x + f1 + 2 f2: outputs after the first move see it thrice, after the second twice.

    Φ = [h 0; h h; h h] of h = (1, 2), so E = ΦᵀΦ + R̄ with 3, 2, 2 and 2 times hᵀh, and
    F_k = Φᵀ(x − y_d) of 3 and 2 times hᵀ.
    """
    matrices = condense_matrices(small_thrusters())
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
    plain, weighed = condense_matrices(problem), condense_matrices(replace(problem, W=W))
    np.testing.assert_array_equal(weighed.E - plain.E, np.kron([[2.0, 1.0], [1.0, 1.0]], W))
    np.testing.assert_array_equal(weighed.F_u, np.kron([[2.0], [1.0]], W))
    np.testing.assert_array_equal(weighed.F_x, plain.F_x)
    with pytest.raises(ShapeError):
        replace(problem, W=np.eye(3))


@pytest.mark.parametrize(("units", "unit"), [("si", (1.0, 1.0)), ("scaled", (5.0, 10.0))])
def test_the_affine_map_by_hand(units: Any, unit: tuple[float, float]) -> None:
    """q of θ = [x; y_ref; f; 1] in the units of the moves, l and u in those of the rows."""
    W = np.diag([2.0, 5.0])
    problem = replace(small_thrusters(), W=W)
    Z = affine_map(problem, condense_matrices(problem), units)
    row = np.array([1.0, 1.0]) if units == "si" else np.array([np.sqrt(73.0), 10.0])
    linear = np.array([3.0, 6.0, 2.0, 4.0])
    of_force = [[4.0, 0.0], [0.0, 10.0], [2.0, 0.0], [0.0, 5.0]]
    q = np.column_stack((linear, -linear, of_force, np.zeros(4))) * np.tile(unit, 2)[:, np.newaxis]
    lower, upper = (
        np.column_stack((np.zeros((2, 2)), [[-0.6, -0.8], [0.0, -1.0]], limit)) / row[:, np.newaxis]
        for limit in (problem.u_min, problem.u_max)
    )
    np.testing.assert_allclose(Z, np.vstack((q, lower, lower, upper, upper)), rtol=1e-15)


def test_as_many_moves_as_steps_are_allowed_and_one_at_least() -> None:
    """1 ≤ N_c ≤ N_p, both ends included."""
    problem = small_thrusters()
    for N_p, N_c in ((1, 1), (3, 3), (3, 1)):
        matrices = condense_matrices(replace(problem, N_p=N_p, N_c=N_c))
        assert matrices.Phi.shape == (N_p, 2 * N_c)
    for N_p, N_c in ((3, 4), (3, 0), (0, 0)):
        with pytest.raises(InputError, match="N_c"):
            replace(problem, N_p=N_p, N_c=N_c)


def test_a_terminal_cost_has_one_of_two_names() -> None:
    """Another name is refused with those there are."""
    with pytest.raises(InputError, match='"none" or "riccati"'):
        replace(small_thrusters(), terminal="lqr")  # type: ignore[arg-type] # bad on purpose
