"""The sea, its drift force and the motion it adds to a measurement."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dpbench.ship.environment import Environment
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import FirstOrderMotion, Sea, WaveDrift, WaveReflection
from tests.ship.conftest import CALM, rotation

Felt = Callable[..., np.ndarray]
SEA = Sea(3.1, 8.5, 0.4)
NOW = np.zeros(1)


def drifting(sea: Sea, seed: int = 0) -> Environment:
    """Drift in a sea and nothing else."""
    return replace(CALM, drift=WaveDrift(sea), seed=seed)


@pytest.mark.parametrize("seed", range(3))
def test_the_wave_height_is_four_standard_deviations_of_the_elevation(seed: int) -> None:
    elevation = (
        SEA.draw_wave_harmonics(seed)
        .evaluate_process_at_times(101.7 * np.arange(20_000), NOW)[:, 0]
        .real
    )
    # The standard deviation of 20 000 independent values is known to 0.5 %; five of those.
    assert 4 * elevation.std() == pytest.approx(SEA.hs_m, rel=0.025)


def test_the_zero_crossing_period_is_that_of_the_spectrum() -> None:
    """A Pierson-Moskowitz sea crosses zero every Tp/1.4049, less the tail left out above 5 ω_p."""
    omega = Sea(2.0, 10.0, 0.0, 1.0).draw_wave_harmonics(0).omega
    # The tail holds 5 % of the second moment, so the period comes out 2.6 % long.
    assert 2 * np.pi / np.sqrt(np.mean(omega**2)) == pytest.approx(10.0 / 1.4049, rel=0.035)


def test_the_drift_is_newmans_double_sum_over_difference_frequencies() -> None:
    """|Z|² = Σ Σ a² cos((ω_i − ω_j) t + ε_i − ε_j): slow, without sum frequencies."""
    waves, t = SEA.draw_wave_harmonics(4), np.array([0.0, 13.7, 250.0])
    difference = np.subtract.outer(waves.omega, waves.omega)
    phase = np.subtract.outer(waves.phase, waves.phase)
    expected = [waves.amplitude**2 * np.cos(difference * x + phase).sum() for x in t]
    found = WaveDrift(SEA).wave_envelope_at_times(t, NOW, 4)[:, 0] ** 2
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_the_mean_drift_force_is_that_of_maruo(hull: Vessel) -> None:
    """Over a long record abeam the mean of the force is (1/16) ρ g L R² Hs²."""
    height = WaveDrift(SEA).wave_envelope_at_times(211.3 * np.arange(20_000), NOW, 1)
    coefficient = WaveReflection(18.0).wave_drift_coefficients(hull.length_m, SEA)[1]
    tz = 8.5 / 1.4049
    short = tz / (0.75 * math.sqrt(18.0))
    R_squared = 0.72 * short**-3 * math.exp(1 - short**-3)
    maruo = 1026 * 9.81 * hull.length_m * R_squared * SEA.hs_m**2 / 16
    # |Z|² is exponentially distributed: 1/√20000 = 0.7 %; five of those.
    assert coefficient * np.mean(height**2) == pytest.approx(maruo, rel=0.035)


def test_short_waves_are_reflected_whole_and_long_ones_pass() -> None:
    """R² is R₀² for waves shorter than the hull's scale and falls with the cube of the period."""
    hull = WaveReflection(18.0)
    short, shorter, longer, longest = (
        hull.wave_drift_coefficients(76.2, Sea(1.0, tp_s, 0.0)) for tp_s in (3.0, 2.0, 30.0, 60.0)
    )
    np.testing.assert_array_equal(short, shorter)
    half = 0.5 * 1026 * 9.81
    np.testing.assert_allclose(
        short, half * np.array([18.0 * 0.42, 76.2 * 0.72, 76.2**2 * 0.018]), rtol=1e-12
    )
    # exp(1 − T'⁻³) is e within T'⁻³ ≈ 0.01 at 30 s.
    np.testing.assert_allclose(longer / longest, 8.0, rtol=0.01)


@pytest.mark.parametrize("heading_deg", range(-170, 180, 35))
def test_drift_on_a_turned_ship_follows_the_waves_in_body_axes(
    heading_deg: float, hull: Vessel, weather_force: Felt
) -> None:
    """X ∝ cos, Y ∝ sin and N ∝ −sin of twice the waves' direction in body axes."""
    psi = math.radians(heading_deg)
    weather = drifting(SEA, 2)
    power = WaveDrift(SEA).wave_envelope_at_times(NOW, NOW, 2)[0, 0] ** 2
    b_x, b_y, b_n = WaveReflection(18.0).wave_drift_coefficients(hull.length_m, SEA)
    beta = SEA.to_rad - psi
    expected = power * np.array(
        [b_x * math.cos(beta), b_y * math.sin(beta), -b_n * math.sin(2 * beta)]
    )
    found = weather_force(hull, weather, psi)
    lever = np.array([1.0, 1.0, hull.length_m])
    np.testing.assert_allclose(found / lever, expected / lever, rtol=2e-5, atol=1.0)


@pytest.mark.slow
def test_motion_lies_along_the_waves_with_the_given_amplitude() -> None:
    """Waves to the east move the ship east and west by X·Hs/4 rms, and turn it by its operator."""
    sea = Sea(2.0, 8.5, np.pi / 2)
    motion = FirstOrderMotion(sea, 0.6, 0.0, 0.01).motion_and_rates_at_times(
        103.1 * np.arange(20_000), 3
    )
    np.testing.assert_allclose(motion[:, [0, 3]], 0.0, atol=1e-15)
    assert motion[:, 1].std() == pytest.approx(0.6 * 2.0 / 4, rel=0.025)
    assert motion[:, 2].std() == pytest.approx(0.01 * 2.0 / 4, rel=0.025)


@pytest.mark.parametrize("to_rad", [0.4, -2.0, 3.1])
def test_turning_the_sea_turns_the_motion(to_rad: float) -> None:
    north, turned = (
        FirstOrderMotion(Sea(2.0, 8.5, angle), 0.6, 0.2, 0.01).motion_and_rates_at_times(
            np.linspace(0, 50, 9), 5
        )
        for angle in (0.0, to_rad)
    )
    R = rotation(to_rad)
    np.testing.assert_allclose(turned[:, :3], north[:, :3] @ R.T, atol=1e-13)
    np.testing.assert_allclose(turned[:, 3:], north[:, 3:] @ R.T, atol=1e-13)


@pytest.mark.slow
def test_the_motion_along_the_waves_is_the_waters_own() -> None:
    sea = Sea(2.0, 8.5, 0.0)
    waves = sea.draw_wave_harmonics(6)
    t = np.linspace(0.0, 600.0, 40_001)
    elevation = waves.evaluate_process_at_times(t, NOW)[:, 0].real
    motion = FirstOrderMotion(sea, 1.0).motion_and_rates_at_times(t, 6)
    velocity = motion[:, 3]
    # In deep water both components are in phase; the spectrum's width leaves less than one.
    assert np.corrcoef(elevation, velocity)[0, 1] > 0.9
    assert abs(np.corrcoef(elevation, motion[:, 0])[0, 1]) < 0.05


def test_drift_and_motion_belong_to_the_same_waves() -> None:
    t = np.linspace(0.0, 100.0, 21)
    motion = FirstOrderMotion(Sea(3.1, 8.5, 0.0), 1.0, 1.0).motion_and_rates_at_times(t, 8)
    envelope = WaveDrift(Sea(3.1, 8.5, 0.0)).wave_envelope_at_times(t, NOW, 8)[:, 0]
    np.testing.assert_allclose(np.hypot(motion[:, 0], motion[:, 1]), envelope, rtol=1e-12)
