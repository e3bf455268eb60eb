"""Mean wind, current and wave drift on a hull by level 1 of DNV-ST-0111 (2021), 3.5 to 3.7.

    wind      X = −0.7 q A_F cos γ       q = ½ρ_a V²
              Y = −0.9 q A_L sin γ       N = Y (x_A + 0.3 (1 − 2γ'/π) L_pp)
    current   X = −0.07 q B T cos γ      q = ½ρ V_c²
              Y = −0.6 q A_c sin γ       N = Y (x_c + [0.4 (1 − 2γ'/π)]_{−0.2…0.25} L_pp)
    waves     X = 0.09 q B h1 h2 f(T')   q = ½ρ g Hs²,  T' = Tz/(0.9 L_pp^0.33)
              Y = −0.09 q L_os sin γ f(T'),  T' = Tz/(0.75 √B)
              N = Y (x_os + (0.05 − 0.14 γ'/π) L_os)
              h1 = h1a + γ'/π (h1b − h1a),  h1a = 0.8 α^0.45,  h1b = 0.7 C²  (C in 0.85…1.15)
              h2 = 0.05 + 0.95 arctan(1.45 (γ' − 1.75))

γ is where all three come from, clockwise from ahead, and γ' the same in 0…π on either side; α is
the bow angle. The standard's y points to port; here it points to starboard, and N turns the bow
there.

Weather is that of the DP capability numbers (table 2-1), and of any wind between them; wind, waves
and current come from one direction.
"""

import math
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix
from dpbench.ship.weather import AIR_DENSITY, GRAVITY, WATER_DENSITY, compute_drift_factor_of_period

DP_CONDITIONS = {
    1: (1.5, 0.1, 3.5, 0.25),
    2: (3.4, 0.4, 4.5, 0.5),
    3: (5.4, 0.8, 5.5, 0.75),
    4: (7.9, 1.3, 6.5, 0.75),
    5: (10.7, 2.1, 7.5, 0.75),
    6: (13.8, 3.1, 8.5, 0.75),
    7: (17.1, 4.2, 9.0, 0.75),
    8: (20.7, 5.7, 10.0, 0.75),
    9: (24.4, 7.4, 10.5, 0.75),
    10: (28.4, 9.5, 11.5, 0.75),
    11: (32.6, 12.1, 12.0, 0.75),
}
"""Wind [m/s], Hs [m], Tp [s], current [m/s] of each DP capability number; 0 is calm."""

CALM = (0.0, 0.0, DP_CONDITIONS[1][2], 0.0)
"""The standard gives calm water no period; that of number 1 stands in for it."""

_TABLE = np.array([CALM, *DP_CONDITIONS.values()])
DYNAMIC_FACTOR = 1.25  # By which thrust has to exceed the mean loads (3.2.2)


@dataclass(frozen=True)
class Condition:
    """Weather of a DP capability number: mean wind [m/s], waves Hs [m], Tp [s], current [m/s]."""

    wind_mps: float
    hs_m: float
    tp_s: float
    current_mps: float

    @property
    def zero_crossing_s(self) -> float:
        """Mean zero-crossing period [s] of a Pierson-Moskowitz spectrum, from its peak period."""
        return self.tp_s / 1.4049


def interpolate_condition_at_wind_speed(wind_mps: float) -> Condition:
    """Return the waves and current for a wind speed; interpolation in the table is ours."""
    columns = (float(np.interp(wind_mps, _TABLE[:, 0], column)) for column in _TABLE.T[1:])
    return Condition(wind_mps, *columns)


@dataclass(frozen=True)
class CapabilityHull:
    """Hull dimensions and areas that the load formulas of DNV-ST-0111 need.

    length_m, breadth_m, draught_m : L_pp, B at the waterline, T.
    submerged_length_m, submerged_x_m : L_os from the foremost to the aftmost point under water, and
        the place of its middle.
    bow_angle_rad : half the angle at which the waterline meets ahead.
    aft_fullness : C_WL,aft, area of the waterline behind the middle over B·L_pp/2.
    frontal_m2, lateral_m2, lateral_x_m : areas above the water from ahead and from abeam, and the
        centre of the latter.
    submerged_m2, current_x_m : area under water from abeam, and its centre.
    skegs : (x, y) [m] of the aftmost point of each.
    assumed : keys that the file leaves out.
    """

    length_m: float
    breadth_m: float
    draught_m: float
    submerged_length_m: float
    submerged_x_m: float
    bow_angle_rad: float
    aft_fullness: float
    frontal_m2: float
    lateral_m2: float
    lateral_x_m: float
    submerged_m2: float
    current_x_m: float
    skegs: tuple[tuple[float, float], ...] = ()
    assumed: tuple[str, ...] = ()


def mirror_angle_to_one_side(from_rad: float) -> float:
    """Return the angle from which weather comes, mirrored to one side of the ship: 0 to π."""
    return abs(math.remainder(from_rad, 2.0 * math.pi))


def compute_mean_environmental_loads(
    hull: CapabilityHull, condition: Condition, from_rad: float
) -> Matrix:
    """Return the mean loads of wind, current and waves in surge, sway [N] and yaw [N·m]: (3, 3)."""
    along, across = math.cos(from_rad), math.sin(from_rad)
    side = mirror_angle_to_one_side(from_rad) / math.pi
    L = hull.length_m
    air = 0.5 * AIR_DENSITY * condition.wind_mps**2
    wind_arm = hull.lateral_x_m + 0.3 * (1.0 - 2.0 * side) * L
    water = 0.5 * WATER_DENSITY * condition.current_mps**2
    shift = min(max(0.4 * (1.0 - 2.0 * side), -0.2), 0.25)
    wave_arm = hull.submerged_x_m + (0.05 - 0.14 * side) * hull.submerged_length_m
    drift_x, drift_y = _compute_mean_wave_drift_force(hull, condition, from_rad)
    forces = [
        (-0.7 * air * hull.frontal_m2 * along, -0.9 * air * hull.lateral_m2 * across, wind_arm),
        (
            -0.07 * water * hull.breadth_m * hull.draught_m * along,
            -0.6 * water * hull.submerged_m2 * across,
            hull.current_x_m + shift * L,
        ),
        (drift_x, drift_y, wave_arm),
    ]
    return np.array([(X, Y, Y * arm) for X, Y, arm in forces])


def _compute_mean_wave_drift_force(
    hull: CapabilityHull, condition: Condition, from_rad: float
) -> tuple[float, float]:
    """Return the mean wave drift force in surge and sway [N]."""
    pressure = 0.09 * 0.5 * WATER_DENSITY * GRAVITY * condition.hs_m**2
    Tz, turned = condition.zero_crossing_s, mirror_angle_to_one_side(from_rad)
    ahead = 0.8 * hull.bow_angle_rad**0.45
    astern = 0.7 * min(max(hull.aft_fullness, 0.85), 1.15) ** 2
    h1 = ahead + turned / math.pi * (astern - ahead)
    h2 = 0.05 + 0.95 * math.atan(1.45 * (turned - 1.75))
    surge = (
        pressure
        * hull.breadth_m
        * h1
        * h2
        * compute_drift_factor_of_period(Tz / (0.9 * hull.length_m**0.33))
    )
    beam = compute_drift_factor_of_period(Tz / (0.75 * math.sqrt(hull.breadth_m)))
    return surge, -pressure * hull.submerged_length_m * math.sin(from_rad) * beam
