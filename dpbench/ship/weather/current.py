"""A steady irrotational current, felt as velocity relative to the water.

    M ν̇ + D (ν − ν_c) = τ + …,   ν_c = R(ψ)ᵀ [V_c cos β, V_c sin β, 0]

Damping is the vessel's own linear D, meant for low relative speed; the term of added mass in
ν̇_c, which only a turning ship meets, is left out with the Coriolis terms that the paper leaves
out (eq. 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Vector


@dataclass(frozen=True)
class Current:
    """A current of constant speed and direction.

    Parameters
    ----------
    speed_mps : V_c [m/s].
    to_rad : β, where it sets *to*, clockwise from north [rad]; sailors name it the same way.
    """

    speed_mps: float
    to_rad: float

    @property
    def velocity(self) -> Vector:
        """(2,) north and east [m/s]."""
        return self.speed_mps * np.array([np.cos(self.to_rad), np.sin(self.to_rad)])
