"""Thrusters: their positions, their limits, and the force they make together.

    τ = T_e f,   f = [X_1, Y_1, …]: two components of an azimuth thruster, one of any other
    column of X_i: (1, 0, −y_i)        of Y_i, and of a tunnel: (0, 1, x_i)

T_e is the extended thruster configuration matrix (Fossen 2021, section 11.2): linear in what an
optimiser chooses, because azimuths are replaced by force components.

    limits   azimuth   |f_i| ≤ T_i, and within its sector       rate   |Δf_i,j| ≤ T_i Δt / rise_i
             tunnel    |f_i| ≤ T_i                                      component by component
             main      −a_i T_i ≤ f_i ≤ T_i                     a_i: share of the thrust astern
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.errors import InputError, format_allowed_names
from dpbench.ship.layout import AXES

ThrusterKind = Literal["azimuth", "tunnel", "main"]
Propeller = Literal["open", "nozzle", "tunnel"]
Trips = tuple[tuple[int, Indices], ...]
"""(sample, entries of f) of thrusters that stop at once at a sample, in order of time."""
ETA_1 = {"open": 800.0, "nozzle": 1200.0, "tunnel": 900.0}
"""η_1 of DNV-ST-0111 (2021), section 3.8: N from kW and m."""
_ROUNDING = 1e-8  # Angles that are the same
MECHANICAL_EFFICIENCY = 0.93  # η_m of DNV-ST-0111 level 1


def describe_sector(start_deg: float, end_deg: float) -> str:
    """Return a sentence: where an azimuth may push, where its race goes, and what is barred.

    >>> describe_sector(0.0, 120.0)
    'pushes 0° to 120° (race 180° to 300°), barred 120° to 360° (race 300° to 180°)'
    """
    race = f"race {format_directions(start_deg + 180.0, end_deg + 180.0)}"
    barred = f"barred {format_directions(end_deg, start_deg)}"
    not_there = f"race {format_directions(end_deg + 180.0, start_deg + 180.0)}"
    return f"pushes {format_directions(start_deg, end_deg)} ({race}), {barred} ({not_there})"


def is_half_turn(sector_rad: tuple[float, float]) -> bool:
    """Return whether the edges of a sector are one line, but for rounding."""
    return abs(sector_rad[1] - sector_rad[0] - np.pi) <= _ROUNDING


def format_sector(sector_rad: tuple[float, float]) -> str:
    """Return the directions of a sector as text in degrees."""
    return format_directions(*np.degrees(sector_rad).tolist())


def format_directions(start_deg: float, end_deg: float) -> str:
    """Return the directions from one to another as text, clockwise, an end at 0° as 360°.

    >>> format_directions(-90.0, 90.0)
    '270° to 90°'
    """
    start, end = round(start_deg, 2) % 360.0, round(end_deg, 2) % 360.0 or 360.0
    return f"{start:g}° to {end:g}°"


def compute_nominal_thrust_N(power_kW: float, diameter_m: float, propeller: Propeller) -> float:
    """Return the bollard pull ahead [N] of a propeller by DNV-ST-0111 level 1."""
    return float(ETA_1[propeller] * (MECHANICAL_EFFICIENCY * power_kW * diameter_m) ** (2.0 / 3.0))


@dataclass(frozen=True)
class Screw:
    """Propeller of a thruster: diameter, type, and height of its shaft above the keel."""

    diameter_m: float
    propeller: Propeller
    height_m: float | None = None


@dataclass(frozen=True)
class Thruster:
    """One thruster of a ship: type, position, largest thrust and limits.

    x_m, y_m : place ahead and to starboard of the origin of the ship's matrices [m].
    thrust_N : T, the largest thrust ahead; of an azimuth, in any direction it may take [N].
    rise_s : time from zero to full thrust [s].
    astern : thrust astern of a main propeller as a share of T.
    sector_rad : (from, to), clockwise from ahead, in which an azimuth may push the ship; None for
        all round.
    controller_sector_rad : part of it that controllers plan with, at most half a turn wide, so that
        its forces are a convex set; None for `sector_rad`, or the middle half turn of a wider one.
    group : what fails together, as behind one switchboard.
    turning_radps : fastest turning of an azimuth [rad/s], if known.
    barred_protects : name of the thruster after whose loss capability plots ignore `sector_rad`.
    """

    name: str
    kind: ThrusterKind
    x_m: float
    y_m: float
    thrust_N: float
    rise_s: float
    astern: float = 1.0
    sector_rad: tuple[float, float] | None = None
    group: str = ""
    screw: Screw | None = None
    turning_radps: float | None = None
    controller_sector_rad: tuple[float, float] | None = None
    barred_protects: str = ""

    def __post_init__(self) -> None:
        if self.turning_radps is not None and self.kind != "azimuth":
            found = f"a thruster of kind {self.kind}"
            raise InputError(f"thruster {self.name}", "turning_degps", found, "an azimuth thruster")
        self._require_width("sector_deg", self.sector_rad, 359.0)
        self._require_width("controller_sector_deg", self.controller_sector_rad, 180.0)
        if self.sector_rad is not None and self.controller_sector_rad is not None:
            (low, high), (start, end) = self.sector_rad, self.controller_sector_rad
            if (start - low + _ROUNDING) % (2.0 * np.pi) + end - start > high - low + 2 * _ROUNDING:
                found = format_sector(self.controller_sector_rad)
                allowed = f"part of sector_deg, {format_sector(self.sector_rad)}"
                raise InputError(f"thruster {self.name}", "controller_sector_deg", found, allowed)

    def _require_width(self, key: str, sector: tuple[float, float] | None, most_deg: float) -> None:
        """Raise InputError for a sector of no azimuth, or of a width that is not allowed."""
        if sector is None:
            return
        if self.kind != "azimuth":
            found = f"a thruster of kind {self.kind}"
            raise InputError(f"thruster {self.name}", key, found, "an azimuth thruster")
        width_deg = float(np.degrees(sector[1] - sector[0]))
        if not 0.0 < width_deg <= most_deg + _ROUNDING:
            found = f"a sector of {width_deg:g}°"
            allowed = f"[a, b] with b − a above 0° and at most {most_deg:g}°"
            raise InputError(f"thruster {self.name}", key, found, allowed)

    def may_push(self, direction_rad: float) -> bool:
        """Return whether an azimuth may push the ship in a direction, clockwise from ahead."""
        if self.sector_rad is None:
            return True
        start, end = self.sector_rad
        return (direction_rad - start + _ROUNDING) % (2.0 * np.pi) <= end - start + 2.0 * _ROUNDING

    @property
    def convex_sector_rad(self) -> tuple[float, float] | None:
        """Sector of at most half a turn that controllers plan with; None for all round."""
        if self.controller_sector_rad is not None or self.sector_rad is None:
            return self.controller_sector_rad
        start, end = self.sector_rad
        spare = 0.5 * (end - start - np.pi)
        return self.sector_rad if spare <= _ROUNDING else (start + spare, end - spare)

    @property
    def component_count(self) -> int:
        """Number of force components: 2 for an azimuth thruster, 1 for any other."""
        return 2 if self.kind == "azimuth" else 1

    @property
    def configuration_columns(self) -> Matrix:
        """Columns (3, components) of this thruster in the configuration matrix T_e."""
        along, across = (1.0, 0.0, -self.y_m), (0.0, 1.0, self.x_m)
        parts = {"azimuth": (along, across), "tunnel": (across,), "main": (along,)}
        return np.array(parts[self.kind]).T


@dataclass(frozen=True, eq=False)
class ThrusterSet:
    """All thrusters of a ship, in the order of its file."""

    thrusters: tuple[Thruster, ...]
    where: str = "thrusters"

    def __post_init__(self) -> None:
        names = [thruster.name for thruster in self.thrusters]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(
                self.where, "thrusters.name", f"{twice[0]!r} twice", "a different name for each"
            )
        for thruster in self.thrusters:
            if (to := thruster.barred_protects) and to not in (
                others := {*names} - {thruster.name}
            ):
                key, allowed = "thrusters.barred_protects", format_allowed_names(to, sorted(others))
                raise InputError(self.where, key, repr(to), allowed)
        if np.linalg.matrix_rank(self.T_e / [[1.0], [1.0], [self.longest_arm_m]]) < AXES:
            key = "" if self.where == "thrusters" else "thrusters"
            allowed = "thrusters that give surge force, sway force and yaw moment independently"
            raise InputError(self.where, key, ", ".join(names) or "none", allowed)

    @property
    def longest_arm_m(self) -> float:
        """Largest distance [m] of a thruster from the origin; 1 where all are at the origin."""
        return max((float(np.hypot(t.x_m, t.y_m)) for t in self.thrusters), default=1.0) or 1.0

    @cached_property
    def T_e(self) -> Matrix:
        """Extended thruster configuration matrix (3, n_f), from forces f to τ = T_e f."""
        parts = [thruster.configuration_columns for thruster in self.thrusters]
        return np.ascontiguousarray(np.hstack(parts)) if parts else np.zeros((AXES, 0))

    @cached_property
    def n_f(self) -> int:
        """Number of force components of all thrusters."""
        return sum(thruster.component_count for thruster in self.thrusters)

    @cached_property
    def slices_in_force_vector(self) -> tuple[slice, ...]:
        """Slice of each thruster's components in the force vector f."""
        ends = np.cumsum([thruster.component_count for thruster in self.thrusters]).tolist()
        return tuple(slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True))

    def repeat_for_each_force_entry(self, values: Sequence[float] | Vector) -> Vector:
        """Return one value per thruster (p,), repeated for each of its force components (n_f,)."""
        return np.repeat(
            np.asarray(values), [thruster.component_count for thruster in self.thrusters]
        )

    @property
    def sector_descriptions(self) -> list[str]:
        """Sentence on each azimuth with a sector: where it may push the ship, and where not."""
        return [
            f"{thruster.name} {describe_sector(*np.degrees(thruster.sector_rad).tolist())}"
            + (
                f"; controllers plan with {format_sector(convex)}"
                if convex != thruster.sector_rad
                else ""
            )
            + (
                f"; after the loss of {thruster.barred_protects}, the capability plot counts all "
                "directions"
                if thruster.barred_protects
                else ""
            )
            for thruster in self.thrusters
            if thruster.sector_rad is not None and (convex := thruster.convex_sector_rad)
        ]

    def copy_with_convex_sectors(self) -> "ThrusterSet":
        """Return the thrusters with the sectors that controllers plan with in place of theirs."""
        convex = (
            replace(t, sector_rad=t.convex_sector_rad, barred_protects="") for t in self.thrusters
        )
        return replace(self, thrusters=tuple(convex))

    @property
    def has_half_turns(self) -> bool:
        """True if controllers plan with a half turn of a wider sector of some azimuth."""
        return any(t.sector_rad != t.convex_sector_rad for t in self.thrusters)

    @property
    def caution_on_rudders(self) -> str:
        """Sentence on what is not counted where mains alone push aft of midships; "" elsewhere.

        Intact, or after the loss of a failure group.
        """
        if self._has_mains_alone_aft(()):
            when = "Aft"
        else:
            groups = self.indices_by_failure_group
            lost = [name for name, own in groups.items() if self._has_mains_alone_aft(own)]
            if not lost:
                return ""
            when = f"After the loss of {' or of '.join(lost)}, aft"
        return (
            f"{when} of midships only main propellers push. Rudders are not modelled: with its "
            "rudders, the ship may hold more wind. Power limits are not counted: with them, it may "
            "hold less."
        )

    def _has_mains_alone_aft(self, lost: Collection[int]) -> bool:
        """Return whether main propellers alone push aft of midships, without those at `lost`."""
        aft = [t.kind for i, t in enumerate(self.thrusters) if t.x_m < 0.0 and i not in lost]
        return set(aft) == {"main"}

    @cached_property
    def largest_thrusts_N(self) -> Vector:
        """Largest thrust of each thruster (p,) [N]."""
        return np.array([thruster.thrust_N for thruster in self.thrusters])

    def largest_force_changes_per_sample(self, sample_s: float) -> Vector:
        """Return the largest change of each force component (n_f,) [N] in one sample."""
        rise_s = np.array([thruster.rise_s for thruster in self.thrusters])
        return self.repeat_for_each_force_entry(self.largest_thrusts_N * sample_s / rise_s)

    def find_force_entries_of_thrusters(self, indices: Collection[int]) -> Indices:
        """Return the entries of the force vector f that belong to thrusters given by index."""
        belongs = [float(i in indices) for i in range(len(self.thrusters))]
        return np.flatnonzero(self.repeat_for_each_force_entry(belongs))

    def thruster_force_magnitudes(self, f: Matrix) -> Matrix:
        """Return the magnitude of each thruster's force (..., p), for forces f (..., n_f) [N]."""
        sizes = [
            np.sqrt((f[..., place] ** 2).sum(axis=-1)) for place in self.slices_in_force_vector
        ]
        return np.stack(sizes, axis=-1)

    def largest_force_along(self, direction: Vector) -> float:
        """Return the largest force of all thrusters along a direction (3,): max of direction·τ."""
        slopes = direction @ self.T_e
        return float(
            sum(
                _largest_thrust_along(t, slopes[at])
                for t, at in zip(self.thrusters, self.slices_in_force_vector, strict=True)
            )
        )

    def least_and_largest_force_by_axis(self) -> tuple[Vector, Vector]:
        """Return the least and largest force (3,) [N, N, N·m] in each axis by itself."""
        axes = np.eye(AXES)
        least = np.array([-self.largest_force_along(-axis) for axis in axes])
        return least, np.array([self.largest_force_along(axis) for axis in axes])

    def largest_force_rate_by_axis(self) -> Vector:
        """Return the fastest change of force (3,) [N/s, N/s, N·m/s] in each axis by itself."""
        largest: Vector = np.abs(self.T_e) @ self.largest_force_changes_per_sample(1.0)
        return largest

    @cached_property
    def indices_by_failure_group(self) -> dict[str, tuple[int, ...]]:
        """Indices of the thrusters in each failure group, by name of the group."""
        members: dict[str, list[int]] = {}
        for i, thruster in enumerate(self.thrusters):
            members.setdefault(thruster.group or thruster.name, []).append(i)
        return {name: tuple(numbers) for name, numbers in members.items()}

    def find_indices_of_thrusters_or_groups(
        self, names: Sequence[str], where: str, key: str
    ) -> set[int]:
        """Return the indices of thrusters given by name, or by name of their failure group."""
        known = {
            thruster.name: (i,) for i, thruster in enumerate(self.thrusters)
        } | self.indices_by_failure_group
        for name in names:
            if name not in known:
                raise InputError(where, key, repr(name), format_allowed_names(name, list(known)))
        return {i for name in names for i in known[name]}


def _largest_thrust_along(thruster: Thruster, slope: Vector) -> float:
    """Return the largest value of slope·f over the forces f that one thruster can give."""
    if thruster.kind != "azimuth":
        low, high = -thruster.astern * thruster.thrust_N, thruster.thrust_N
        return float(max(slope[0] * low, slope[0] * high))
    best = float(np.hypot(*slope))
    if thruster.sector_rad is not None:
        start, end = thruster.sector_rad
        to = np.arctan2(slope[1], slope[0])
        if (to - start) % (2.0 * np.pi) > end - start:
            ends = (slope @ [np.cos(edge), np.sin(edge)] for edge in (start, end))
            best = max(0.0, *map(float, ends))
    return best * thruster.thrust_N
