"""The tables of a scenario file that say where the ship starts and where it shall go."""

from __future__ import annotations

import numpy as np
from pydantic import SerializerFunctionWrapHandler, model_serializer

from dpbench.arrays import Vector
from dpbench.mpc.reference import ReferenceFilter
from dpbench.scenario.key_types import Degrees, Number, Positive, Speed, TurnRate
from dpbench.scenario.problem_files import FileModel
from dpbench.ship.froude import Froude

SPEEDS = ("surge_mps", "sway_mps", "yaw_degps")
"""The keys of `[start]` that a ship at rest leaves out."""


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

    def smoothed(self, scale: Froude, where: str) -> ReferenceFilter | None:
        """The filter in SI; None for none."""
        if self.filter is None:
            return None
        return ReferenceFilter(self.filter.period_s * scale.time, self.filter.damping, where)
