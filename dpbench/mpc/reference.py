"""The reference over time: a setpoint, or the trajectory of a reference filter towards it.

    η_d''' + (2ζ+1) ω η_d'' + (2ζ+1) ω² η_d' + ω³ η_d = ω³ η_r        (Fossen 2021, section 12.1.1)

The third-order filter gives a reference with continuous acceleration, which a ship can follow.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from dpbench.arrays import Matrix, Vector
from dpbench.ship.estimation.estimator import shift_heading_near
from dpbench.ship.layout import YAW

FILTER_ORDER = 3


@dataclass(frozen=True)
class ReferenceFilter:
    """Natural period [s] and relative damping of the filter that smooths the reference."""

    period_s: float
    damping: float = 1.0


def shift_target_heading_near_start(target: Vector, start: Vector) -> Vector:
    """Return the pose `target` (3,) with its heading shifted to within π of that of `start`."""
    reference = target.copy()
    reference[YAW] = shift_heading_near(target[YAW], start[YAW])
    return reference


def build_smoothed_reference_table(
    start: Vector,
    target: Vector,
    samples: int,
    sample_s: float,
    smoothed: ReferenceFilter | None = None,
) -> Matrix:
    """Return the reference (samples, 3), smoothed from rest at the start or the target at once."""
    goal = shift_target_heading_near_start(target, start)
    table = np.tile(goal, (samples, 1))
    if smoothed is None:
        return table
    omega, zeta = 2 * np.pi / smoothed.period_s, smoothed.damping
    A = np.array([[0, 1, 0], [0, 0, 1], [-(omega**3), -(2 * zeta + 1) * omega**2, 0]])
    A[2, 2] = -(2 * zeta + 1) * omega
    advance = scipy.linalg.expm(A * sample_s)
    # Distance to the goal, its first and second derivative; the goal is the filter's equilibrium.
    away = np.zeros((FILTER_ORDER, len(goal)))
    away[0] = start - goal
    for k in range(samples):
        table[k] = goal + away[0]
        away = advance @ away
    return table
