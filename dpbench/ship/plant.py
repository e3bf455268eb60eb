"""The ship itself: nonlinear 3-DOF motion integrated with fixed-step Runge-Kutta 4.

    η̇ = R(ψ) ν,      M ν̇ + D ν = τ + R(ψ)ᵀ b(t)        (paper eq. 3-4, b in the NED frame)

State (6,) = [u, v, r, n, e, ψ] in m/s, m/s, rad/s, m, m, rad; ψ is never wrapped here. The force
τ is held over the sample; b is read at the stage times from a table (`Environment.stage_table`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dpbench.qp.program import Matrix, Vector
from dpbench.ship.vessel import Vessel

SUBSTEPS = 10
"""Runge-Kutta sub-steps per sample: at 0.3 s one sample is exact to 1e-10 m for every vessel."""


@njit(cache=True, error_model="numpy", fastmath=False)
def _derivative(s, tau, b, Minv, MinvD, out):  # type: ignore[no-untyped-def] # compiled by numba
    """ṡ of the state s under force tau and NED disturbance b, into out; all (6,) or (3,)."""
    c, sn = np.cos(s[5]), np.sin(s[5])
    f0 = tau[0] + c * b[0] + sn * b[1]
    f1 = tau[1] - sn * b[0] + c * b[1]
    f2 = tau[2] + b[2]
    for i in range(3):
        acceleration = Minv[i, 0] * f0 + Minv[i, 1] * f1 + Minv[i, 2] * f2
        for j in range(3):
            acceleration -= MinvD[i, j] * s[j]
        out[i] = acceleration
    out[3] = c * s[0] - sn * s[1]
    out[4] = sn * s[0] + c * s[1]
    out[5] = s[2]


@njit(cache=True, error_model="numpy", fastmath=False)
def _advance(s, tau, b, Minv, MinvD, h, work):  # type: ignore[no-untyped-def] # compiled by numba
    """Advance the state s (6,) in place by the sub-steps that b (2·substeps + 1, 3) covers."""
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    for i in range(b.shape[0] // 2):
        _derivative(s, tau, b[2 * i], Minv, MinvD, k1)
        for j in range(6):
            mid[j] = s[j] + 0.5 * h * k1[j]
        _derivative(mid, tau, b[2 * i + 1], Minv, MinvD, k2)
        for j in range(6):
            mid[j] = s[j] + 0.5 * h * k2[j]
        _derivative(mid, tau, b[2 * i + 1], Minv, MinvD, k3)
        for j in range(6):
            mid[j] = s[j] + h * k3[j]
        _derivative(mid, tau, b[2 * i + 2], Minv, MinvD, k4)
        for j in range(6):
            s[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])


class Plant:
    """The true ship, advanced one sample at a time.

    Parameters
    ----------
    vessel : its M and D.
    state : (6,) initial [u, v, r, n, e, ψ], copied.
    sample_s : length of a sample [s].
    substeps : Runge-Kutta steps per sample.
    """

    def __init__(
        self, vessel: Vessel, state: Vector, sample_s: float, substeps: int = SUBSTEPS
    ) -> None:
        self.state: Vector = np.array(state, dtype=np.float64)
        self._Minv: Matrix = np.ascontiguousarray(np.linalg.inv(vessel.M))
        self._MinvD: Matrix = np.ascontiguousarray(np.linalg.solve(vessel.M, vessel.D))
        self._h = sample_s / substeps
        self._work = np.empty((5, 6))

    def advance(self, tau: Vector, b_stages: Matrix) -> None:
        """One sample under the constant force tau (3,) and disturbances (2·substeps + 1, 3)."""
        _advance(self.state, tau, b_stages, self._Minv, self._MinvD, self._h, self._work)
