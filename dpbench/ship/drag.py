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

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.kernel_cache import njit
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

_FADING, _ALONG, _ACROSS, _CENTRE, _HALF_LENGTH = range(5)
"""Entries of the array that the kernel reads."""


def cross_flow_coefficient(breadth_m: float, draught_m: float) -> float:
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
    def of(cls, hull: CapabilityHull) -> HullDrag:
        """Return the drag of a hull from its dimensions below the water."""
        half, section = 0.5 * WATER_DENSITY, hull.breadth_m * hull.draught_m
        coefficient = cross_flow_coefficient(hull.breadth_m, hull.draught_m)
        return cls(
            along=half * SURGE_COEFFICIENT * section,
            across=half * coefficient * hull.submerged_m2,
            centre_m=hull.current_x_m,
            length_m=hull.submerged_length_m,
            fading_mps=FADING_FROUDE_NUMBER * math.sqrt(GRAVITY * hull.length_m),
        )

    def scaled(self, factor: float) -> HullDrag:
        """Return the drag of a hull that meets `factor` times the force."""
        return replace(self, along=factor * self.along, across=factor * self.across)

    def to_array(self) -> Vector:
        """Return the numbers (5,) that the kernels read."""
        half_m = 0.5 * self.length_m
        return np.array([1.0 / self.fading_mps, self.along, self.across, self.centre_m, half_m])

    def force(self, D: Matrix, velocity: Vector) -> Vector:
        """Return the force F (3,) [N, N, N·m] that keeps a velocity (3,) through the water."""
        force = np.empty(3)
        write_drag(velocity[U], velocity[V], velocity[R], D, self.to_array(), force)
        return force


@njit(cache=True, error_model="numpy", fastmath=False)
def write_drag(u, v, r, D, hull, out):  # type: ignore[no-untyped-def] # compiled by numba
    """Write the drag F (3,) at a velocity through the water to out."""
    speed = np.sqrt(u * u + v * v)
    root = np.exp(-0.5 * speed * hull[_FADING])
    u_left, v_left = root * u, root * v
    middle, edge = v + hull[_CENTRE] * r, hull[_HALF_LENGTH] * r
    force, moment = _mean_cross_flow(middle, edge)
    across = hull[_ACROSS] * force
    out[U] = root * (D[U, U] * u_left + D[U, V] * v_left + D[U, R] * r)
    out[V] = root * (D[V, U] * u_left + D[V, V] * v_left + D[V, R] * r)
    out[R] = D[R, U] * u_left + D[R, V] * v_left + D[R, R] * r
    out[U] += hull[_ALONG] * speed * u
    out[V] += across
    out[R] += hull[_CENTRE] * across + hull[_ACROSS] * hull[_HALF_LENGTH] * moment


@njit(cache=True, error_model="numpy", fastmath=False)
def _mean_cross_flow(middle, edge):  # type: ignore[no-untyped-def] # compiled by numba
    """Return the means of w|w| and t w|w| over −1 ≤ t ≤ 1, of w = middle + edge t."""
    aft, fore = middle - edge, middle + edge
    if aft * fore >= 0.0:
        size = abs(middle)
        return middle * size + edge * edge / 3.0 * np.sign(middle), 2.0 / 3.0 * size * edge
    aft_cubed, fore_cubed = abs(aft) ** 3, abs(fore) ** 3
    grown = fore_cubed - aft_cubed
    turned = 0.25 * (fore_cubed * fore - aft_cubed * aft) - middle / 3.0 * grown
    return grown / (6.0 * edge), turned / (2.0 * edge * edge)
