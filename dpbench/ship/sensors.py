"""White noise of the position reference and the gyrocompass, one draw per sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.weather.streams import stream


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Independent Gaussian noise on the measured pose.

    Parameters
    ----------
    std : (3,) standard deviations of north, east, heading [m, m, rad].
    """

    std: Vector

    def table(self, samples: int, seed: int) -> Matrix:
        """Draw the noise (samples, 3) [m, m, rad]; a longer table begins with the shorter one."""
        return np.asarray(self.std * stream(seed, "noise").standard_normal((samples, 3)))
