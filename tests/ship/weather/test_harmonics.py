"""Realisations of a spectrum: energy, where it lies, and the sum itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from dpbench.ship.weather.harmonics import Harmonics, draw_harmonics, jonswap, random_stream

BAND = (0.3, 3.0)
COUNT = 150


def density(omega: np.ndarray) -> np.ndarray:
    """A sea of 2 m and 8.5 s."""
    return jonswap(omega, 2.0, 8.5, 3.3)


def integral(low: float, high: float) -> float:
    """The density's integral by another rule, split at the peak's kink."""
    peak = 2 * np.pi / 8.5
    corners = [low, *[w for w in (peak,) if low < w < high], high]
    return sum(quad(density, a, b)[0] for a, b in pairwise(corners))


def made(seed: int) -> Harmonics:
    """A realisation of the sea."""
    return draw_harmonics(density, BAND, COUNT, random_stream(seed, "waves"))


@pytest.mark.parametrize("seed", range(5))
def test_the_variance_of_every_realisation_is_the_integral_of_the_spectrum(seed: int) -> None:
    """N a²/2 equals ∫S dω over the band for every seed, not only on average."""
    found = made(seed)
    # The trapezoidal rule on 4000 points leaves 1e-5, most of it at the kink of the peak.
    assert COUNT * found.amplitude**2 / 2 == pytest.approx(integral(*BAND), rel=2e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_energy_lies_where_the_spectrum_has_it(seed: int) -> None:
    """The share of harmonics below any frequency is the spectrum's share, within one harmonic."""
    omega = made(seed).omega
    for below in (0.5, 0.7, 0.8, 1.0, 1.5, 2.5):
        share = integral(BAND[0], below) / integral(*BAND)
        assert np.mean(omega < below) == pytest.approx(share, abs=1.01 / COUNT)


def test_a_given_variance_replaces_the_integral() -> None:
    """A process can be asked to have an exact variance, whatever the truncation of its band."""
    found = draw_harmonics(density, BAND, COUNT, random_stream(0, "waves"), 0.25)
    assert COUNT * found.amplitude**2 / 2 == pytest.approx(0.25, rel=1e-14)


@pytest.mark.parametrize("steps", [3, 1024, 2050])
def test_the_factored_sum_is_the_sum(steps: int) -> None:
    """Times in two parts give Σ a exp(j(ω(t + s) + ε)), beyond the rows that are summed at once."""
    waves = made(1)
    start, offset = 0.3 * np.arange(steps), np.array([0.0, 0.07, 0.3])
    found = waves.at(start, offset)
    for k in (0, steps // 2, steps - 1):
        for m in range(3):
            angle = waves.omega * (start[k] + offset[m]) + waves.phase
            expected = waves.amplitude * np.exp(1j * angle).sum()
            # Phases of 2000 rad are known to 2e-13.
            assert found[k, m] == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_are_those_of_the_sum(order: int) -> None:
    """The derivative of each order is the central difference of the one below."""
    waves, t, h = made(2), np.linspace(0.0, 40.0, 9), 1e-4
    beside = waves.at(t, np.array([-h, h]), order - 1)
    # Truncation h²ω³a/6 ≈ 2e-8 m/s, cancellation 1e-16/h ≈ 1e-12.
    np.testing.assert_allclose(
        waves.at(t, np.zeros(1), order)[:, 0],
        (beside[:, 1] - beside[:, 0]) / (2 * h),
        atol=2e-7,
    )


def test_a_long_series_has_the_variance_and_does_not_repeat() -> None:
    """Over 20 000 instants the series has its variance, and late values differ from early ones."""
    waves = made(3)
    z = waves.at(97.3 * np.arange(20_000), np.zeros(1))[:, 0].real
    # Independent Gaussian values leave a relative error of √(2/20000) = 1 %; five of those.
    assert z.var() == pytest.approx(integral(*BAND), rel=0.05)
    assert np.corrcoef(z[:10_000], z[10_000:])[0, 1] == pytest.approx(0.0, abs=0.05)
