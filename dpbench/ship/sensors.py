"""White noise of the position reference and the gyrocompass, one draw per sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.validation import finite_array, not_negative
from dpbench.ship.weather.streams import stream


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Independent Gaussian noise on the measured pose.

    Parameters
    ----------
    std : (3,) standard deviations of north, east, heading [m, m, rad].
    where : the file named in errors.
    """

    std: Vector
    where: str = "SensorNoise"

    def __post_init__(self) -> None:
        object.__setattr__(self, "std", finite_array(self.where, "std", self.std, (3,)))
        not_negative(self.where, std=float(self.std.min()))

    def table(self, samples: int, seed: int) -> Matrix:
        """(samples, 3) [m, m, rad]; a longer table begins with the shorter one."""
        return np.asarray(self.std * stream(seed, "noise").standard_normal((samples, 3)))
