"""Published spectra against their closed integrals and numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import beta

from dpbench.ship.weather.harmonics import harris_gust, jonswap, norsok_gust


@pytest.mark.parametrize("mean_mps", [5.0, 10.0, 24.4])
def test_norsok_integrates_to_its_closed_form(mean_mps: float) -> None:
    """∫S df = 320 (U/10)² B(1/n, 2/(3n)) / n over the slope 172 (U/10)^(−3/4)."""
    n = 0.468
    area = 320 * (mean_mps / 10) ** 2 / (172 * (mean_mps / 10) ** -0.75)
    exact = area * beta(1 / n, 2 / (3 * n)) / n
    logarithmic = quad(
        lambda x: np.exp(x) * norsok_gust(np.exp(x), mean_mps), -30.0, 30.0, limit=400
    )[0]
    assert logarithmic == pytest.approx(exact, rel=1e-6)


def test_norsok_by_hand() -> None:
    """At 10 m/s the density is 320 (m/s)²/Hz at rest and 320/2^3.5613 at f̃ = 1."""
    assert norsok_gust(np.array(1e-12), 10.0) == pytest.approx(320.0, rel=1e-3)
    assert norsok_gust(np.array(1 / 172), 10.0) == pytest.approx(27.11, rel=1e-3)


@pytest.mark.parametrize("mean_mps", [10.0, 17.1, 24.4])
def test_norsok_gusts_have_about_the_turbulence_of_the_standard(mean_mps: float) -> None:
    """Gusts within the hour have the intensity 0.06 (1 + 0.043 U) of ISO 19901-1, within a fifth.

    Spectrum and intensity are separate fits of the standard, so they agree no better.
    """
    variance = quad(
        lambda x: np.exp(x) * norsok_gust(np.exp(x), mean_mps), np.log(1 / 3600), np.log(10.0)
    )[0]
    published = 0.06 * (1 + 0.043 * mean_mps)
    assert np.sqrt(variance) / mean_mps == pytest.approx(published, rel=0.2)


@pytest.mark.parametrize("mean_mps", [5.0, 24.4])
def test_harris_integrates_to_its_closed_form(mean_mps: float) -> None:
    """∫S df = 4 κ U² 2^(−1/3) B(1/2, 1/3)/2, about 6.68 κ U²."""
    exact = 4 * 0.0026 * mean_mps**2 * 2 ** (-1 / 3) * 0.5 * beta(0.5, 1 / 3)
    found = quad(lambda x: np.exp(x) * harris_gust(np.exp(x), mean_mps), -30.0, 30.0, limit=400)[0]
    assert found == pytest.approx(exact, rel=1e-6)
    assert exact == pytest.approx(6.68 * 0.0026 * mean_mps**2, rel=1e-3)


def test_pierson_moskowitz_integrates_to_its_closed_form() -> None:
    """With γ = 1 the energy up to ω is Hs²/16 · exp(−(5/4)(ω_p/ω)⁴)."""
    hs_m, tp_s = 2.0, 8.5
    omega_p = 2 * np.pi / tp_s
    for ratio in (0.8, 1.0, 1.7, 4.0):
        found = quad(lambda w: jonswap(np.array(w), hs_m, tp_s, 1.0), 1e-3, ratio * omega_p)[0]
        assert found == pytest.approx(hs_m**2 / 16 * np.exp(-1.25 / ratio**4), rel=1e-8)


@pytest.mark.parametrize(
    ("gamma", "within"), [(1.0, 1e-6), (2.0, 0.01), (3.3, 0.01), (5.0, 0.01), (7.0, 0.02)]
)
def test_jonswap_keeps_the_wave_height_for_every_peakedness(gamma: float, within: float) -> None:
    """The normalising 1 − 0.287 ln γ, a fit, leaves 16 m0 within 1 % of Hs² (2 % at γ = 7)."""
    omega_p = 2 * np.pi / 9.0
    m0 = sum(
        quad(lambda w: jonswap(np.array(w), 3.0, 9.0, gamma), a * omega_p, b * omega_p)[0]
        for a, b in ((0.2, 1.0), (1.0, 2.0), (2.0, 50.0))
    )
    assert 16 * m0 == pytest.approx(9.0, rel=within)


def test_jonswap_peaks_at_the_peak_period() -> None:
    """The density is largest at ω_p and there γ·A_γ times that of Pierson-Moskowitz."""
    omega_p = 2 * np.pi / 8.5
    omega = np.linspace(0.5, 2.0, 1501) * omega_p
    density = jonswap(omega, 2.0, 8.5, 3.3)
    assert omega[np.argmax(density)] == pytest.approx(omega_p, rel=1e-9)
    ratio = density.max() / jonswap(omega, 2.0, 8.5, 1.0)[np.argmax(density)]
    assert ratio == pytest.approx(3.3 * (1 - 0.287 * np.log(3.3)), rel=1e-12)
