"""What happens to a commanded force on its way to the hull: lost thrust and dead time.

τ_hull(k) = efficiency · τ(k − delay),   τ = 0 before the start
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dpbench.arrays import Vector
from dpbench.ship.layout import AXES


@dataclass(frozen=True, eq=False)
class Actuators:
    """Imperfect thrusters behind the controller's limits: those hold for the command τ.

    Parameters
    ----------
    efficiency : (3,) share of the command that reaches the hull in surge, sway, yaw, 0 to 1.
    delay_samples : whole samples between command and force.
    """

    efficiency: Vector = field(default_factory=lambda: np.ones(AXES))
    delay_samples: int = 0


class Thrust:
    """The state of the actuators in one run: a ring of the commands still under way."""

    def __init__(self, actuators: Actuators) -> None:
        self._efficiency = actuators.efficiency
        self._ring = np.zeros((actuators.delay_samples + 1, AXES))
        self._newest = 0
        self._delivered = np.zeros(AXES)

    def deliver(self, tau: Vector) -> Vector:
        """The force on the hull in this sample for the command tau (3,); valid until the next."""
        self._ring[self._newest] = tau
        self._newest = (self._newest + 1) % len(self._ring)
        # After the step the place to be written next holds the oldest command.
        np.multiply(self._efficiency, self._ring[self._newest], out=self._delivered)
        return self._delivered
