"""Vessel data of the linear low-frequency model (paper eq. 4), limits of its actuators, its drag.

M ν̇ + D ν = τ + w,     order surge, sway, yaw

The nonlinear drag of the hull is cross flow in sway and yaw, and resistance in surge. For the
velocity (u, v, r) through the water the hull meets the force −F (Fossen 2021, sections 6.4 and
10.3; strip integral as in `crossFlowDrag.m` of MSS):

    F = S D S ν + [½ρ c B T V u,  ½ρ C_d T̄ ∫ w|w| dx,  ½ρ C_d T̄ ∫ x w|w| dx],   w = v + x r
    V = √(u² + v²),   S = diag(√e, √e, 1),   e = exp(−V / V_0),   V_0 = 0.004 √(gL)

C_d is Hoerner's two-dimensional coefficient at B/2T, c = 0.07 that of DNV-ST-0111, 3.6. The strips
are those of a rectangle of area A_c = T̄ L_os about x_c, where the integrals have a closed form.

The linear damping D is identified at some cm/s and fades with speed; S keeps S D S positive
definite. Its sway entry is limited so that the force abeam rises with speed. Its yaw part stays, as
published yaw damping is ten times the strip integral of a turn. All of it follows Froude's law.
Munk's moment is left out with the Coriolis terms (paper eq. 4).
"""

import math
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.layout import R, U, V
from dpbench.ship.thrusters import ThrusterSet
from dpbench.ship.weather import GRAVITY, WATER_DENSITY, WaveReflection, Windage

FADING_FROUDE_NUMBER = 0.004
"""V_0 over √(gL): 0.11 m/s on a ship of 76 m, so that 1 % of D is left at 0.5 m/s."""
_GOLDEN = 0.5 * (1.0 + math.sqrt(5.0))
_STEEPEST = _GOLDEN * math.exp(_GOLDEN) / (_GOLDEN - 1.0)
"""Least x eˣ / (x − 1) over x > 1: see `HullDrag.limit_linear_damping`."""
SURGE_COEFFICIENT = 0.07  # Of ½ρ B T V u (DNV-ST-0111, section 3.6)
AXIS_NAMES = ("surge", "sway", "yaw")
_HOERNER = np.array(
    [
        [0.2, 0.35, 0.47, 0.5, 0.65, 0.83, 1.0, 1.3, 1.65, 2.0, 2.5, 3.0, 4.0],
        [1.96, 1.90, 1.60, 1.20, 1.00, 0.88, 0.825, 0.76, 0.69, 0.65, 0.61, 0.587, 0.56],
    ]
)
"""B/2T and C_d, read off the curve of Hoerner (Leite et al. 1998, Applied Ocean Research 20)."""


def compute_cross_flow_drag_coefficient(breadth_m: float, draught_m: float) -> float:
    """Return Hoerner's two-dimensional drag coefficient C_d of a hull section."""
    return float(np.interp(0.5 * breadth_m / draught_m, *_HOERNER))


@dataclass(frozen=True)
class HullDrag:
    """Drag of a hull beside its linear damping.

    along, across : force over V u and over |v| v [kg/m].
    centre_m, length_m : the strips of the hull, about their centre.
    fading_mps : speed V_0 at which 1/e of the linear damping is left.
    """

    along: float
    across: float
    centre_m: float
    length_m: float
    fading_mps: float

    @classmethod
    def from_hull(cls, hull: CapabilityHull) -> "HullDrag":
        """Return the drag of a hull from its dimensions below the water."""
        half, section = 0.5 * WATER_DENSITY, hull.breadth_m * hull.draught_m
        coefficient = compute_cross_flow_drag_coefficient(hull.breadth_m, hull.draught_m)
        return cls(
            along=half * SURGE_COEFFICIENT * section,
            across=half * coefficient * hull.submerged_m2,
            centre_m=hull.current_x_m,
            length_m=hull.submerged_length_m,
            fading_mps=FADING_FROUDE_NUMBER * math.sqrt(GRAVITY * hull.length_m),
        )

    def copy_with_scaled_force(self, factor: float) -> "HullDrag":
        """Return the drag of a hull that meets `factor` times the force."""
        return replace(self, along=factor * self.along, across=factor * self.across)

    def to_kernel_array(self) -> Vector:
        """Return the hull's numbers (5,) that the drag kernels read."""
        half_m = 0.5 * self.length_m
        return np.array([1.0 / self.fading_mps, self.along, self.across, self.centre_m, half_m])

    def limit_linear_damping(self, D: Matrix) -> Matrix:
        """Return damping (3, 3) with which the force abeam never falls as the speed rises.

        The force D v exp(−v/V_0) + a v² rises at every speed v if D is at most
        2 a V_0 φ eᵠ / (φ − 1), with the golden ratio φ. Couplings are limited by its root.
        """
        most = 2.0 * self.across * self.fading_mps * _STEEPEST
        scale = np.ones(len(D))
        scale[V] = min(1.0, math.sqrt(most / D[V, V]))
        limited: Matrix = D * np.outer(scale, scale)
        return limited

    def compute_drag_force(self, D: Matrix, velocity: Vector) -> Vector:
        """Return the force F (3,) [N, N, N·m] that keeps a velocity (3,) through the water."""
        force = np.empty(3)
        # Numba is imported where a force is asked for: commands that only read a vessel do without.
        write_drag = import_module("dpbench.ship.drag_kernel").write_drag_force
        linear, hull = self.limit_linear_damping(D), self.to_kernel_array()
        write_drag(velocity[U], velocity[V], velocity[R], linear, hull, force)
        return force


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
        for axis, low, high in zip(AXIS_NAMES, self.tau_min, self.tau_max, strict=True):
            if not low < 0.0 < high:
                allowed = f"a minimum below 0, then a maximum above 0 in {axis}"
                raise InputError(self.where, axis, [float(low), float(high)], allowed)

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

    def accelerations_at_force_limits(self) -> Matrix:
        """Return the accelerations (2, 3) under the least and the largest force, axis by axis."""
        return np.stack([self.tau_min, self.tau_max]) / np.diag(self.M)

    def copy_with_model_mismatch(
        self, mass_percent: float = 0.0, damping_percent: float = 0.0
    ) -> "Vessel":
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
    """Return a dimensionless inertia matrix of the Bis system in SI units."""
    N = np.diag([1.0, 1.0, length_m])
    descaled: Matrix = m_kg * N @ np.asarray(Mb, dtype=np.float64) @ N
    return descaled


def convert_bis_damping_to_si(
    Db: Matrix, m_kg: float, length_m: float, g_mps2: float = 9.81
) -> Matrix:
    """Return a dimensionless damping matrix of the Bis system in SI units."""
    return float(np.sqrt(g_mps2 / length_m)) * convert_bis_inertia_to_si(Db, m_kg, length_m)
