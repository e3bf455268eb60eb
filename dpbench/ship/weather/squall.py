"""A squall: a force that rises, stays and decays along straight lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dpbench.arrays import Matrix, Vector


@dataclass(frozen=True, eq=False)
class Squall:
    """One squall, added to the slow forces.

    Parameters
    ----------
    start_s, rise_s : it grows from zero at start_s to the full force at start_s + rise_s [s].
    hold_until_s, decay_s : it stays until hold_until_s and is gone decay_s later [s].
    force : (3,) full force, north, east, yaw [N, N, N·m].
    """

    start_s: float
    rise_s: float
    hold_until_s: float
    decay_s: float
    force: Vector

    def at(self, t_s: ArrayLike) -> Matrix:
        """Return the force at the times t_s (...,): (..., 3) [N, N, N·m]."""
        end_s = self.hold_until_s + self.decay_s
        corners = [self.start_s, self.start_s + self.rise_s, self.hold_until_s, end_s]
        share = np.interp(np.asarray(t_s, dtype=np.float64), corners, [0.0, 1.0, 1.0, 0.0])
        return np.multiply.outer(share, self.force)
