"""A stationary Gaussian process of given spectrum as a sum of harmonics.

    z(t) = Σ a exp(j(ω_i t + ε_i)),   variance of Re z = N a²/2

The band is cut into N bins of equal energy; each bin has one harmonic of the amplitude that
carries the bin's energy, at a random place in the bin and with a random phase. Random places keep
the sum from repeating itself, equal energies put the harmonics where the spectrum is.

Published spectral densities of wind gusts, over f in Hz, and of waves, over ω in rad/s:

NORSOK:  S(f) = 320 (U/10)² (z/10)^0.45 / (1 + f̃ⁿ)^(5/(3n)),
         f̃ = 172 f (z/10)^(2/3) (U/10)^(−3/4),   n = 0.468,   z = 10 m here
Harris:  S(f) = 4 κ L U / (2 + (f L/U)²)^(5/6),   L = 1800 m,   κ = 0.0026
JONSWAP: S(ω) = A_γ (5/16) Hs² ω_p⁴ ω⁻⁵ exp(−(5/4)(ω/ω_p)⁻⁴) γ^exp(−½((ω − ω_p)/(σ ω_p))²),
         A_γ = 1 − 0.287 ln γ,   σ = 0.07 up to ω_p, 0.09 above
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector

HARRIS_LENGTH_M = 1800.0
HARRIS_DRAG = 0.0026
_GRID = 4000
_ROWS = 1024


def make_random_generator(seed: int, name: str) -> np.random.Generator:
    """Return a generator of a seed and a named source, independent of what others there are."""
    # NumPy may change its default generator.
    key = np.random.SeedSequence(seed, spawn_key=tuple(name.encode()))
    return np.random.Generator(np.random.PCG64(key))


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Sum of harmonics of equal amplitude that represents a random process."""

    amplitude: float
    omega: Vector
    phase: Vector

    def evaluate_process_at_times(
        self, start_s: Vector, offset_s: Vector, derivative: int = 0
    ) -> NDArray[np.complex128]:
        """Return the complex process, or a derivative, at times start_s (K,) + offset_s (M,)."""
        # Times in two parts factor the sum into K·N and M·N exponentials. It is summed without
        # BLAS, so that no thread count changes its last bits.
        later = np.exp(1j * np.outer(offset_s, self.omega))
        weight = self.amplitude * (1j * self.omega) ** derivative
        z = np.empty((start_s.size, offset_s.size), dtype=np.complex128)
        for first in range(0, start_s.size, _ROWS):
            rows = slice(first, first + _ROWS)
            begin = weight * np.exp(1j * (np.outer(start_s[rows], self.omega) + self.phase))
            z[rows] = np.einsum("kn,mn->km", begin, later)
        return z


def draw_harmonics_of_spectrum(
    density: Callable[[Vector], Vector],
    band: tuple[float, float],
    count: int,
    rng: np.random.Generator,
    variance: float | None = None,
) -> Harmonics:
    """Draw harmonics of a density over a band [rad/s], of `variance` or the density's integral."""
    omega = np.geomspace(*band, _GRID)
    S = density(omega)
    energy = np.concatenate([[0.0], np.cumsum(0.5 * (S[1:] + S[:-1]) * np.diff(omega))])
    place, phase = rng.random((2, count))
    quantile = (np.arange(count) + place) / count * energy[-1]
    total = energy[-1] if variance is None else variance
    return Harmonics(
        float(np.sqrt(2.0 * total / count)), np.interp(quantile, energy, omega), 2 * np.pi * phase
    )


def norsok_gust_spectrum(f_Hz: Vector, mean_mps: float) -> Vector:
    """Return the NORSOK spectral density of wind gusts [(m/s)²/Hz] at 10 m height.

    Source: Andersen & Løvseth 2006, Marine Structures 19; NORSOK N-003; ISO 19901-1.
    """
    n = 0.468
    scaled = 172.0 * f_Hz * (mean_mps / 10.0) ** -0.75
    density: Vector = 320.0 * (mean_mps / 10.0) ** 2 / (1.0 + scaled**n) ** (5.0 / (3.0 * n))
    return density


def harris_gust_spectrum(f_Hz: Vector, mean_mps: float) -> Vector:
    """Return the Harris spectral density of wind gusts [(m/s)²/Hz].

    Source: Harris 1971; Faltinsen 1990, eq. 2.40, who advises against it below 0.01 Hz.
    """
    scaled = f_Hz * HARRIS_LENGTH_M / mean_mps
    top = 4.0 * HARRIS_DRAG * HARRIS_LENGTH_M * mean_mps
    density: Vector = top / (2.0 + scaled**2) ** (5.0 / 6.0)
    return density


def jonswap_wave_spectrum(omega: Vector, hs_m: float, tp_s: float, gamma: float) -> Vector:
    """Return the JONSWAP spectral density of the wave elevation [m²·s/rad].

    Source: DNV-RP-C205, section 3.5.5. A_γ is a fit: the integral is Hs²/16 within 1 % up to γ = 5.
    """
    omega_p = 2 * np.pi / tp_s
    sigma = np.where(omega <= omega_p, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((omega - omega_p) / (sigma * omega_p)) ** 2)
    shape = np.exp(-1.25 * (omega_p / omega) ** 4) * omega_p**4 / omega**5
    density: Vector = (1.0 - 0.287 * np.log(gamma)) * 0.3125 * hs_m**2 * shape * peak
    return density
