"""Keys, units (kN, kN·m, degrees) and bounds of vessel files, converted to SI."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.scenario.problem_files import FileModel, KeysError
from dpbench.scenario.tables import key_types as keys
from dpbench.ship.capability.loads import CapabilityHull
from dpbench.ship.thrusters import Screw, Thruster, ThrusterSet, compute_nominal_thrust_N
from dpbench.ship.vessel import (
    AXIS_NAMES,
    HullDrag,
    Vessel,
    convert_bis_damping_to_si,
    convert_bis_inertia_to_si,
)
from dpbench.ship.weather import WATER_DENSITY, WaveReflection, Windage

MOST_X = 0.6
"""Largest distance of a thruster or centre from midships over the length."""


class LimitsTable(FileModel):
    """Limits of the control force and of its rate of change."""

    surge_N: keys.Two
    """Smallest and largest surge force [N], with zero between them."""
    sway_N: keys.Two
    """Smallest and largest sway force [N], with zero between them."""
    yaw_Nm: keys.Two
    """Smallest and largest yaw moment [N·m], with zero between them."""
    rate_max_N_per_s: keys.ThreePositive
    """Rate limits in surge, sway [N/s] and yaw [N·m/s]."""


class WindageTable(FileModel):
    """Areas and coefficients of the hull above water, for wind forces."""

    frontal_m2: keys.Positive
    """Projected area above the water seen from ahead, A_F [m²]."""
    lateral_m2: keys.Positive
    """Projected area above the water seen from abeam, A_L [m²]."""
    c_x: keys.NotNegative = Windage.c_x
    """Coefficient of the force along the ship; Fossen (2021) gives 0.50 to 0.90."""
    c_y: keys.NotNegative = Windage.c_y
    """Coefficient of the force across the ship; Fossen (2021) gives 0.70 to 0.95."""
    c_n: keys.NotNegative = Windage.c_n
    """Coefficient of the moment; Fossen (2021) gives 0.05 to 0.20."""


class ReflectionTable(FileModel):
    """Wave reflection of the hull at the waterline, for drift forces."""

    breadth_m: keys.Positive
    """Breadth at the waterline [m]."""
    head: keys.NotNegative = WaveReflection.head
    """Reflection R₀² of short waves from ahead (DNV-ST-0111, bow angle of 24°)."""
    beam: keys.NotNegative = WaveReflection.beam
    """R₀² of short waves from abeam."""
    yaw: keys.NotNegative = WaveReflection.yaw
    """R₀² of the moment of short waves from the quarters."""


class ThrusterTable(FileModel):
    """One thruster: its position, and its thrust or the data to compute it by DNV-ST-0111."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"controller_sector_deg", "barred_protects"})

    name: str
    """Name in tables, and in the faults of a scenario."""
    kind: Literal["azimuth", "tunnel", "main"]
    """Type of thruster: turning azimuth, tunnel across the ship, main along it without a rudder."""
    x_m: keys.Number
    """Position ahead of the origin of the matrices [m]."""
    y_m: keys.Number = 0.0
    """Position to starboard of the centre line [m]."""
    thrust_kN: keys.Positive | None = None
    """Largest thrust ahead [kN]. Either this, or power_kW, diameter_m and propeller."""
    power_kW: keys.Positive | None = None
    """Power of its drive [kW]; the thrust is then that of DNV-ST-0111 level 1."""
    diameter_m: keys.Positive | None = None
    """Diameter of the propeller [m]."""
    propeller: Literal["open", "nozzle", "tunnel"] | None = None
    """Kind of the propeller."""
    height_m: keys.Number | None = None
    """Height of its shaft above the keel [m], for losses in waves; no such losses without it."""
    rise_s: keys.Positive
    """Time from zero to full thrust [s]."""
    astern: keys.Share = 1.0
    """Thrust astern of a main propeller as a share of that ahead."""
    sector_deg: keys.Two | None = None
    """Directions in which an azimuth may push the ship, from and to, clockwise from ahead [°]. All
    round by default. In its place: `barred_deg`, from and to, the directions in which it may not
    push."""
    controller_sector_deg: keys.Two | None = None
    """Part of sector_deg that controllers plan with, at most half a turn wide, as their QPs need a
    convex set of forces; by default sector_deg, or the middle half turn of a wider one. Capability
    plots use all of sector_deg."""
    barred_protects: str | None = None
    """Name of the thruster that the barred directions protect. Capability plots count all
    directions in a failure case in which that thruster is lost. Controllers keep their sector."""
    turning_degps: keys.Positive | None = None
    """Largest turning rate of an azimuth [°/s]; required with azimuth_turning = true."""
    group: str = ""
    """Failure group, for example of one switchboard; by default the thruster fails alone."""

    @model_validator(mode="before")
    @classmethod
    def _convert_barred_to_allowed(cls, keys: Any) -> Any:
        """Return a thruster's keys with the sector left by barred directions in their place."""
        if not isinstance(keys, dict) or "barred_deg" not in keys:
            return keys
        barred = keys["barred_deg"]
        if keys.get("sector_deg") is not None:
            raise ValueError("either sector_deg or barred_deg")
        edges = barred if isinstance(barred, list) else []
        if len(edges) != 2 or not all(isinstance(edge, int | float) for edge in edges):
            raise KeysError(repr(barred), "two numbers, from and to", "barred_deg")
        others = {key: value for key, value in keys.items() if key != "barred_deg"}
        return others | {"sector_deg": edges[::-1]}

    @model_validator(mode="after")
    def _require_thrust_or_propeller(self) -> "ThrusterTable":
        """Return the table itself; ValueError unless it gives either thrust or propeller."""
        made_of = [self.power_kW, self.diameter_m, self.propeller]
        given = [value is not None for value in made_of]
        if (self.thrust_kN is None) != all(given) or (any(given) and not all(given)):
            raise ValueError(
                "thrust_kN, or power_kW with diameter_m and propeller (optional in a CSV file)"
            )
        if self.height_m is not None and self.thrust_kN is not None:
            raise ValueError("height_m only together with power_kW, diameter_m and propeller")
        if self.barred_protects is not None and self.sector_deg is None:
            raise ValueError("barred_protects only together with barred_deg or sector_deg")
        return self

    def build_thruster(self) -> Thruster:
        """Return the thruster in SI units; InputError for values that do not fit its kind."""
        screw = None
        if self.thrust_kN is not None:
            thrust_N = 1e3 * self.thrust_kN
        else:
            assert self.power_kW and self.diameter_m and self.propeller, "the validator demands it"
            thrust_N = compute_nominal_thrust_N(self.power_kW, self.diameter_m, self.propeller)
            screw = Screw(self.diameter_m, self.propeller, self.height_m)
        place = self.name, self.kind, self.x_m, self.y_m
        rest = self.astern, _convert_sector_to_radians(self.sector_deg), self.group, screw
        turning = None if self.turning_degps is None else math.radians(self.turning_degps)
        planned = _convert_sector_to_radians(self.controller_sector_deg)
        return Thruster(
            *place, thrust_N, self.rise_s, *rest, turning, planned, self.barred_protects or ""
        )


def _convert_sector_to_radians(sector_deg: Sequence[float] | None) -> tuple[float, float] | None:
    """Return the directions of a sector, from and to, in radians that rise; None for None."""
    if sector_deg is None:
        return None
    start, end = sector_deg
    # From 330 to 30 goes by way of 0.
    end = end if end >= start else start + (end - start) % 360.0
    return math.radians(start), math.radians(end)


class CapabilityTable(FileModel):
    """Hull data for DP capability plots by DNV-ST-0111, table A-2, in addition to `[windage]`.

    The cross-flow drag of a vessel takes the hull below the water from it too.

    What is left out is assumed, and listed with the result.
    """

    breadth_m: keys.Positive
    """Breadth at the waterline [m]."""
    draught_m: keys.Positive
    """Summer draught [m]."""
    submerged_length_m: keys.Positive | None = None
    """Length from the foremost to the aftmost point under water, L_os [m]; assumed: length_m."""
    submerged_x_m: keys.Number | None = None
    """Centre of submerged_length_m, ahead of L_pp/2 [m]; assumed: 0."""
    bow_angle_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """Half the angle of the waterline at the bow [°]; assumed: 22."""
    aft_fullness: keys.Positive | None = None
    """Area of the waterline behind L_pp/2 over that of the rectangle around it; assumed: 1."""
    lateral_x_m: keys.Number | None = None
    """Centre of lateral_m2, ahead of L_pp/2 [m]; assumed: 0."""
    submerged_m2: keys.Positive | None = None
    """Area under water from abeam [m²]; assumed: length_m · draught_m."""
    current_x_m: keys.Number | None = None
    """Centre of submerged_m2, ahead of L_pp/2 [m]; assumed: 0."""
    skegs: list[keys.Two] = []
    """[x, y] of the aftmost point of each skeg, ahead of L_pp/2 and to starboard [m]."""

    def build_capability_hull(self, length_m: float, windage: Windage) -> CapabilityHull:
        """Return the hull for capability plots in SI units, with assumed values where left out."""
        assumed = {
            "submerged_length_m": length_m,
            "submerged_x_m": 0.0,
            "bow_angle_deg": 22.0,
            "aft_fullness": 1.0,
            "lateral_x_m": 0.0,
            "submerged_m2": length_m * self.draught_m,
            "current_x_m": 0.0,
        }
        given = {key: getattr(self, key) for key in assumed}
        known = {key: assumed[key] if value is None else value for key, value in given.items()}
        return CapabilityHull(
            length_m=length_m,
            breadth_m=self.breadth_m,
            draught_m=self.draught_m,
            bow_angle_rad=math.radians(known.pop("bow_angle_deg")),
            frontal_m2=windage.frontal_m2,
            lateral_m2=windage.lateral_m2,
            skegs=tuple((x, y) for x, y in self.skegs),
            assumed=tuple(key for key, value in given.items() if value is None),
            **known,
        )


def build_thruster_set(tables: Sequence[ThrusterTable], where: str) -> ThrusterSet:
    """Return the thrusters of a file in SI units; InputError names the file and the thruster."""
    try:
        every = tuple(table.build_thruster() for table in tables)
    except InputError as error:
        key = f"{error.where}: {error.key}"
        raise InputError(where, key, error.found, error.allowed) from error
    return ThrusterSet(every, where)


class VesselFile(FileModel):
    """Contents of a vessel file, with matrices in SI units or dimensionless in the Bis system.

    `model_scale` λ makes it a model ship of scale 1 : λ, for which scenarios are scaled.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"thrusters", "capability", "drag"})

    title: str
    """Short description of the ship."""
    source: str
    """Source of the numbers."""
    length_m: keys.Length
    """Length for Bis scaling and for the moments of wind and drift [m]."""
    limits: LimitsTable | None = None
    """Limits of the control force and of its rate; without it, those of the thrusters."""
    thrusters: list[ThrusterTable] = []
    """Thrusters, for controllers that command them."""
    model_scale: keys.Positive = 1.0
    """λ of a model ship of scale 1 : λ, to which scenarios are scaled by Froude's law."""
    windage: WindageTable | None = None
    """Required if the weather has wind."""
    reflection: ReflectionTable | None = None
    """Required if the weather has wave drift."""
    capability: CapabilityTable | None = None
    """Required by drag = "cross_flow" and, with windage and thrusters, by `dpbench capability`."""
    drag: Literal["linear", "cross_flow"] = "linear"
    """Drag of the simulated ship. linear: D at any speed; cross_flow: D that decreases with speed,
    and the cross-flow drag of the hull in `[capability]`. The controller's model has D."""
    inertia: keys.ThreeByThree | None = None
    """M (3, 3) with added mass [kg, kg·m, kg·m²]; symmetric, positive definite."""
    damping: keys.ThreeByThree | None = None
    """D (3, 3), linear [kg/s, kg·m/s, kg·m²/s]; its symmetric part positive definite."""
    mass_kg: keys.Positive | None = None
    """Mass for the Bis system [kg]."""
    inertia_bis: keys.ThreeByThree | None = None
    """Dimensionless M in the Bis system."""
    damping_bis: keys.ThreeByThree | None = None
    """Dimensionless D in the Bis system."""

    @model_validator(mode="after")
    def _require_keys_of_complete_vessel(self) -> "VesselFile":
        """Return the file's model itself; ValueError if its keys do not define one whole vessel."""
        systems = ({"inertia", "damping"}, {"mass_kg", "inertia_bis", "damping_bis"})
        given = {key for key in systems[0] | systems[1] if getattr(self, key) is not None}
        if given not in systems:
            raise ValueError("either inertia and damping, or mass_kg, inertia_bis and damping_bis")
        if self.limits is None and not self.thrusters:
            raise ValueError("limits, or thrusters to derive them from")
        if self.capability is not None and self.windage is None:
            raise ValueError("[capability] only with [windage], whose areas it uses")
        if self.drag == "cross_flow" and self.capability is None:
            raise ValueError('drag = "cross_flow" only with [capability], whose hull it uses')
        return self

    def build_vessel(self, name: str, where: str) -> Vessel:
        """Return the vessel in SI units; InputError naming `where` for unfit values."""
        if self.inertia is not None:
            M, D = np.array(self.inertia), np.array(self.damping)
        else:
            assert self.mass_kg is not None, "the validator demands it beside inertia_bis"
            M = convert_bis_inertia_to_si(np.array(self.inertia_bis), self.mass_kg, self.length_m)
            D = convert_bis_damping_to_si(np.array(self.damping_bis), self.mass_kg, self.length_m)
        thrusters = build_thruster_set(self.thrusters, where) if self.thrusters else None
        low, high, rate = self._compute_force_and_rate_limits(thrusters)
        air, water = self.windage, self.reflection
        windage = Windage(**air.model_dump()) if air else None
        reflection = WaveReflection(**water.model_dump()) if water else None
        hull = None
        if self.capability and windage:
            hull = self.capability.build_capability_hull(self.length_m, windage)
        drag = HullDrag.from_hull(hull) if hull and self.drag == "cross_flow" else None
        ship = (name, self.title, self.source, self.length_m, M, D, low, high, rate, where)
        try:
            vessel = Vessel(*ship, windage, reflection, thrusters, hull, drag)
        except InputError as error:
            bis = "" if self.inertia is not None else "_bis"
            names = {"M": f"inertia{bis}", "D": f"damping{bis}"}
            for axis, limit in zip(AXIS_NAMES, ("surge_N", "sway_N", "yaw_Nm"), strict=True):
                names[axis] = f"limits.{limit}" if self.limits else "thrusters"
            key = names.get(error.key, error.key)
            raise InputError(where, key, error.found, error.allowed) from error
        self._refuse_implausible_mass(float(M[0, 0]), where)
        self._refuse_places_outside_ship(where)
        return vessel

    def _refuse_places_outside_ship(self, where: str) -> None:
        """Raise InputError for a thruster, centre or skeg that lies ahead or aft of the ship."""
        places = [(f"thruster {one.name}: x_m", one.x_m) for one in self.thrusters or ()]
        if (hull := self.capability) is not None:
            centres = ("submerged_x_m", "lateral_x_m", "current_x_m")
            places += [(f"capability.{key}", getattr(hull, key)) for key in centres]
            places += [("capability.skegs", x) for x, _ in hull.skegs]
        most = MOST_X * self.length_m
        for key, x_m in places:
            if x_m is not None and abs(x_m) > most:
                allowed = f"{-most:g} to {most:g} m from midships on this ship"
                raise InputError(where, key, f"{x_m:g}", allowed)

    def _refuse_implausible_mass(self, surge_kg: float, where: str) -> None:
        """Raise InputError unless a ship is 0.5 to 5 % of the water in a cube of its length."""
        share = surge_kg / (WATER_DENSITY * self.length_m**3)
        if not 1e-4 <= share <= 1.0:
            found = f"{self.length_m:g} m with a surge inertia of {surge_kg:.3g} kg"
            allowed = (
                f"an inertia of 1e-4·ρL³ to 1·ρL³, with ρ = {WATER_DENSITY:g} kg/m³ and "
                "L = length_m; check the units (m and kg)"
            )
            raise InputError(where, "length_m", found, allowed)

    def _compute_force_and_rate_limits(
        self, thrusters: ThrusterSet | None
    ) -> tuple[Vector, Vector, Vector]:
        """Return the lower, upper and rate limits of the control force, (3,) each."""
        if self.limits is None:
            assert thrusters is not None, "the validator demands one of the two"
            return (
                *thrusters.least_and_largest_force_by_axis(),
                thrusters.largest_force_rate_by_axis(),
            )
        ranges = np.array([self.limits.surge_N, self.limits.sway_N, self.limits.yaw_Nm])
        low, high = np.ascontiguousarray(ranges.T)
        return low, high, np.array(self.limits.rate_max_N_per_s)
