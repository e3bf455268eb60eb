"""The largest wind a ship holds from each direction, intact and after each failure."""

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import brentq

from dpbench.arrays import Vector
from dpbench.bench.capability.utilisation import Utilisation
from dpbench.errors import InputError
from dpbench.ship.capability import losses
from dpbench.ship.capability.conditions import DP_CONDITIONS, interpolate_condition
from dpbench.ship.capability.loads import DYNAMIC_FACTOR, mean_loads
from dpbench.ship.capability.shapes import Piece, convex_pieces
from dpbench.ship.vessel import Vessel

DIRECTIONS = 36
"""Every 10° (2.4.6)."""
INTACT = "intact"
CHORD_RAD = math.radians(1.0)
"""Angle between corners on the edge of a notch, where circles are circles."""
WIND_TOLERANCE = 1e-4
"""Of a wind held [m/s]."""

Combination = tuple[Piece, ...]


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
            raise InputError(vessel.where, "thrusters", "none", "[[thrusters]] of the vessel")
        if vessel.capability is None:
            allowed = "this table, with at least breadth_m and draught_m, and [windage]"
            raise InputError(vessel.where, "capability", "nothing", allowed)
        if sides is not None and (sides < 4 or sides % 2):
            raise InputError("sides", "", sides, "an even number from 4 on")
        self.vessel, self.thrusters, self.hull = vessel, vessel.thrusters, vessel.capability
        self.sides = sides
        self._utilisation = Utilisation(self.thrusters, sides)
        self.pieces_of = cache(self._split_thrust_areas)
        self.combinations = cache(self._list_combinations)
        # One wind is asked with many choices of pieces in a row.
        self.weather = lru_cache(maxsize=64)(self._compute_weather)

    @property
    def cases(self) -> list[Case]:
        """The intact ship, then the loss of each group of thrusters that fail together."""
        groups = self.thrusters.groups.items()
        return [
            Case(INTACT, frozenset()),
            *(Case(name, frozenset(numbers)) for name, numbers in groups),
        ]

    def _compute_weather(self, from_rad: float, wind_mps: float) -> Weather:
        """Return load and usable shares of thrust in wind, waves and current from `from_rad`."""
        condition = interpolate_condition(wind_mps)
        loads = mean_loads(self.hull, condition, from_rad)
        vented = [
            losses.thrust_share_when_vented(thruster, self.hull, condition, from_rad)
            for thruster in self.thrusters.thrusters
        ]
        return Weather(DYNAMIC_FACTOR * loads.sum(axis=0), losses.MISCELLANEOUS * np.array(vented))

    def _split_thrust_areas(self, case: Case) -> list[list[Piece]]:
        """Return each thruster's thrust area in one failure case, split into convex pieces."""
        every = self.thrusters.thrusters
        working = [every[j] for j in range(len(every)) if j not in case.lost]
        dead = [every[j] for j in sorted(case.lost)]
        step = CHORD_RAD if self.sides is None else 2.0 * math.pi / self.sides
        return [
            [Piece()]
            if thruster.kind != "azimuth" or i in case.lost
            else convex_pieces(
                thruster.sector_rad,
                losses.forbidden_zones(thruster, working),
                losses.dead_losses(thruster, dead),
                losses.skeg_losses(thruster, self.hull),
                step,
            )
            for i, thruster in enumerate(every)
        ]

    def lost_thrusters(self, case: Case) -> frozenset[int]:
        """Return the indices of the lost thrusters and of those that may push in no direction."""
        nowhere = {i for i, parts in enumerate(self.pieces_of(case)) if not parts}
        return case.lost | nowhere

    def _list_combinations(self, case: Case) -> list[Combination]:
        """Return every choice of one convex piece of thrust area for each thruster."""
        return list(product(*(some or [Piece()] for some in self.pieces_of(case))))

    def least_use(self, case: Case, from_rad: float, wind_mps: float, chosen: Combination) -> float:
        """Return the least share of full thrust that holds a wind, in given convex thrust areas."""
        weather = self.weather(from_rad, wind_mps)
        return self._utilisation.least_use(
            weather.load, weather.shares, chosen, self.lost_thrusters(case)
        )

    def best_choice(
        self, case: Case, from_rad: float, wind_mps: float
    ) -> tuple[float, Combination]:
        """Return the least share of full thrust that holds a wind, and its convex thrust areas."""
        uses = [
            (self.least_use(case, from_rad, wind_mps, chosen), chosen)
            for chosen in self.combinations(case)
        ]
        return min(uses, key=lambda use: use[0])

    def find_wind_limit(self, case: Case, from_rad: float) -> WindLimit:
        """Return the largest wind held, with all weaker winds of the standard's table held too."""
        number, low, choices = 0, 0.0, self.combinations(case).copy()
        for wind_mps, *_ in DP_CONDITIONS.values():
            uses = (self.least_use(case, from_rad, wind_mps, chosen) for chosen in choices)
            holding = next((i for i, use in enumerate(uses) if use <= 1.0), None)
            if holding is None:
                return WindLimit(
                    self._solve_wind_limit(case, from_rad, (low, wind_mps), choices), number
                )
            # What holds this wind most likely holds the next.
            choices.insert(0, choices.pop(holding))
            number, low = number + 1, wind_mps
        return WindLimit(low, number)

    def _solve_wind_limit(
        self, case: Case, from_rad: float, between: tuple[float, float], choices: list[Combination]
    ) -> float:
        """Return the wind [m/s] within `between` that takes full thrust, in the best areas."""
        low, high = between
        for chosen in choices:

            def missing(wind_mps: float, chosen: Combination = chosen) -> float:
                return min(self.least_use(case, from_rad, wind_mps, chosen), 10.0) - 1.0

            if missing(low) < 0.0:
                low = float(brentq(missing, low, high, xtol=WIND_TOLERANCE))
        return low
