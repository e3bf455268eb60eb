"""Estimators: from the measurement to the state the controller acts on (paper Figure 2).

    estimate [u, v, r, n, e, ψ](t_k) = f(measured(t_0..t_k), τ(t_0..t_k))

An estimator keeps the low-frequency motion, which the thrusters can and should counteract, and
leaves out the first-order wave motion, which they cannot.
"""

import math
from abc import ABC, abstractmethod

import numpy as np

from dpbench.arrays import Vector
from dpbench.errors import ShapeError
from dpbench.kernel_cache import njit
from dpbench.ship.layout import HEADING, STATE

TURN = 2.0 * math.pi


@njit(cache=True)
def shift_heading_near(heading_rad, near_rad):  # type: ignore[no-untyped-def] # compiled by numba
    """Return heading_rad shifted by whole turns to within π of near_rad."""
    return heading_rad + TURN * np.rint((near_rad - heading_rad) / TURN)


class Estimator(ABC):
    """Estimator of the ship's low-frequency state from measured position and heading.

    Order in the loop: `start_from_state` at t_0, then one `update_and_return_state` per sample, the
    first with the measurement at t_0 itself: it advances nothing, and its τ is not read.
    """

    change: Vector
    """(6,) [Δu, Δv, Δr, Δn, Δe, Δψ] over the sample before the last update, zero at the first.

    The law takes it for Δν, Δη. A filter's is free of the corrections between two of its
    estimates (`observer`). Overwritten by the next update.
    """

    @abstractmethod
    def start_from_state(self, state: Vector) -> None:
        """Set the estimate to the state (6,) = [u, v, r, n, e, ψ] at the start of a run."""

    @abstractmethod
    def update_and_return_state(self, measured: Vector, tau: Vector) -> Vector:
        """Advance by a measurement and applied force; return the low-frequency state (6,).

        measured : (6,) [u, v, r, n, e, ψ] or (3,) [n, e, ψ], wave motion and noise included; ψ may
            be wrapped. A filter reads the pose only: there is no sensor of low-frequency speed.
        tau : (3,) force applied over the sample before this measurement [N, N, N·m].
        """


class MeasuredState(Estimator):
    """Placeholder estimator that returns the measured state, wave motion included."""

    def __init__(self) -> None:
        self._estimate, self.change = np.zeros(STATE), np.zeros(STATE)
        self._first = True

    def start_from_state(self, state: Vector) -> None:
        """Set the last measured state to the state (6,) at the start of a run."""
        self._estimate[...] = state
        self.change[...] = 0.0
        self._first = True

    def update_and_return_state(self, measured: Vector, tau: Vector) -> Vector:
        """Return the measurement as the estimate; store its change since the last one."""
        if measured.shape != (STATE,):
            raise ShapeError.from_shapes("MeasuredState", "measured", measured.shape, "shape (6,)")
        estimate, change = self._estimate, self.change
        heading_before = estimate[HEADING]
        np.subtract(measured, estimate, out=change)
        turns = TURN * round(change[HEADING] / TURN)
        estimate[...] = measured
        estimate[HEADING] -= turns
        change[HEADING] = estimate[HEADING] - heading_before
        if self._first:
            change[...] = 0.0
            self._first = False
        return estimate
