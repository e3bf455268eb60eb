"""The weather of a run, and the noise of its measurement.

    b(t) = g(t) · (mean + amplitude · sin(2πt/T + phase)) + squalls,   g(t) = min(t / ramp, 1)

b is the low-frequency force in the north-east-down frame (paper section IV). Wind, current and
wave drift act through the ship's own velocity and heading, so they enter as vectors in that frame
(air velocity, water velocity, wave envelope), each grown by the same g(t); the plant applies the
laws of `wind`, `current` and `waves`. Nothing here depends on the ship, so a run evaluates it all
once at the stage times of the integrator and the step loop only reads tables.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.ship.layout import (
    AIR,
    AXES,
    COEFFICIENTS,
    DRIFT_U,
    LOADED,
    PLAIN,
    STATE,
    WATER,
    WAVE,
    WIND_U,
)
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import FirstOrderMotion, WaveDrift, Wind, make_random_generator

WeatherDraw = dict[str, Matrix]
"""Wind speed and wave height at the stage times, as drawn by an environment."""


@dataclass(frozen=True, eq=False)
class Squall:
    """Force that rises, stays and decays along straight lines, added to the slow forces.

    start_s, rise_s : it grows from zero at start_s to the full force at start_s + rise_s [s].
    hold_until_s, decay_s : it stays until hold_until_s and is gone decay_s later [s].
    force : (3,) full force, north, east, yaw [N, N, N·m].
    """

    start_s: float
    rise_s: float
    hold_until_s: float
    decay_s: float
    force: Vector

    def force_at(self, t_s: ArrayLike) -> Matrix:
        """Return the squall's force (..., 3) [N, N, N·m] at the times t_s."""
        end_s = self.hold_until_s + self.decay_s
        corners = [self.start_s, self.start_s + self.rise_s, self.hold_until_s, end_s]
        share = np.interp(np.asarray(t_s, dtype=np.float64), corners, [0.0, 1.0, 1.0, 0.0])
        return np.multiply.outer(share, self.force)


@dataclass(frozen=True)
class Current:
    """Steady, irrotational ocean current of constant speed and direction.

        M ν̇ + D (ν − ν_c) = τ + …,   ν_c = R(ψ)ᵀ [V_c cos β, V_c sin β, 0]

    V_c = speed_mps, to the direction β = to_rad from north. D is meant for low relative speed. The
    term of added mass in ν̇_c, which only a turning ship meets, is left out with the Coriolis terms
    that the paper leaves out (eq. 4).
    """

    speed_mps: float
    to_rad: float

    @property
    def velocity_north_east(self) -> Vector:
        """Velocity (2,) of the current, north and east [m/s]."""
        return self.speed_mps * np.array([np.cos(self.to_rad), np.sin(self.to_rad)])


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """White Gaussian noise on measured position and heading; std (3,) [m, m, rad]."""

    std: Vector

    def draw_noise_table(self, samples: int, seed: int) -> Matrix:
        """Return random sensor noise (samples, 3) of a seed; more samples keep the first ones."""
        stream = make_random_generator(seed, "noise")
        return np.asarray(self.std * stream.standard_normal((samples, AXES)))


@dataclass(frozen=True, eq=False)
class Environment:
    """Weather of a run: slow forces, squalls, wind, current, waves, and the measurement's noise.

    mean, amplitude : (3,) slow force, north, east, yaw [N, N, N·m], of periods and phases (3,).
    ramp_s : time over which all but squalls grows from zero [s]; 0 for none.
    motion, noise : what the measurement shows besides the ship's low-frequency motion.
    seed : of all random sources; each draws from its own stream of it.
    """

    mean: Vector
    amplitude: Vector
    period_s: Vector
    phase_rad: Vector
    ramp_s: float = 0.0
    squalls: tuple[Squall, ...] = ()
    wind: Wind | None = None
    current: Current | None = None
    drift: WaveDrift | None = None
    motion: FirstOrderMotion | None = None
    noise: SensorNoise | None = None
    seed: int = 0

    @property
    def depends_on_ship(self) -> bool:
        """True if a load of the weather depends on the ship's velocity or heading, as wind does."""
        return any(source is not None for source in (self.wind, self.current, self.drift))

    @property
    def is_random(self) -> bool:
        """True if any part of the weather is random, so that the seed matters."""
        return bool(self.random_parts)

    @property
    def random_parts(self) -> list[str]:
        """Names of what is drawn at random from the seed: gusts, waves, noise."""
        waves = self.drift is not None or self.motion is not None
        gusty = self.wind is not None and self.wind.gusts != "none"
        drawn = {"gusts": gusty, "waves": waves, "noise": self.noise is not None}
        return [name for name, is_drawn in drawn.items() if is_drawn]

    def compute_slow_forces_and_squalls(self, t_s: ArrayLike) -> Matrix:
        """Return slow forces and squalls (..., 3) [N, N, N·m], north, east, yaw, at times t_s."""
        t = np.asarray(t_s, dtype=np.float64)[..., np.newaxis]
        b = self.mean + self.amplitude * np.sin(2 * np.pi * t / self.period_s + self.phase_rad)
        if self.ramp_s > 0:
            b *= np.minimum(t / self.ramp_s, 1.0)
        for squall in self.squalls:
            b += squall.force_at(t_s)
        return b

    def draw_wind_and_waves_at_stages(
        self, steps: int, sample_s: float, substeps: int
    ) -> WeatherDraw:
        """Return wind speed and wave envelope at Runge-Kutta stages (steps, 2·substeps + 1)."""
        start, offset = _compute_sample_and_stage_times(steps, sample_s, substeps)
        drawn: WeatherDraw = {}
        if self.wind is not None:
            drawn["wind"] = self.wind.wind_speed_at_times(start, offset, self.seed)
        if self.drift is not None:
            drawn["waves"] = self.drift.wave_envelope_at_times(start, offset, self.seed)
        return drawn

    def build_weather_table_at_stages(
        self, steps: int, sample_s: float, substeps: int, drawn: WeatherDraw | None = None
    ) -> Matrix:
        """Return the weather at all Runge-Kutta stages: (steps, 2·substeps + 1, 3 or 9).

        Entry [k, 2i] is the start of sub-step i of sample k, [k, 2i + 1] its middle, and the last
        entry the end of the sample; the columns are those of `layout`. `drawn` saves summing up
        the harmonics; it may be of more steps.
        """
        start, offset = _compute_sample_and_stage_times(steps, sample_s, substeps)
        t = start[:, np.newaxis] + offset
        b = np.ascontiguousarray(self.compute_slow_forces_and_squalls(t))
        if not self.depends_on_ship:
            return b
        drawn = (
            self.draw_wind_and_waves_at_stages(steps, sample_s, substeps)
            if drawn is None
            else drawn
        )
        table = np.zeros((*t.shape, LOADED))
        table[..., :PLAIN] = b
        if self.wind is not None:
            table[..., AIR] = _make_vectors_in_direction(drawn["wind"][:steps], self.wind.to_rad)
        if self.current is not None:
            table[..., WATER] = self.current.velocity_north_east
        if self.drift is not None:
            table[..., WAVE] = _make_vectors_in_direction(
                drawn["waves"][:steps], self.drift.sea.to_rad
            )
        if self.ramp_s > 0:
            table[..., PLAIN:] *= np.minimum(t / self.ramp_s, 1.0)[..., np.newaxis]
        return table

    def wind_and_drift_coefficients(self, vessel: Vessel) -> Vector | None:
        """Return wind and drift coefficients (6,) or None if unneeded; InputError without them."""
        if not self.depends_on_ship:
            return None
        coefficients = np.zeros(COEFFICIENTS)
        if self.wind is not None:
            if vessel.windage is None:
                allowed = "wind areas and coefficients, because the weather has wind"
                raise InputError(vessel.where, "windage", "nothing", allowed)
            coefficients[WIND_U:DRIFT_U] = vessel.windage.wind_force_coefficients(vessel.length_m)
        if self.drift is not None:
            if vessel.reflection is None:
                allowed = (
                    "a breadth and the wave reflection coefficients, as the weather has wave drift"
                )
                raise InputError(vessel.where, "reflection", "nothing", allowed)
            coefficients[DRIFT_U:] = vessel.reflection.wave_drift_coefficients(
                vessel.length_m, self.drift.sea
            )
        return coefficients

    def wave_frequency_motion_at_samples(self, samples: int, sample_s: float) -> Matrix:
        """Return wave-frequency motion [n, e, ψ] and its rate at the samples: (samples, 6), SI."""
        if self.motion is None:
            return np.zeros((samples, STATE))
        t = sample_s * np.arange(samples, dtype=np.float64)
        return self.motion.motion_and_rates_at_times(t, self.seed)

    def draw_measurement_noise(self, samples: int) -> Matrix:
        """Return the noise (samples, 3) [m, m, rad] of the measured position and heading."""
        if self.noise is None:
            return np.zeros((samples, AXES))
        return self.noise.draw_noise_table(samples, self.seed)


def _compute_sample_and_stage_times(
    steps: int, sample_s: float, substeps: int
) -> tuple[Vector, Vector]:
    """Return the sample times (steps,) and the Runge-Kutta stage times after each sample [s]."""
    start = sample_s * np.arange(steps, dtype=np.float64)
    return start, np.linspace(0.0, sample_s, 2 * substeps + 1)


def _make_vectors_in_direction(length: Matrix, to_rad: float) -> Matrix:
    """Return horizontal vectors (..., 2), north and east, of given lengths in one direction."""
    vectors: Matrix = np.multiply.outer(length, np.array([np.cos(to_rad), np.sin(to_rad)]))
    return vectors
