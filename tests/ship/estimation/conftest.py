"""Fixtures of the tests of both filters: ship, sea, the model, the response to waves."""

import math

import numpy as np

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.estimation.kalman import KalmanFilter
from dpbench.ship.estimation.observer import PassiveObserver, WaveModel
from dpbench.ship.vessel import Vessel

SAMPLE_S = 0.3
SHIP = load_vessel("supply_fs99")
WAVES = WaveModel.from_peak_period(8.5, np.array([0.3, 0.3, np.radians(0.5)]))
OMEGA0 = 2 * np.pi / 8.5
FULL_SCALE = ("supply_fs99", "supply_mss", "supply_tmr", "osv")
OUTPUT = np.hstack([np.eye(3), np.zeros((3, 9)), np.eye(3)])


def model_matrix(ship: Vessel, leak: np.ndarray, waves: WaveModel) -> np.ndarray:
    """A of the states [η, b, ν, ξ1, ξ2] at heading zero, written block by block in SI."""
    I3, O3 = np.eye(3), np.zeros((3, 3))
    Minv = np.linalg.inv(ship.M)
    w0, lam = 2 * np.pi / waves.peak_period_s, waves.damping
    return np.block(
        [
            [O3, O3, I3, O3, O3],
            [O3, -np.diag(leak), O3, O3, O3],
            [O3, Minv, -Minv @ ship.D, O3, O3],
            [O3, O3, O3, O3, I3],
            [O3, O3, O3, -np.diag(w0**2), -np.diag(2 * lam * w0)],
        ]
    )


def response(estimator: KalmanFilter | PassiveObserver, axis: int) -> float:
    """The share of motion at the peak along an axis that reaches the estimated pose."""
    amplitude = np.array([0.5, 0.5, 0.01])[axis]
    estimator.start_from_state(np.zeros(6))
    N = 1700  # sixty periods of 85/3 samples
    t, estimates = SAMPLE_S * np.arange(2 * N), np.empty((2 * N, 6))
    measured = np.zeros(3)
    for k in range(2 * N):
        measured[axis] = amplitude * math.sin(OMEGA0 * t[k])
        estimates[k] = estimator.update_and_return_state(measured, np.zeros(3))
    phasor = np.exp(-1j * OMEGA0 * t[N:])
    return float(np.abs(2 / N * phasor @ estimates[N:, 3 + axis]) / amplitude)
