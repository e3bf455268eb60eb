"""Passive nonlinear observer (Fossen & Strand 1999, Automatica 35, pp. 3-16).

With ỹ = y − η̂ − ξ̂2 (measured less estimated pose), R = R(ψ measured), north-east axes:

    ξ̂1˙ = ξ̂2 + K11 ỹ                         η̂˙ = R ν̂ + K2 ỹ
    ξ̂2˙ = −ω0² ξ̂1 − 2 λ ω0 ξ̂2 + K12 ỹ        b̂˙ = −b̂/T_b + K3 ỹ
    M ν̂˙ = −D ν̂ + τ + Rᵀ b̂ + Rᵀ K4 ỹ

Integrated with fixed-step Runge-Kutta 4; between two measurements y runs along a straight line,
since a held y would be half a sample late and detune the notch.

Gains by the tuning rules of the same paper:

    K11 = −2 (ζ_n − λ) ω_c / ω0,   K12 = 2 ω0 (ζ_n − λ),   K2 = ω_c,   K3 = (K3/K4) K4
    ζ_n > λ,   1/T_b < K3/K4 < ω0 < ω_c

They give the pose loop a notch at ω0 and the cut-off ω_c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.ship.estimation.estimator import shift_heading_near
from dpbench.ship.estimation.observer import (
    BIAS,
    ETA,
    NU,
    WITH_WAVES,
    XI1,
    XI2,
    ModelObserver,
    WaveModel,
    write_model_change_of_sample,
)
from dpbench.ship.layout import AXES, POSE
from dpbench.ship.vessel import Vessel

CUTOFF_RATIO = 1.5
"""ω_c / ω0. The rules alone do not make the error loop passive: at the 1.1 / 0.8976 of Fossen's
example its phase reaches -95°, at 1.5 with the ratios below it stays above -90°."""
STIFFNESS_RATIO = 0.4  # √(K4 / M) / ω0: how fast a pose error moves the speed
BIAS_RATIO = 0.1  # (K3 / K4) / ω0: how fast it moves the bias
BIAS_TIME_RATIO = 1e4  # T_b · ω0: a constant bias is short by K4 / (K3 T_b), a thousandth of it


@dataclass(frozen=True, eq=False)
class PassiveTuning:
    """Gains of the nonlinear passive observer of Fossen and Strand.

    notch_damping : (3,) ζ_n, above the damping λ of the waves; 1 gives -20 dB at the peak.
    cutoff_radps : (3,) ω_c, above ω0 [rad/s].
    K4 : (3,) gain of the pose error on the force [N/m, N/m, N·m/rad].
    bias_rate_radps : (3,) K3/K4 [rad/s], between 1/T_b and ω0.
    bias_time_s : (3,) T_b [s].
    wave_filter : False leaves the wave states out (K1 = 0).
    """

    waves: WaveModel
    notch_damping: Vector
    cutoff_radps: Vector
    K4: Vector
    bias_rate_radps: Vector
    bias_time_s: Vector
    wave_filter: bool = True

    @classmethod
    def choose_for_ship(
        cls, ship: Vessel, waves: WaveModel, *, wave_filter: bool = True
    ) -> PassiveTuning:
        """Choose observer gains in proportion to the ship's inertia and the wave period."""
        omega0 = waves.natural_frequencies_radps
        return cls(
            waves,
            np.ones(AXES),
            CUTOFF_RATIO * omega0,
            np.diag(ship.M) * (STIFFNESS_RATIO * omega0) ** 2,
            BIAS_RATIO * omega0,
            BIAS_TIME_RATIO / omega0,
            wave_filter,
        )

    @property
    def gain_vectors(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        """Gain vectors K11, K12, K2, K3 and K4 of the passive observer, (3,) each."""
        omega0, on = self.waves.natural_frequencies_radps, float(self.wave_filter)
        rise: Vector = on * 2 * (self.notch_damping - self.waves.damping)
        K3: Vector = self.bias_rate_radps * self.K4
        return -rise * self.cutoff_radps / omega0, rise * omega0, self.cutoff_radps, K3, self.K4


OBSERVER_SUBSTEPS = 2
"""Runge-Kutta steps per sample: at 0.3 s they leave less than 0.01 mm and 0.01 mm/s."""

# Rows of the (8, 3) table of constants, one column per axis: gains, ω0², 2 λ ω0, 1/T_b.
_K11, _K12, _K2, _K3, _K4, _STIFF, _DAMP, _LEAK = range(8)


@njit(cache=True)
def _write_observer_derivative(x, y, tau, Minv, MinvD, rows, out):  # type: ignore[no-untyped-def] # compiled by numba
    """Write the derivative of the observer state (15,) at a measured pose y (3,) to `out`."""
    c, s = np.cos(y[2]), np.sin(y[2])
    e = (y[0] - x[ETA] - x[XI2], y[1] - x[ETA + 1] - x[XI2 + 1], y[2] - x[ETA + 2] - x[XI2 + 2])
    north, east = x[BIAS] + rows[_K4, 0] * e[0], x[BIAS + 1] + rows[_K4, 1] * e[1]
    force = (
        tau[0] + c * north + s * east,
        tau[1] + c * east - s * north,
        tau[2] + x[BIAS + 2] + rows[_K4, 2] * e[2],
    )
    velocity = (c * x[NU] - s * x[NU + 1], s * x[NU] + c * x[NU + 1], x[NU + 2])
    for i in range(AXES):
        acceleration = 0.0
        for j in range(AXES):
            acceleration += Minv[i, j] * force[j] - MinvD[i, j] * x[NU + j]
        out[ETA + i] = velocity[i] + rows[_K2, i] * e[i]
        out[BIAS + i] = rows[_K3, i] * e[i] - rows[_LEAK, i] * x[BIAS + i]
        out[NU + i] = acceleration
        out[XI1 + i] = x[XI2 + i] + rows[_K11, i] * e[i]
        out[XI2 + i] = (
            rows[_K12, i] * e[i] - rows[_STIFF, i] * x[XI1 + i] - rows[_DAMP, i] * x[XI2 + i]
        )


@njit(cache=True)
def _advance_observer_by_one_sample(  # type: ignore[no-untyped-def] # compiled by numba
    x, before, measured, tau, Minv, MinvD, rows, J, h, substeps, estimate, change
):
    """Advance the observer state x (15,) by one sample of Runge-Kutta sub-steps."""
    pose, work, y = len(measured) - AXES, np.empty((5, WITH_WAVES)), np.empty(AXES)
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    rise = (
        measured[pose] - before[0],
        measured[pose + 1] - before[1],
        shift_heading_near(measured[pose + 2], before[2]) - before[2],
    )
    for step in range(substeps):
        for j in range(AXES):
            y[j] = before[j] + rise[j] * step / substeps
        _write_observer_derivative(x, y, tau, Minv, MinvD, rows, k1)
        for j in range(AXES):
            y[j] = before[j] + rise[j] * (step + 0.5) / substeps
        for j in range(WITH_WAVES):
            mid[j] = x[j] + 0.5 * h * k1[j]
        _write_observer_derivative(mid, y, tau, Minv, MinvD, rows, k2)
        for j in range(WITH_WAVES):
            mid[j] = x[j] + 0.5 * h * k2[j]
        _write_observer_derivative(mid, y, tau, Minv, MinvD, rows, k3)
        for j in range(AXES):
            y[j] = before[j] + rise[j] * (step + 1) / substeps
        for j in range(WITH_WAVES):
            mid[j] = x[j] + h * k3[j]
        _write_observer_derivative(mid, y, tau, Minv, MinvD, rows, k4)
        for j in range(WITH_WAVES):
            x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    for j in range(AXES):
        before[j] += rise[j]
        estimate[j], estimate[AXES + j] = x[NU + j], x[ETA + j]
    if substeps > 0:
        write_model_change_of_sample(J, estimate, tau, x[BIAS:NU], change)


class PassiveObserver(ModelObserver):
    """Nonlinear passive observer of Fossen and Strand, integrated by Runge-Kutta steps."""

    def __init__(
        self,
        ship: Vessel,
        tuning: PassiveTuning,
        sample_s: float,
        substeps: int = OBSERVER_SUBSTEPS,
    ) -> None:
        super().__init__(ship, sample_s, WITH_WAVES)
        waves = tuning.waves
        omega0 = waves.natural_frequencies_radps
        rows: Matrix = np.array(
            [*tuning.gain_vectors, omega0**2, 2 * waves.damping * omega0, 1 / tuning.bias_time_s]
        )
        Minv, MinvD = np.linalg.inv(ship.M), np.linalg.solve(ship.M, ship.D)
        inertia = np.ascontiguousarray(Minv), np.ascontiguousarray(MinvD)
        self._matrices = *inertia, rows, self._J
        self._h, self._substeps = sample_s / substeps, substeps
        self._pose = np.zeros(AXES)

    def start_from_state(self, state: Vector) -> None:
        """Set the observer to the state (6,) at the start of a run, without bias or wave motion."""
        super().start_from_state(state)
        self._pose[...] = state[POSE]

    def update_and_return_state(self, measured: Vector, tau: Vector) -> Vector:
        """Advance the observer by one sample and return the estimated state (6,)."""
        substeps = self._substeps if self._advance else 0
        inputs, out = (self._pose, measured, tau), (self._estimate, self.change)
        _advance_observer_by_one_sample(self._x, *inputs, *self._matrices, self._h, substeps, *out)
        self._advance = True
        return self._estimate
