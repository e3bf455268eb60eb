"""The tables of vessel and scenario files: keys, units and bounds, as a person writes them.

Files speak the units of the trade (kN, kN·m, degrees); what they make is SI.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import (
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.mpc.reference import ReferenceFilter
from dpbench.scenario.key_types import (
    Count,
    Degrees,
    Horizon,
    NotNegative,
    Number,
    Percent,
    Positive,
    Seconds,
    Speed,
    ThreeByThree,
    ThreeLosses,
    ThreeNotNegative,
    ThreePositive,
    ThreeShares,
    TurnRate,
    Two,
)
from dpbench.scenario.problem_files import FileModel
from dpbench.scenario.weather_tables import EnvironmentTable
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel, bis_descaled, bis_descaled_damping
from dpbench.ship.weather.waves import WaveReflection
from dpbench.ship.weather.wind import Windage

SPEEDS = ("surge_mps", "sway_mps", "yaw_degps")
"""The keys of `[start]` that a ship at rest leaves out."""


class LimitsTable(FileModel):
    """Limits of the control force and of its rate."""

    surge_N: Two
    sway_N: Two
    yaw_Nm: Two
    rate_max_N_per_s: ThreePositive


class WindageTable(FileModel):
    """The hull above the water, as the wind sees it."""

    frontal_m2: Positive
    lateral_m2: Positive
    c_x: NotNegative = 0.7
    c_y: NotNegative = 0.9
    c_n: NotNegative = 0.095


class ReflectionTable(FileModel):
    """The hull at the waterline, as wave drift sees it."""

    breadth_m: Positive
    head: NotNegative = 0.42
    beam: NotNegative = 0.72
    yaw: NotNegative = 0.018


class VesselFile(FileModel):
    """`problems/vessels/*.toml`: matrices in SI, or dimensionless in the Bis system.

    `model_scale` λ makes it a model ship of scale 1 : λ, for which scenarios are scaled.
    """

    title: str
    source: str
    length_m: Positive
    limits: LimitsTable
    model_scale: Positive = 1.0
    windage: WindageTable | None = None
    reflection: ReflectionTable | None = None
    inertia: ThreeByThree | None = None
    damping: ThreeByThree | None = None
    mass_kg: Positive | None = None
    inertia_bis: ThreeByThree | None = None
    damping_bis: ThreeByThree | None = None

    @model_validator(mode="after")
    def _one_system(self) -> VesselFile:
        systems = ({"inertia", "damping"}, {"mass_kg", "inertia_bis", "damping_bis"})
        given = {key for key in systems[0] | systems[1] if getattr(self, key) is not None}
        if given not in systems:
            raise ValueError("either inertia and damping, or mass_kg, inertia_bis and damping_bis")
        return self

    def vessel(self, name: str, where: str) -> Vessel:
        """The vessel in SI units; raises InputError naming `where`."""
        if self.inertia is not None:
            M, D = np.array(self.inertia), np.array(self.damping)
        else:
            assert self.mass_kg is not None, "the validator demands it beside inertia_bis"
            M = bis_descaled(np.array(self.inertia_bis), self.mass_kg, self.length_m)
            D = bis_descaled_damping(np.array(self.damping_bis), self.mass_kg, self.length_m)
        ranges = np.array([self.limits.surge_N, self.limits.sway_N, self.limits.yaw_Nm])
        low, high = np.ascontiguousarray(ranges.T)
        rate = np.array(self.limits.rate_max_N_per_s)
        air, water = self.windage, self.reflection
        windage = Windage(**air.model_dump()) if air else None
        reflection = WaveReflection(**water.model_dump()) if water else None
        ship = (name, self.title, self.source, self.length_m, M, D, low, high, rate, where)
        try:
            return Vessel(*ship, windage, reflection)
        except InputError as error:
            bis = "" if self.inertia is not None else "_bis"
            keys = {"M": f"inertia{bis}", "D": f"damping{bis}", "tau_min, tau_max": "limits"}
            key = keys.get(error.key, error.key)
            raise InputError(where, key, error.found, error.allowed) from error


class EstimatorTable(FileModel):
    """What stands between the sensors and the controller.

    `measured`: nothing. The filters take period and size of the wave motion from the weather where
    the file does not give them.
    """

    kind: Literal["measured", "kalman", "passive"] = "measured"
    wave_filter: bool = True
    peak_period_s: Positive | None = None


class PlantTable(FileModel):
    """How the true ship differs from the controller's model of it."""

    mass_percent: Percent = 0.0
    damping_percent: Percent = 0.0
    thrust_loss_percent: ThreeLosses = [0.0, 0.0, 0.0]
    delay_samples: Count = 0


class FaultTable(FileModel):
    """From `at_s` on the limits of the force are this share of the vessel's, which is known to the
    controller at that sample."""

    at_s: NotNegative
    limit_share: ThreeShares


class OutputsTable(FileModel):
    """Softened bounds on the predicted output: watch circle around the reference, speed."""

    radius_m: Positive | None = None
    speed_mps: Positive | None = None

    @model_validator(mode="after")
    def _something(self) -> OutputsTable:
        if self.radius_m is None and self.speed_mps is None:
            raise ValueError("at least one of radius_m and speed_mps")
        return self


class ControllerTable(FileModel):
    """Horizons and weights; R either in SI or in multiples of 1/Δu_max²."""

    tuning: str
    prediction_horizon: Horizon
    control_horizon: Horizon
    output_weight: ThreeNotNegative
    # Positive move weights keep the QP strictly convex.
    move_weight: ThreePositive | None = None
    move_weight_relative: ThreePositive | None = None
    model_heading_deg: Degrees = 0.0
    linearisation: Literal["fixed", "each_step"] = "fixed"
    amplitude: Literal["reachable", "hard", "soft"] = "reachable"
    terminal: Literal["none", "riccati"] = "none"
    outputs: OutputsTable | None = None

    @model_validator(mode="after")
    def _consistent(self) -> ControllerTable:
        if (self.move_weight is None) == (self.move_weight_relative is None):
            raise ValueError("exactly one of move_weight and move_weight_relative")
        return self

    @field_validator("control_horizon")
    @classmethod
    def _within_prediction(cls, N_c: int, info: ValidationInfo) -> int:
        N_p = info.data.get("prediction_horizon", N_c)
        if N_c > N_p:
            raise ValueError(f"1 up to prediction_horizon ({N_p})")
        return N_c


class PoseTable(FileModel):
    """A position and heading."""

    north_m: Number = 0.0
    east_m: Number = 0.0
    heading_deg: Degrees = 0.0

    def pose(self) -> Vector:
        """[n, e, ψ] in m, m, rad."""
        return np.array([self.north_m, self.east_m, np.radians(self.heading_deg)])


class StartTable(PoseTable):
    """Where the ship is at the first sample, and how it moves: over ground, along its own axes."""

    surge_mps: Speed = 0.0
    sway_mps: Speed = 0.0
    yaw_degps: TurnRate = 0.0

    def velocity(self) -> Vector:
        """[u, v, r] in m/s, m/s, rad/s."""
        return np.array([self.surge_mps, self.sway_mps, np.radians(self.yaw_degps)])

    @model_serializer(mode="wrap")
    def _zero_unsaid(self, write: SerializerFunctionWrapHandler) -> dict[str, float]:
        """Rest is not written: documents of before there was a speed stay equal, byte for byte."""
        table: dict[str, float] = write(self)
        return {key: value for key, value in table.items() if value or key not in SPEEDS}


class FilterTable(FileModel):
    """A third-order reference filter, which starts at rest at the ship's start."""

    period_s: Positive
    damping: Positive = 1.0


class ReferenceTable(PoseTable):
    """The set-point, whether it is filtered, and whether the controller sees it coming."""

    filter: FilterTable | None = None
    preview: bool = False

    def smoothed(self, scale: Froude) -> ReferenceFilter | None:
        """The filter in SI; None for none."""
        if self.filter is None:
            return None
        return ReferenceFilter(self.filter.period_s * scale.time, self.filter.damping)


class ScenarioFile(FileModel):
    """`problems/scenarios/*.toml`."""

    title: str
    shows: str
    vessel: str
    sample_s: Seconds
    duration_s: Seconds
    controller: ControllerTable
    environment: EnvironmentTable
    start: StartTable = StartTable()
    reference: ReferenceTable = ReferenceTable()
    estimator: EstimatorTable = EstimatorTable()
    plant: PlantTable = PlantTable()
    faults: list[FaultTable] = []
