"""Compiled integration of the ship's motion over one sample: Runge-Kutta 4 of fixed step.

    k1 = f(t, s),   k2 = f(t + h/2, s + h/2 k1),   k3 = f(t + h/2, s + h/2 k2),
    k4 = f(t + h, s + h k3),   s ← s + h/6 (k1 + 2 k2 + 2 k3 + k4)

State s (6,) = [u, v, r, n, e, ψ]. There are two kernels, because a branch in the derivative keeps
it from being inlined and triples the cost of the ship that has no wind, current or drift.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", fastmath=False)
def _towards(s, k, h, mid):  # type: ignore[no-untyped-def] # compiled by numba
    """s + h k into mid; all (6,)."""
    for j in range(6):
        mid[j] = s[j] + h * k[j]


@njit(cache=True, error_model="numpy", fastmath=False)
def _step(s, k, h):  # type: ignore[no-untyped-def] # compiled by numba
    """Advance s (6,) in place by the slopes k (4 or more, 6)."""
    for j in range(6):
        s[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])


@njit(cache=True, error_model="numpy", fastmath=False)
def _accelerate(s, c, sn, f0, f1, f2, u, v, Minv, MinvD, out):  # type: ignore[no-untyped-def] # compiled by numba
    """ṡ into out (6,) under body force f, at u, v through the water; c, sn of the heading."""
    for i in range(3):
        acceleration = Minv[i, 0] * f0 + Minv[i, 1] * f1 + Minv[i, 2] * f2
        acceleration -= MinvD[i, 0] * u
        acceleration -= MinvD[i, 1] * v
        acceleration -= MinvD[i, 2] * s[2]
        out[i] = acceleration
    out[3] = c * s[0] - sn * s[1]
    out[4] = sn * s[0] + c * s[1]
    out[5] = s[2]


@njit(cache=True, error_model="numpy", fastmath=False)
def _plain(s, tau, b, Minv, MinvD, out):  # type: ignore[no-untyped-def] # compiled by numba
    """ṡ of s (6,) under force tau (3,) and NED force b (3,), into out (6,)."""
    c, sn = np.cos(s[5]), np.sin(s[5])
    f0 = tau[0] + c * b[0] + sn * b[1]
    f1 = tau[1] - sn * b[0] + c * b[1]
    f2 = tau[2] + b[2]
    _accelerate(s, c, sn, f0, f1, f2, s[0], s[1], Minv, MinvD, out)


@njit(cache=True, error_model="numpy", fastmath=False)
def _loaded(s, tau, b, Minv, MinvD, loads, out):  # type: ignore[no-untyped-def] # compiled by numba
    """The same in wind, current and drift: b (9,) of the stage table, loads (6,) of the hull."""
    c, sn = np.cos(s[5]), np.sin(s[5])
    air_u, air_v = c * b[3] + sn * b[4] - s[0], c * b[4] - sn * b[3] - s[1]
    water_u, water_v = c * b[5] + sn * b[6], c * b[6] - sn * b[5]
    wave_u, wave_v = c * b[7] + sn * b[8], c * b[8] - sn * b[7]
    air = np.sqrt(air_u * air_u + air_v * air_v)
    wave = np.sqrt(wave_u * wave_u + wave_v * wave_v)
    f0 = tau[0] + c * b[0] + sn * b[1] + loads[0] * air * air_u + loads[3] * wave * wave_u
    f1 = tau[1] - sn * b[0] + c * b[1] + loads[1] * air * air_v + loads[4] * wave * wave_v
    f2 = tau[2] + b[2] - 2.0 * (loads[2] * air_u * air_v + loads[5] * wave_u * wave_v)
    _accelerate(s, c, sn, f0, f1, f2, s[0] - water_u, s[1] - water_v, Minv, MinvD, out)


@njit(cache=True, error_model="numpy", fastmath=False)
def advance(s, tau, b, Minv, MinvD, h, work):  # type: ignore[no-untyped-def] # compiled by numba
    """Advance s (6,) in place by the sub-steps that b (2·substeps + 1, 3) covers; work (5, 6)."""
    if b.shape[1] != 3:
        raise ValueError("a stage table of 3 columns is for weather that ignores the ship")
    mid = work[4]
    for i in range(b.shape[0] // 2):
        _plain(s, tau, b[2 * i], Minv, MinvD, work[0])
        _towards(s, work[0], 0.5 * h, mid)
        _plain(mid, tau, b[2 * i + 1], Minv, MinvD, work[1])
        _towards(s, work[1], 0.5 * h, mid)
        _plain(mid, tau, b[2 * i + 1], Minv, MinvD, work[2])
        _towards(s, work[2], h, mid)
        _plain(mid, tau, b[2 * i + 2], Minv, MinvD, work[3])
        _step(s, work, h)


@njit(cache=True, error_model="numpy", fastmath=False)
def advance_loaded(s, tau, b, Minv, MinvD, loads, h, work):  # type: ignore[no-untyped-def] # compiled by numba
    """The same with b (2·substeps + 1, 9) and the hull's loads (6,)."""
    if b.shape[1] != 9:
        raise ValueError("a stage table of 9 columns is for weather that moves with the ship")
    mid = work[4]
    for i in range(b.shape[0] // 2):
        _loaded(s, tau, b[2 * i], Minv, MinvD, loads, work[0])
        _towards(s, work[0], 0.5 * h, mid)
        _loaded(mid, tau, b[2 * i + 1], Minv, MinvD, loads, work[1])
        _towards(s, work[1], 0.5 * h, mid)
        _loaded(mid, tau, b[2 * i + 1], Minv, MinvD, loads, work[2])
        _towards(s, work[2], h, mid)
        _loaded(mid, tau, b[2 * i + 2], Minv, MinvD, loads, work[3])
        _step(s, work, h)
