"""The tables of vessel and scenario files: keys, units and bounds, as a person writes them.

Files speak the units of the trade (kN, kN·m, degrees); what they make is SI.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from dpbench.errors import InputError
from dpbench.problem_files import FileModel
from dpbench.qp.program import Vector
from dpbench.ship.vessel import Vessel, bis_descaled, bis_descaled_damping

# Bounds far beyond any ship, so that a slip of the keyboard is an error and not an overflow.
Number = Annotated[float, Field(ge=-1e15, le=1e15)]
Positive = Annotated[float, Field(gt=0, le=1e15)]
NotNegative = Annotated[float, Field(ge=0, le=1e15)]
Seconds = Annotated[float, Field(ge=1e-4, le=1e6)]
Degrees = Annotated[float, Field(ge=-36000, le=36000)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Two = Annotated[list[Number], Field(min_length=2, max_length=2)]
ThreeByThree = Annotated[list[Three], Field(min_length=3, max_length=3)]
ThreePositive = Annotated[list[Positive], Field(min_length=3, max_length=3)]
ThreeNotNegative = Annotated[list[NotNegative], Field(min_length=3, max_length=3)]
Horizon = Annotated[int, Field(ge=1, le=1000)]


class LimitsTable(FileModel):
    """Limits of the control force and of its rate."""

    surge_N: Two
    sway_N: Two
    yaw_Nm: Two
    rate_max_N_per_s: ThreePositive


class VesselFile(FileModel):
    """`problems/vessels/*.toml`: matrices in SI, or dimensionless in the Bis system."""

    title: str
    source: str
    length_m: Positive
    limits: LimitsTable
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
        low, high = np.array([self.limits.surge_N, self.limits.sway_N, self.limits.yaw_Nm]).T
        rate = np.array(self.limits.rate_max_N_per_s)
        try:
            return Vessel(
                name, self.title, self.source, self.length_m, M, D, low, high, rate, where
            )
        except InputError as error:
            bis = "" if self.inertia is not None else "_bis"
            keys = {"M": f"inertia{bis}", "D": f"damping{bis}", "tau_min, tau_max": "limits"}
            key = keys.get(error.key, error.key)
            raise InputError(where, key, error.found, error.allowed) from error


class PoseTable(FileModel):
    """A position and heading."""

    north_m: Number = 0.0
    east_m: Number = 0.0
    heading_deg: Degrees = 0.0

    def pose(self) -> Vector:
        """[n, e, ψ] in m, m, rad."""
        return np.array([self.north_m, self.east_m, np.radians(self.heading_deg)])


class EnvironmentTable(FileModel):
    """b(t) = g(t)·(mean + amplitude·sin(2πt/T + phase)), north, east, yaw, in kN and kN·m."""

    mean_kN: Three
    amplitude_kN: Three
    period_s: ThreePositive
    phase_rad: Three = [0.0, 1.0, 2.0]
    ramp_s: NotNegative = 0.0


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


class ScenarioFile(FileModel):
    """`problems/scenarios/*.toml`."""

    title: str
    shows: str
    vessel: str
    sample_s: Seconds
    duration_s: Seconds
    controller: ControllerTable
    environment: EnvironmentTable
    start: PoseTable = PoseTable()
    reference: PoseTable = PoseTable()
