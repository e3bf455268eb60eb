"""The best choice of pieces against the trial of all, and how few bounds it takes."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dpbench.bench.capability.frontier import CapabilityPlot
from dpbench.bench.capability.utilisation import Choices, find_least_use_and_pieces
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Screw, Thruster, ThrusterSet


def ship_of_azimuths(count: int, sides: int | None = None) -> CapabilityPlot:
    """Azimuths in pairs along a ship, each in the race of its neighbours."""
    screw = Screw(3.1, "open", 1.5)
    steps = np.linspace(-40.0, 40.0, (count + 1) // 2)
    places = [(x, y) for x in steps for y in (-5.0, 5.0)][:count]
    azimuths = tuple(
        Thruster(f"t{i}", "azimuth", float(x), y, 1.9e5, 10.0, screw=screw)
        for i, (x, y) in enumerate(places)
    )
    return CapabilityPlot(
        replace(load_vessel("ratownik"), thrusters=ThrusterSet(azimuths)), sides=sides
    )


@pytest.mark.slow
@pytest.mark.parametrize("sides", [None, 24])
def test_the_best_choice_is_the_best_of_all(sides: int | None) -> None:
    """Four azimuths, intact and without one, in mild and heavy weather."""
    plot = ship_of_azimuths(4, sides)
    for case, from_deg, wind_mps in product(
        plot.intact_and_failure_cases[:2], (0.0, 70.0, 200.0), (5.0, 14.0)
    ):
        at = case, math.radians(from_deg), wind_mps
        every = [
            plot.least_use(*at, chosen)
            for chosen in product(*(some or [Piece()] for some in plot.pieces_of(case)))
        ]
        use, chosen = plot.find_least_use_and_pieces(*at)
        assert len(every) > 10
        assert use == pytest.approx(min(every), rel=1e-7)
        assert plot.least_use(*at, chosen) == use


def test_few_bounds_are_enough_for_many_choices() -> None:
    """The bound of each thruster's best piece is the best choice at once, if uses are sums."""
    pieces: Choices = tuple(tuple(Piece() for _ in range(4)) for _ in range(12))
    costs = {id(piece): 1.0 + k for some in pieces for k, piece in enumerate(some)}
    asked: list[Choices] = []

    def relax(some: Choices) -> tuple[float, list[np.ndarray]]:
        asked.append(some)
        own = [np.array([costs[id(piece)] for piece in one]) for one in some]
        return float(sum(cost.min() for cost in own)), [1.0 / cost for cost in own]

    use, chosen = find_least_use_and_pieces(relax, pieces)
    assert use == 12.0
    assert chosen == tuple(some[0] for some in pieces)
    assert len(asked) == 2


@pytest.mark.slow
def test_eight_azimuths_in_each_others_race_have_an_edge() -> None:
    """11 664 choices; one direction took a minute where each was tried."""
    plot = ship_of_azimuths(8)
    assert (
        math.prod(len(some) for some in plot.pieces_of(plot.intact_and_failure_cases[0])) == 11_664
    )
    edge = plot.find_wind_limit(plot.intact_and_failure_cases[0], math.radians(70.0))
    assert plot.find_least_use_and_pieces(
        plot.intact_and_failure_cases[0], math.radians(70.0), edge.wind_mps
    )[0] == pytest.approx(1)
    mirrored = plot.find_wind_limit(plot.intact_and_failure_cases[0], math.radians(-70.0))
    assert mirrored.wind_mps == pytest.approx(edge.wind_mps, abs=1e-5)


@pytest.mark.slow
def test_a_ship_whose_first_pieces_balance_nothing_has_an_edge() -> None:
    """In a calm all choices are alike; the edge is that of the choice that holds some wind."""
    plot = ship_of_azimuths(2)
    case = plot.intact_and_failure_cases[0]
    first = tuple(some[0] for some in plot.pieces_of(case))
    starboard, port = math.radians(90.0), math.radians(270.0)
    assert plot.least_use(case, starboard, 1e-3, first) < 1.0
    assert plot.least_use(case, port, 1e-3, first) == math.inf
    edge = plot.find_wind_limit(case, starboard).wind_mps
    assert plot.find_wind_limit(case, port).wind_mps == pytest.approx(edge)
