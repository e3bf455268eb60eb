"""Wind and waves: realisations of spectra, forces by hand, and magnitudes of full-size ships."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import beta

from dpbench.ship.environment import Current, Environment
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import (
    FirstOrderMotion,
    Harmonics,
    Sea,
    WaveDrift,
    WaveReflection,
    Wind,
    convert_from_deg_to_towards_rad,
    draw_harmonics_of_spectrum,
    harris_gust_spectrum,
    jonswap_wave_spectrum,
    make_random_generator,
    norsok_gust_spectrum,
)
from tests.ship.conftest import CALM, rotation

BAND = (0.3, 3.0)
COUNT = 150
Felt = Callable[..., np.ndarray]
# DP capability number: wind [m/s], Hs [m], Tp [s], force beam-on, head-on [kN]; current 0.75 m/s.
# Of level 1 of DNV-ST-0111 for a hull of 76 m. Breadth 18 m, draught 6 m and areas of 290 and
# 700 m² are usual for such a supply ship; the coefficients are those of the standard.
TABLE = {
    4: (7.9, 1.3, 6.5, 138, 17),
    5: (10.7, 2.1, 7.5, 194, 31),
    6: (13.8, 3.1, 8.5, 268, 50),
    7: (17.1, 4.2, 9.0, 377, 77),
    8: (20.7, 5.7, 10.0, 503, 109),
    9: (24.4, 7.4, 10.5, 694, 157),
}
CURRENT_MPS = 0.75
LENGTH_M, BREADTH_M, DRAUGHT_M = 76.2, 18.0, 6.0
SEA = Sea(3.1, 8.5, 0.4)
NOW = np.zeros(1)


def density(omega: np.ndarray) -> np.ndarray:
    """A sea of 2 m and 8.5 s."""
    return jonswap_wave_spectrum(omega, 2.0, 8.5, 3.3)


def integral(low: float, high: float) -> float:
    """The density's integral by another rule, split at the peak's kink."""
    peak = 2 * np.pi / 8.5
    corners = [low, *[w for w in (peak,) if low < w < high], high]
    return sum(quad(density, a, b)[0] for a, b in pairwise(corners))


def made(seed: int) -> Harmonics:
    """A realisation of the sea."""
    return draw_harmonics_of_spectrum(density, BAND, COUNT, make_random_generator(seed, "waves"))


@pytest.mark.parametrize("seed", range(5))
def test_the_variance_of_every_realisation_is_the_integral_of_the_spectrum(seed: int) -> None:
    """N a²/2 equals ∫S dω over the band for every seed, not only on average."""
    found = made(seed)
    # The trapezoidal rule on 4000 points leaves 1e-5, most of it at the kink of the peak.
    assert COUNT * found.amplitude**2 / 2 == pytest.approx(integral(*BAND), rel=2e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_energy_lies_where_the_spectrum_has_it(seed: int) -> None:
    omega = made(seed).omega
    for below in (0.5, 0.7, 0.8, 1.0, 1.5, 2.5):
        share = integral(BAND[0], below) / integral(*BAND)
        assert np.mean(omega < below) == pytest.approx(share, abs=1.01 / COUNT)


def test_a_given_variance_replaces_the_integral() -> None:
    found = draw_harmonics_of_spectrum(
        density, BAND, COUNT, make_random_generator(0, "waves"), 0.25
    )
    assert COUNT * found.amplitude**2 / 2 == pytest.approx(0.25, rel=1e-14)


@pytest.mark.parametrize("steps", [3, 1024, 2050])
def test_the_factored_sum_is_the_sum(steps: int) -> None:
    """Times in two parts give Σ a exp(j(ω(t + s) + ε)), beyond the rows that are summed at once."""
    waves = made(1)
    start, offset = 0.3 * np.arange(steps), np.array([0.0, 0.07, 0.3])
    found = waves.evaluate_process_at_times(start, offset)
    for k in (0, steps // 2, steps - 1):
        for m in range(3):
            angle = waves.omega * (start[k] + offset[m]) + waves.phase
            expected = waves.amplitude * np.exp(1j * angle).sum()
            # Phases of 2000 rad are known to 2e-13.
            assert found[k, m] == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_are_those_of_the_sum(order: int) -> None:
    waves, t, h = made(2), np.linspace(0.0, 40.0, 9), 1e-4
    beside = waves.evaluate_process_at_times(t, np.array([-h, h]), order - 1)
    # Truncation h²ω³a/6 ≈ 2e-8 m/s, cancellation 1e-16/h ≈ 1e-12.
    np.testing.assert_allclose(
        waves.evaluate_process_at_times(t, np.zeros(1), order)[:, 0],
        (beside[:, 1] - beside[:, 0]) / (2 * h),
        atol=2e-7,
    )


def test_a_long_series_has_the_variance_and_does_not_repeat() -> None:
    waves = made(3)
    z = waves.evaluate_process_at_times(97.3 * np.arange(20_000), np.zeros(1))[:, 0].real
    # Independent Gaussian values leave a relative error of √(2/20000) = 1 %; five of those.
    assert z.var() == pytest.approx(integral(*BAND), rel=0.05)
    assert np.corrcoef(z[:10_000], z[10_000:])[0, 1] == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("mean_mps", [5.0, 10.0, 24.4])
def test_norsok_integrates_to_its_closed_form(mean_mps: float) -> None:
    """∫S df = 320 (U/10)² B(1/n, 2/(3n)) / n over the slope 172 (U/10)^(−3/4)."""
    n = 0.468
    area = 320 * (mean_mps / 10) ** 2 / (172 * (mean_mps / 10) ** -0.75)
    exact = area * beta(1 / n, 2 / (3 * n)) / n
    logarithmic = quad(
        lambda x: np.exp(x) * norsok_gust_spectrum(np.exp(x), mean_mps), -30.0, 30.0, limit=400
    )[0]
    assert logarithmic == pytest.approx(exact, rel=1e-6)


def test_norsok_by_hand() -> None:
    """At 10 m/s the density is 320 (m/s)²/Hz at rest and 320/2^3.5613 at f̃ = 1."""
    assert norsok_gust_spectrum(np.array(1e-12), 10.0) == pytest.approx(320.0, rel=1e-3)
    assert norsok_gust_spectrum(np.array(1 / 172), 10.0) == pytest.approx(27.11, rel=1e-3)


@pytest.mark.parametrize("mean_mps", [10.0, 17.1, 24.4])
def test_norsok_gusts_have_about_the_turbulence_of_the_standard(mean_mps: float) -> None:
    """Gusts within the hour have the intensity 0.06 (1 + 0.043 U) of ISO 19901-1, within a fifth.

    Spectrum and intensity are separate fits of the standard, so they agree no better.
    """
    variance = quad(
        lambda x: np.exp(x) * norsok_gust_spectrum(np.exp(x), mean_mps),
        np.log(1 / 3600),
        np.log(10.0),
    )[0]
    published = 0.06 * (1 + 0.043 * mean_mps)
    assert np.sqrt(variance) / mean_mps == pytest.approx(published, rel=0.2)


@pytest.mark.parametrize("mean_mps", [5.0, 24.4])
def test_harris_integrates_to_its_closed_form(mean_mps: float) -> None:
    """∫S df = 4 κ U² 2^(−1/3) B(1/2, 1/3)/2, about 6.68 κ U²."""
    exact = 4 * 0.0026 * mean_mps**2 * 2 ** (-1 / 3) * 0.5 * beta(0.5, 1 / 3)
    found = quad(
        lambda x: np.exp(x) * harris_gust_spectrum(np.exp(x), mean_mps), -30.0, 30.0, limit=400
    )[0]
    assert found == pytest.approx(exact, rel=1e-6)
    assert exact == pytest.approx(6.68 * 0.0026 * mean_mps**2, rel=1e-3)


def test_pierson_moskowitz_integrates_to_its_closed_form() -> None:
    """With γ = 1 the energy up to ω is Hs²/16 · exp(−(5/4)(ω_p/ω)⁴)."""
    hs_m, tp_s = 2.0, 8.5
    omega_p = 2 * np.pi / tp_s
    for ratio in (0.8, 1.0, 1.7, 4.0):
        found = quad(
            lambda w: jonswap_wave_spectrum(np.array(w), hs_m, tp_s, 1.0), 1e-3, ratio * omega_p
        )[0]
        assert found == pytest.approx(hs_m**2 / 16 * np.exp(-1.25 / ratio**4), rel=1e-8)


@pytest.mark.parametrize(
    ("gamma", "within"), [(1.0, 1e-6), (2.0, 0.01), (3.3, 0.01), (5.0, 0.01), (7.0, 0.02)]
)
def test_jonswap_keeps_the_wave_height_for_every_peakedness(gamma: float, within: float) -> None:
    """The normalising 1 − 0.287 ln γ, a fit, leaves 16 m0 within 1 % of Hs² (2 % at γ = 7)."""
    omega_p = 2 * np.pi / 9.0
    m0 = sum(
        quad(
            lambda w: jonswap_wave_spectrum(np.array(w), 3.0, 9.0, gamma), a * omega_p, b * omega_p
        )[0]
        for a, b in ((0.2, 1.0), (1.0, 2.0), (2.0, 50.0))
    )
    assert 16 * m0 == pytest.approx(9.0, rel=within)


def test_jonswap_peaks_at_the_peak_period() -> None:
    """The density is largest at ω_p and there γ·A_γ times that of Pierson-Moskowitz."""
    omega_p = 2 * np.pi / 8.5
    omega = np.linspace(0.5, 2.0, 1501) * omega_p
    density = jonswap_wave_spectrum(omega, 2.0, 8.5, 3.3)
    assert omega[np.argmax(density)] == pytest.approx(omega_p, rel=1e-9)
    ratio = density.max() / jonswap_wave_spectrum(omega, 2.0, 8.5, 1.0)[np.argmax(density)]
    assert ratio == pytest.approx(3.3 * (1 - 0.287 * np.log(3.3)), rel=1e-12)


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


def weather(dp: int, to_rad: float) -> Environment:
    """Wind, waves and current of a DP capability number, all to one direction."""
    wind_mps, hs_m, tp_s, _, _ = TABLE[dp]
    zero = np.zeros(3)
    return Environment(
        zero,
        zero,
        np.ones(3),
        zero,
        wind=Wind(wind_mps, to_rad, "none"),
        current=Current(CURRENT_MPS, to_rad),
        drift=WaveDrift(Sea(hs_m, tp_s, to_rad)),
    )


def mean_loads_kN(ship: Vessel, dp: int) -> np.ndarray:
    """Head-on and beam-on force and quartering moment of wind and drift at rest: (3,) kN, kN·m."""
    wind_mps, hs_m, _, _, _ = TABLE[dp]
    loads = weather(dp, 0.0).wind_and_drift_coefficients(ship)
    assert loads is not None
    # The law takes V² and |Z|², whose mean is Hs²/8.
    return (loads[:3] * wind_mps**2 + loads[3:] * hs_m**2 / 8) / 1000


def standard_current_kN() -> np.ndarray:
    """Head-on and beam-on current force of the standard, section 3.6: (2,) kN."""
    pressure = 0.5 * 1026 * CURRENT_MPS**2 / 1000
    return pressure * np.array([0.07 * BREADTH_M * DRAUGHT_M, 0.6 * LENGTH_M * DRAUGHT_M])


@pytest.mark.parametrize("dp", TABLE)
def test_mean_forces_are_those_of_the_standard(dp: int, hull: Vessel) -> None:
    """Wind and drift, with the standard's own current, give the table's forces within 4 %."""
    head, beam = mean_loads_kN(hull, dp)[:2] + standard_current_kN()
    assert beam == pytest.approx(TABLE[dp][3], rel=0.04)
    assert head == pytest.approx(TABLE[dp][4], rel=0.04)


@pytest.mark.parametrize("dp", TABLE)
def test_the_linear_damping_of_the_model_overstates_the_current(dp: int, hull: Vessel) -> None:
    beam = mean_loads_kN(hull, dp)[1] + hull.D[1, 1] * CURRENT_MPS / 1000
    assert 1.0 < beam / TABLE[dp][3] < 2.0


def test_the_yaw_moment_is_under_three_meganewton_metres(hull: Vessel) -> None:
    """In the quarters wind and drift of DP capability number 9 turn the ship with 1 to 3 MN·m."""
    assert 1e3 < mean_loads_kN(hull, 9)[2] < 3e3


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
