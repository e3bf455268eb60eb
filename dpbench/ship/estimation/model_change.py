"""How a ship's state changed over the last sample, by the model and one estimate.

    M ν̇ + D ν = f,  η̇ = R ν  with f = τ + Rᵀ b held:   [Δν; RᵀΔη] = J [ν; f]

The law acts on Δν, Δη (paper eq. 6). As the difference of two estimates they also hold the two
corrections between them, and a centimetre of correction in 0.3 s reads as a speed of 3 cm/s: behind
a Kalman filter that alone keeps the rate limits active. The model says the same change without it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import expm

from dpbench.arrays import Matrix
from dpbench.ship.vessel import Vessel


def change_matrix(ship: Vessel, sample_s: float) -> Matrix:
    """J (6, 6), exact for a held f and heading.

    With the state [∫ν; ν] advanced by [[I, F_p], [0, F_v]] and [G_p; G_v] f over the sample, and
    ν⁻ = F_v⁻¹ (ν − G_v f) the speed before it: Δν = ν − ν⁻, RᵀΔη = F_p ν⁻ + G_p f.
    """
    A = np.zeros((9, 9))
    A[:3, 3:6] = np.eye(3)
    A[3:6, 3:6], A[3:6, 6:] = -np.linalg.solve(ship.M, ship.D), np.linalg.inv(ship.M)
    step = expm(A * sample_s)
    F_p, F_v, G_p, G_v = step[:3, 3:6], step[3:6, 3:6], step[:3, 6:], step[3:6, 6:]
    back = np.linalg.inv(F_v) @ np.hstack([np.eye(3), -G_v])
    speed = np.hstack([np.eye(3), np.zeros((3, 3))]) - back
    pose = F_p @ back + np.hstack([np.zeros((3, 3)), G_p])
    return np.ascontiguousarray(np.vstack([speed, pose]))


@njit(cache=True)
def model_change(J, estimate, tau, b, change):  # type: ignore[no-untyped-def] # compiled by numba
    """[Δν, Δη] (6,) into change, from estimate (6,), force tau (3,) and bias b (3,) in NED."""
    c, s = np.cos(estimate[5]), np.sin(estimate[5])
    f0 = tau[0] + c * b[0] + s * b[1]
    f1 = tau[1] + c * b[1] - s * b[0]
    f2 = tau[2] + b[2]
    for i in range(6):
        total = J[i, 3] * f0 + J[i, 4] * f1 + J[i, 5] * f2
        for j in range(3):
            total += J[i, j] * estimate[j]
        change[i] = total
    surge = change[3]
    change[3] = c * surge - s * change[4]
    change[4] = s * surge + c * change[4]
