"""The passive observer against its equations written a second time, and its tuning rules."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.estimation.observer import PassiveObserver, PassiveTuning, WaveModel
from dpbench.ship.vessel import Vessel
from tests.ship.conftest import rotation
from tests.ship.estimation.conftest import (
    FULL_SCALE,
    OMEGA0,
    OUTPUT,
    SAMPLE_S,
    SHIP,
    WAVES,
    model_matrix,
    response,
)

TUNING = PassiveTuning.choose_for_ship(SHIP, WAVES)


def linear(ship: Vessel, tuning: PassiveTuning) -> tuple[np.ndarray, np.ndarray]:
    """A and B of ẋ = A x + B y at heading zero, x = [η̂, b̂, ν̂, ξ̂1, ξ̂2]."""
    K11, K12, K2, K3, K4 = (np.diag(gain) for gain in tuning.gain_vectors)
    B = np.vstack([K2, K3, np.linalg.inv(ship.M) @ K4, K11, K12])
    return model_matrix(ship, 1 / tuning.bias_time_s, tuning.waves) - B @ OUTPUT, B


def test_the_gains_follow_the_published_rules() -> None:
    """λ 0.1, ζ_n 1, ω0 0.8976, ω_c 1.1 rad/s give Fossen's example: K1 = (-2.2059, 1.6157)."""
    waves = WaveModel(np.full(3, 2 * np.pi / 0.8976), np.full(3, 0.1), WAVES.std)
    tuning = PassiveTuning(
        waves,
        np.ones(3),
        np.full(3, 1.1),
        np.array([0.1, 0.1, 0.01]),
        np.full(3, 0.1),
        np.full(3, 1000.0),
    )
    K11, K12, K2, K3, K4 = tuning.gain_vectors
    np.testing.assert_allclose(K11, -2.2059, atol=5e-5)
    np.testing.assert_allclose(K12, 1.6157, atol=5e-5)
    np.testing.assert_array_equal(K2, 1.1)
    np.testing.assert_allclose(K3, 0.1 * K4, rtol=1e-15)


@pytest.mark.parametrize("name", [*FULL_SCALE, "cybership2"])
def test_the_defaults_are_passive_for_every_vessel(name: str) -> None:
    ship = load_vessel(name)
    scale = math.sqrt(70.0) if name == "cybership2" else 1.0
    waves = WaveModel.from_peak_period(8.5 / scale, WAVES.std)
    tuning = PassiveTuning.choose_for_ship(ship, waves)
    K11, K12, K2, K3, K4 = tuning.gain_vectors
    s = 1j * np.logspace(-6, 3, 4000)[:, None] * waves.natural_frequencies_radps
    w0, lam, leak = waves.natural_frequencies_radps, waves.damping, 1 / tuning.bias_time_s
    wave = s**2 + 2 * lam * w0 * s + w0**2
    pose = (s + K2) * wave + s * (K12 * s - K11 * w0**2)
    H = wave / pose * K4 * (s + leak + K3 / K4) / (s + leak)
    assert (H.real > 0).all()
    # A start is forgotten to 1/e within 300 s, the slowest being the heavily damped yaw of `osv`.
    assert np.linalg.eigvals(linear(ship, tuning)[0]).real.max() < -0.003 * scale


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_wave_motion_at_the_peak_period_is_taken_out(axis: int) -> None:
    """Motion at the peak loses 20 dB on its way to the pose, as the transfer function says."""
    tunings = (PassiveTuning.choose_for_ship(SHIP, WAVES, wave_filter=on) for on in (True, False))
    reached = [response(PassiveObserver(SHIP, tuning, SAMPLE_S), axis) for tuning in tunings]
    A, B = linear(SHIP, TUNING)
    H = np.linalg.solve(1j * OMEGA0 * np.eye(15) - A, B)
    assert reached[0] < 0.1
    assert reached[1] > 4 * reached[0]
    # Straight lines between samples take (ω0 h)²/12, 0.4 %, off a sine.
    assert reached[0] == pytest.approx(np.abs(H[axis, axis]), rel=6e-3)


def test_the_step_is_the_solution_of_the_differential_equations() -> None:
    observer = PassiveObserver(SHIP, TUNING, SAMPLE_S)
    K11, K12, K2, K3, K4 = TUNING.gain_vectors
    w0, lam = WAVES.natural_frequencies_radps, WAVES.damping
    Minv = np.linalg.inv(SHIP.M)
    steps = 200
    t = SAMPLE_S * np.arange(steps)
    swing = np.sin(OMEGA0 * t[:, None] + [0.0, 1.0, 2.0]) * [0.5, 0.4, 0.02]
    poses = np.column_stack([3 + 0.1 * t, -2 + 0.05 * t, 1.5 + 0.02 * t]) + swing
    taus = SHIP.tau_max * np.cos(0.1 * t[:, None] + [0.0, 1.0, 2.0]) * 0.3
    start = np.concatenate([[0.1, 0.05, 0.01], poses[0]])
    observer.start_from_state(start)
    observer.update_and_return_state(poses[0], taus[0])
    x = np.concatenate([poses[0], np.zeros(3), start[:3], np.zeros(6)])
    for k in range(1, steps):

        def equations(at_s: float, x: np.ndarray, k: int = k) -> np.ndarray:
            y = poses[k - 1] + (poses[k] - poses[k - 1]) * at_s / SAMPLE_S
            eta, b, nu, xi1, xi2 = x.reshape(5, 3)
            R = rotation(y[2])
            e = y - eta - xi2
            return np.concatenate(
                [
                    R @ nu + K2 * e,
                    K3 * e - b / TUNING.bias_time_s,
                    Minv @ (taus[k] + R.T @ (b + K4 * e) - SHIP.D @ nu),
                    xi2 + K11 * e,
                    -(w0**2) * xi1 - 2 * lam * w0 * xi2 + K12 * e,
                ]
            )

        x = solve_ivp(equations, (0.0, SAMPLE_S), x, method="DOP853", rtol=1e-10, atol=1e-9).y[
            :, -1
        ]
        estimate = observer.update_and_return_state(poses[k], taus[k])
        # Two Runge-Kutta steps a sample leave less than a hundredth of a millimetre.
        np.testing.assert_allclose(estimate[3:], x[0:3], rtol=0, atol=1e-5)
        np.testing.assert_allclose(estimate[:3], x[6:9], rtol=0, atol=1e-5)
