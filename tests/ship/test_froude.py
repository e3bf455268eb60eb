"""Froude factors of a model ship, and a scenario of the 1 : 70 model in SI units."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.scenario.scenario import load_scenario
from dpbench.ship.froude import Froude


def test_factors_of_a_model_of_one_to_four() -> None:
    """The factors are 1/4 of lengths, 1/2 of times, 1/4³ of forces and 1/4⁴ of moments."""
    scale = Froude(4.0)
    assert (scale.length_factor, scale.time_and_speed_factor) == (0.25, 0.5)
    assert scale.force_and_moment_factors.tolist() == [1 / 64, 1 / 64, 1 / 256]
    assert scale.velocity_factors.tolist() == [0.5, 0.5, 2.0]
    assert scale.pose_factors.tolist() == [0.25, 0.25, 1.0]


@settings(derandomize=True, max_examples=50)
@given(st.floats(0.1, 200.0))
def test_factors_agree_with_one_another(ratio: float) -> None:
    scale = Froude(ratio)
    acceleration = scale.velocity_factors / scale.time_and_speed_factor
    assert acceleration[:2] == pytest.approx([1.0, 1.0])
    assert scale.velocity_factors[:2] == pytest.approx(
        [scale.length_factor / scale.time_and_speed_factor] * 2
    )
    assert scale.force_and_moment_factors[:2] == pytest.approx([scale.length_factor**3] * 2)
    assert scale.force_and_moment_factors[2] == pytest.approx(
        scale.force_and_moment_factors[0] * scale.length_factor
    )
    # Moment of inertia, mass times length², times an angular acceleration in 1/time².
    inertia = scale.length_factor**5
    assert scale.force_and_moment_factors[2] == pytest.approx(inertia * acceleration[2])


def test_the_model_ship_meets_the_weather_of_the_full_ship() -> None:
    """Weather of `calm` at 1 : 70, where 70³ = 343 000, 70⁴ = 24 010 000, √70 = 8.3666."""
    calm = load_scenario("calm@cybership2")
    weather = calm.environment
    # -20 kN, 55 kN, 500 kN·m and 10 kN, 30 kN, 300 kN·m
    expected = [-0.05830903790087463, 0.16034985422740525, 0.02082465639316951]
    np.testing.assert_allclose(weather.mean, expected, rtol=1e-12)
    expected = [0.029154518950437317, 0.08746355685131195, 0.012494793835901708]
    np.testing.assert_allclose(weather.amplitude, expected, rtol=1e-12)
    # 150, 120, 100 s, a ramp of 60 s, samples of 0.3 s
    periods = [17.928429140015904, 14.342743312012724, 11.952286093343936]
    np.testing.assert_allclose(weather.period_s, periods, rtol=1e-12)
    assert weather.ramp_s == pytest.approx(7.171371656006362)
    assert calm.sample_s == pytest.approx(0.03585685828003181)
    np.testing.assert_array_equal(weather.phase_rad, [0.0, 1.0, 2.0])


def test_the_model_ship_is_weighed_as_the_full_ship() -> None:
    calm = load_scenario("calm@cybership2")
    # 1·70², and 100 of the heading as it is
    np.testing.assert_allclose(calm.problem.Q, np.diag([4900.0, 4900.0, 100.0]), rtol=1e-12)
    # 1e-10·(70³)² and 1e-14·(70⁴)²
    np.testing.assert_allclose(calm.problem.R, np.diag([11.7649, 11.7649, 5.764801]), rtol=1e-12)


def test_the_squall_of_the_model_ship() -> None:
    """Forces scale by 70³ and 70⁴, every time by √70."""
    (full,) = load_scenario("squall").environment.squalls
    (model,) = load_scenario("squall@cybership2").environment.squalls
    np.testing.assert_allclose(model.force * [343e3, 343e3, 24010e3], full.force, rtol=1e-12)
    for name in ("start_s", "rise_s", "hold_until_s", "decay_s"):
        scaled = getattr(model, name) * 8.366600265340756
        assert scaled == pytest.approx(getattr(full, name))
