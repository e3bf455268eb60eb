"""Vessel data of the linear low-frequency model (paper eq. 4) and the limits of its actuators.

M ν̇ + D ν = τ + w,     order surge, sway, yaw
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.drag import HullDrag
from dpbench.ship.thrusters import ThrusterSet
from dpbench.ship.weather.waves import WaveReflection
from dpbench.ship.weather.wind import Windage


@dataclass(frozen=True, eq=False)
class Vessel:
    """Ship data: inertia, damping, limits of the control force and of its rate.

    source : where the numbers were published.
    M : (3, 3) inertia with added mass [kg, kg·m, kg·m²], positive definite.
    D : (3, 3) linear damping [kg/s, kg·m/s, kg·m²/s], positive definite symmetric part.
    tau_min, tau_max : (3,) limits of the force [N, N, N·m]; zero lies inside.
    rate_max : (3,) limits of its rate [N/s, N/s, N·m/s].
    windage, reflection, thrusters, capability : for wind, wave drift, commanded thrusters, and DP
        capability level 1.
    drag : nonlinear drag of the plant; without it D is all that the ship meets.
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
    drag: HullDrag | None = None

    def __post_init__(self) -> None:
        self._require_valid_matrices()
        if not (self.tau_min < 0).all() or not (self.tau_max > 0).all():
            limits = f"[{self.tau_min.tolist()}, {self.tau_max.tolist()}]"
            raise InputError(self.where, "tau_min, tau_max", limits, "limits with zero inside")

    def _require_valid_matrices(self) -> None:
        """Raise InputError where M is not symmetric, or M or D is not positive definite."""
        if not np.allclose(self.M, self.M.T, rtol=1e-3, atol=0.0):
            raise InputError(self.where, "M", self.M.tolist(), "a symmetric matrix")
        for name in ("M", "D"):
            matrix = getattr(self, name)
            smallest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
            if smallest <= 0.0:
                indefinite = f"a matrix with smallest eigenvalue {smallest:.3g}"
                raise InputError(self.where, name, indefinite, "a positive definite matrix")

    def largest_force_change_per_sample(self, sample_s: float) -> Vector:
        """Return the largest change of the control force (3,) [N, N, N·m] in one sample."""
        largest: Vector = self.rate_max * sample_s
        return largest

    def linear_model_time_constants_s(self) -> Vector:
        """Return the time constants (3,) [s] of the linear model, fastest first."""
        rates = np.linalg.eigvals(np.linalg.solve(self.M, self.D))
        return np.sort(1.0 / rates.real)

    def accelerations_at_force_limits(self) -> Matrix:
        """Return the accelerations (2, 3) under the least and the largest force, axis by axis."""
        return np.stack([self.tau_min, self.tau_max]) / np.diag(self.M)

    def copy_with_model_mismatch(
        self, mass_percent: float = 0.0, damping_percent: float = 0.0
    ) -> Vessel:
        """Return a vessel with inertia M, and damping D and drag, changed by per cent."""
        mass, damping = 1.0 + mass_percent / 100.0, 1.0 + damping_percent / 100.0
        drag = self.drag and self.drag.copy_with_scaled_force(damping)
        return replace(self, M=mass * self.M, D=damping * self.D, drag=drag)

    def force_to_keep_velocity(self, velocity: Vector) -> Vector:
        """Return the force (3,) [N, N, N·m] that keeps a velocity (3,) through the water."""
        if self.drag is None:
            linear: Vector = self.D @ velocity
            return linear
        return self.drag.compute_drag_force(self.D, velocity)


def convert_bis_inertia_to_si(Mb: Matrix, m_kg: float, length_m: float) -> Matrix:
    """Convert a dimensionless inertia matrix of the Bis system to SI units."""
    N = np.diag([1.0, 1.0, length_m])
    descaled: Matrix = m_kg * N @ np.asarray(Mb, dtype=np.float64) @ N
    return descaled


def convert_bis_damping_to_si(
    Db: Matrix, m_kg: float, length_m: float, g_mps2: float = 9.81
) -> Matrix:
    """Convert a dimensionless damping matrix of the Bis system to SI units."""
    return float(np.sqrt(g_mps2 / length_m)) * convert_bis_inertia_to_si(Db, m_kg, length_m)
