"""Wind with gusts, and the force of the wind on the hull above the water.

    X = ½ρ c_x A_F |V| u_rw,   Y = ½ρ c_y A_L |V| v_rw,   N = −½ρ c_n A_L L · 2 u_rw v_rw

(u_rw, v_rw) is the velocity of the air relative to the ship in body axes and V its length, so a
wind from ahead (u_rw < 0) pushes back and one that blows to starboard (v_rw > 0) pushes there.
With γ_rw = −atan2(v, u) of the *ship* relative to the air these are Fossen's forces on symmetrical
ships, −c_x cos γ, c_y sin γ, c_n sin 2γ (Fossen 2021, section 10.1): a wind on the bow turns the
bow away from it, until it blows from abeam.

Directions are where the wind blows *to*, clockwise from north in rad.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.froude import FULL_SIZE, Froude
from dpbench.ship.weather.harmonics import (
    draw_harmonics_of_spectrum,
    harris_gust_spectrum,
    make_random_generator,
    norsok_gust_spectrum,
)

AIR_DENSITY = 1.226  # kg/m³ (DNV-ST-0111, section 3.5)

GUST_BAND_HZ = (1.0 / 600.0, 0.5)
"""Slower changes are the mean of a ten-minute run; faster ones do not reach a whole hull."""

_GUSTS = {"norsok": norsok_gust_spectrum, "harris": harris_gust_spectrum}
_COMPONENTS = 200


def convert_from_deg_to_towards_rad(from_deg: float) -> float:
    """Convert a compass direction that wind comes from [°] to the direction it blows to [rad]."""
    return math.radians(math.remainder(from_deg + 180.0, 360.0))


@dataclass(frozen=True)
class Wind:
    """Wind of constant direction, with gusts around a mean speed at 10 m height.

    speed_mps : mean speed at the ship, so that of the model's wind for a model ship [m/s].
    scale : of the model ship. The spectra hold at full size and do not follow Froude's law, so the
        gusts are drawn there and then scaled.
    """

    speed_mps: float
    to_rad: float
    gusts: Literal["norsok", "harris", "none"] = "norsok"
    scale: Froude = FULL_SIZE

    def wind_speed_at_times(self, start_s: Vector, offset_s: Vector, seed: int) -> Matrix:
        """Return the wind speed [m/s] at times start_s (K,) + offset_s (M,): (K, M)."""
        if self.gusts == "none" or self.speed_mps == 0.0:
            return np.full((start_s.size, offset_s.size), self.speed_mps)
        spectrum, turn, slower = _GUSTS[self.gusts], 2 * np.pi, self.scale.time_and_speed_factor
        low, high = GUST_BAND_HZ
        gust = draw_harmonics_of_spectrum(
            lambda omega: spectrum(omega / turn, self.speed_mps / slower) / turn,
            (turn * low, turn * high),
            _COMPONENTS,
            make_random_generator(seed, "wind"),
        )
        gusts = gust.evaluate_process_at_times(start_s / slower, offset_s / slower).real
        speed: Matrix = self.speed_mps + slower * gusts
        return speed


@dataclass(frozen=True)
class Windage:
    """Projected areas of the hull above water, and their wind force coefficients.

    Fossen 2021 gives 0.50-0.90, 0.70-0.95 and 0.05-0.20; DNV-ST-0111, section 3.5, has 0.7, 0.9
    and about 0.095.
    """

    frontal_m2: float
    lateral_m2: float
    c_x: float = 0.7
    c_y: float = 0.9
    c_n: float = 0.095

    def wind_force_coefficients(self, length_m: float) -> Vector:
        """Return the wind force coefficients (3,) [kg/m, kg/m, kg] of surge, sway and yaw."""
        side = self.lateral_m2
        areas = [self.c_x * self.frontal_m2, self.c_y * side, self.c_n * side * length_m]
        return 0.5 * AIR_DENSITY * np.array(areas)
