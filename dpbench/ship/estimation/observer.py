"""Common parts of the two observers with a model: wave model, layout of the state, start, bias.

    x   0    3    6    9    12   15
        │ η  │ b  │ ν  │ ξ1 │ ξ2 │       three each: surge or north, sway or east, yaw
        └─ WITHOUT_WAVES ─┘      │       pose, bias, velocity
        └───── WITH_WAVES ───────┘       and the two states of the wave oscillators (`WaveModel`)

Numbers, because numba compiles a kernel with the value of a global number; see `ship.layout` for
what its cache does not see.

    M ν̇ + D ν = f,  η̇ = R ν  with f = τ + Rᵀ b held:   [Δν; RᵀΔη] = J [ν; f]

The law acts on Δν, Δη (paper eq. 6), here by the model and one estimate. The difference of two
estimates also holds the corrections between them: a centimetre in 0.3 s reads as 3 cm/s, which
alone keeps the rate limits active behind a Kalman filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.ship.estimation.estimator import Estimator
from dpbench.ship.layout import AXES, EAST, HEADING, NORTH, POSE, STATE, VELOCITY
from dpbench.ship.vessel import Vessel

ETA, BIAS, NU, XI1, XI2 = range(0, 5 * AXES, AXES)
WITHOUT_WAVES, WITH_WAVES = XI1, XI2 + AXES


JONSWAP_DAMPING = 0.1
"""λ that fits a JONSWAP spectrum of γ = 3.3; 0.26 fits Pierson-Moskowitz (Fossen 2021)."""


@dataclass(frozen=True, eq=False)
class WaveModel:
    """First-order wave motion in three axes, as white noise filtered by an oscillator each.

        h(s) = K_w s / (s² + 2 λ ω0 s + ω0²),     ω0 = 2π / T_p,     K_w = 2 σ √(λ ω0)
        ξ̇1 = ξ2,   ξ̇2 = −ω0² ξ1 − 2 λ ω0 ξ2 + K_w w,   wave motion = ξ2

    With w of unit intensity the motion has the standard deviation σ, var ξ2 = K_w² / (4 λ ω0).
    (Fossen 2021, ch. 10.3, linear wave spectrum approximations; there σ is K_w / (2 λ ω0).)

    peak_period_s : (3,) period of the spectrum's peak T_p [s].
    damping : (3,) relative damping λ of the oscillator, below 1.
    std : (3,) standard deviation σ of the motion [m, m, rad]; a Kalman filter weighs the wave
        states by it, the passive observer has no use for it.
    """

    peak_period_s: Vector
    damping: Vector
    std: Vector

    @classmethod
    def from_peak_period(cls, peak_period_s: float, std: Vector) -> WaveModel:
        """Build the wave model of a peak period [s], with the same damping in every axis."""
        return cls(np.full(AXES, peak_period_s), np.full(AXES, JONSWAP_DAMPING), std)

    @property
    def natural_frequencies_radps(self) -> Vector:
        """Natural frequencies ω0 (3,) [rad/s] of the wave oscillators."""
        omega0: Vector = 2 * np.pi / self.peak_period_s
        return omega0

    @property
    def K_w(self) -> Vector:
        """Gains (3,) of the driving white noise [m/s^1.5, m/s^1.5, rad/s^1.5]."""
        gain: Vector = 2 * self.std * np.sqrt(self.damping * self.natural_frequencies_radps)
        return gain


def build_matrix_of_sample_change(ship: Vessel, sample_s: float) -> Matrix:
    """Return the matrix (6, 6) from velocity and force to a sample's change of velocity and pose.

    With the state [∫ν; ν] advanced by [[I, F_p], [0, F_v]] and [G_p; G_v] f over the sample, and
    ν⁻ = F_v⁻¹ (ν − G_v f) the speed before it: Δν = ν − ν⁻, RᵀΔη = F_p ν⁻ + G_p f.
    """
    path, velocity, force = (slice(i, i + AXES) for i in range(0, 3 * AXES, AXES))
    one, zero = np.eye(AXES), np.zeros((AXES, AXES))
    A = np.zeros((3 * AXES, 3 * AXES))
    A[path, velocity] = one
    A[velocity, velocity] = -np.linalg.solve(ship.M, ship.D)
    A[velocity, force] = np.linalg.inv(ship.M)
    step = expm(A * sample_s)
    F_p, F_v = step[path, velocity], step[velocity, velocity]
    G_p, G_v = step[path, force], step[velocity, force]
    back = np.linalg.inv(F_v) @ np.hstack([one, -G_v])
    speed = np.hstack([one, zero]) - back
    pose = F_p @ back + np.hstack([zero, G_p])
    return np.ascontiguousarray(np.vstack([speed, pose]))


@njit(cache=True)
def write_model_change_of_sample(J, estimate, tau, b, change):  # type: ignore[no-untyped-def] # compiled by numba
    """Write the ship model's change of velocity and pose (6,) in one sample to `change`."""
    c, s = np.cos(estimate[HEADING]), np.sin(estimate[HEADING])
    f0 = tau[0] + c * b[0] + s * b[1]
    f1 = tau[1] + c * b[1] - s * b[0]
    f2 = tau[2] + b[2]
    for i in range(STATE):
        total = J[i, AXES] * f0 + J[i, AXES + 1] * f1 + J[i, AXES + 2] * f2
        for j in range(AXES):
            total += J[i, j] * estimate[j]
        change[i] = total
    # So far along the ship; over ground from here.
    ahead, starboard = change[NORTH], change[EAST]
    change[NORTH] = c * ahead - s * starboard
    change[EAST] = s * ahead + c * starboard


class ModelObserver(Estimator):
    """Observer base class with a ship model, a bias force and optional wave states."""

    def __init__(self, ship: Vessel, sample_s: float, states: int) -> None:
        self._J: Matrix = build_matrix_of_sample_change(ship, sample_s)
        self._x: Vector = np.zeros(states)
        self._estimate, self.change = np.zeros(STATE), np.zeros(STATE)
        self._advance = False

    def start_from_state(self, state: Vector) -> None:
        """Set the observer to the state (6,) at the start of a run, without bias or wave motion."""
        self._x[...] = 0.0
        self._x[ETA:BIAS], self._x[NU:XI1] = state[POSE], state[VELOCITY]
        self._estimate[...] = state
        self.change[...] = 0.0
        self._advance = False

    @property
    def estimated_bias_force(self) -> Vector:
        """Estimated bias force (3,), north, east, yaw [N, N, N·m]."""
        return self._x[BIAS:NU].copy()
