"""Observers with a model: wave model, layout of the state, start, bias; the passive observer.

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

The passive nonlinear observer is that of Fossen & Strand (1999, Automatica 35, pp. 3-16). With ỹ =
y − η̂ − ξ̂2 (measured less estimated pose), R = R(ψ measured), north-east axes:

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

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.ship.estimation.estimator import Estimator, shift_heading_near
from dpbench.ship.layout import AXES, EAST, HEADING, NORTH, POSE, STATE, VELOCITY
from dpbench.ship.vessel import Vessel

ETA, BIAS, NU, XI1, XI2 = range(0, 5 * AXES, AXES)
WITHOUT_WAVES, WITH_WAVES = XI1, XI2 + AXES
JONSWAP_DAMPING = 0.1
"""λ that fits a JONSWAP spectrum of γ = 3.3; 0.26 fits Pierson-Moskowitz (Fossen 2021)."""
CUTOFF_RATIO = 1.5
"""ω_c / ω0. The rules alone do not make the error loop passive: at the 1.1 / 0.8976 of Fossen's
example its phase reaches -95°, at 1.5 with the ratios below it stays above -90°."""
STIFFNESS_RATIO = 0.4  # √(K4 / M) / ω0: how fast a pose error moves the speed
BIAS_RATIO = 0.1  # (K3 / K4) / ω0: how fast it moves the bias
BIAS_TIME_RATIO = 1e4  # T_b · ω0: a constant bias is short by K4 / (K3 T_b), a thousandth of it


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
    def from_peak_period(cls, peak_period_s: float, std: Vector) -> "WaveModel":
        """Return the wave model of a peak period [s], with the same damping in every axis."""
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
    ) -> "PassiveTuning":
        """Return observer gains in proportion to the ship's inertia and the wave period."""
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
    """Advance the observer state x (15,) in place by one sample of Runge-Kutta sub-steps."""
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
