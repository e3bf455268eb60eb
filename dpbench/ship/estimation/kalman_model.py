"""The stochastic model behind the Kalman filter and its steady-state gain.

In vessel-parallel axes (positions and forces turned by the measured heading), states
[η, b, ν, ξ1, ξ2] of three each, w white with unit intensity, v white with the sensors' variance:

    η̇ = ν,   ḃ = −b/T_b + E_b w,   M ν̇ = τ + b − D ν + E_ν w,   ξ as in `wave_filter`
    y_k = η + ξ2 + v_k                                      (Fossen 2021, ch. 13.4)

Discrete: Φ = e^{Ah}, Γ = ∫ e^{As} B ds, Q = ∫ e^{As} E Eᵀ e^{Aᵀs} ds over a sample (Van Loan 1978),
P = Φ (P − P Cᵀ S⁻¹ C P) Φᵀ + Q,   S = C P Cᵀ + R,   K = P Cᵀ S⁻¹.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.ship.estimation.estimator import checked_sample, positive_vector
from dpbench.ship.estimation.wave_filter import WaveModel
from dpbench.ship.vessel import Vessel

SENSOR_STD = np.array([0.1, 0.1, np.radians(0.1)])
"""White noise of satellite position and gyrocompass [m, m, rad], per sample."""
FORCE_SHARE = 0.005
"""Root intensity of the unmodelled white force, as a share of the thrust τ_max·√T_p."""
BIAS_SHARE = 0.02
"""Growth of the bias over one period T_p of the waves, as a share of the thrust τ_max.

Small enough that in waves of 2 m the thrusters of `supply_fs99` meet their rate limit in a few per
cent of the steps only; the bias then follows weather that changes within minutes, not faster."""
RESIDUAL_MAX = 1e-6
"""Largest relative residual of the Riccati equation that a solution may leave."""
RADIUS_MAX = 1.0 - 1e-9
"""Largest spectral radius of a filter; at 0.3 s it forgets its start in ten years."""


@dataclass(frozen=True, eq=False)
class KalmanTuning:
    """What the filter assumes of the noise; axes surge, sway, yaw.

    Parameters
    ----------
    measurement_std : (3,) standard deviation of the white sensor noise [m, m, rad].
    force_noise : (3,) root intensity of the white force on the ship [N√s, N√s, N·m√s].
    bias_noise : (3,) root intensity of what drives the bias: a random walk grows by this in one
        second [N/√s, N/√s, N·m/√s].
    waves : model of the wave motion; None switches the wave filter off.
    bias_time_s : time constant of the bias (first-order Markov) [s]; inf for a random walk.
    where : the file named in errors.

    Raises
    ------
    ShapeError, InputError : naming the key, what was found and what is allowed.
    """

    measurement_std: Vector
    force_noise: Vector
    bias_noise: Vector
    waves: WaveModel | None
    bias_time_s: float = math.inf
    where: str = "KalmanTuning"

    def __post_init__(self) -> None:
        for name in ("measurement_std", "force_noise", "bias_noise"):
            array = positive_vector(self.where, name, getattr(self, name))
            object.__setattr__(self, name, array)
        if not self.bias_time_s > 0:
            raise InputError(self.where, "bias_time_s", self.bias_time_s, "a positive time or inf")

    @classmethod
    def of_ship(
        cls,
        ship: Vessel,
        waves: WaveModel,
        measurement_std: Vector = SENSOR_STD,
        *,
        wave_filter: bool = True,
        where: str = "KalmanTuning",
    ) -> KalmanTuning:
        """Noise in proportion to the ship's limits and to the period of the sea.

        Without the wave filter the motion of the waves counts as sensor noise.
        """
        period = waves.peak_period_s
        # Weather pushes no harder along the ship than across it, whatever its main propellers can.
        force = np.minimum(ship.tau_max, [ship.tau_max[1], np.inf, np.inf])
        if not wave_filter:
            measurement_std = np.hypot(measurement_std, waves.std)
        return cls(
            measurement_std,
            FORCE_SHARE * force * np.sqrt(period),
            BIAS_SHARE * force / np.sqrt(period),
            waves if wave_filter else None,
            where=where,
        )


@dataclass(frozen=True, eq=False)
class KalmanModel:
    """The discrete model in SI, n = 15 states (9 without wave filter), and its steady state.

    Phi (n, n), Gamma (n, 3), C (3, n), Q (n, n), R (3, 3); P (n, n) covariance of the predicted
    state, S (3, 3) of the innovation, K (n, 3) gain of the correction.
    """

    Phi: Matrix
    Gamma: Matrix
    C: Matrix
    Q: Matrix
    R: Matrix
    P: Matrix
    S: Matrix
    K: Matrix


def kalman_model(ship: Vessel, tuning: KalmanTuning, sample_s: float) -> KalmanModel:
    """Discretise exactly and solve the Riccati equation.

    The algebra runs in units of the problem (σ of the sensor, the time of the filter, the force
    that moves one by the other); in SI the same call returns five digits of the gain.

    Raises
    ------
    InputError : when the noise leaves no steady state that rounding can tell.
    """
    h = checked_sample(tuning.where, sample_s)
    A, B, E, C = _continuous(ship, tuning)
    unit = _units(ship, tuning, len(A))
    sigma = tuning.measurement_std
    Phi, Gamma, Q = discretise(A * unit / unit[:, None], B / unit[:, None], E / unit[:, None], h)
    Cs = C * unit / sigma[:, None]
    P, S, K = _steady_state(Phi, Cs, Q, tuning.where)
    outer = np.outer(unit, unit)
    return KalmanModel(
        Phi=np.ascontiguousarray(Phi * unit[:, None] / unit),
        Gamma=np.ascontiguousarray(Gamma * unit[:, None]),
        C=C,
        Q=Q * outer,
        R=np.diag(sigma**2),
        P=P * outer,
        S=S * np.outer(sigma, sigma),
        K=np.ascontiguousarray(K * unit[:, None] / sigma),
    )


def discretise(A: Matrix, B: Matrix, E: Matrix, h: float) -> tuple[Matrix, Matrix, Matrix]:
    """Φ, Γ and Q of ẋ = A x + B u + E w over h seconds, u held, w white with unit intensity.

    Van Loan, "Computing integrals involving the matrix exponential", IEEE TAC 23 (1978).
    """
    n, m = B.shape
    held = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
    noise = expm(np.block([[-A, E @ E.T], [np.zeros((n, n)), A.T]]) * h)
    Phi, Gamma = held[:n, :n], held[:n, n:]
    Q = Phi @ noise[:n, n:]
    return Phi, Gamma, 0.5 * (Q + Q.T)


def _steady_state(Phi: Matrix, C: Matrix, Q: Matrix, where: str) -> tuple[Matrix, Matrix, Matrix]:
    """P, S, K of the module's equations for R = I, verified; InputError where there is none."""
    n = len(Phi)
    allowed = "noises of comparable effect"
    try:
        # Our own units balance it; LAPACK's balancing overflows where the noises differ too much.
        P = np.asarray(solve_discrete_are(Phi.T, C.T, Q, np.eye(3), balanced=False), np.float64)
    except (LinAlgError, ValueError) as error:
        raise InputError(where, "", f"no steady state ({error})", allowed) from error
    S = C @ P @ C.T + np.eye(3)
    K = np.asarray(np.linalg.solve(S, C @ P).T, np.float64)
    spread = np.sqrt(np.abs(np.diag(P)))
    rest = (Phi @ (P - K @ S @ K.T) @ Phi.T + Q - P) / np.outer(spread, spread)
    residual = float(np.abs(rest).max())
    radius = float(np.abs(np.linalg.eigvals((np.eye(n) - K @ C) @ Phi)).max())
    if not (residual < RESIDUAL_MAX and radius < RADIUS_MAX):
        found = f"no steady state (Riccati residual {residual:.1e}, spectral radius {radius:.12f})"
        raise InputError(where, "", found, allowed)
    return P, S, K


def _continuous(ship: Vessel, tuning: KalmanTuning) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """A, B, E, C of the module's equations, in SI."""
    n = 9 if tuning.waves is None else 15
    Minv = np.linalg.inv(ship.M)
    A, B, E, C = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, n - 3)), np.zeros((3, n))
    eta, b, nu, xi1, xi2 = (slice(i, i + 3) for i in range(0, 15, 3))
    A[eta, nu] = C[:, eta] = np.eye(3)
    A[b, b] = -np.eye(3) / tuning.bias_time_s
    A[nu, b] = B[nu] = Minv
    A[nu, nu] = -Minv @ ship.D
    E[b, 0:3], E[nu, 3:6] = np.diag(tuning.bias_noise), Minv * tuning.force_noise
    if tuning.waves is not None:
        omega0 = tuning.waves.omega0_radps
        A[xi1, xi2] = C[:, xi2] = np.eye(3)
        A[xi2, xi1] = -np.diag(omega0**2)
        A[xi2, xi2] = -np.diag(2 * tuning.waves.damping * omega0)
        E[xi2, 6:9] = np.diag(tuning.waves.K_w)
    return A, B, E, C


def _units(ship: Vessel, tuning: KalmanTuning, n: int) -> Vector:
    """One unit (n,) per state: lengths in σ of the sensor, times in the filter's own.

    That time is 1/ω0 with a wave filter, else the time in which the bias alone moves the ship by
    σ: bias noise · t^2.5 = M σ.
    """
    sigma, mass = tuning.measurement_std, np.diag(ship.M)
    if tuning.waves is None:
        time = (mass * sigma / tuning.bias_noise) ** 0.4
    else:
        time = 1 / tuning.waves.omega0_radps
    unit = np.concatenate(
        [sigma, mass * sigma / time**2, sigma / time, sigma * time, sigma],
    )
    scaled: Vector = unit[:n]
    return scaled
