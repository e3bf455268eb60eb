"""The first-order wave motion of a ship as filtered white noise, one oscillator per axis.

    h(s) = K_w s / (s² + 2 λ ω0 s + ω0²),     ω0 = 2π / T_p,     K_w = 2 σ √(λ ω0)
    ξ̇1 = ξ2,   ξ̇2 = −ω0² ξ1 − 2 λ ω0 ξ2 + K_w w,   wave motion = ξ2

With w of unit intensity the motion has the standard deviation σ, since var ξ2 = K_w² / (4 λ ω0).
(Fossen 2021, ch. 10.3, linear wave spectrum approximations; there σ is K_w / (2 λ ω0).)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector
from dpbench.ship.layout import AXES

JONSWAP_DAMPING = 0.1
"""λ that fits a JONSWAP spectrum of γ = 3.3; 0.26 fits Pierson-Moskowitz (Fossen 2021)."""


@dataclass(frozen=True, eq=False)
class WaveModel:
    """What an estimator assumes of the wave motion of the ship, per axis.

    Parameters
    ----------
    peak_period_s : (3,) period of the spectrum's peak T_p [s].
    damping : (3,) relative damping λ of the oscillator, below 1.
    std : (3,) standard deviation σ of the motion [m, m, rad]; a Kalman filter weighs the wave
        states by it, the passive observer has no use for it.
    """

    peak_period_s: Vector
    damping: Vector
    std: Vector

    @classmethod
    def of_sea(cls, peak_period_s: float, std: Vector) -> WaveModel:
        """Make a model with the same peak and JONSWAP's damping in every axis."""
        return cls(np.full(AXES, peak_period_s), np.full(AXES, JONSWAP_DAMPING), std)

    @property
    def omega0_radps(self) -> Vector:
        """ω0 (3,) [rad/s]."""
        omega0: Vector = 2 * np.pi / self.peak_period_s
        return omega0

    @property
    def K_w(self) -> Vector:
        """Gain of the driving noise (3,) [m/s^1.5, m/s^1.5, rad/s^1.5]."""
        gain: Vector = 2 * self.std * np.sqrt(self.damping * self.omega0_radps)
        return gain
