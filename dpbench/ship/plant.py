"""The ship itself: nonlinear 3-DOF motion integrated with fixed-step Runge-Kutta 4.

    η̇ = R(ψ) ν,      M ν̇ + D ν = τ + R(ψ)ᵀ b(t)        (paper eq. 3-4, b in the NED frame)

In wind, current or wave drift the damping acts on the velocity through the water, D (ν − ν_c), and
the loads of `wind` and `waves` join the force. State (6,) = [u, v, r, n, e, ψ] in m/s, m/s, rad/s,
m, m, rad; ψ is never wrapped here. The force τ is held over the sample; the weather is read at the
stage times from a table (`Environment.stage_table`).
"""

from __future__ import annotations

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.ship.actuators import Actuators, Thrust
from dpbench.ship.kernels import STAGES, advance, advance_loaded
from dpbench.ship.layout import STATE
from dpbench.ship.vessel import Vessel

SUBSTEPS = 10
"""Runge-Kutta sub-steps per sample: at 0.3 s one sample is exact to 1e-10 m for every vessel."""


class Plant:
    """The true ship, advanced one sample at a time.

    Parameters
    ----------
    vessel : its M and D, which may differ from those of the controller's model.
    state : (6,) initial [u, v, r, n, e, ψ], copied.
    sample_s : length of a sample [s].
    substeps : Runge-Kutta steps per sample.
    loads : (6,) from `Environment.load_coefficients`, which is None where the weather has neither
        wind nor current nor drift.
    actuators : what is lost or late between the command and the hull; None for nothing.
    """

    def __init__(
        self,
        vessel: Vessel,
        state: Vector,
        sample_s: float,
        substeps: int = SUBSTEPS,
        *,
        loads: Vector | None = None,
        actuators: Actuators | None = None,
    ) -> None:
        self.state: Vector = np.array(state, dtype=np.float64)
        self._Minv: Matrix = np.ascontiguousarray(np.linalg.inv(vessel.M))
        self._MinvD: Matrix = np.ascontiguousarray(np.linalg.solve(vessel.M, vessel.D))
        self._loads = None if loads is None else np.array(loads, dtype=np.float64)
        self._thrust = None if actuators is None else Thrust(actuators)
        self._h = sample_s / substeps
        self._work = np.empty((STAGES + 1, STATE))

    def advance(self, tau: Vector, stages: Matrix) -> None:
        """One sample under the commanded force tau (3,) and weather (2·substeps + 1, 3 or 9).

        Raises
        ------
        ValueError : the weather has 3 columns where the plant has loads, or 9 where it has none.
        """
        if self._thrust is not None:
            tau = self._thrust.deliver(tau)
        s, Minv, MinvD, h, work = self.state, self._Minv, self._MinvD, self._h, self._work
        if self._loads is None:
            advance(s, tau, stages, Minv, MinvD, h, work)
        else:
            advance_loaded(s, tau, stages, Minv, MinvD, self._loads, h, work)
