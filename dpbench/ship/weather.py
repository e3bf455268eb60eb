"""Wind with gusts, a long-crested JONSWAP sea, and their effects on the ship.

Gusts and waves are stationary Gaussian processes of given spectra, sums of harmonics:

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

The force of the wind on the hull above the water is

    X = ½ρ c_x A_F |V| u_rw,   Y = ½ρ c_y A_L |V| v_rw,   N = −½ρ c_n A_L L · 2 u_rw v_rw

(u_rw, v_rw) is the velocity of the air relative to the ship in body axes and V its length, so a
wind from ahead (u_rw < 0) pushes back and one that blows to starboard (v_rw > 0) pushes there.
With γ_rw = −atan2(v, u) of the *ship* relative to the air these are Fossen's forces on symmetrical
ships, −c_x cos γ, c_y sin γ, c_n sin 2γ (Fossen 2021, section 10.1): a wind on the bow turns the
bow away from it, until it blows from abeam.

Directions are where the wind blows *to*, clockwise from north in rad.

The elevation of the waves is ζ(t) = Re Z(t) with Z = Σ a exp(j(ω_i t + ε_i)); Hs = 4 √variance.
*Drift* is the slowly varying force of second order: Newman's approximation makes it the squared
envelope |Z|², whose mean Hs²/8 gives Maruo's mean force on each of B (ahead) and L (abeam)

    X = ½ρ g B R_x² |w| u_w,   Y = ½ρ g L R_y² |w| v_w,   N = −½ρ g L² R_n² · 2 u_w v_w

where (u_w, v_w) is the vector of length |Z| along the waves in body axes: the law of the wind.
*First-order motion* is the wave-frequency motion that a measurement sees on top of the ship's own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix, Vector
from dpbench.ship.froude import FULL_SIZE, Froude

HARRIS_LENGTH_M = 1800.0
HARRIS_DRAG = 0.0026
_GRID = 4000
_ROWS = 1024
AIR_DENSITY = 1.226  # kg/m³ (DNV-ST-0111, section 3.5)
GUST_BAND_HZ = (1.0 / 600.0, 0.5)
"""Slower changes are the mean of a ten-minute run; faster ones do not reach a whole hull."""
_COMPONENTS = 200
WATER_DENSITY = 1026.0
GRAVITY = 9.81
_BAND = (0.5, 5.0)  # Of the peak frequency: holds all but 0.1 % of the energy


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
    """Return random harmonics of a density in a band [rad/s], of its variance or a given one."""
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


def convert_from_deg_to_towards_rad(from_deg: float) -> float:
    """Return the direction wind blows to [rad], from the compass direction it comes from [°]."""
    return math.radians(math.remainder(from_deg + 180.0, 360.0))


@dataclass(frozen=True)
class Wind:
    """Wind of constant direction, with gusts around a mean speed at 10 m height.

    speed_mps : mean speed at the ship, so that of the model's wind for a model ship [m/s].
    scale : of the model ship. The spectra hold at full size and do not follow Froude's law, so the
        gusts are drawn there and then scaled.
    """

    speed_mps: float
    to_rad: float
    gusts: Literal["norsok", "harris", "none"] = "norsok"
    scale: Froude = FULL_SIZE

    def wind_speed_at_times(self, start_s: Vector, offset_s: Vector, seed: int) -> Matrix:
        """Return the wind speed [m/s] at times start_s (K,) + offset_s (M,): (K, M)."""
        if self.gusts == "none" or self.speed_mps == 0.0:
            return np.full((start_s.size, offset_s.size), self.speed_mps)
        spectrum = norsok_gust_spectrum if self.gusts == "norsok" else harris_gust_spectrum
        turn, slower = 2 * np.pi, self.scale.time_and_speed_factor
        low, high = GUST_BAND_HZ
        gust = draw_harmonics_of_spectrum(
            lambda omega: spectrum(omega / turn, self.speed_mps / slower) / turn,
            (turn * low, turn * high),
            _COMPONENTS,
            make_random_generator(seed, "wind"),
        )
        gusts = gust.evaluate_process_at_times(start_s / slower, offset_s / slower).real
        speed: Matrix = self.speed_mps + slower * gusts
        return speed


@dataclass(frozen=True)
class Windage:
    """Projected areas of the hull above water, and their wind force coefficients.

    Fossen 2021 gives 0.50-0.90, 0.70-0.95 and 0.05-0.20; DNV-ST-0111, section 3.5, has 0.7, 0.9
    and about 0.095.
    """

    frontal_m2: float
    lateral_m2: float
    c_x: float = 0.7
    c_y: float = 0.9
    c_n: float = 0.095

    def wind_force_coefficients(self, length_m: float) -> Vector:
        """Return the wind force coefficients (3,) [kg/m, kg/m, kg] of surge, sway and yaw."""
        side = self.lateral_m2
        areas = [self.c_x * self.frontal_m2, self.c_y * side, self.c_n * side * length_m]
        return 0.5 * AIR_DENSITY * np.array(areas)


@dataclass(frozen=True)
class Sea:
    """Long-crested irregular sea: wave height, period, direction.

    hs_m, tp_s : significant height [m], peak period [s].
    to_rad : where the waves run to, clockwise from north [rad].
    gamma : peakedness, 1 (Pierson-Moskowitz) to 7.
    scale : of the model ship in this sea; height and period above are the model's.
    """

    hs_m: float
    tp_s: float
    to_rad: float
    gamma: float = 3.3
    scale: Froude = FULL_SIZE

    def draw_wave_harmonics(self, seed: int) -> Harmonics:
        """Return the random wave components of a seed; their significant wave height is exact."""
        omega_p = 2 * np.pi / self.tp_s
        return draw_harmonics_of_spectrum(
            lambda omega: jonswap_wave_spectrum(omega, 1.0, self.tp_s, self.gamma),
            (_BAND[0] * omega_p, _BAND[1] * omega_p),
            _COMPONENTS,
            make_random_generator(seed, "waves"),
            self.hs_m**2 / 16.0,
        )


@dataclass(frozen=True)
class WaveDrift:
    """Slowly varying wave drift force on the ship."""

    sea: Sea

    def wave_envelope_at_times(self, start_s: Vector, offset_s: Vector, seed: int) -> Matrix:
        """Return the envelope of the wave elevation [m] at times start_s (K,) + offset_s (M,)."""
        return np.abs(
            self.sea.draw_wave_harmonics(seed).evaluate_process_at_times(start_s, offset_s)
        )


@dataclass(frozen=True)
class WaveReflection:
    """Reflection of waves by the hull at the waterline, which causes drift forces.

    R² falls with the period, since long waves pass under the hull: R² = R₀² f(T'), f = 1 for
    T' ≤ 1, else T'⁻³ exp(1 − T'⁻³), with T' = Tz/(0.75 √B) abeam and Tz/(0.9 L^0.33) ahead and
    Tz = Tp/1.4049 (DNV-ST-0111, section 3.7). The exponent 0.33 makes T' ahead depend on the unit
    of length, so T' is that of the full-size ship.

    head, beam, yaw : R₀² of short waves from ahead (the standard's value for a bow angle of 24°),
        from abeam and, for the moment, from the quarters.
    """

    breadth_m: float
    head: float = 0.42
    beam: float = 0.72
    yaw: float = 0.018

    def wave_drift_coefficients(self, length_m: float, sea: Sea) -> Vector:
        """Return the wave drift coefficients (3,) [N/m², N/m², N/m] of surge, sway and yaw."""
        tz_s, smaller = sea.tp_s / sea.scale.time_and_speed_factor / 1.4049, sea.scale.length_factor
        ahead = compute_drift_factor_of_period(tz_s / (0.9 * (length_m / smaller) ** 0.33))
        abeam = compute_drift_factor_of_period(tz_s / (0.75 * (self.breadth_m / smaller) ** 0.5))
        widths = [
            self.breadth_m * self.head * ahead,
            length_m * self.beam * abeam,
            length_m**2 * self.yaw * abeam,
        ]
        return 0.5 * WATER_DENSITY * GRAVITY * np.array(widths)


def compute_drift_factor_of_period(t_prime: float) -> float:
    """Return the factor by which wave drift falls in long waves, from the relative period T'."""
    cubed = max(t_prime, 1.0) ** -3
    return float(cubed * np.exp(1.0 - cubed))


@dataclass(frozen=True)
class FirstOrderMotion:
    """First-order motion of the ship, with the frequency of the waves.

    Along the waves it lags the elevation by a quarter period, as the water itself does; across
    and heading follow the elevation. The operators hold at all frequencies and headings; they are
    per wave amplitude, where the water's own motion along the waves is 1.
    """

    sea: Sea
    along: float = 0.6
    across: float = 0.0
    heading_rad_per_m: float = 0.0

    def motion_and_rates_at_times(self, t_s: Vector, seed: int) -> Matrix:
        """Return wave-frequency motion [n, e, ψ] and its rate at times t_s (K,): (K, 6), SI."""
        harmonics, here = self.sea.draw_wave_harmonics(seed), np.zeros(1)
        c, s = np.cos(self.sea.to_rad), np.sin(self.sea.to_rad)
        columns = []
        for derivative in (0, 1):
            Z = harmonics.evaluate_process_at_times(t_s, here, derivative)[:, 0]
            along, across = self.along * Z.imag, self.across * Z.real
            columns += [c * along - s * across, s * along + c * across]
            columns.append(self.heading_rad_per_m * Z.real)
        return np.stack(columns, axis=1)
