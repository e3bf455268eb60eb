"""Kalman filter of a ship in dynamic positioning, with bias and wave-frequency states.

    x⁻ = Φ x + Γ τ,     ε = Tᵀ y − C x⁻,     x = x⁻ + K ε         (model in `kalman_model`)

T(ψ) turns vessel-parallel axes into north-east ones, ψ being the *measured* heading. The gain is
computed once, in vessel-parallel axes, where the model does not depend on the heading; positions,
bias and wave states are remembered in north-east axes, so that a turn of the ship moves none of
them. Of the state x (see `observer` for its layout) these are η, b, ξ1, ξ2; ν is along the ship in
both. What is left out is the turn within one sample and the wave part of the measured heading,
both a degree or so.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dpbench.arrays import Vector
from dpbench.ship.estimation.estimator import nearest_turn
from dpbench.ship.estimation.kalman_model import KalmanModel, KalmanTuning, kalman_model
from dpbench.ship.estimation.observer import (
    BIAS,
    ETA,
    NU,
    WITHOUT_WAVES,
    XI1,
    XI2,
    ModelObserver,
    model_change,
)
from dpbench.ship.layout import AXES
from dpbench.ship.vessel import Vessel


@njit(cache=True)
def _turned(x, c, s):  # type: ignore[no-untyped-def] # compiled by numba
    """Turn η, b, ξ1, ξ2 of the state x in place by the angle of cosine c and sine s."""
    for first in (ETA, BIAS, XI1, XI2):
        if first < len(x):
            turned = c * x[first] - s * x[first + 1]
            x[first + 1] = s * x[first] + c * x[first + 1]
            x[first] = turned


@njit(cache=True)
def _filter_step(  # type: ignore[no-untyped-def] # compiled by numba
    x, measured, tau, Phi, Gamma, K, J, advance, epsilon, estimate, change
):
    """One update of the state x (n,) in place; fills epsilon (3,), estimate and change (6,)."""
    n, pose = len(x), len(measured) - AXES
    heading = nearest_turn(measured[pose + 2], x[ETA + 2])
    c, s = np.cos(heading), np.sin(heading)
    _turned(x, c, -s)
    predicted = x.copy()
    if advance:
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += Phi[i, j] * x[j]
            for j in range(AXES):
                total += Gamma[i, j] * tau[j]
            predicted[i] = total
    north, east = measured[pose], measured[pose + 1]
    epsilon[0] = c * north + s * east - predicted[ETA]
    epsilon[1] = c * east - s * north - predicted[ETA + 1]
    epsilon[2] = heading - predicted[ETA + 2]
    if n > WITHOUT_WAVES:
        for j in range(AXES):
            epsilon[j] -= predicted[XI2 + j]
    for i in range(n):
        x[i] = predicted[i] + K[i, 0] * epsilon[0] + K[i, 1] * epsilon[1] + K[i, 2] * epsilon[2]
    _turned(x, c, s)
    for j in range(AXES):
        estimate[j] = x[NU + j]
        estimate[AXES + j] = x[ETA + j]
    if advance:
        model_change(J, estimate, tau, x[BIAS:NU], change)


class KalmanFilter(ModelObserver):
    """Steady-state Kalman filter.

    Parameters
    ----------
    ship : M and D of the model, which need not be those of the true ship.
    tuning : noise of the model; without `waves` the wave filter is off.
    sample_s : time between updates [s].

    Raises
    ------
    InputError : for a bad sample or noise without a steady state.
    """

    def __init__(self, ship: Vessel, tuning: KalmanTuning, sample_s: float) -> None:
        self.model: KalmanModel = kalman_model(ship, tuning, sample_s)
        super().__init__(ship, sample_s, len(self.model.Phi))
        self._Phi, self._Gamma, self._K = self.model.Phi, self.model.Gamma, self.model.K
        self.innovation: Vector = np.zeros(AXES)
        """ε (3,) of the last update, in vessel-parallel axes [m, m, rad]; overwritten."""

    def update(self, measured: Vector, tau: Vector) -> Vector:
        _filter_step(
            self._x,
            measured,
            tau,
            self._Phi,
            self._Gamma,
            self._K,
            self._J,
            self._advance,
            self.innovation,
            self._estimate,
            self.change,
        )
        self._advance = True
        return self._estimate
