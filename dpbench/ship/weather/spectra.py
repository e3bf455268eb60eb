"""Published spectral densities of wind gusts, over f in Hz, and of waves, over ω in rad/s.

NORSOK:  S(f) = 320 (U/10)² (z/10)^0.45 / (1 + f̃ⁿ)^(5/(3n)),
         f̃ = 172 f (z/10)^(2/3) (U/10)^(−3/4),   n = 0.468,   z = 10 m here
Harris:  S(f) = 4 κ L U / (2 + (f L/U)²)^(5/6),   L = 1800 m,   κ = 0.0026
JONSWAP: S(ω) = A_γ (5/16) Hs² ω_p⁴ ω⁻⁵ exp(−(5/4)(ω/ω_p)⁻⁴) γ^exp(−½((ω − ω_p)/(σ ω_p))²),
         A_γ = 1 − 0.287 ln γ,   σ = 0.07 up to ω_p, 0.09 above
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Vector

HARRIS_LENGTH_M = 1800.0
HARRIS_DRAG = 0.0026


def norsok_gust(f_Hz: Vector, mean_mps: float) -> Vector:
    """Gust density [(m/s)²/Hz] at 10 m for the mean speed at 10 m.

    Source: Andersen & Løvseth 2006, Marine Structures 19; NORSOK N-003; ISO 19901-1.
    """
    n = 0.468
    scaled = 172.0 * f_Hz * (mean_mps / 10.0) ** -0.75
    density: Vector = 320.0 * (mean_mps / 10.0) ** 2 / (1.0 + scaled**n) ** (5.0 / (3.0 * n))
    return density


def harris_gust(f_Hz: Vector, mean_mps: float) -> Vector:
    """Gust density [(m/s)²/Hz] for the mean speed at 10 m.

    Source: Harris 1971; Faltinsen 1990, eq. 2.40, who advises against it below 0.01 Hz.
    """
    scaled = f_Hz * HARRIS_LENGTH_M / mean_mps
    top = 4.0 * HARRIS_DRAG * HARRIS_LENGTH_M * mean_mps
    density: Vector = top / (2.0 + scaled**2) ** (5.0 / 6.0)
    return density


def jonswap(omega: Vector, hs_m: float, tp_s: float, gamma: float) -> Vector:
    """Density of the wave elevation [m²·s/rad] at ω [rad/s]; γ = 1 is Pierson-Moskowitz.

    Source: DNV-RP-C205, section 3.5.5. A_γ is a fit: the integral is Hs²/16 within 1 % up to γ = 5.
    """
    omega_p = 2 * np.pi / tp_s
    sigma = np.where(omega <= omega_p, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((omega - omega_p) / (sigma * omega_p)) ** 2)
    shape = np.exp(-1.25 * (omega_p / omega) ** 4) * omega_p**4 / omega**5
    density: Vector = (1.0 - 0.287 * np.log(gamma)) * 0.3125 * hs_m**2 * shape * peak
    return density
