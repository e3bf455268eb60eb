"""The largest wind a ship holds from each direction, intact and after each failure."""

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.optimize import brentq

from dpbench.arrays import Vector
from dpbench.bench.capability.utilisation import (
    Choices,
    Combination,
    Utilisation,
    find_least_use_and_pieces,
)
from dpbench.bench.progress import Progress, Silent
from dpbench.errors import InputError
from dpbench.ship.capability import losses
from dpbench.ship.capability.loads import (
    DP_CONDITIONS,
    DYNAMIC_FACTOR,
    compute_mean_environmental_loads,
    interpolate_condition_at_wind_speed,
)
from dpbench.ship.capability.shapes import Piece, split_force_set_into_convex_pieces
from dpbench.ship.vessel import Vessel

DIRECTIONS = 36
"""Every 10° (2.4.6)."""
FROM_DEG = tuple(360.0 * k / DIRECTIONS for k in range(DIRECTIONS))
"""Directions of wind, waves and current, clockwise from ahead."""
BOW_DEG = 30.0
"""The sector to either side of the bow that the notation names (2.5.1)."""
INTACT = "intact"
CHORD_RAD = math.radians(1.0)
"""Angle between corners on the edge of a notch, where circles are circles."""
_NOWHERE = Piece()
"""Stand-in for the piece of a thruster that may push in no direction, which counts as lost."""
WIND_TOLERANCE = 1e-7
"""Accuracy of the largest wind held [m/s]."""


@dataclass(frozen=True)
class Case:
    """A failure case: its name and the indices of the lost thrusters."""

    name: str
    lost: frozenset[int]


@dataclass(frozen=True)
class WindLimit:
    """The largest wind [m/s] held from one direction, and its number (11: nothing known beyond)."""

    wind_mps: float
    number: int


@dataclass(frozen=True, eq=False)
class Weather:
    """Load (3,) [N, N, N·m] of one weather, and the share of thrust (p,) that losses leave."""

    load: Vector
    shares: Vector


class CapabilityPlot:
    """Solver of the largest wind a ship's thrusters hold, by direction and failure case.

    `sides` are those of polygons in place of circles, even and at least 4; None for circles.
    InputError for bad sides, or a vessel without thrusters or the hull of `[capability]`.
    """

    def __init__(self, vessel: Vessel, sides: int | None = None) -> None:
        if vessel.thrusters is None:
            raise InputError(
                vessel.where, "thrusters", "nothing", "a [[thrusters]] table for each thruster"
            )
        if vessel.capability is None:
            allowed = "this table with at least breadth_m and draught_m, and the table [windage]"
            raise InputError(vessel.where, "capability", "nothing", allowed)
        if sides is not None and (sides < 4 or sides % 2):
            raise InputError("`sides`", "", sides, "an even number, 4 or more")
        self.vessel, self.thrusters, self.hull = vessel, vessel.thrusters, vessel.capability
        self.sides = sides
        self._utilisation = Utilisation(self.thrusters, sides)
        self.pieces_of = cache(self._split_thrust_areas)
        # One wind is asked with many choices of pieces in a row.
        self.weather = lru_cache(maxsize=64)(self._compute_load_and_usable_shares)

    @property
    def intact_and_failure_cases(self) -> list[Case]:
        """The intact ship, then the loss of each group of thrusters that fail together."""
        groups = self.thrusters.indices_by_failure_group.items()
        return [
            Case(INTACT, frozenset()),
            *(Case(name, frozenset(numbers)) for name, numbers in groups),
        ]

    def _compute_load_and_usable_shares(self, from_rad: float, wind_mps: float) -> Weather:
        """Return load and usable shares of thrust in wind, waves and current from `from_rad`."""
        condition = interpolate_condition_at_wind_speed(wind_mps)
        loads = compute_mean_environmental_loads(self.hull, condition, from_rad)
        vented = [
            losses.compute_thrust_share_when_vented(thruster, self.hull, condition, from_rad)
            for thruster in self.thrusters.thrusters
        ]
        return Weather(DYNAMIC_FACTOR * loads.sum(axis=0), losses.MISCELLANEOUS * np.array(vented))

    def _split_thrust_areas(self, case: Case) -> list[list[Piece]]:
        """Return each thruster's thrust area in one failure case, split into convex pieces."""
        every = self.thrusters.thrusters
        working = [every[j] for j in range(len(every)) if j not in case.lost]
        dead = [every[j] for j in sorted(case.lost)]
        dead_names = {thruster.name for thruster in dead}
        step = CHORD_RAD if self.sides is None else 2.0 * math.pi / self.sides
        return [
            [Piece()]
            if thruster.kind != "azimuth" or i in case.lost
            else split_force_set_into_convex_pieces(
                None if thruster.barred_protects in dead_names else thruster.sector_rad,
                losses.find_forbidden_thrust_directions(thruster, working),
                losses.list_losses_at_dead_thrusters(thruster, dead),
                losses.list_losses_at_skegs(thruster, self.hull),
                step,
            )
            for i, thruster in enumerate(every)
        ]

    def find_unusable_thrusters(self, case: Case) -> frozenset[int]:
        """Return the indices of the lost thrusters and of those that may push in no direction."""
        nowhere = {i for i, parts in enumerate(self.pieces_of(case)) if not parts}
        return case.lost | nowhere

    def _list_piece_choices(self, case: Case) -> Choices:
        """Return each thruster's convex thrust areas in a failure case, to choose one from."""
        return tuple(tuple(some or [_NOWHERE]) for some in self.pieces_of(case))

    def least_use(self, case: Case, from_rad: float, wind_mps: float, chosen: Combination) -> float:
        """Return the least share of full thrust that holds a wind, in given convex thrust areas."""
        weather = self.weather(from_rad, wind_mps)
        return self._utilisation.least_use(
            weather.load, weather.shares, chosen, self.find_unusable_thrusters(case)
        )

    def find_least_use_and_pieces(
        self, case: Case, from_rad: float, wind_mps: float
    ) -> tuple[float, Combination]:
        """Return the least share of full thrust that holds a wind, and its convex thrust areas."""
        weather, lost = self.weather(from_rad, wind_mps), self.find_unusable_thrusters(case)
        return find_least_use_and_pieces(
            lambda some: self._utilisation.relax_to_convex_hulls(
                weather.load, weather.shares, some, lost
            ),
            self._list_piece_choices(case),
        )

    def find_wind_limit(self, case: Case, from_rad: float) -> WindLimit:
        """Return the largest wind held, with all weaker winds of the standard's table held too."""
        number, low = 0, 0.0
        # Nothing pushes in calm: any choice holds it.
        chosen = tuple(pieces[0] for pieces in self._list_piece_choices(case))
        for wind_mps, *_ in DP_CONDITIONS.values():
            # What holds this wind most likely holds the next.
            if self.least_use(case, from_rad, wind_mps, chosen) > 1.0:
                use, best = self.find_least_use_and_pieces(case, from_rad, wind_mps)
                if use > 1.0:
                    limit = self._solve_wind_limit_between(case, from_rad, (low, wind_mps), chosen)
                    return WindLimit(limit, number)
                chosen = best
            number, low = number + 1, wind_mps
        return WindLimit(low, number)

    def _solve_wind_limit_between(
        self, case: Case, from_rad: float, between: tuple[float, float], chosen: Combination
    ) -> float:
        """Return the wind [m/s] within `between` that takes full thrust, in the best areas.

        chosen : areas that hold the lower of the two.
        """
        low, high = between
        while True:

            def missing(wind_mps: float, chosen: Combination = chosen) -> float:
                return min(self.least_use(case, from_rad, wind_mps, chosen), 10.0) - 1.0

            if missing(high) <= 0.0:
                return high
            low = float(brentq(missing, low, high, xtol=WIND_TOLERANCE))
            # Not at the edge itself, as all choices hold a calm.
            above = low + WIND_TOLERANCE
            use, better = self.find_least_use_and_pieces(case, from_rad, above)
            if use >= 1.0 or above >= high:
                return low
            low, chosen = above, better


@dataclass(frozen=True)
class Capability:
    """Wind limits of a ship from each direction of `FROM_DEG`, by failure case, intact first.

    `lost` are the thrusters that a case lacks; `assumed` the keys that the hull's file leaves out.
    """

    vessel: str
    sides: int | None
    held: dict[str, tuple[WindLimit, ...]]
    lost: dict[str, tuple[str, ...]]
    assumed: tuple[str, ...]

    @property
    def limits_after_worst_failure(self) -> tuple[WindLimit, ...]:
        """The lowest wind limit after any failure, by direction."""
        failures = [held for case, held in self.held.items() if case != INTACT]
        return tuple(
            min(at_once, key=lambda held: held.wind_mps) for at_once in zip(*failures, strict=True)
        )

    @property
    def dp_capability_numbers(self) -> tuple[int, int, int, int]:
        """Least DP capability numbers near the bow and all round: intact, then worst failure."""
        return (
            *_least_numbers_at_bow_and_all_round(self.held[INTACT]),
            *_least_numbers_at_bow_and_all_round(self.limits_after_worst_failure),
        )

    @property
    def notation(self) -> str:
        """The four DP capability numbers in the standard's notation (2.5.1)."""
        return f"DP capability-L1({', '.join(map(str, self.dp_capability_numbers))})"


def _least_numbers_at_bow_and_all_round(held: tuple[WindLimit, ...]) -> tuple[int, int]:
    """Return the least DP capability number within `BOW_DEG` of the bow, and all round."""
    near = [
        at.number
        for at, from_deg in zip(held, FROM_DEG, strict=True)
        if abs(math.remainder(from_deg, 360.0)) <= BOW_DEG
    ]
    return min(near), min(at.number for at in held)


def compute_capability(frontier: CapabilityPlot, progress: Progress | None = None) -> Capability:
    """Return the wind limits from all directions; ArithmeticError if the cone solver fails."""
    progress, cases = progress or Silent(), frontier.intact_and_failure_cases
    progress.start(len(cases) * DIRECTIONS)
    held: dict[str, tuple[WindLimit, ...]] = {}
    for case in cases:
        edges = []
        for from_deg in FROM_DEG:
            edges.append(frontier.find_wind_limit(case, math.radians(from_deg)))
            progress.advance(1, f"{frontier.vessel.id}, {case.name}")
        held[case.name] = tuple(edges)
    names = [thruster.name for thruster in frontier.thrusters.thrusters]
    lost = {case.name: tuple(names[i] for i in sorted(case.lost)) for case in cases}
    return Capability(frontier.vessel.id, frontier.sides, held, lost, frontier.hull.assumed)


def is_beyond_standard_winds(held: WindLimit) -> bool:
    """Return whether a wind limit is in the last row of the standard's weather table."""
    return held.number == max(DP_CONDITIONS)
