"""The weather of scenario files, in the units of the trade, at full size.

Wind and waves come *from* a compass direction, a current sets *towards* one. For a model ship all
is scaled by Froude's law.
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from dpbench.arrays import Vector
from dpbench.scenario.problem_files import FileModel
from dpbench.scenario.tables import key_types as keys
from dpbench.ship.environment import Current, Environment, SensorNoise, Squall
from dpbench.ship.froude import Froude
from dpbench.ship.weather import (
    FirstOrderMotion,
    Sea,
    WaveDrift,
    Wind,
    convert_from_deg_to_towards_rad,
)

_PER_KN = 1000.0


class SquallTable(FileModel):
    """A force that rises linearly, holds and decays linearly, on top of the slow forces."""

    start_s: keys.NotNegative
    """Time at which it begins to rise [s]."""
    rise_s: keys.Positive
    """Rise time [s]."""
    hold_until_s: keys.NotNegative
    """Time until which it holds [s]; not before the end of the rise."""
    decay_s: keys.Positive
    """Decay time [s]."""
    force_kN: keys.Three
    """Full force: north, east [kN], yaw [kN·m]."""

    @field_validator("hold_until_s")
    @classmethod
    def _require_hold_end_after_rise(cls, hold_until_s: float, info: ValidationInfo) -> float:
        """Return the end of a squall's hold [s]; ValueError where that is before it has risen."""
        risen_s = info.data.get("start_s", 0.0) + info.data.get("rise_s", 0.0)
        if hold_until_s < risen_s:
            raise ValueError(f"start_s + rise_s = {risen_s:g} s or later")
        return hold_until_s

    def build_squall(self, scale: Froude) -> Squall:
        """Return the squall of a scenario file's table in SI units, Froude-scaled."""
        return Squall(
            self.start_s * scale.time_and_speed_factor,
            self.rise_s * scale.time_and_speed_factor,
            self.hold_until_s * scale.time_and_speed_factor,
            self.decay_s * scale.time_and_speed_factor,
            _PER_KN * np.array(self.force_kN) * scale.force_and_moment_factors,
        )


class WindTable(FileModel):
    """Mean wind 10 m above the water, and the gusts along it."""

    speed_mps: keys.NotNegative
    """Mean speed 10 m above the water [m/s]."""
    from_deg: keys.Degrees
    """Compass direction it comes from [°]."""
    gusts: Literal["norsok", "harris", "none"] = "norsok"
    """Spectrum of the gusts; none: a steady wind."""

    def build_wind(self, scale: Froude) -> Wind:
        """Return the wind of a scenario file's table in SI units, Froude-scaled."""
        return Wind(
            self.speed_mps * scale.time_and_speed_factor,
            convert_from_deg_to_towards_rad(self.from_deg),
            self.gusts,
            scale,
        )


class CurrentTable(FileModel):
    """Steady ocean current: speed and direction."""

    speed_mps: keys.NotNegative
    """Speed [m/s]."""
    towards_deg: keys.Degrees
    """Compass direction it sets towards [°]."""

    def build_current(self, scale: Froude) -> Current:
        """Return the current of a scenario file's table in SI units, Froude-scaled."""
        return Current(self.speed_mps * scale.time_and_speed_factor, math.radians(self.towards_deg))


class MotionTable(FileModel):
    """Wave-frequency ship motion in the measurement, per metre of wave amplitude."""

    along_m_per_m: keys.Number = 0.6
    """Motion along the waves [m] per metre of wave amplitude; that of the water is 1."""
    across_m_per_m: keys.Number = 0.2
    """Motion across the waves [m] per metre of wave amplitude."""
    heading_deg_per_m: keys.Number = 0.3
    """Heading [°] per metre of wave amplitude."""


class WavesTable(FileModel):
    """Irregular sea with a JONSWAP spectrum, and its effects on ship and measurement."""

    hs_m: keys.NotNegative
    """Significant height [m]."""
    tp_s: keys.Positive
    """Peak period [s]."""
    from_deg: keys.Degrees
    """Compass direction they come from [°]."""
    gamma: Annotated[float, Field(ge=1, le=7)] = 3.3
    """Peakedness of the JONSWAP spectrum; 1 is Pierson-Moskowitz."""
    drift: bool = True
    """Apply the slow drift force to the ship."""
    motion: MotionTable | None = None
    """First-order wave motion in the measurement; {}: with the defaults. Without this key: none."""

    def build_sea(self, scale: Froude) -> Sea:
        """Return the sea of a scenario file's table in SI units, Froude-scaled."""
        to_rad = convert_from_deg_to_towards_rad(self.from_deg)
        return Sea(
            self.hs_m * scale.length_factor,
            self.tp_s * scale.time_and_speed_factor,
            to_rad,
            self.gamma,
            scale,
        )

    def build_wave_frequency_motion_if_any(self, scale: Froude) -> FirstOrderMotion | None:
        """Return the wave-frequency motion in SI units; None where the measurement shows none."""
        motion = self.motion
        if motion is None:
            return None
        sea, turn = (
            self.build_sea(scale),
            math.radians(motion.heading_deg_per_m) / scale.length_factor,
        )
        return FirstOrderMotion(sea, motion.along_m_per_m, motion.across_m_per_m, turn)

    def compute_wave_frequency_motion_std(self, scale: Froude) -> Vector:
        """Return the standard deviation (3,) [m, m, rad] of the wave-frequency motion."""
        motion = self.motion or MotionTable()
        elevation = 0.25 * self.hs_m * scale.length_factor
        widest = max(abs(motion.along_m_per_m), abs(motion.across_m_per_m))
        turn = abs(math.radians(motion.heading_deg_per_m)) / scale.length_factor
        return elevation * np.array([widest, widest, turn])


class NoiseTable(FileModel):
    """Standard deviations of the white noise of the sensors."""

    position_m: keys.NotNegative
    """Standard deviation of the noise of north and east [m]."""
    heading_deg: keys.NotNegative
    """Standard deviation of the noise of the heading [°]."""

    def compute_sensor_noise_std(self, scale: Froude) -> Vector:
        """Return the standard deviations (3,) [m, m, rad] of the sensor noise."""
        metres = self.position_m * scale.length_factor
        return np.array([metres, metres, math.radians(self.heading_deg)])


class EnvironmentTable(FileModel):
    """Slow forces b(t) = g(t)·(mean + amplitude·sin(2πt/T + phase)), and the rest of the weather.

    North, east, yaw, in kN and kN·m.
    """

    mean_kN: keys.Three = [0.0, 0.0, 0.0]
    """Constant part of the slow force: north, east [kN], yaw [kN·m]."""
    amplitude_kN: keys.Three = [0.0, 0.0, 0.0]
    """Amplitude of its sine: north, east [kN], yaw [kN·m]."""
    period_s: keys.ThreePositive = [60.0, 60.0, 60.0]
    """Period T of each sine [s]."""
    phase_rad: keys.Three = [0.0, 1.0, 2.0]
    """Phase of each sine [rad]."""
    ramp_s: keys.NotNegative = 0.0
    """g(t) grows from 0 to 1 in this time [s]; 0: it is 1 from the start.

    It multiplies slow forces, speeds of wind and current, and the wave height that causes drift:
    forces of wind and drift grow with g², that of the current with g (linear damping) or about g²
    (cross-flow drag). Squalls, wave motion and noise are not ramped."""
    seed: keys.Count = 0
    """Seed of gusts, waves and noise: the same seed gives the same weather."""
    squalls: list[SquallTable] = []
    """Squalls, one table each."""
    wind: WindTable | None = None
    """Wind; needs the vessel's windage."""
    current: CurrentTable | None = None
    """A current."""
    waves: WavesTable | None = None
    """Waves; their drift needs the vessel's reflection."""
    noise: NoiseTable | None = None
    """Noise of the sensors."""

    def build_environment(self, scale: Froude) -> Environment:
        """Return all weather of a scenario file's table in SI units, Froude-scaled."""
        sea = self.waves.build_sea(scale) if self.waves else None
        return Environment(
            _PER_KN * np.array(self.mean_kN) * scale.force_and_moment_factors,
            _PER_KN * np.array(self.amplitude_kN) * scale.force_and_moment_factors,
            np.array(self.period_s) * scale.time_and_speed_factor,
            np.array(self.phase_rad),
            self.ramp_s * scale.time_and_speed_factor,
            squalls=tuple(squall.build_squall(scale) for squall in self.squalls),
            wind=self.wind.build_wind(scale) if self.wind else None,
            current=self.current.build_current(scale) if self.current else None,
            drift=WaveDrift(sea) if sea and self.waves and self.waves.drift else None,
            motion=self.waves.build_wave_frequency_motion_if_any(scale) if self.waves else None,
            noise=SensorNoise(self.noise.compute_sensor_noise_std(scale)) if self.noise else None,
            seed=self.seed,
        )
