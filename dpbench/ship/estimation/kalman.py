"""Kalman filter of a ship in dynamic positioning, with bias and wave-frequency states.

    x⁻ = Φ x + Γ τ,     ε = Tᵀ y − C x⁻,     x = x⁻ + K ε         (the model below)

T(ψ) turns vessel-parallel axes into north-east ones, ψ being the *measured* heading. The gain is
computed once, in vessel-parallel axes, where the model does not depend on the heading; η, b, ξ1, ξ2
of the state x (layout: `observer`) are kept in north-east axes, so that a turn of the ship moves
none of them; ν is along the ship in both. The turn within one sample and the wave part of the
measured heading, both a degree or so, are left out.

The stochastic model behind it: in vessel-parallel axes (positions and forces turned by the measured
heading), states [η, b, ν, ξ1, ξ2] of three each, w white with unit intensity, v white with the
sensors' variance:

    η̇ = ν,   ḃ = −b/T_b + E_b w,   M ν̇ = τ + b − D ν + E_ν w,   ξ as in `WaveModel`
    y_k = η + ξ2 + v_k                                      (Fossen 2021, ch. 13.4)

Discrete: Φ = e^{Ah}, Γ = ∫ e^{As} B ds, Q = ∫ e^{As} E Eᵀ e^{Aᵀs} ds over a sample (Van Loan 1978),
P = Φ (P − P Cᵀ S⁻¹ C P) Φᵀ + Q,   S = C P Cᵀ + R,   K = P Cᵀ S⁻¹.

The matrices in blocks of three (0 left out; without the wave filter the last two rows and columns
of blocks are not there), the order of x that of `observer`:

    A       η    b       ν       ξ1     ξ2          B         E   on bias  on speed  on waves
    η                    I                          η         η
    b          −I/T_b                               b         b   E_b
    ν           M⁻¹     −M⁻¹D                       ν  M⁻¹    ν            M⁻¹E_f
    ξ1                                  I           ξ1        ξ1
    ξ2                          −ω0²   −2λω0        ξ2        ξ2                     K_w
    C       I                           I

Two examples to follow by hand. A trolley of mass 1 on rails, ṗ = v, v̇ = u + w: over h = 2 s a held
force of 1 moves it by h²/2 = 2 and makes it faster by h = 2, and white noise leaves the variances
h³/3 = 8/3 of p, h = 2 of v and h²/2 = 2 between them.

>>> A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
>>> Phi, Gamma, Q = discretise_model_and_noise(A, B, B, 2.0)
>>> bool(np.allclose(Phi, [[1, 2], [0, 1]]) and np.allclose(Gamma, [[2], [2]]))
True
>>> bool(np.allclose(Q, [[8 / 3, 2], [2, 2]]))
True

Three positions that walk at random, x⁺ = x + w and y = x + v with unit variances, each on its own:
p = p − p²/(p + 1) + 1, that is p² = p + 1, so p = (1 + √5)/2 = 1.618, s = p + 1 = 2.618 and
k = p/s = 1/p = 0.618, the share of the innovation that enters the estimate.

>>> one = np.eye(3)
>>> P, S, K = _solve_for_covariances_and_gain(one, one, one, "random walk")
>>> golden = (1 + math.sqrt(5)) / 2
>>> [bool(np.allclose(X, x * one)) for X, x in ((P, golden), (S, golden + 1), (K, 1 / golden))]
[True, True, True]
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.kernel_cache import njit
from dpbench.ship.estimation.estimator import shift_heading_near
from dpbench.ship.estimation.observer import (
    BIAS,
    ETA,
    NU,
    WITH_WAVES,
    WITHOUT_WAVES,
    XI1,
    XI2,
    ModelObserver,
    WaveModel,
    write_model_change_of_sample,
)
from dpbench.ship.layout import AXES
from dpbench.ship.vessel import Vessel

NOISES = range(0, 3 * AXES, AXES)
"""First entry of w that drives the bias, the speed and, with the wave filter, the waves."""
SENSOR_STD = np.array([0.1, 0.1, np.radians(0.1)])
"""White noise of satellite position and gyrocompass [m, m, rad], per sample."""
FORCE_SHARE = 0.005
"""Root intensity of the unmodelled white force, as a share of the thrust τ_max·√T_p."""
BIAS_SHARE = 0.02
"""Growth of the bias over one period T_p of the waves, as a share of the thrust τ_max.

Small enough that in waves of 2 m the thrusters of `supply_fs99` meet their rate limit in a few per
cent of the steps only; the bias then follows weather that changes within minutes, not faster."""
RESIDUAL_MAX = 1e-6  # Largest relative residual of the Riccati equation that a solution may leave
RADIUS_MAX = 1.0 - 1e-9
"""Largest spectral radius of a filter; at 0.3 s it forgets its start in ten years."""


@dataclass(frozen=True, eq=False)
class KalmanTuning:
    """Noise levels that the Kalman filter assumes for sensors, bias and waves.

    measurement_std : (3,) standard deviation of the white sensor noise [m, m, rad].
    force_noise : (3,) root intensity of the white force on the ship [N√s, N√s, N·m√s].
    bias_noise : (3,) root intensity of the bias' random walk [N/√s, N/√s, N·m/√s].
    waves : model of the wave motion; None switches the wave filter off.
    bias_time_s : time constant of the bias (first-order Markov) [s]; inf for a random walk.
    """

    measurement_std: Vector
    force_noise: Vector
    bias_noise: Vector
    waves: WaveModel | None
    bias_time_s: float = math.inf
    where: str = "KalmanTuning"

    @classmethod
    def choose_for_ship(
        cls,
        ship: Vessel,
        waves: WaveModel,
        measurement_std: Vector = SENSOR_STD,
        *,
        wave_filter: bool = True,
        where: str = "KalmanTuning",
    ) -> "KalmanTuning":
        """Return noise by force limits and wave period; waves that are not filtered are noise."""
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
    """Discrete model of ship, bias and waves, with its steady-state Kalman gain.

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


def build_kalman_model(ship: Vessel, tuning: KalmanTuning, sample_s: float) -> KalmanModel:
    """Return the ship's model discretised for a Kalman filter, with gain by the Riccati equation.

    The algebra runs in units of the problem (σ of the sensor, the time of the filter, the force
    that moves one by the other); in SI the same call returns five digits of the gain.

    Raises InputError when the noise leaves no steady state that rounding can tell.
    """
    A, B, E, C = _build_continuous_model_matrices(ship, tuning)
    unit = _choose_state_units(ship, tuning, len(A))
    sigma = tuning.measurement_std
    Phi, Gamma, Q = discretise_model_and_noise(
        A * unit / unit[:, None], B / unit[:, None], E / unit[:, None], sample_s
    )
    Cs = C * unit / sigma[:, None]
    P, S, K = _solve_for_covariances_and_gain(Phi, Cs, Q, tuning.where)
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


def discretise_model_and_noise(
    A: Matrix, B: Matrix, E: Matrix, h: float
) -> tuple[Matrix, Matrix, Matrix]:
    """Return Φ, Γ and noise covariance Q of ẋ = A x + B u + E w, discretised exactly.

    w : white noise of intensity 1. Source: Van Loan, IEEE TAC 23.
    """
    n, m = B.shape
    held = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
    noise = expm(np.block([[-A, E @ E.T], [np.zeros((n, n)), A.T]]) * h)
    Phi, Gamma = held[:n, :n], held[:n, n:]
    Q = Phi @ noise[:n, n:]
    return Phi, Gamma, 0.5 * (Q + Q.T)


def _solve_for_covariances_and_gain(
    Phi: Matrix, C: Matrix, Q: Matrix, where: str
) -> tuple[Matrix, Matrix, Matrix]:
    """Return state covariance P, innovation covariance S and gain K of the Riccati equation."""
    n, one = len(Phi), np.eye(AXES)
    allowed = "measurement_std, force_noise and bias_noise of comparable effect"
    try:
        # Our own units balance it; LAPACK's balancing overflows where the noises differ too much.
        P = np.asarray(solve_discrete_are(Phi.T, C.T, Q, one, balanced=False), np.float64)
    except (LinAlgError, ValueError) as error:
        raise InputError(where, "", f"no steady state ({error})", allowed) from error
    S = C @ P @ C.T + one
    K = np.asarray(np.linalg.solve(S, C @ P).T, np.float64)
    spread = np.sqrt(np.abs(np.diag(P)))
    rest = (Phi @ (P - K @ S @ K.T) @ Phi.T + Q - P) / np.outer(spread, spread)
    residual = float(np.abs(rest).max())
    radius = float(np.abs(np.linalg.eigvals((np.eye(n) - K @ C) @ Phi)).max())
    if not (residual < RESIDUAL_MAX and radius < RADIUS_MAX):
        measured = f"Riccati residual {residual:.1e}, spectral radius {radius:.12f}"
        raise InputError(where, "", f"no steady state ({measured})", allowed)
    return P, S, K


def _build_continuous_model_matrices(
    ship: Vessel, tuning: KalmanTuning
) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return matrices A, B, C, E of the filter's linear model in continuous time."""
    n = WITHOUT_WAVES if tuning.waves is None else WITH_WAVES
    Minv = np.linalg.inv(ship.M)
    A, B, C = np.zeros((n, n)), np.zeros((n, AXES)), np.zeros((AXES, n))
    # A column a state less the pose; those of ξ1, which nothing drives, stay zero at the end.
    E = np.zeros((n, n - AXES))
    eta, b, nu, xi1, xi2 = (slice(first, first + AXES) for first in (ETA, BIAS, NU, XI1, XI2))
    on_bias, on_speed, on_waves = (slice(first, first + AXES) for first in NOISES)
    one = np.eye(AXES)
    A[eta, nu] = C[:, eta] = one
    A[b, b] = -one / tuning.bias_time_s
    A[nu, b] = B[nu] = Minv
    A[nu, nu] = -Minv @ ship.D
    E[b, on_bias], E[nu, on_speed] = np.diag(tuning.bias_noise), Minv * tuning.force_noise
    if tuning.waves is not None:
        omega0 = tuning.waves.natural_frequencies_radps
        A[xi1, xi2] = C[:, xi2] = one
        A[xi2, xi1] = -np.diag(omega0**2)
        A[xi2, xi2] = -np.diag(2 * tuning.waves.damping * omega0)
        E[xi2, on_waves] = np.diag(tuning.waves.K_w)
    return A, B, E, C


def _choose_state_units(ship: Vessel, tuning: KalmanTuning, n: int) -> Vector:
    """Return a unit (n,) for each state, so that the Riccati equation is well scaled.

    Lengths are in σ of the sensor; times in 1/ω0 with a wave filter, else in the time in which the
    bias alone moves the ship by σ: bias noise · t^2.5 = M σ.
    """
    sigma, mass = tuning.measurement_std, np.diag(ship.M)
    if tuning.waves is None:
        time = (mass * sigma / tuning.bias_noise) ** 0.4
    else:
        time = 1 / tuning.waves.natural_frequencies_radps
    unit = np.concatenate([sigma, mass * sigma / time**2, sigma / time, sigma * time, sigma])
    scaled: Vector = unit[:n]
    return scaled


@njit(cache=True)
def _rotate_state_in_place(x, c, s):  # type: ignore[no-untyped-def] # compiled by numba
    """Rotate the north-east parts of a state in place, by cosine c and sine s."""
    for first in (ETA, BIAS, XI1, XI2):
        if first < len(x):
            turned = c * x[first] - s * x[first + 1]
            x[first + 1] = s * x[first] + c * x[first + 1]
            x[first] = turned


@njit(cache=True)
def _advance_filter_by_one_sample(  # type: ignore[no-untyped-def] # compiled by numba
    x, measured, tau, Phi, Gamma, K, J, advance, epsilon, estimate, change
):
    """Advance filter state x in place by one sample; write innovation, estimate and change."""
    n, pose = len(x), len(measured) - AXES
    heading = shift_heading_near(measured[pose + 2], x[ETA + 2])
    c, s = np.cos(heading), np.sin(heading)
    _rotate_state_in_place(x, c, -s)
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
    _rotate_state_in_place(x, c, s)
    for j in range(AXES):
        estimate[j] = x[NU + j]
        estimate[AXES + j] = x[ETA + j]
    if advance:
        write_model_change_of_sample(J, estimate, tau, x[BIAS:NU], change)


class KalmanFilter(ModelObserver):
    """Steady-state Kalman filter of a ship with bias force and wave motion."""

    def __init__(self, ship: Vessel, tuning: KalmanTuning, sample_s: float) -> None:
        self.model: KalmanModel = build_kalman_model(ship, tuning, sample_s)
        super().__init__(ship, sample_s, len(self.model.Phi))
        self._matrices = self.model.Phi, self.model.Gamma, self.model.K, self._J
        self.innovation: Vector = np.zeros(AXES)
        """ε (3,) of the last update, in vessel-parallel axes [m, m, rad]; overwritten."""

    def update_and_return_state(self, measured: Vector, tau: Vector) -> Vector:
        """Advance the filter by one sample's force and measurement; return the state (6,)."""
        out = self.innovation, self._estimate, self.change
        _advance_filter_by_one_sample(self._x, measured, tau, *self._matrices, self._advance, *out)
        self._advance = True
        return self._estimate
