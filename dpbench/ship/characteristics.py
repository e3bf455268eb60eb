"""Time constants, speeds, drift and mean force in weather of the linear model of a ship.

M ν̇ + D ν = τ + w, order surge, sway, yaw. Speeds are those at which damping balances the force:
the linear one, meant for some cm/s, or the drag of a vessel that has it.
"""

from collections.abc import Callable
from functools import partial
from itertools import permutations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.environment import Environment
from dpbench.ship.layout import DRIFT_U, WIND_U
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import GRAVITY

SWAY = 1
SLOW_FROUDE_NUMBER = 0.2  # Beyond it waves of the hull's own making take over from linear damping


def compute_axis_time_constants_s(vessel: Vessel) -> Vector:
    """Return the time constants (3,) [s] by participation factors (Kundur 1994, chapter 12)."""
    rates, right = np.linalg.eig(np.linalg.solve(vessel.M, vessel.D))
    participation = np.abs(right * np.linalg.inv(right).T)
    axes = range(len(rates))
    modes = max(permutations(axes), key=lambda modes: participation[axes, modes].sum())
    constants: Vector = 1.0 / rates.real[list(modes)]
    return constants


def compute_speeds_at_force_limits(vessel: Vessel) -> Matrix:
    """Return the steady speeds (2, 3) [m/s, m/s, rad/s] under the least and the largest force."""
    axes = np.eye(len(vessel.D))

    def speed(axis: int, force: float) -> float:
        if force == 0.0:
            return 0.0
        along = np.sign(force) * axes[axis]
        excess = partial(
            _compute_force_share_minus_one,
            vessel,
            along,
            np.where(axes[axis] > 0.0, abs(force), np.inf),
        )
        return float(np.sign(force)) * _find_root_of_growing_function(excess)

    limits = (vessel.tau_min, vessel.tau_max)
    return np.array([[speed(i, force) for i, force in enumerate(limit)] for limit in limits])


def compute_linear_damping_speeds(vessel: Vessel) -> Vector:
    """Return the largest speeds (3,) of linear damping: Fr √(gL), of bow and stern in a turn."""
    speed_mps = SLOW_FROUDE_NUMBER * np.sqrt(GRAVITY * vessel.length_m)
    return np.array([speed_mps, speed_mps, speed_mps / (0.5 * vessel.length_m)])


def find_largest_current_abeam_mps(
    vessel: Vessel, find_share: Callable[[Vector], float] | None = None
) -> float:
    """Return the largest current abeam [m/s] that the ship can hold against.

    find_share : the share of full thrust that a force (3,) takes; by default only the limits of
        each axis by itself count.
    """
    reach, along = np.minimum(-vessel.tau_min, vessel.tau_max), np.eye(len(vessel.D))[SWAY]

    def excess(speed: float) -> float:
        beyond = _compute_force_share_minus_one(vessel, along, reach, speed)
        if find_share is None or beyond >= 0.0 or speed == 0.0:
            return beyond
        force = vessel.force_to_keep_velocity(speed * along)
        return max(beyond, find_share(force) - 1.0, find_share(-force) - 1.0)

    return _find_root_of_growing_function(excess)


def _compute_force_share_minus_one(
    vessel: Vessel, along: Vector, reach: Vector, speed: float
) -> float:
    """Return the largest share over the axes of a reach (3,) that a speed takes, less 1."""
    return float(np.max(np.abs(vessel.force_to_keep_velocity(speed * along)) / reach)) - 1.0


def _find_root_of_growing_function(excess: Callable[[float], float]) -> float:
    """Return the positive argument at which a function that grows from −1 is zero."""
    # `dpbench list vessels` needs no root, and starts in half the time without SciPy's optimisers.
    from scipy.optimize import brentq

    high = 1e-3
    while excess(high) < 0.0:
        high *= 2.0
    return float(brentq(excess, 0.0, high, xtol=1e-300, rtol=1e-14))


def has_mirror_symmetry(vessel: Vessel) -> bool:
    """Return whether surge is uncoupled, and the limits of sway and yaw are symmetric."""
    across = np.concatenate([vessel.M[0, 1:], vessel.M[1:, 0], vessel.D[0, 1:], vessel.D[1:, 0]])
    return not across.any() and np.array_equal(vessel.tau_min[1:], -vessel.tau_max[1:])


def compute_mean_weather_force(
    vessel: Vessel, weather: Environment, heading_rad: float = 0.0
) -> Vector:
    """Return the mean force (3,) [N, N, N·m] of weather without squalls on the ship at rest.

    The squared envelope of the drift has the mean Hs²/8.
    Raises InputError where the weather has wind or drift and the vessel no hull data for it.
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    load = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ weather.mean
    hull = weather.wind_and_drift_coefficients(vessel)
    if hull is None:
        return load
    if weather.wind is not None:
        towards = weather.wind.to_rad - heading_rad
        load = load + weather.wind.speed_mps**2 * hull[
            WIND_U:DRIFT_U
        ] * _compute_unit_flow_force_factors(towards)
    if weather.drift is not None:
        sea = weather.drift.sea
        load = load + sea.hs_m**2 / 8.0 * hull[DRIFT_U:] * _compute_unit_flow_force_factors(
            sea.to_rad - heading_rad
        )
    if weather.current is not None:
        towards = weather.current.to_rad - heading_rad
        flow = np.array([np.cos(towards), np.sin(towards), 0.0])
        load = load - vessel.force_to_keep_velocity(-weather.current.speed_mps * flow)
    return load


def _compute_unit_flow_force_factors(towards_rad: float) -> Vector:
    """Return the force factors (3,) of a unit flow in a direction: |V| u, |V| v and −2 u v."""
    u, v = np.cos(towards_rad), np.sin(towards_rad)
    return np.array([u, v, -2.0 * u * v])
