"""The ship itself: nonlinear 3-DOF motion integrated with fixed-step Runge-Kutta 4.

    η̇ = R(ψ) ν,      M ν̇ + D ν = τ + R(ψ)ᵀ b(t)        (paper eq. 3-4, b in the NED frame)

In wind, current or wave drift the damping acts on the velocity through the water, D (ν − ν_c), and
the loads of `wind` and `waves` join the force. A vessel with drag meets that of `drag` in place of
D (ν − ν_c). State (6,) = [u, v, r, n, e, ψ] in m/s, m/s, rad/s,
m, m, rad; ψ is never wrapped here. The force τ is held over the sample; the weather is read at the
stage times from a table (`Environment.build_weather_table_at_stages`).

    k1 = f(t, s),   k2 = f(t + h/2, s + h/2 k1),   k3 = f(t + h/2, s + h/2 k2),
    k4 = f(t + h, s + h k3),   s ← s + h/6 (k1 + 2 k2 + 2 k3 + k4)

State s and the rows b of a stage table are laid out as `layout` says:

    row of b       0      1      2      3      4      …   2·substeps
    time           t             t+h           t+2h             h the sub-step
    sub-step 0     k1   k2 k3    k4
    sub-step 1                   k1   k2 k3    k4

There are three kernels, because a branch in the derivative keeps it from being inlined and triples
the cost of the ship that has no wind, current or drift.

What is measured: [ν; η] + [R(ψ)ᵀ η̇_w; η_w] + [0; noise], η_w the motion of the waves.
"""

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
from dpbench.ship.actuators import Actuators, CommandedThrusters
from dpbench.ship.drag_kernel import write_drag_force
from dpbench.ship.environment import Environment
from dpbench.ship.layout import (
    AIR_EAST,
    AIR_NORTH,
    AXES,
    COEFFICIENTS,
    DRIFT_R,
    DRIFT_U,
    DRIFT_V,
    EAST,
    FORCE_EAST,
    FORCE_NORTH,
    FORCE_YAW,
    HEADING,
    LOADED,
    NORTH,
    PLAIN,
    RATE_EAST,
    RATE_HEADING,
    RATE_NORTH,
    STATE,
    WATER_EAST,
    WATER_NORTH,
    WAVE_EAST,
    WAVE_NORTH,
    WIND_R,
    WIND_U,
    WIND_V,
    R,
    U,
    V,
)
from dpbench.ship.vessel import Vessel

STAGES = 4
"""Slopes of a Runge-Kutta step; `work` (STAGES + 1, 6) holds them and the state in between."""
SUBSTEPS = 10
"""Runge-Kutta sub-steps per sample: at 0.3 s one sample is exact to 1e-10 m for every vessel."""


@njit(cache=True, error_model="numpy", fastmath=False)
def _write_runge_kutta_midpoint(s, k, h, mid):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the intermediate state s + h k (6,) of a Runge-Kutta step to mid."""
    for j in range(STATE):
        mid[j] = s[j] + h * k[j]


@njit(cache=True, error_model="numpy", fastmath=False)
def _advance_by_mean_slope_in_place(s, k, h):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Advance s (6,) in place by the weighted mean of four Runge-Kutta slopes k."""
    for j in range(STATE):
        s[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])


@njit(cache=True, error_model="numpy", fastmath=False)
def _write_state_derivative(s, c, sn, f0, f1, f2, u, v, Minv, MinvD, out):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the state derivative (6,) for a body force and a velocity through the water to out."""
    for i in range(AXES):
        acceleration = Minv[i, 0] * f0 + Minv[i, 1] * f1 + Minv[i, 2] * f2
        acceleration -= MinvD[i, 0] * u
        acceleration -= MinvD[i, 1] * v
        acceleration -= MinvD[i, 2] * s[R]
        out[i] = acceleration
    out[NORTH] = c * s[U] - sn * s[V]
    out[EAST] = sn * s[U] + c * s[V]
    out[HEADING] = s[R]


@njit(cache=True, error_model="numpy", fastmath=False)
def _write_derivative_in_calm(s, tau, b, Minv, MinvD, out):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the state derivative (6,) under thrust tau and slow forces b alone to out."""
    c, sn = np.cos(s[HEADING]), np.sin(s[HEADING])
    f0 = tau[0] + c * b[FORCE_NORTH] + sn * b[FORCE_EAST]
    f1 = tau[1] - sn * b[FORCE_NORTH] + c * b[FORCE_EAST]
    f2 = tau[2] + b[FORCE_YAW]
    _write_state_derivative(s, c, sn, f0, f1, f2, s[U], s[V], Minv, MinvD, out)


@njit(cache=True, error_model="numpy", fastmath=False)
def _write_derivative_in_weather(s, tau, b, Minv, MinvD, loads, out):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the state derivative (6,) under thrust, wind, current and wave drift to out."""
    c, sn = np.cos(s[HEADING]), np.sin(s[HEADING])
    air_u = c * b[AIR_NORTH] + sn * b[AIR_EAST] - s[U]
    air_v = c * b[AIR_EAST] - sn * b[AIR_NORTH] - s[V]
    water_u = c * b[WATER_NORTH] + sn * b[WATER_EAST]
    water_v = c * b[WATER_EAST] - sn * b[WATER_NORTH]
    wave_u = c * b[WAVE_NORTH] + sn * b[WAVE_EAST]
    wave_v = c * b[WAVE_EAST] - sn * b[WAVE_NORTH]
    air = np.sqrt(air_u * air_u + air_v * air_v)
    wave = np.sqrt(wave_u * wave_u + wave_v * wave_v)
    f0 = tau[0] + c * b[FORCE_NORTH] + sn * b[FORCE_EAST]
    f0 = f0 + loads[WIND_U] * air * air_u + loads[DRIFT_U] * wave * wave_u
    f1 = tau[1] - sn * b[FORCE_NORTH] + c * b[FORCE_EAST]
    f1 = f1 + loads[WIND_V] * air * air_v + loads[DRIFT_V] * wave * wave_v
    turning = loads[WIND_R] * air_u * air_v + loads[DRIFT_R] * wave_u * wave_v
    f2 = tau[2] + b[FORCE_YAW] - 2.0 * turning
    _write_state_derivative(s, c, sn, f0, f1, f2, s[U] - water_u, s[V] - water_v, Minv, MinvD, out)


@njit(cache=True, error_model="numpy", fastmath=False)
def _write_derivative_with_drag(s, tau, b, Minv, undamped, loads, D, hull, out):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write the state derivative (6,) in all weather to out, with drag in place of damping."""
    c, sn = np.cos(s[HEADING]), np.sin(s[HEADING])
    u = s[U] - (c * b[WATER_NORTH] + sn * b[WATER_EAST])
    v = s[V] - (c * b[WATER_EAST] - sn * b[WATER_NORTH])
    # The last entries of out are free until the weather writes them.
    force = out[NORTH:]
    write_drag_force(u, v, s[R], D, hull, force)
    f0, f1, f2 = force[U], force[V], force[R]
    _write_derivative_in_weather(s, tau, b, Minv, undamped, loads, out)
    for i in range(AXES):
        out[i] -= Minv[i, 0] * f0 + Minv[i, 1] * f1 + Minv[i, 2] * f2


@njit(cache=True, error_model="numpy", fastmath=False)
def advance_state_in_calm(s, tau, b, Minv, MinvD, h, work):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Advance the ship state s (6,) in place by one sample under thrust and slow forces b."""
    if b.shape[1] != PLAIN:
        raise ValueError("a stage table of 3 columns is for weather that ignores the ship")
    mid = work[STAGES]
    for i in range(b.shape[0] // 2):
        _write_derivative_in_calm(s, tau, b[2 * i], Minv, MinvD, work[0])
        _write_runge_kutta_midpoint(s, work[0], 0.5 * h, mid)
        _write_derivative_in_calm(mid, tau, b[2 * i + 1], Minv, MinvD, work[1])
        _write_runge_kutta_midpoint(s, work[1], 0.5 * h, mid)
        _write_derivative_in_calm(mid, tau, b[2 * i + 1], Minv, MinvD, work[2])
        _write_runge_kutta_midpoint(s, work[2], h, mid)
        _write_derivative_in_calm(mid, tau, b[2 * i + 2], Minv, MinvD, work[3])
        _advance_by_mean_slope_in_place(s, work, h)


@njit(cache=True, error_model="numpy", fastmath=False)
def advance_state_in_weather(s, tau, b, Minv, MinvD, loads, h, work):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Advance the ship state s (6,) in place by one sample under thrust, wind, current, waves."""
    if b.shape[1] != LOADED:
        raise ValueError("a stage table of 9 columns is for weather that moves with the ship")
    mid = work[STAGES]
    for i in range(b.shape[0] // 2):
        _write_derivative_in_weather(s, tau, b[2 * i], Minv, MinvD, loads, work[0])
        _write_runge_kutta_midpoint(s, work[0], 0.5 * h, mid)
        _write_derivative_in_weather(mid, tau, b[2 * i + 1], Minv, MinvD, loads, work[1])
        _write_runge_kutta_midpoint(s, work[1], 0.5 * h, mid)
        _write_derivative_in_weather(mid, tau, b[2 * i + 1], Minv, MinvD, loads, work[2])
        _write_runge_kutta_midpoint(s, work[2], h, mid)
        _write_derivative_in_weather(mid, tau, b[2 * i + 2], Minv, MinvD, loads, work[3])
        _advance_by_mean_slope_in_place(s, work, h)


@njit(cache=True, error_model="numpy", fastmath=False)
def advance_state_with_drag(s, tau, b, Minv, undamped, loads, D, hull, h, work):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Advance the ship state s (6,) in place by one sample in all weather, with nonlinear drag."""
    if b.shape[1] != LOADED:
        raise ValueError("a stage table of 9 columns is for a ship with drag")
    mid = work[STAGES]
    for i in range(b.shape[0] // 2):
        _write_derivative_with_drag(s, tau, b[2 * i], Minv, undamped, loads, D, hull, work[0])
        _write_runge_kutta_midpoint(s, work[0], 0.5 * h, mid)
        _write_derivative_with_drag(mid, tau, b[2 * i + 1], Minv, undamped, loads, D, hull, work[1])
        _write_runge_kutta_midpoint(s, work[1], 0.5 * h, mid)
        _write_derivative_with_drag(mid, tau, b[2 * i + 1], Minv, undamped, loads, D, hull, work[2])
        _write_runge_kutta_midpoint(s, work[2], h, mid)
        _write_derivative_with_drag(mid, tau, b[2 * i + 2], Minv, undamped, loads, D, hull, work[3])
        _advance_by_mean_slope_in_place(s, work, h)


class ShipPlant:
    """Simulated true ship, a nonlinear 3-DOF model advanced by one sample at a time.

    state : (6,) initial [u, v, r, n, e, ψ], copied.
    substeps : Runge-Kutta steps per sample.
    loads : (6,) or None, from `Environment.wind_and_drift_coefficients`.
    actuators : losses and delays, or thrusters, between the command and the hull.
    """

    def __init__(
        self,
        vessel: Vessel,
        state: Vector,
        sample_s: float,
        substeps: int = SUBSTEPS,
        *,
        loads: Vector | None = None,
        actuators: Actuators | CommandedThrusters | None = None,
    ) -> None:
        self.state: Vector = np.array(state, dtype=np.float64)
        self._Minv: Matrix = np.ascontiguousarray(np.linalg.inv(vessel.M))
        self._MinvD: Matrix = np.ascontiguousarray(np.linalg.solve(vessel.M, vessel.D))
        self._D, self._hull = np.ascontiguousarray(vessel.D), None
        if vessel.drag is not None:
            self._hull, self._MinvD = vessel.drag.to_kernel_array(), np.zeros_like(vessel.D)
            self._D = np.ascontiguousarray(vessel.drag.limit_linear_damping(vessel.D))
            loads = np.zeros(COEFFICIENTS) if loads is None else loads
        self._loads = None if loads is None else np.array(loads, dtype=np.float64)
        self._thrust = None if actuators is None else actuators.make_state_at_rest()
        self._h = sample_s / substeps
        self._work = np.empty((STAGES + 1, STATE))

    def advance_by_one_sample(self, tau: Vector, stages: Matrix) -> None:
        """Advance the stored ship state by one sample under a force (3,) or thruster forces (n_f,).

        Raises ValueError unless the weather has 9 columns where the plant has loads or drag, and 3
        elsewhere.
        """
        if self._thrust is not None:
            tau = self._thrust.force_on_hull_for_command(tau)
        s, Minv, MinvD, h, work = self.state, self._Minv, self._MinvD, self._h, self._work
        loads, hull = self._loads, self._hull
        if loads is None:
            advance_state_in_calm(s, tau, stages, Minv, MinvD, h, work)
        elif hull is None:
            advance_state_in_weather(s, tau, stages, Minv, MinvD, loads, h, work)
        else:
            advance_state_with_drag(s, tau, stages, Minv, MinvD, loads, self._D, hull, h, work)


@njit(cache=True)
def _write_measured_state(state, motion, noise, measured):  # type: ignore[no-untyped-def] # compiled: numba finds the types
    """Write to `measured` the state (6,) plus wave motion (6,) and noise (3,)."""
    c, s = np.cos(state[HEADING]), np.sin(state[HEADING])
    measured[U] = state[U] + c * motion[RATE_NORTH] + s * motion[RATE_EAST]
    measured[V] = state[V] - s * motion[RATE_NORTH] + c * motion[RATE_EAST]
    measured[R] = state[R] + motion[RATE_HEADING]
    for i in range(AXES):
        measured[AXES + i] = state[AXES + i] + motion[i] + noise[i]


class Sensors:
    """Sensors of one run, which add wave-frequency motion and noise to the true state."""

    def __init__(self, environment: Environment, samples: int, sample_s: float) -> None:
        self._ideal = environment.motion is None and environment.noise is None
        self._motion = environment.wave_frequency_motion_at_samples(samples, sample_s)
        self._noise = environment.draw_measurement_noise(samples)
        self._measured = np.empty(STATE)

    def measure_state(self, state: Vector, k: int) -> Vector:
        """Return the measured state [u, v, r, n, e, ψ] of sample k, in an array that is reused."""
        if self._ideal:
            return state
        _write_measured_state(state, self._motion[k], self._noise[k], self._measured)
        return self._measured
