"""The Kalman filter against its own stochastic model, built and simulated a second time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.stats import binom, chi2

from dpbench.errors import InputError
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.estimation.kalman import (
    SENSOR_STD,
    KalmanFilter,
    KalmanTuning,
    build_kalman_model,
)
from dpbench.ship.estimation.observer import WaveModel
from dpbench.ship.vessel import Vessel
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

TUNING = KalmanTuning.choose_for_ship(SHIP, WAVES)


def continuous(ship: Vessel, tuning: KalmanTuning) -> tuple[np.ndarray, ...]:
    """A, B, E Eᵀ, C of the states [η, b, ν, ξ1, ξ2], written block by block in SI."""
    O3, Minv, waves = np.zeros((3, 3)), np.linalg.inv(ship.M), tuning.waves
    assert waves is not None
    w0, lam = 2 * np.pi / waves.peak_period_s, waves.damping
    B = np.vstack([O3, O3, Minv, O3, O3])
    # var ξ2 = K_w²/(4 λ ω0) is to be σ².
    drive = np.diag(4 * lam * w0 * waves.std**2)
    force = Minv @ np.diag(tuning.force_noise**2) @ Minv.T
    EE = block_diag(O3, np.diag(tuning.bias_noise**2), force, O3, drive)
    return model_matrix(ship, np.full(3, 1 / tuning.bias_time_s), waves), B, EE, OUTPUT


def sampled(ship: Vessel, tuning: KalmanTuning, h: float) -> tuple[np.ndarray, ...]:
    """Φ, Γ, Q, C by Gauss-Legendre quadrature of the integrals over a sample."""
    A, B, EE, C = continuous(ship, tuning)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    powers = [expm(A * 0.5 * h * (1 + x)) for x in nodes]
    Gamma = sum(0.5 * h * w * X @ B for X, w in zip(powers, weights, strict=True))
    Q = sum(0.5 * h * w * X @ EE @ X.T for X, w in zip(powers, weights, strict=True))
    return expm(A * h), np.asarray(Gamma), np.asarray(Q), C


def innovations(tuning: KalmanTuning, steps: int, seed: int) -> tuple[KalmanFilter, np.ndarray]:
    """Innovations (steps, 3) of a filter with `tuning` on data of the model with TUNING."""
    Phi, Gamma, Q, C = sampled(SHIP, TUNING, SAMPLE_S)
    scale = np.sqrt(np.diag(Q))
    root = scale[:, None] * np.linalg.cholesky(Q / np.outer(scale, scale))
    rng = np.random.default_rng(seed)
    kalman = KalmanFilter(SHIP, tuning, SAMPLE_S)
    kalman.start_from_state(np.zeros(6))
    x, tau, found = np.zeros(15), np.zeros(3), np.empty((steps, 3))
    mass = np.diag(SHIP.M)
    for k in range(steps):
        estimate = kalman.update_and_return_state(
            C @ x + TUNING.measurement_std * rng.normal(size=3), tau
        )
        found[k] = kalman.innovation
        tau = -mass * (0.01 * estimate[3:] + 0.2 * estimate[:3]) - kalman.estimated_bias_force
        x = Phi @ x + Gamma @ tau + root @ rng.normal(size=15)
    return kalman, found


def outside_bounds(series: np.ndarray, lags: int) -> int:
    """Autocorrelations of (N, 3) at lags 1..lags outside the 95 % bounds ±1.96/√N."""
    N = len(series)
    r = [(series[:-j] * series[j:]).sum(axis=0) / (series**2).sum(axis=0) for j in range(1, lags)]
    return int((np.abs(r) > 1.96 / math.sqrt(N)).sum())


@pytest.mark.parametrize("bias_time_s", [math.inf, 30.0])
def test_the_discrete_model_holds_the_integrals_of_the_continuous_one(bias_time_s: float) -> None:
    tuning = replace(TUNING, bias_time_s=bias_time_s)
    Phi, Gamma, Q, C = sampled(SHIP, tuning, SAMPLE_S)
    model = build_kalman_model(SHIP, tuning, SAMPLE_S)
    size = np.sqrt(np.diag(Q))
    # Twelve Gauss points are exact to rounding here; Q is compared as a correlation.
    np.testing.assert_allclose(model.Phi, Phi, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(model.Gamma, Gamma, rtol=1e-11, atol=1e-20)
    np.testing.assert_allclose(model.Q / np.outer(size, size), Q / np.outer(size, size), atol=1e-10)
    np.testing.assert_array_equal(model.C, C)


def test_the_gain_is_where_the_riccati_iteration_comes_to_rest() -> None:
    Phi, _, Q, C = sampled(SHIP, TUNING, SAMPLE_S)
    model = build_kalman_model(SHIP, TUNING, SAMPLE_S)
    R = np.diag(TUNING.measurement_std**2)
    P = 10 * Q
    for _ in range(4000):
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        I_KC = np.eye(15) - K @ C
        P = Phi @ (I_KC @ P @ I_KC.T + K @ R @ K.T) @ Phi.T + Q
    size = np.abs(model.K).max(axis=1, keepdims=True)
    # Both are exact to the conditioning of SI units, about 1e-10.
    np.testing.assert_allclose(model.K / size, K / size, rtol=0, atol=1e-7)
    np.testing.assert_allclose(model.S, C @ P @ C.T + R, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("wave_filter", [True, False])
@pytest.mark.parametrize("name", [*FULL_SCALE, "cybership2"])
def test_the_filter_forgets_its_start_for_every_vessel(name: str, wave_filter: bool) -> None:
    """With the defaults the slowest error of every vessel falls to 1/e within ten wave periods."""
    ship = load_vessel(name)
    length, time = (70.0, math.sqrt(70.0)) if name == "cybership2" else (1.0, 1.0)
    lengths = np.array([length, length, 1.0])
    waves = WaveModel.from_peak_period(8.5 / time, WAVES.std / lengths)
    tuning = KalmanTuning.choose_for_ship(
        ship, waves, SENSOR_STD / lengths, wave_filter=wave_filter
    )
    model = build_kalman_model(ship, tuning, SAMPLE_S / time)
    forgets = (np.eye(len(model.K)) - model.K @ model.C) @ model.Phi
    radius = np.abs(np.linalg.eigvals(forgets)).max()
    assert radius < math.exp(-SAMPLE_S / 85.0)


@pytest.mark.slow
def test_innovations_are_white_on_matched_noise() -> None:
    """Out of 3 x 40 autocorrelations no more than chance leave their 95 % bounds."""
    # Chance leaves 6 of 120 outside, and more than 13 once in 300 seeds.
    lags, limit = 41, int(binom.ppf(0.997, 120, 0.05))
    _, found = innovations(TUNING, 20_500, seed=20)
    assert outside_bounds(found[500:], lags) <= limit
    unfiltered = KalmanTuning.choose_for_ship(SHIP, WAVES, wave_filter=False)
    _, coloured = innovations(unfiltered, 20_500, seed=20)
    assert outside_bounds(coloured[500:], lags) > 60


@pytest.mark.slow
def test_innovations_have_the_covariance_the_filter_predicts() -> None:
    """Σ εᵀ S⁻¹ ε lies in the 99 % interval of χ² with 3 N degrees, in total and per axis."""
    N = 20_000
    kalman, found = innovations(TUNING, N + 500, seed=21)
    found, S = found[500:], kalman.model.S
    low, high = chi2.interval(0.99, 3 * N)
    assert low < np.einsum("ki,ij,kj->", found, np.linalg.inv(S), found) < high
    low, high = chi2.interval(0.99, N)
    per_axis = (found**2).sum(axis=0) / np.diag(S)
    assert (low < per_axis).all()
    assert (per_axis < high).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_wave_motion_at_the_peak_period_is_taken_out(axis: int) -> None:
    """Motion at the peak loses 20 dB on its way to the pose, as the transfer function says."""
    kalman = KalmanFilter(SHIP, TUNING, SAMPLE_S)
    reached = response(kalman, axis)
    Phi, _, _, C = sampled(SHIP, TUNING, SAMPLE_S)
    K, z = kalman.model.K, np.exp(1j * OMEGA0 * SAMPLE_S)
    H = np.linalg.solve(np.eye(15) - (np.eye(15) - K @ C) @ Phi / z, K)
    assert reached < 0.1
    # The start has died out to e^-20 after the first half.
    assert reached == pytest.approx(np.abs(H[axis, axis]), rel=1e-4)


def test_a_turn_of_the_ship_does_not_turn_the_sea() -> None:
    """At a turn by 90° from one sample to the next the wave motion is predicted on its course."""
    kalman = KalmanFilter(SHIP, TUNING, SAMPLE_S)
    kalman.start_from_state(np.zeros(6))
    measured, before = np.zeros(3), 0.0
    for k in range(1001):
        before = np.abs(kalman.innovation[:2]).max()
        angle = OMEGA0 * SAMPLE_S * k
        measured[:2] = 0.5 * math.sin(angle), 0.3 * math.cos(angle)
        measured[2] = math.pi / 2 if k == 1000 else 0.0
        kalman.update_and_return_state(measured, np.zeros(3))
    # What is left is the estimated drift of centimetres per second, which turns with the ship.
    assert np.abs(kalman.innovation[:2]).max() < before + 0.02


def test_without_wave_filter_the_motion_counts_as_sensor_noise() -> None:
    tuning = KalmanTuning.choose_for_ship(SHIP, WAVES, wave_filter=False)
    kalman, found = innovations(tuning, 4500, seed=22)
    ratio = found[500:].std(axis=0) / np.sqrt(np.diag(kalman.model.S))
    # The waves are coloured, so the sizes agree, not the statistics.
    assert (np.abs(ratio - 1) < 0.2).all()


def test_a_bias_that_hardly_moves_is_refused() -> None:
    tuning = KalmanTuning(SENSOR_STD, np.full(3, 1e4), np.full(3, 1e-30), WAVES)
    with pytest.raises(InputError, match="no steady state"):
        KalmanFilter(SHIP, tuning, SAMPLE_S)
