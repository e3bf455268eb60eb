"""What happens to a commanded force on its way to the hull: lost thrust and dead time.

τ_hull(k) = efficiency · τ(k − delay),   τ = 0 before the start
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.ship.layout import AXES
from dpbench.ship.validation import finite_array


@dataclass(frozen=True, eq=False)
class Actuators:
    """Imperfect thrusters behind the controller's limits: those hold for the command τ.

    Parameters
    ----------
    efficiency : (3,) share of the command that reaches the hull in surge, sway, yaw, 0 to 1.
    delay_samples : whole samples between command and force.
    where : the file named in errors.
    """

    efficiency: Vector = field(default_factory=lambda: np.ones(AXES))
    delay_samples: int = 0
    where: str = "Actuators"

    def __post_init__(self) -> None:
        share = finite_array(self.where, "efficiency", self.efficiency, (AXES,))
        object.__setattr__(self, "efficiency", share)
        if not ((share >= 0).all() and (share <= 1).all()):
            raise InputError(self.where, "efficiency", share.tolist(), "shares from 0 to 1")
        if not (self.delay_samples >= 0 and self.delay_samples == int(self.delay_samples)):
            allowed = "whole samples, 0 or more"
            raise InputError(self.where, "delay_samples", self.delay_samples, allowed)


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
