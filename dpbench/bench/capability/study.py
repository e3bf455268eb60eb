"""The capability of a ship from all directions, intact and after each failure."""

import math
from dataclasses import dataclass

from dpbench.bench.capability.frontier import DIRECTIONS, INTACT, CapabilityPlot, WindLimit
from dpbench.bench.progress import Progress, Silent
from dpbench.ship.capability.conditions import DP_CONDITIONS

BOW_DEG = 30.0
"""The sector to either side of the bow that the notation names (2.5.1)."""
FROM_DEG = tuple(360.0 * k / DIRECTIONS for k in range(DIRECTIONS))
"""Directions of wind, waves and current, clockwise from ahead."""


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
    def worst_failure(self) -> tuple[WindLimit, ...]:
        """The lowest wind limit after any failure, by direction."""
        failures = [held for case, held in self.held.items() if case != INTACT]
        return tuple(
            min(at_once, key=lambda held: held.wind_mps) for at_once in zip(*failures, strict=True)
        )

    @property
    def numbers(self) -> tuple[int, int, int, int]:
        """Least DP capability numbers near the bow and all round: intact, then worst failure."""
        return (*_least_numbers(self.held[INTACT]), *_least_numbers(self.worst_failure))

    @property
    def notation(self) -> str:
        """The four DP capability numbers in the standard's notation (2.5.1)."""
        return f"DP capability-L1({', '.join(map(str, self.numbers))})"


def _least_numbers(held: tuple[WindLimit, ...]) -> tuple[int, int]:
    """Return the least DP capability number within `BOW_DEG` of the bow, and all round."""
    near = [
        at.number
        for at, from_deg in zip(held, FROM_DEG, strict=True)
        if abs(math.remainder(from_deg, 360.0)) <= BOW_DEG
    ]
    return min(near), min(at.number for at in held)


def compute_capability(frontier: CapabilityPlot, progress: Progress | None = None) -> Capability:
    """Return the wind limits from all directions; ArithmeticError if the cone solver fails."""
    progress, cases = progress or Silent(), frontier.cases
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


def is_beyond_standard(held: WindLimit) -> bool:
    """Return whether a wind limit is in the last row of the standard's weather table."""
    return held.number == max(DP_CONDITIONS)
