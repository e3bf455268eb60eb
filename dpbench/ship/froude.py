"""Froude's similarity: what a full-size scenario becomes for a model ship of scale 1 : λ.

    length 1/λ,   time and speed 1/√λ,   mass and force 1/λ³,   moment 1/λ⁴      (same density)

Accelerations and angles stay, so the model sees the same sea (Newman 1977, section 2.4).
"""

import math
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector


@dataclass(frozen=True)
class Froude:
    """Froude scaling factors from full size to a model of scale 1 : ratio."""

    ratio: float = 1.0

    @property
    def length_factor(self) -> float:
        """Froude scale factor of lengths, model over full size."""
        return 1.0 / self.ratio

    @property
    def time_and_speed_factor(self) -> float:
        """Froude scale factor of times, which is also that of speeds."""
        return 1.0 / math.sqrt(self.ratio)

    @property
    def force_and_moment_factors(self) -> Vector:
        """Froude scale factors (3,) of surge force, sway force and yaw moment."""
        return np.array([self.ratio**-3, self.ratio**-3, self.ratio**-4])

    @property
    def velocity_factors(self) -> Vector:
        """Froude scale factors (3,) of surge speed, sway speed and yaw rate."""
        return np.array(
            [
                self.time_and_speed_factor,
                self.time_and_speed_factor,
                1.0 / self.time_and_speed_factor,
            ]
        )

    @property
    def pose_factors(self) -> Vector:
        """Froude scale factors (3,) of north, east and heading."""
        return np.array([self.length_factor, self.length_factor, 1.0])


FULL_SIZE = Froude()
