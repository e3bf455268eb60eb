"""The largest wind held: published numbers, symmetry, order of polygons, and linear programs."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.capability.frontier import FROM_DEG, CapabilityPlot, Case, WindLimit
from dpbench.errors import InputError
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.loads import DP_CONDITIONS
from dpbench.ship.thrusters import ThrusterSet

pytestmark = pytest.mark.slow
INTACT = Case("intact", frozenset())
MSV = Path(__file__).with_name("msv.toml")
PUBLISHED = Path(__file__).parents[2] / "ship" / "capability" / "ratownik_published.csv"
PAIR = ("stern port", "stern starboard")


def test_numbers_are_the_published_ones(held_intact: list[WindLimit]) -> None:
    """All 36 of Ratownik intact."""
    published = pd.read_csv(PUBLISHED, comment="#")
    assert published["from_deg"].tolist() == list(FROM_DEG)
    assert [held.number for held in held_intact] == published["number"].tolist()


@pytest.mark.parametrize("sides", [None, 24])
def test_numbers_of_a_second_ship_are_the_published_ones(sides: int | None) -> None:
    """All 36 of MSV: two azimuths aft, two tunnels; 0° to 350°."""
    frontier = CapabilityPlot(load_vessel(MSV), sides)
    found = [
        frontier.find_wind_limit(INTACT, math.radians(from_deg)).number for from_deg in FROM_DEG
    ]
    to_starboard = [9, 9, 8, 7, 7, *(10 * [6]), 7, 8, 8, 9]
    assert found == [*to_starboard, *to_starboard[-2:0:-1]]


def test_winds_lie_in_the_rows_of_their_numbers(held_intact: list[WindLimit]) -> None:
    for held in held_intact:
        low, high = (DP_CONDITIONS[held.number + step][0] for step in (0, 1))
        assert low <= held.wind_mps < high


def test_port_and_starboard_hold_the_same(held_intact: list[WindLimit]) -> None:
    winds = np.array([held.wind_mps for held in held_intact])
    np.testing.assert_allclose(winds[1:], winds[:0:-1], atol=3e-4)


@pytest.mark.parametrize("case", ["board A", "board B"])
def test_without_interaction_a_thruster_never_helps_less_than_its_loss(case: str) -> None:
    frontier = CapabilityPlot(load_vessel("osv"))
    intact, *failures = frontier.intact_and_failure_cases
    failure = next(one for one in failures if one.name == case)
    for from_deg in range(0, 360, 40):
        whole, less = (
            frontier.find_wind_limit(one, math.radians(from_deg)) for one in (intact, failure)
        )
        assert less.wind_mps <= whole.wind_mps + 1e-3
        assert less.number <= whole.number


def test_polygons_become_the_circle_with_order_two() -> None:
    """Twice the sides give away a quarter of the thrust, the most over 24 directions."""
    vessel, wind_mps = load_vessel("osv"), 20.0
    directions = [math.radians(15.0 * k + 4.0) for k in range(24)]
    circle = np.array(
        [
            CapabilityPlot(vessel).find_least_use_and_pieces(INTACT, angle, wind_mps)[0]
            for angle in directions
        ]
    )
    gaps = []
    for sides in (8, 16, 32, 64):
        polygon = CapabilityPlot(vessel, sides)
        use = np.array(
            [polygon.find_least_use_and_pieces(INTACT, angle, wind_mps)[0] for angle in directions]
        )
        assert (use >= circle * (1.0 - 1e-8)).all()
        assert (use <= circle / math.cos(math.pi / sides) * (1.0 + 1e-8)).all()
        gaps.append((use / circle).max() - 1.0)
    assert [math.log2(a / b) for a, b in pairwise(gaps)] == pytest.approx([2.0] * 3, abs=0.4)


def test_a_ship_that_can_push_sideways_only_holds_nothing() -> None:
    """After the loss of all azimuths only tunnels are left: number 0, and next to no wind."""
    frontier = CapabilityPlot(load_vessel("ratownik"))
    held = frontier.find_wind_limit(Case("all azimuths", frozenset({0, 1, 2})), math.radians(30.0))
    assert held.number == 0
    assert held.wind_mps < 1e-2


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="thrusters: missing"):
        CapabilityPlot(load_vessel("supply_fs99"))
    with pytest.raises(InputError, match="capability: missing"):
        CapabilityPlot(replace(load_vessel("osv"), capability=None))
    for sides in (2, 7):
        with pytest.raises(InputError, match="an even number"):
            CapabilityPlot(load_vessel("osv"), sides)


def test_a_zone_is_open_in_the_cases_without_the_thruster_that_it_protects() -> None:
    """Then the ship holds what it holds without the zone; in other cases, what it holds with it."""
    vessel = load_vessel("osv")
    assert vessel.thrusters is not None
    thrusters = vessel.thrusters.thrusters
    port, starboard = (next(t for t in thrusters if t.name == name) for name in PAIR)
    half = (math.radians(-90.0), math.radians(90.0))

    def build_plot(**keys: Any) -> CapabilityPlot:
        every = [replace(t, **keys) if t is port else t for t in thrusters]
        return CapabilityPlot(replace(vessel, thrusters=ThrusterSet(tuple(every))))

    plots = [build_plot(sector_rad=half, barred_protects=starboard.name)]
    plots += [build_plot(), build_plot(sector_rad=half)]
    from_rad = math.radians(120.0)
    for case in plots[0].intact_and_failure_cases:
        protected, free, barred = (plot.find_wind_limit(case, from_rad) for plot in plots)
        lost = {thrusters[i].name for i in case.lost}
        assert protected == (free if starboard.name in lost else barred)
        if starboard.name in lost and port.name not in lost:
            assert free.wind_mps > barred.wind_mps + 0.5
    with pytest.raises(InputError, match=f"barred_protects: found 'nobody'; .*{starboard.name}"):
        build_plot(sector_rad=half, barred_protects="nobody")
