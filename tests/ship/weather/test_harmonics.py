"""Realisations of a spectrum: energy, where it lies, and the sum itself."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import beta

from dpbench.ship.weather import (
    Harmonics,
    draw_harmonics_of_spectrum,
    harris_gust_spectrum,
    jonswap_wave_spectrum,
    make_random_generator,
    norsok_gust_spectrum,
)

BAND = (0.3, 3.0)
COUNT = 150


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
