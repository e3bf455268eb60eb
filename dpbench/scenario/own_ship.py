"""A ship made of its particulars: a library vessel scaled to its size, in a sea that it can hold.

Inertia and damping are scaled in the Bis system (Norrbin 1970; Fossen 2021), by the mass m and the
length L:

    M = m N M_b N,   D = m √(g/L) N D_b N,   N = diag(1, 1, L)

Two ships of one form and one fineness have the same M_b and D_b. The rest follows Froude's law.
Length, breadth and draught make the drag of the plant, and sway damping is fitted to it:

    D_22 = Y(v₁)/v₁,   v₁ = 0.018 √(gL)

Y is the cross-flow drag, v₁ 0.5 m/s on a ship of 76 m; couplings change with √D_22, so that D stays
positive definite. The linear model of the controller and the plant agree at v₁. Below, the model
damps up to 1.6 times as strongly, above too weakly, by v/v₁. The ratios of dimensions measure how
far the ship's form is from the library's, and the added masses of two published regressions how far
the result can be trusted.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError
from dpbench.scenario.scenario import load_vessel
from dpbench.scenario.tables.vessel_file import CapabilityTable
from dpbench.scenario.tables.weather import CurrentTable, EnvironmentTable, WavesTable, WindTable
from dpbench.ship.capability.loads import (
    DP_CONDITIONS,
    DYNAMIC_FACTOR,
    Condition,
    compute_mean_environmental_loads,
)
from dpbench.ship.capability.losses import MISCELLANEOUS
from dpbench.ship.layout import V
from dpbench.ship.vessel import HullDrag, Vessel
from dpbench.ship.weather import GRAVITY, WATER_DENSITY


@dataclass(frozen=True)
class Particulars:
    """Main dimensions of the user's ship: length, breadth, draught [m], displacement [kg]."""

    length_m: float
    breadth_m: float
    draught_m: float
    displacement_kg: float

    @property
    def block_coefficient(self) -> float:
        """Block coefficient C_B = ∇/(L B T) in sea water."""
        block_m3 = self.length_m * self.breadth_m * self.draught_m
        return self.displacement_kg / WATER_DENSITY / block_m3

    def describe_as_title(self, name: str) -> str:
        """Return the title of a ship of this size: its name and main dimensions."""
        size = f"{self.length_m:g} x {self.breadth_m:g} x {self.draught_m:g} m"
        return f"{name}, {size}, {self.displacement_kg / 1000:.6g} t"


@dataclass(frozen=True)
class LibraryShip:
    """Length, breadth [m] and mass [kg] of the ship that a library vessel's matrices describe."""

    length_m: float
    breadth_m: float
    mass_kg: float


LIBRARY = {
    "supply_fs99": LibraryShip(76.2, 18.0, 4.591e6),
    "supply_mss": LibraryShip(76.2, 18.0, 6.0e6),
    "supply_tmr": LibraryShip(82.8, 19.2, 6.362e6),
    "osv": LibraryShip(83.0, 18.0, 4.977e6),
}
"""Library vessels of full size; breadths of the first two as their wave reflection has them."""

PAPER_SHIP = "supply_fs99"
NOT_CHOSEN = ("osv", "supply_tmr")
"""Used on request only: MSS `osv.m` makes its damping from chosen time constants, and `supply_tmr`
damps surge three to five times as strongly as the others."""

DP_NUMBERS = {number: DP_CONDITIONS[number] for number in range(1, 10)}
"""Wind [m/s], Hs [m], Tp [s], current [m/s] of DP capability numbers up to a strong gale."""

FROM_DEG = 30.0  # Wind and waves come from the bow, not quite ahead: a heading a ship may choose

FITTED_FROUDE_NUMBER = 0.018
"""Speed v₁ over √(gL) at which linear damping and cross-flow drag abeam are equal."""

RAMP_S = 60.0
SPARE = MISCELLANEOUS / DYNAMIC_FACTOR
"""Share of the limits that the mean force may take, as in `dpbench capability`: gusts and drift
need the rest, and thrusters lose some."""


@dataclass(frozen=True, eq=False)
class ThrustLimits:
    """Largest force of the user's ship ahead, sideways and in yaw [N, N, N·m]."""

    ahead_N: float
    sway_N: float | None = None
    yaw_Nm: float | None = None


def find_most_similar_library_vessel(own: Particulars) -> str:
    """Return the library vessel most similar in length, breadth and displacement."""

    def distance(name: str) -> float:
        ship = LIBRARY[name]
        ratios = (
            own.length_m / ship.length_m,
            own.breadth_m / ship.breadth_m,
            math.cbrt(own.displacement_kg / ship.mass_kg),
        )
        return sum(math.log(ratio) ** 2 for ratio in ratios)

    return min((name for name in LIBRARY if name not in NOT_CHOSEN), key=distance)


def scale_inertia_and_damping(like: str, length_m: float, mass_kg: float) -> tuple[Matrix, Matrix]:
    """Return inertia and damping (3, 3) [SI] of a library vessel scaled to a length and mass."""
    vessel, ship = load_vessel(like), LIBRARY[like]
    longer = length_m / ship.length_m
    N = np.diag([1.0, 1.0, longer])
    M = mass_kg / ship.mass_kg * N @ vessel.M @ N
    D = mass_kg / ship.mass_kg / math.sqrt(longer) * N @ vessel.D @ N
    return M, D


def scale_library_vessel_to_own_ship(
    like: str, own: Particulars, thrust: ThrustLimits, name: str = "own"
) -> Vessel:
    """Return a library vessel scaled to the user's ship's dimensions and thrust, with its drag.

    Forces that are not given keep the library vessel's share of the force ahead, the moment its
    share of sway force times length. Times, and with them the rate limits, grow with √L. Areas in
    the wind grow with L² on the side and with L·B in front.
    """
    vessel, ship = load_vessel(like), LIBRARY[like]
    longer, broader = own.length_m / ship.length_m, own.breadth_m / ship.breadth_m
    M, D = scale_inertia_and_damping(like, own.length_m, own.displacement_kg)
    ahead = thrust.ahead_N / vessel.tau_max[0]
    sway = ahead if thrust.sway_N is None else thrust.sway_N / vessel.tau_max[1]
    yaw = sway * longer if thrust.yaw_Nm is None else thrust.yaw_Nm / vessel.tau_max[2]
    stronger: Vector = np.array([ahead, sway, yaw])
    windage, reflection = vessel.windage, vessel.reflection
    assert windage is not None, "as every library vessel"
    windage = replace(
        windage,
        frontal_m2=windage.frontal_m2 * longer * broader,
        lateral_m2=windage.lateral_m2 * longer**2,
    )
    hull = CapabilityTable(breadth_m=own.breadth_m, draught_m=own.draught_m)
    capability = hull.build_capability_hull(own.length_m, windage)
    drag = HullDrag.from_hull(capability)
    return replace(
        vessel,
        id=name,
        title=own.describe_as_title(name),
        length_m=own.length_m,
        M=M,
        D=fit_sway_damping_to_drag(D, drag, own.length_m),
        tau_min=stronger * vessel.tau_min,
        tau_max=stronger * vessel.tau_max,
        rate_max=stronger * vessel.rate_max / math.sqrt(longer),
        where=name,
        windage=windage,
        reflection=reflection and replace(reflection, breadth_m=own.breadth_m),
        thrusters=None,
        capability=capability,
        drag=drag,
    )


def choose_speed_of_damping_fit_mps(length_m: float) -> float:
    """Return the speed v₁ abeam [m/s] at which linear damping is fitted to the drag."""
    return FITTED_FROUDE_NUMBER * math.sqrt(GRAVITY * length_m)


def fit_sway_damping_to_drag(D: Matrix, drag: HullDrag, length_m: float) -> Matrix:
    """Return damping (3, 3) whose sway force at v₁ is the cross-flow drag; couplings with it."""
    scale = np.ones(len(D))
    scale[V] = math.sqrt(drag.across * choose_speed_of_damping_fit_mps(length_m) / D[V, V])
    fitted: Matrix = D * np.outer(scale, scale)
    return fitted


def estimate_added_mass_by_regression(own: Particulars) -> Vector:
    """Return the added mass (3,) [kg, kg, kg·m²] in surge, sway, yaw by published regressions.

    Surge: 2.7 ρ ∇^(5/3)/L² (Söding 1982). Sway and yaw, over ½ρL³ and ½ρL⁵ (Clarke, Gedling &
    Hine 1983; MSS has them as `addedMassSurge.m` and `clarke83.m`):

        π (T/L)² (1 + 0.16 C_B B/T − 5.1 (B/L)²),   π (T/L)² (1/12 + 0.017 C_B B/T − 0.33 B/L)
    """
    L, B, T = own.length_m, own.breadth_m, own.draught_m
    fullness = own.block_coefficient * B / T
    volume_m3 = own.displacement_kg / WATER_DENSITY
    slender = math.pi * (T / L) ** 2
    half = 0.5 * WATER_DENSITY
    return np.array(
        [
            2.7 * WATER_DENSITY * volume_m3 ** (5.0 / 3.0) / L**2,
            half * L**3 * slender * (1.0 + 0.16 * fullness - 5.1 * (B / L) ** 2),
            half * L**5 * slender * (1.0 / 12.0 + 0.017 * fullness - 0.33 * B / L),
        ]
    )


def compute_rigid_body_inertia(own: Particulars) -> Vector:
    """Return the rigid-body inertia (3,) [kg, kg, kg·m²] in surge, sway and yaw."""
    m = own.displacement_kg
    return np.array([m, m, m * (0.25 * own.length_m) ** 2])


def compute_thrust_to_weight_ratio(own: Particulars, force_N: float) -> float:
    """Return the ratio of a force to the ship's weight."""
    return force_N / (own.displacement_kg * GRAVITY)


def compute_froude_time_scale(length_m: float) -> float:
    """Return the ratio of this ship's time scale to that of the paper's ship: √(L/L_paper)."""
    return math.sqrt(length_m / LIBRARY[PAPER_SHIP].length_m)


def make_environment_of_dp_number(number: int, from_deg: float = FROM_DEG) -> EnvironmentTable:
    """Return wind, waves and current of a DP capability number at full size, as settings."""
    wind_mps, hs_m, tp_s, current_mps = DP_NUMBERS[number]
    return EnvironmentTable(
        ramp_s=RAMP_S,
        seed=1,
        wind=WindTable(speed_mps=wind_mps, from_deg=from_deg),
        current=CurrentTable(speed_mps=current_mps, towards_deg=(from_deg + 180.0) % 360.0),
        waves=WavesTable(hs_m=hs_m, tp_s=tp_s, from_deg=from_deg),
    )


def compute_mean_force_of_dp_number(
    vessel: Vessel, number: int, from_deg: float = FROM_DEG
) -> Vector:
    """Return the mean force (3,) [N, N, N·m] in weather of a DP capability number from a direction.

    It is that of `dpbench capability`, level 1 of DNV-ST-0111. Raises InputError where the vessel
    has no hull for it.
    """
    if vessel.capability is None:
        allowed = "this table with at least breadth_m and draught_m, and the table [windage]"
        raise InputError(vessel.where, "capability", "nothing", allowed)
    condition = Condition(*DP_NUMBERS[number])
    load: Vector = compute_mean_environmental_loads(
        vessel.capability, condition, math.radians(from_deg)
    ).sum(axis=0)
    return load


def compute_limit_share_of_dp_number(vessel: Vessel, number: int) -> float:
    """Return the share of the limits that the mean force of a DP capability number's weather takes.

    The share is that of surge, or of sway and yaw together: the same thrusters at bow and stern
    make both.
    """
    load = compute_mean_force_of_dp_number(vessel, number)
    # What pushes astern is met with force ahead.
    limit = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    surge, sway, yaw = np.abs(load) / limit
    return float(max(surge, sway + yaw))


def find_largest_bearable_dp_number(vessel: Vessel) -> int:
    """Return the largest DP capability number with a mean force within `SPARE` of the limits."""
    return max(
        (n for n in DP_NUMBERS if compute_limit_share_of_dp_number(vessel, n) <= SPARE), default=1
    )
