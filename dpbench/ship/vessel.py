"""Vessel data of the linear low-frequency model (paper eq. 4) and the limits of its actuators.

M ν̇ + D ν = τ + w,     order surge, sway, yaw
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.thrusters import ThrusterSet
from dpbench.ship.weather.waves import WaveReflection
from dpbench.ship.weather.wind import Windage


@dataclass(frozen=True, eq=False)
class Vessel:
    """A 3-DOF ship with limits on the generalised control force and on its rate.

    source : where the numbers were published.
    M : (3, 3) inertia with added mass [kg, kg·m, kg·m²], positive definite.
    D : (3, 3) linear damping [kg/s, kg·m/s, kg·m²/s], positive definite symmetric part.
    tau_min, tau_max : (3,) limits of the force [N, N, N·m]; zero lies inside.
    rate_max : (3,) limits of its rate [N/s, N/s, N·m/s].
    windage, reflection, thrusters, capability : needed for wind, for wave drift, where thrusters
        are commanded, and for DP capability level 1.
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
    windage: Windage | None = None
    reflection: WaveReflection | None = None
    thrusters: ThrusterSet | None = None
    capability: CapabilityHull | None = None

    def __post_init__(self) -> None:
        self._check_matrices()
        if not (self.tau_min < 0).all() or not (self.tau_max > 0).all():
            limits = f"[{self.tau_min.tolist()}, {self.tau_max.tolist()}]"
            raise InputError(self.where, "tau_min, tau_max", limits, "limits with zero inside")

    def _check_matrices(self) -> None:
        if not np.allclose(self.M, self.M.T, rtol=1e-3, atol=0.0):
            raise InputError(self.where, "M", self.M.tolist(), "a symmetric matrix")
        for name in ("M", "D"):
            matrix = getattr(self, name)
            smallest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
            if smallest <= 0.0:
                indefinite = f"a matrix with smallest eigenvalue {smallest:.3g}"
                raise InputError(self.where, name, indefinite, "a positive definite matrix")

    def step_max(self, sample_s: float) -> Vector:
        """Return Δu_max (3,) [N, N, N·m], the largest change of the force in one sample."""
        largest: Vector = self.rate_max * sample_s
        return largest

    def time_constants_s(self) -> Vector:
        """Return 1 over the eigenvalues of M⁻¹D, fastest first: (3,) [s]."""
        rates = np.linalg.eigvals(np.linalg.solve(self.M, self.D))
        return np.sort(1.0 / rates.real)

    def reachable_acceleration(self) -> Matrix:
        """Return τ_min and τ_max over the diagonal of M: (2, 3) [m/s², m/s², rad/s²]."""
        return np.stack([self.tau_min, self.tau_max]) / np.diag(self.M)

    def with_mismatch(self, mass_percent: float = 0.0, damping_percent: float = 0.0) -> Vessel:
        """Return the ship with M and D changed by per cent."""
        mass, damping = 1.0 + mass_percent / 100.0, 1.0 + damping_percent / 100.0
        return replace(self, M=mass * self.M, D=damping * self.D)


def descale_bis(Mb: Matrix, m_kg: float, length_m: float) -> Matrix:
    """Return the inertia of the Bis system, M = m N Mb N, N = diag(1, 1, L) (Fossen 2021, 7.2)."""
    N = np.diag([1.0, 1.0, length_m])
    descaled: Matrix = m_kg * N @ np.asarray(Mb, dtype=np.float64) @ N
    return descaled


def descale_bis_damping(Db: Matrix, m_kg: float, length_m: float, g_mps2: float = 9.81) -> Matrix:
    """Return the damping of the Bis system, D = m √(g/L) N Db N: its unit time is √(L/g)."""
    return float(np.sqrt(g_mps2 / length_m)) * descale_bis(Db, m_kg, length_m)
