"""Nonlinear drag of a hull in the water: cross flow in sway and yaw, resistance in surge.

For the velocity (u, v, r) through the water the hull meets the force −F (Fossen 2021, sections 6.4
and 10.3; strip integral as in `crossFlowDrag.m` of MSS):

    F = S D S ν + [½ρ c B T V u,  ½ρ C_d T̄ ∫ w|w| dx,  ½ρ C_d T̄ ∫ x w|w| dx],   w = v + x r
    V = √(u² + v²),   S = diag(√e, √e, 1),   e = exp(−V / V_0),   V_0 = 0.004 √(gL)

C_d is Hoerner's two-dimensional coefficient at B/2T, c = 0.07 that of DNV-ST-0111, 3.6. The strips
are those of a rectangle of area A_c = T̄ L_os about x_c, where the integrals have a closed form.

The linear damping D is identified at some cm/s and fades with speed; S keeps S D S positive
definite. Its yaw part stays, as published yaw damping is ten times the strip integral of a turn.
All of it follows Froude's law. Munk's moment is left out with the Coriolis terms (paper eq. 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.layout import R, U, V
from dpbench.ship.weather.waves import GRAVITY, WATER_DENSITY

FADING_FROUDE_NUMBER = 0.004
"""V_0 over √(gL): 0.11 m/s on a ship of 76 m, so that 1 % of D is left at 0.5 m/s."""
SURGE_COEFFICIENT = 0.07  # Of ½ρ B T V u (DNV-ST-0111, section 3.6)
_HOERNER = np.array(
    [
        [0.2, 0.35, 0.47, 0.5, 0.65, 0.83, 1.0, 1.3, 1.65, 2.0, 2.5, 3.0, 4.0],
        [1.96, 1.90, 1.60, 1.20, 1.00, 0.88, 0.825, 0.76, 0.69, 0.65, 0.61, 0.587, 0.56],
    ]
)
"""B/2T and C_d, read off the curve of Hoerner (Leite et al. 1998, Applied Ocean Research 20)."""


def compute_cross_flow_drag_coefficient(breadth_m: float, draught_m: float) -> float:
    """Return Hoerner's two-dimensional drag coefficient C_d of a hull section."""
    return float(np.interp(0.5 * breadth_m / draught_m, *_HOERNER))


@dataclass(frozen=True)
class HullDrag:
    """Drag of a hull beside its linear damping.

    along, across : force over V u and over |v| v [kg/m].
    centre_m, length_m : the strips of the hull, about their centre.
    fading_mps : speed V_0 at which 1/e of the linear damping is left.
    """

    along: float
    across: float
    centre_m: float
    length_m: float
    fading_mps: float

    @classmethod
    def from_hull(cls, hull: CapabilityHull) -> HullDrag:
        """Return the drag of a hull from its dimensions below the water."""
        half, section = 0.5 * WATER_DENSITY, hull.breadth_m * hull.draught_m
        coefficient = compute_cross_flow_drag_coefficient(hull.breadth_m, hull.draught_m)
        return cls(
            along=half * SURGE_COEFFICIENT * section,
            across=half * coefficient * hull.submerged_m2,
            centre_m=hull.current_x_m,
            length_m=hull.submerged_length_m,
            fading_mps=FADING_FROUDE_NUMBER * math.sqrt(GRAVITY * hull.length_m),
        )

    def copy_with_scaled_force(self, factor: float) -> HullDrag:
        """Return the drag of a hull that meets `factor` times the force."""
        return replace(self, along=factor * self.along, across=factor * self.across)

    def to_kernel_array(self) -> Vector:
        """Return the hull's numbers (5,) that the drag kernels read."""
        half_m = 0.5 * self.length_m
        return np.array([1.0 / self.fading_mps, self.along, self.across, self.centre_m, half_m])

    def compute_drag_force(self, D: Matrix, velocity: Vector) -> Vector:
        """Return the force F (3,) [N, N, N·m] that keeps a velocity (3,) through the water."""
        force = np.empty(3)
        # Numba is imported where a force is asked for: commands that only read a vessel do without.
        write_drag = import_module("dpbench.ship.drag_kernel").write_drag_force
        write_drag(velocity[U], velocity[V], velocity[R], D, self.to_kernel_array(), force)
        return force
