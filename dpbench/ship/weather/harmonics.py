"""A stationary Gaussian process of given spectrum as a sum of harmonics.

    z(t) = Σ a exp(j(ω_i t + ε_i)),   variance of Re z = N a²/2

The band is cut into N bins of equal energy; each bin has one harmonic of the amplitude that
carries the bin's energy, at a random place in the bin and with a random phase. Random places keep
the sum from repeating itself, equal energies put the harmonics where the spectrum is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector

_GRID = 4000
_ROWS = 1024


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Harmonics of one amplitude.

    Parameters
    ----------
    amplitude : of each harmonic, in the unit of the process.
    omega, phase : (N,) [rad/s], [rad].
    """

    amplitude: float
    omega: Vector
    phase: Vector

    def at(self, start_s: Vector, offset_s: Vector, derivative: int = 0) -> NDArray[np.complex128]:
        """z, or its derivative of the given order, at the times start_s (K,) + offset_s (M,).

        Returns
        -------
        (K, M). The sum factors into K·N and M·N exponentials, which is why times come in two
        parts; it is summed without BLAS, so that no thread count changes its last bits.
        """
        later = np.exp(1j * np.outer(offset_s, self.omega))
        weight = self.amplitude * (1j * self.omega) ** derivative
        z = np.empty((start_s.size, offset_s.size), dtype=np.complex128)
        for first in range(0, start_s.size, _ROWS):
            rows = slice(first, first + _ROWS)
            begin = weight * np.exp(1j * (np.outer(start_s[rows], self.omega) + self.phase))
            z[rows] = np.einsum("kn,mn->km", begin, later)
        return z


def realise(
    density: Callable[[Vector], Vector],
    band: tuple[float, float],
    count: int,
    rng: np.random.Generator,
    variance: float | None = None,
) -> Harmonics:
    """Harmonics of the spectrum `density` over `band` [rad/s], drawn from `rng`.

    Parameters
    ----------
    density : positive spectral density over ω [unit²·s/rad].
    band : its lowest and highest ω, above 0.
    count : number of harmonics.
    variance : of the process; the integral of the density over the band when None.
    """
    omega = np.geomspace(*band, _GRID)
    S = density(omega)
    energy = np.concatenate([[0.0], np.cumsum(0.5 * (S[1:] + S[:-1]) * np.diff(omega))])
    place, phase = rng.random((2, count))
    quantile = (np.arange(count) + place) / count * energy[-1]
    total = energy[-1] if variance is None else variance
    return Harmonics(
        float(np.sqrt(2.0 * total / count)), np.interp(quantile, energy, omega), 2 * np.pi * phase
    )
