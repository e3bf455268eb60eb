"""A long-crested JONSWAP sea and its two effects on the ship.

Elevation ζ(t) = Re Z(t) with Z = Σ a exp(j(ω_i t + ε_i)); Hs = 4 √variance.
*Drift* is the slowly varying force of second order: Newman's approximation makes it the squared
envelope |Z|², whose mean Hs²/8 gives Maruo's mean force on each of B (ahead) and L (abeam)

    X = ½ρ g B R_x² |w| u_w,   Y = ½ρ g L R_y² |w| v_w,   N = −½ρ g L² R_n² · 2 u_w v_w

where (u_w, v_w) is the vector of length |Z| along the waves in body axes: the law of the wind.
*First-order motion* is the wave-frequency motion that a measurement sees on top of the ship's own.
"""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.froude import FULL_SIZE, Froude
from dpbench.ship.weather.harmonics import (
    Harmonics,
    draw_harmonics_of_spectrum,
    jonswap_wave_spectrum,
    make_random_generator,
)

WATER_DENSITY = 1026.0
GRAVITY = 9.81

_BAND = (0.5, 5.0)  # Of the peak frequency: holds all but 0.1 % of the energy

_COMPONENTS = 200


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
        """Draw the wave components of a seed; their significant wave height is exact."""
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
