"""The prediction model against integration."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lti, step

from dpbench.errors import ShapeError
from dpbench.mpc.model import (
    StateSpace,
    augment_to_incremental_model,
    build_prediction_model,
    build_rotation_matrix,
    discretise_zero_order_hold,
    linearise_ship_at_heading,
    relinearise_model_at_turned_heading,
)
from dpbench.mpc.reference import (
    ReferenceFilter,
    build_smoothed_reference_table,
    shift_target_heading_near_start,
)
from dpbench.scenario.scenario import load_vessel
from tests.mpc.conftest import VESSELS, sample_of

HEADINGS = (0.0, 0.7, -2.5)


def test_rotation_maps_body_axes_to_compass_axes() -> None:
    R = build_rotation_matrix(np.pi / 2)
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-16)
    np.testing.assert_allclose(R @ [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], atol=1e-16)
    np.testing.assert_allclose(
        build_rotation_matrix(0.4) @ build_rotation_matrix(0.4).T, np.eye(3), atol=1e-15
    )


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_linear_model_is_the_derivative_of_the_motion_at_rest(name: str, psi0_rad: float) -> None:
    """A_c and B_c are the Jacobian of the nonlinear motion at rest at heading ψ0 (eq. 5-8)."""
    ship = load_vessel(name)

    def motion(nu: np.ndarray, psi: float, tau: np.ndarray) -> np.ndarray:
        c, s = np.cos(psi), np.sin(psi)
        eta_dot = [c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]]
        return np.concatenate([np.linalg.solve(ship.M, tau - ship.D @ nu), eta_dot])

    model, zero = linearise_ship_at_heading(ship.M, ship.D, psi0_rad), np.zeros(3)
    # The motion is linear in ν and τ and, at rest, independent of η: differences are exact.
    for j, unit in enumerate(np.eye(3)):
        tau, close = ship.tau_max * unit, {"rtol": 1e-12, "atol": 1e-15}
        np.testing.assert_allclose(model.A[:, j], motion(unit, psi0_rad, zero), **close)
        np.testing.assert_allclose(model.B[:, j] * tau[j], motion(zero, psi0_rad, tau), **close)
    np.testing.assert_array_equal(model.A[:, 3:], 0.0)
    np.testing.assert_array_equal(model.C, np.hstack([np.zeros((3, 3)), np.eye(3)]))


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_discrete_model_is_an_exact_zero_order_hold(name: str, psi0_rad: float) -> None:
    ship, sample_s = load_vessel(name), sample_of(name)
    continuous = linearise_ship_at_heading(ship.M, ship.D, psi0_rad)
    discrete = discretise_zero_order_hold(continuous, sample_s)
    rng = np.random.default_rng(3)
    for _ in range(3):
        x, u = rng.normal(size=6), rng.uniform(-1, 1, 3) * ship.tau_max
        after = solve_ivp(
            lambda _t, s, u=u: continuous.A @ s + continuous.B @ u,
            (0.0, sample_s),
            x,
            method="DOP853",
            rtol=1e-13,
            atol=1e-14,
        ).y[:, -1]
        np.testing.assert_allclose(discrete.A @ x + discrete.B @ u, after, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_incremental_model_equals_the_whole_one_under_a_constant_disturbance(
    name: str, psi0_rad: float
) -> None:
    """Driven by Δu, eq. 11 gives the outputs of eq. 9 driven by u + w, for any constant w."""
    ship, sample_s = load_vessel(name), sample_of(name)
    discrete = discretise_zero_order_hold(
        linearise_ship_at_heading(ship.M, ship.D, psi0_rad), sample_s
    )
    model = build_prediction_model(ship.M, ship.D, psi0_rad, sample_s)
    rng = np.random.default_rng(5)
    w, u = 0.3 * ship.tau_max, 0.2 * ship.tau_min
    before = np.concatenate([0.1 * rng.normal(size=3), rng.normal(size=3)])
    x_m = discrete.A @ before + discrete.B @ (u + w)
    x = np.concatenate([x_m - before, x_m[3:]])
    for _ in range(40):
        du = rng.uniform(-1, 1, 3) * ship.largest_force_change_per_sample(sample_s)
        u = u + du
        x_m, previous = discrete.A @ x_m + discrete.B @ (u + w), x_m
        x = model.A @ x + model.B @ du
        np.testing.assert_allclose(model.C @ x, x_m[3:], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(x[:6], x_m - previous, rtol=1e-9, atol=1e-12)


def test_augmented_blocks_are_where_the_paper_puts_them() -> None:
    """A = [A_m 0; C_m A_m I], B = [B_m; C_m B_m], C = [0 I] for sizes that are all different."""
    rng = np.random.default_rng(7)
    A, B, C = (rng.normal(size=shape) for shape in ((5, 5), (5, 2), (3, 5)))
    model = augment_to_incremental_model(StateSpace(A, B, C))
    assert (model.n_x, model.n_u, model.n_y) == (8, 2, 3)
    expected = np.block([[A, np.zeros((5, 3))], [C @ A, np.eye(3)]])
    np.testing.assert_allclose(model.A, expected, rtol=1e-14)
    np.testing.assert_allclose(model.B, np.vstack((B, C @ B)), rtol=1e-14)
    np.testing.assert_array_equal(model.C, np.eye(3, 8, 5))


@pytest.mark.parametrize(
    ("shapes", "named"),
    [
        (((2, 3), (2, 1), (1, 2)), "A"),
        (((2, 2), (3, 1), (1, 2)), "B"),
        (((2, 2), (2, 1), (1, 3)), "C"),
    ],
)
def test_matrices_that_do_not_fit_are_refused_by_name(shapes: Any, named: str) -> None:
    with pytest.raises(ShapeError) as caught:
        StateSpace(*(np.zeros(shape) for shape in shapes))
    assert caught.value.key == named
    with pytest.raises(ShapeError, match="9 states"):
        relinearise_model_at_turned_heading(
            StateSpace(np.eye(8), np.ones((8, 3)), np.eye(3, 8)), 0.1
        )


@settings(max_examples=60, derandomize=True, deadline=None)
@given(name=st.sampled_from(VESSELS), psi0_rad=st.floats(-7, 7), psi_rad=st.floats(-7, 7))
def test_a_rotated_model_is_the_one_discretised_at_the_new_heading(
    name: str, psi0_rad: float, psi_rad: float
) -> None:
    """Turning the discretised model from ψ0 to ψ gives what the matrix exponential gives at ψ."""
    ship, sample_s = load_vessel(name), sample_of(name)
    found = relinearise_model_at_turned_heading(
        build_prediction_model(ship.M, ship.D, psi0_rad, sample_s), psi_rad - psi0_rad
    )
    expected = build_prediction_model(ship.M, ship.D, psi_rad, sample_s)
    # Entries of A are 1 at most; those of B are compared in what a maximum increment does.
    step = ship.largest_force_change_per_sample(sample_s)
    np.testing.assert_allclose(found.A, expected.A, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.B * step, expected.B * step, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.C, expected.C)


START, GOAL = np.array([1.0, -2.0, 0.1]), np.array([21.0, 13.0, 0.6])


def test_a_set_point_is_there_from_the_first_sample() -> None:
    np.testing.assert_array_equal(
        build_smoothed_reference_table(START, GOAL, 5, 0.3), np.tile(GOAL, (5, 1))
    )


@pytest.mark.parametrize("damping", [0.7, 1.0])
def test_the_filter_is_the_third_order_transfer_function(damping: float) -> None:
    """η_d/η_r = ω³ / (s³ + (2ζ+1)ωs² + (2ζ+1)ω²s + ω³), stepped by scipy on its own."""
    period, sample_s, samples = 40.0, 0.3, 400
    omega = 2 * np.pi / period
    middle = 2 * damping + 1
    system = lti([omega**3], [1.0, middle * omega, middle * omega**2, omega**3])
    _, rise = step(system, T=np.arange(samples) * sample_s)
    table = build_smoothed_reference_table(
        START, GOAL, samples, sample_s, ReferenceFilter(period, damping)
    )
    expected = START + np.multiply.outer(rise, GOAL - START)
    np.testing.assert_allclose(table, expected, rtol=0, atol=1e-9)


def test_the_filter_starts_at_rest_and_arrives() -> None:
    table = build_smoothed_reference_table(START, GOAL, 2000, 0.3, ReferenceFilter(40.0))
    np.testing.assert_allclose(table[0], START, rtol=0, atol=1e-15)
    # ω³t³/6 of 20 m at t = 0.3 s is 3.5e-4 m.
    assert np.abs(table[1] - START).max() < 4e-4
    np.testing.assert_allclose(table[-1], GOAL, atol=1e-9)


def test_heading_goes_the_short_way() -> None:
    """A goal at -175° seen from 175° is at 185°, filtered or not."""
    start, goal = np.array([0.0, 0.0, np.radians(175)]), np.array([0.0, 0.0, np.radians(-175)])
    assert np.degrees(shift_target_heading_near_start(goal, start)[2]) == pytest.approx(185.0)
    heading = np.degrees(
        build_smoothed_reference_table(start, goal, 100, 0.3, ReferenceFilter(20.0))[:, 2]
    )
    assert heading.min() >= 175.0 - 1e-9
    assert heading.max() <= 185.0 + 1e-9
