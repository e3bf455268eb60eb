"""Vessel data of the linear low-frequency model (paper eq. 4) and the limits of its actuators.

M ν̇ + D ν = τ + w,     order surge, sway, yaw
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dpbench.errors import InputError, ShapeError
from dpbench.qp.program import Matrix, Vector


@dataclass(frozen=True, eq=False)
class Vessel:
    """A 3-DOF ship with limits on the generalised control force and on its rate.

    Parameters
    ----------
    id : name of the file it comes from.
    title : the ship in words.
    source : where the numbers were published.
    length_m : length the numbers belong to [m].
    M : (3, 3) inertia with added mass [kg, kg·m, kg·m²], positive definite.
    D : (3, 3) linear damping [kg/s, kg·m/s, kg·m²/s], positive definite symmetric part.
    tau_min, tau_max : (3,) limits of the force [N, N, N·m]; zero lies inside.
    rate_max : (3,) limits of its rate [N/s, N/s, N·m/s].
    where : the file named in errors.

    Raises
    ------
    ShapeError, InputError : naming the key, what was found and what is allowed.
    """

    id: str
    title: str
    source: str
    length_m: float
    M: Matrix
    D: Matrix
    tau_min: Vector
    tau_max: Vector
    rate_max: Vector
    where: str = "Vessel"

    def __post_init__(self) -> None:
        shapes = {"M": (3, 3), "D": (3, 3), "tau_min": (3,), "tau_max": (3,), "rate_max": (3,)}
        for name, shape in shapes.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape:
                raise ShapeError.of(self.where, name, array.shape, f"shape {shape}")
            if not np.isfinite(array).all():
                raise InputError(self.where, name, array.tolist(), "finite numbers")
            object.__setattr__(self, name, array)
        self._check_matrices()
        if not (self.tau_min < 0).all() or not (self.tau_max > 0).all():
            found = f"[{self.tau_min.tolist()}, {self.tau_max.tolist()}]"
            raise InputError(self.where, "tau_min, tau_max", found, "limits with zero inside")
        if not (self.rate_max > 0).all():
            raise InputError(self.where, "rate_max", self.rate_max.tolist(), "positive rates")

    def _check_matrices(self) -> None:
        if not np.allclose(self.M, self.M.T, rtol=1e-3, atol=0.0):
            raise InputError(self.where, "M", self.M.tolist(), "a symmetric matrix")
        for name in ("M", "D"):
            matrix = getattr(self, name)
            smallest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
            if smallest <= 0.0:
                found = f"a matrix with smallest eigenvalue {smallest:.3g}"
                raise InputError(self.where, name, found, "a positive definite matrix")

    def step_max(self, sample_s: float) -> Vector:
        """Δu_max (3,) [N, N, N·m]: the largest change of the force in one sample."""
        largest: Vector = self.rate_max * sample_s
        return largest


def bis_descaled(Mb: Matrix, m_kg: float, length_m: float) -> Matrix:
    """Inertia from the Bis system, M = m N Mb N with N = diag(1, 1, L) (Fossen 2021, ch. 7.2)."""
    N = np.diag([1.0, 1.0, length_m])
    descaled: Matrix = m_kg * N @ np.asarray(Mb, dtype=np.float64) @ N
    return descaled


def bis_descaled_damping(Db: Matrix, m_kg: float, length_m: float, g_mps2: float = 9.81) -> Matrix:
    """Damping from the Bis system, D = m √(g/L) N Db N: unit time of Bis is √(L/g)."""
    return float(np.sqrt(g_mps2 / length_m)) * bis_descaled(Db, m_kg, length_m)
