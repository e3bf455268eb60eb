"""Wind on the hull: Fossen's law, its signs, the gusts, and what is refused."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from dpbench.ship.environment import Environment
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import (
    Wind,
    convert_from_deg_to_towards_rad,
    harris_gust_spectrum,
    norsok_gust_spectrum,
)
from tests.ship.conftest import CALM, rotation

Felt = Callable[..., np.ndarray]


def blowing(speed_mps: float, to_rad: float) -> Environment:
    """A steady wind and nothing else."""
    return replace(CALM, wind=Wind(speed_mps, to_rad, "none"))


@pytest.mark.parametrize(("come", "go"), [(0, 180), (90, -90), (180, 0), (270, 90), (405, -135)])
def test_a_wind_from_one_side_goes_to_the_other(come: float, go: float) -> None:
    assert math.degrees(convert_from_deg_to_towards_rad(come)) == pytest.approx(go, abs=1e-12)


@pytest.mark.parametrize("heading_deg", range(-180, 180, 25))
def test_wind_on_a_turned_moving_ship_is_the_force_of_fossen(
    heading_deg: float, hull: Vessel, weather_force: Felt
) -> None:
    """X, Y, N are ½ρV²(−c_x cos γ A_F, c_y sin γ A_L, c_n sin 2γ A_L L) of the relative wind."""
    psi, nu = math.radians(heading_deg), np.array([1.5, -0.8, 0.0])
    speed, to_rad = 13.8, 0.9
    u, v = nu[:2] - rotation(psi)[:2, :2].T @ (
        speed * np.array([math.cos(to_rad), math.sin(to_rad)])
    )
    gamma, pressure = -math.atan2(v, u), 0.5 * 1.226 * (u * u + v * v)
    expected = pressure * np.array(
        [
            -0.7 * math.cos(gamma) * 290.0,
            0.9 * math.sin(gamma) * 700.0,
            0.095 * math.sin(2 * gamma) * 700.0 * 76.2,
        ]
    )
    found = weather_force(hull, blowing(speed, to_rad), psi, nu)
    lever = np.array([1.0, 1.0, hull.length_m])
    np.testing.assert_allclose(found / lever, expected / lever, rtol=2e-5, atol=1.0)


def test_signs_are_those_a_sailor_expects(hull: Vessel, weather_force: Felt) -> None:
    ahead, starboard, bow = (
        weather_force(hull, blowing(15.0, convert_from_deg_to_towards_rad(come_deg)))
        for come_deg in (0, 90, 45)
    )
    assert ahead[0] < -1e4
    assert starboard[1] < -5e4
    assert bow[2] < -1e5
    # sin π is not quite zero: 1e-16 of the force, and the 1e-6 of reading it off the motion.
    np.testing.assert_allclose([ahead[1], starboard[0]], 0.0, atol=1.0)


@pytest.mark.parametrize(
    ("gusts", "density"), [("norsok", norsok_gust_spectrum), ("harris", harris_gust_spectrum)]
)
def test_gusts_have_the_mean_and_variance_of_their_spectrum(
    gusts: str, density: Callable[..., float]
) -> None:
    """The wind has its mean speed and the variance ∫S df between 1/600 and 0.5 Hz."""
    speed = Wind(17.1, 0.0, gusts).wind_speed_at_times(1013.0 * np.arange(20_000), np.zeros(1), 5)[
        :, 0
    ]  # type: ignore[arg-type] # the name comes from a table
    variance = quad(density, 1 / 600, 0.5, args=(17.1,), limit=200)[0]
    # Independent values: a relative 1 % on the variance, σ/√20000 on the mean; five of each.
    assert speed.var() == pytest.approx(variance, rel=0.05)
    assert speed.mean() == pytest.approx(17.1, abs=5 * math.sqrt(variance / 20_000))


def test_a_wind_without_gusts_is_steady() -> None:
    t = 0.3 * np.arange(50)
    for wind in (Wind(12.0, 1.0, "none"), Wind(0.0, 1.0, "norsok")):
        np.testing.assert_array_equal(wind.wind_speed_at_times(t, np.zeros(2), 0), wind.speed_mps)
