"""Mean loads of level 1: the published ones of a ship, symmetry, and the weather between rows."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from dpbench.scenario.own_ship import DP_NUMBERS
from dpbench.ship.capability.loads import (
    DP_CONDITIONS,
    CapabilityHull,
    Condition,
    compute_mean_environmental_loads,
    interpolate_condition_at_wind_speed,
)

PORT = np.array([1.0, -1.0, -1.0])
"""From axes with y to port to those with y to starboard, and back."""
ROUNDED_kN = 0.06
"""The published loads have one digit behind the point; so do areas and places of the hull."""


def test_loads_are_the_published_ones(hull: CapabilityHull, published: pd.DataFrame) -> None:
    """36 directions at the number held: within the last digit, the air's density put right."""
    for row in published.itertuples():
        condition = Condition(*DP_CONDITIONS[row.number])
        loads = (
            compute_mean_environmental_loads(hull, condition, math.radians(row.from_deg))
            * PORT
            / 1e3
        )
        for ours, name in zip(loads, ("wind", "current", "waves"), strict=True):
            wanted = np.array([getattr(row, f"{name}_{axis}") for axis in "xyn"])
            if name == "wind":
                wanted = wanted * 1.226 / 1.23
            np.testing.assert_allclose(ours, wanted, rtol=2e-4, atol=ROUNDED_kN)


@given(st.floats(0.0, math.pi), st.floats(0.0, 33.0))
def test_weather_from_port_is_the_mirror_image(from_rad: float, wind_mps: float) -> None:
    some = CapabilityHull(80.0, 18.0, 5.0, 82.0, 1.0, 0.4, 1.2, 300.0, 900.0, 3.0, 400.0, -2.0)
    condition = interpolate_condition_at_wind_speed(wind_mps)
    starboard, port = (
        compute_mean_environmental_loads(some, condition, angle) for angle in (from_rad, -from_rad)
    )
    np.testing.assert_allclose(port, starboard * PORT, rtol=1e-12, atol=1e-6)


def test_rows_of_the_table_are_met_and_joined() -> None:
    for wind_mps, *rest in DP_CONDITIONS.values():
        found = interpolate_condition_at_wind_speed(wind_mps)
        np.testing.assert_allclose([found.hs_m, found.tp_s, found.current_mps], rest)
    middle = interpolate_condition_at_wind_speed(0.5 * (13.8 + 17.1))
    assert middle.hs_m == pytest.approx(0.5 * (3.1 + 4.2))
    assert (
        interpolate_condition_at_wind_speed(0.0).hs_m
        == interpolate_condition_at_wind_speed(0.0).current_mps
        == 0.0
    )


def test_a_ship_of_ones_own_gets_the_weather_of_the_same_table() -> None:
    assert list(DP_NUMBERS) == list(range(1, 10))
    assert all(DP_CONDITIONS[number] == row for number, row in DP_NUMBERS.items())
