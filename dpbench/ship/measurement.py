"""What is measured of the ship: its state, the motion of the waves on top of it, and noise.

measured = [ν; η] + [R(ψ)ᵀ η̇_w; η_w] + [0; noise]
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Vector
from dpbench.kernel_cache import njit
from dpbench.ship.environment import Environment
from dpbench.ship.layout import (
    AXES,
    HEADING,
    RATE_EAST,
    RATE_HEADING,
    RATE_NORTH,
    STATE,
    R,
    U,
    V,
)


@njit(cache=True)
def _sense(state, motion, noise, measured):  # type: ignore[no-untyped-def] # compiled by numba
    """Write the measurement (6,) of state (6,), motion (6,) in NED and noise (3,)."""
    c, s = np.cos(state[HEADING]), np.sin(state[HEADING])
    measured[U] = state[U] + c * motion[RATE_NORTH] + s * motion[RATE_EAST]
    measured[V] = state[V] - s * motion[RATE_NORTH] + c * motion[RATE_EAST]
    measured[R] = state[R] + motion[RATE_HEADING]
    for i in range(AXES):
        measured[AXES + i] = state[AXES + i] + motion[i] + noise[i]


class Sensors:
    """The sensors in one run of `samples` samples; without wave motion and noise they are ideal."""

    def __init__(self, environment: Environment, samples: int, sample_s: float) -> None:
        self._ideal = environment.motion is None and environment.noise is None
        self._motion = environment.measured_motion(samples, sample_s)
        self._noise = environment.noise_table(samples)
        self._measured = np.empty(STATE)

    def sense(self, state: Vector, k: int) -> Vector:
        """[u, v, r, n, e, ψ] as measured at sample k; valid until the next."""
        if self._ideal:
            return state
        _sense(state, self._motion[k], self._noise[k], self._measured)
        return self._measured
