"""The prediction model against integration, against the paper's blocks and against itself driven
by whole forces instead of increments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dpbench.errors import ShapeError
from dpbench.mpc.model import (
    StateSpace,
    augment,
    discretise,
    linearise,
    prediction_model,
    rotated,
    rotation,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Environment
from dpbench.ship.plant import SUBSTEPS, Plant

VESSELS = ("supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2")
HEADINGS = (0.0, 0.7, -2.5)


def sample_of(name: str) -> float:
    """The paper's sample, Froude-scaled for the model ship."""
    return 0.3 if name != "cybership2" else 0.3 / np.sqrt(70.0)


def test_rotation_maps_body_axes_to_compass_axes() -> None:
    """A ship heading east moves east when it surges and south when it sways to starboard."""
    R = rotation(np.pi / 2)
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-16)
    np.testing.assert_allclose(R @ [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], atol=1e-16)
    np.testing.assert_allclose(rotation(0.4) @ rotation(0.4).T, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_linear_model_is_the_derivative_of_the_motion_at_rest(name: str, psi0_rad: float) -> None:
    """A_c and B_c are the Jacobian of the nonlinear motion at rest at heading ψ0 (eq. 5-8)."""
    ship = load_vessel(name)

    def motion(nu: np.ndarray, psi: float, tau: np.ndarray) -> np.ndarray:
        c, s = np.cos(psi), np.sin(psi)
        eta_dot = [c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]]
        return np.concatenate([np.linalg.solve(ship.M, tau - ship.D @ nu), eta_dot])

    model = linearise(ship.M, ship.D, psi0_rad)
    # The motion is linear in ν and τ and, at rest, independent of η: differences are exact.
    for j in range(3):
        unit = np.eye(3)[j]
        np.testing.assert_allclose(
            model.A[:, j], motion(unit, psi0_rad, np.zeros(3)), rtol=1e-12, atol=1e-15
        )
        step = ship.tau_max[j]
        np.testing.assert_allclose(
            model.B[:, j] * step, motion(np.zeros(3), psi0_rad, step * unit), rtol=1e-12, atol=1e-15
        )
    np.testing.assert_array_equal(model.A[:, 3:], 0.0)
    np.testing.assert_array_equal(model.C, np.hstack([np.zeros((3, 3)), np.eye(3)]))


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_discrete_model_is_an_exact_zero_order_hold(name: str, psi0_rad: float) -> None:
    """One step of (A_m, B_m) is the solution of (A_c, B_c) under a force held over the sample."""
    ship, sample_s = load_vessel(name), sample_of(name)
    continuous = linearise(ship.M, ship.D, psi0_rad)
    discrete = discretise(continuous, sample_s)
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
def test_the_plant_follows_the_discrete_model_while_the_heading_stays(psi0_rad: float) -> None:
    """At constant heading the nonlinear ship and the discrete model move alike."""
    ship = load_vessel("supply_tmr")
    M, D = np.diag(np.diag(ship.M)), ship.D
    discrete = discretise(linearise(M, D, psi0_rad), 0.3)
    # A diagonal ship does not turn under surge and sway forces, so the model is exact for it.
    diagonal = type(ship)(
        "diagonal", "", "", ship.length_m, M, D, ship.tau_min, ship.tau_max, ship.rate_max
    )
    x = np.array([0.3, -0.2, 0.0, 1.2, 1.3, psi0_rad])
    plant = Plant(diagonal, x, 0.3)
    b = np.array([4e4, -3e4, 0.0])
    still = Environment(b, np.zeros(3), np.ones(3), np.zeros(3)).stage_table(1, 0.3, SUBSTEPS)[0]
    tau = np.array([2e5, 1e5, 0.0])
    for _ in range(100):
        plant.advance(tau, still)
        x = discrete.A @ x + discrete.B @ (tau + rotation(psi0_rad).T @ b)
    # RK4's truncation, 1e-13 a sample, adds up over 100 samples.
    np.testing.assert_allclose(plant.state, x, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("psi0_rad", HEADINGS)
@pytest.mark.parametrize("name", VESSELS)
def test_incremental_model_equals_the_whole_one_under_a_constant_disturbance(
    name: str, psi0_rad: float
) -> None:
    """Driven by Δu, eq. 11 gives the outputs of eq. 9 driven by u + w, for any constant w."""
    ship, sample_s = load_vessel(name), sample_of(name)
    discrete = discretise(linearise(ship.M, ship.D, psi0_rad), sample_s)
    model = prediction_model(ship.M, ship.D, psi0_rad, sample_s)
    rng = np.random.default_rng(5)
    w, u = 0.3 * ship.tau_max, 0.2 * ship.tau_min
    before = np.concatenate([0.1 * rng.normal(size=3), rng.normal(size=3)])
    x_m = discrete.A @ before + discrete.B @ (u + w)
    x = np.concatenate([x_m - before, x_m[3:]])
    for _ in range(40):
        du = rng.uniform(-1, 1, 3) * ship.step_max(sample_s)
        u = u + du
        x_m, previous = discrete.A @ x_m + discrete.B @ (u + w), x_m
        x = model.A @ x + model.B @ du
        np.testing.assert_allclose(model.C @ x, x_m[3:], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(x[:6], x_m - previous, rtol=1e-9, atol=1e-12)


def test_augmented_blocks_stand_where_the_paper_puts_them() -> None:
    """A = [A_m 0; C_m A_m I], B = [B_m; C_m B_m], C = [0 I] for sizes that are all different."""
    rng = np.random.default_rng(7)
    n_x, n_u, n_y = 5, 2, 3
    plant = StateSpace(
        rng.normal(size=(n_x, n_x)), rng.normal(size=(n_x, n_u)), rng.normal(size=(n_y, n_x))
    )
    model = augment(plant)
    assert (model.n_x, model.n_u, model.n_y) == (n_x + n_y, n_u, n_y)
    np.testing.assert_array_equal(model.A[:n_x, :n_x], plant.A)
    np.testing.assert_array_equal(model.A[:n_x, n_x:], 0.0)
    np.testing.assert_allclose(model.A[n_x:, :n_x], plant.C @ plant.A, rtol=1e-14)
    np.testing.assert_array_equal(model.A[n_x:, n_x:], np.eye(n_y))
    np.testing.assert_array_equal(model.B[:n_x], plant.B)
    np.testing.assert_allclose(model.B[n_x:], plant.C @ plant.B, rtol=1e-14)
    np.testing.assert_array_equal(model.C, np.eye(n_y, n_x + n_y, n_x))


@pytest.mark.parametrize(
    ("A", "B", "C", "named"),
    [
        (np.zeros((2, 3)), np.zeros((2, 1)), np.zeros((1, 2)), "A"),
        (np.eye(2), np.zeros((3, 1)), np.zeros((1, 2)), "B"),
        (np.eye(2), np.zeros((2, 1)), np.zeros((1, 3)), "C"),
    ],
)
def test_matrices_that_do_not_fit_are_refused_by_name(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, named: str
) -> None:
    """A state-space model names the matrix whose shape is wrong."""
    with pytest.raises(ShapeError) as caught:
        StateSpace(A, B, C)
    assert caught.value.key == named


@settings(max_examples=60, derandomize=True, deadline=None)
@given(name=st.sampled_from(VESSELS), psi0_rad=st.floats(-7, 7), psi_rad=st.floats(-7, 7))
def test_a_rotated_model_is_the_one_discretised_at_the_new_heading(
    name: str, psi0_rad: float, psi_rad: float
) -> None:
    """Turning the discretised model from ψ0 to ψ gives what the matrix exponential gives at ψ."""
    ship, sample_s = load_vessel(name), sample_of(name)
    found = rotated(prediction_model(ship.M, ship.D, psi0_rad, sample_s), psi_rad - psi0_rad)
    expected = prediction_model(ship.M, ship.D, psi_rad, sample_s)
    # Entries of A are 1 at most; those of B are compared in what a rate-limit step does.
    step = ship.step_max(sample_s)
    np.testing.assert_allclose(found.A, expected.A, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.B * step, expected.B * step, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.C, expected.C)


def test_only_a_ship_can_be_rotated() -> None:
    """A model of other sizes has no heading to turn and is refused."""
    with pytest.raises(ShapeError, match="9 states"):
        rotated(StateSpace(np.eye(8), np.ones((8, 3)), np.eye(3, 8)), 0.1)
