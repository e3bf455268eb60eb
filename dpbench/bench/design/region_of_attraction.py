"""How far a controller may be thrown off sideways and still bring the ship back.

The ship starts at rest at a pure sway offset, from starboard and from port, and the certified
optimum of every step steers it. An offset holds when the ship then stays within a tolerance of the
reference over the end of a long run, from both sides. What is measured is the design (horizon,
weights, limits), not a solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dpbench.bench.design.bracket import Bracket, Side, Trial, Verdict, find_edge
from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.errors import CertificateError
from dpbench.scenario.scenario import Scenario
from dpbench.ship.froude import Froude

# All at full size; a model ship is given what Froude's law makes of them.
OFFSETS_M = tuple(0.25 * 2.0**i for i in range(9))
"""Offsets that are tried first, 0.25 m to 64 m."""
WIDTH = 0.05
"""Of the bracket, relative to its upper end."""
DURATION_S = 600.0
"""Of a trial. The slowest return seen, from 64 m, takes more than four minutes."""
TAIL_S = 60.0
"""The end of a trial over which the ship has to stay where it belongs."""
TOLERANCE_M = 0.1
"""How close it has to stay: more than five times what the weather of `calm` moves it about."""

_SIDES: tuple[tuple[Side, float], ...] = (("starboard", 1.0), ("port", -1.0))


@dataclass(frozen=True)
class RegionOfAttraction:
    """The edge of the sway offsets [m] a controller brings the ship back from, in some weather."""

    weather: str
    bracket: Bracket


def froude_of(scenario: Scenario) -> Froude:
    """The scale of a scenario's ship."""
    return Froude(float(scenario.files["vessel"]["model_scale"]))


def verdict(scenario: Scenario, offset_m: float) -> Verdict:
    """What becomes of a ship that starts at rest at this offset [m]; to starboard if positive.

    A step without a certified optimum leaves the trial undecided.
    """
    scale = froude_of(scenario)
    start = np.array([0.0, offset_m, 0.0])
    try:
        state = solve_exactly(replace(scenario, start=start, velocity=np.zeros(3))).state
    except CertificateError:
        return "undecided"
    tail = round(TAIL_S * scale.time / scenario.sample_s)
    away = np.hypot(*(state[-tail - 1 :, 3:5] - scenario.reference[:2]).T)
    # NaN stays outside.
    return "holds" if (away <= TOLERANCE_M * scale.length).all() else "fails"


def trial(scenario: Scenario, offset_m: float) -> Trial:
    """An offset from both sides; one that does not hold settles it."""
    for side, sign in _SIDES:
        found = verdict(scenario, sign * offset_m)
        if found != "holds":
            return Trial(offset_m, found, side)
    return Trial(offset_m, "holds")


def region_of_attraction(scenario: Scenario, weather: str) -> RegionOfAttraction:
    """The region of a scenario's controller in the weather of the scenario, which is called so."""
    grid = [offset * froude_of(scenario).length for offset in OFFSETS_M]
    return RegionOfAttraction(
        weather, find_edge(lambda offset: trial(scenario, offset), grid, WIDTH)
    )
