"""The least use of thrust against a linear program of corners; the best choice of pieces; reach."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from dpbench.bench.capability.frontier import CapabilityPlot
from dpbench.bench.capability.utilisation import (
    Choices,
    ThrusterReach,
    Utilisation,
    find_least_use_and_pieces,
)
from dpbench.errors import InputError
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Screw, Thruster, ThrusterKind, ThrusterSet

Vector = NDArray[np.float64]
KINDS: tuple[ThrusterKind, ...] = ("azimuth", "tunnel", "main")
SIDES = 24


def draw_layout(rng: np.random.Generator) -> ThrusterSet | None:
    """One to twelve thrusters, half of them on a grid so that arms coincide; None if impossible."""
    drawn = []
    for i in range(rng.integers(1, 13)):
        kind = KINDS[rng.integers(3)]
        on_grid = rng.random() < 0.5
        x = rng.choice([-36.0, -30.0, 0.0, 30.0]) if on_grid else rng.uniform(-40.0, 40.0)
        y = rng.choice([-5.0, 0.0, 5.0]) if on_grid else rng.uniform(-8.0, 8.0)
        sector = None
        if kind == "azimuth" and rng.random() < 0.3:
            start = rng.uniform(-np.pi, np.pi)
            sector = (start, start + rng.uniform(0.05, np.pi))
        astern = rng.choice([0.0, 0.5, 1.0]) if kind == "main" else 1.0
        thrust_N = 10 ** rng.uniform(3.5, 6.0)
        drawn.append(Thruster(f"t{i}", kind, x, y, thrust_N, 8.0, astern, sector))
    try:
        return ThrusterSet(tuple(drawn))
    except InputError:
        return None


def corners(thruster: Thruster, sides: int, outside: bool) -> Vector:
    """Corners (c, 1 or 2) of a thruster's relative forces, of a polygon inside or around it."""
    if thruster.kind != "azimuth":
        return np.array([[1.0], [-thruster.astern]])
    angle = 2.0 * np.pi * np.arange(-sides, 2 * sides) / sides
    size = np.full(len(angle), 1.0 / np.cos(np.pi / sides) if outside else 1.0)
    if thruster.sector_rad is None:
        angle, size = angle[:sides], size[:sides]
    else:
        ends = np.array(thruster.sector_rad)
        inside = (angle > ends[0]) & (angle < ends[1])
        off = (ends % (2.0 * np.pi / sides)) - np.pi / sides
        edge = (1.0 if outside else np.cos(np.pi / sides)) / np.cos(off)
        angle, size = np.r_[angle[inside], ends], np.r_[size[inside], edge]
    return size[:, np.newaxis] * np.column_stack((np.cos(angle), np.sin(angle)))


def least_use(
    ship: ThrusterSet, load: Vector, shares: Vector, lost: set[int], sides: int, outside: bool
) -> float:
    """The least use, as weights of corners that sum to at most u for each thruster."""
    alive = [i for i in range(len(ship.thrusters)) if i not in lost]
    parts = [
        shares[i] * ship.thrusters[i].thrust_N * corner @ ship.thrusters[i].configuration_columns.T
        for i in alive
        for corner in [corners(ship.thrusters[i], sides, outside)]
    ]
    if not parts:
        return np.inf
    forces = np.vstack(parts).T
    units = np.array([1.0, 1.0, ship.longest_arm_m]) * np.abs(forces[:2]).max()
    size = float(np.abs(load / units).max())
    sums = np.zeros((len(alive), forces.shape[1] + 1))
    sums[:, -1] = -1.0
    for row, own in enumerate(
        np.split(np.arange(forces.shape[1]), np.cumsum(list(map(len, parts)))[:-1])
    ):
        sums[row, own] = 1.0
    exact = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    answer = linprog(
        np.eye(forces.shape[1] + 1)[-1],
        A_ub=sums,
        b_ub=np.zeros(len(alive)),
        A_eq=np.column_stack((forces / units[:, np.newaxis], np.zeros(3))),
        b_eq=-load / units / size,
        options=exact,
    )
    return np.inf if answer.x is None else float(answer.x[-1]) * size


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 800, 200))
def test_random_layouts_have_the_use_of_a_linear_program(first: int) -> None:
    """To 1e-6 for polygons, and between polygons inside and around for circles."""
    for seed in range(first, first + 200):
        rng = np.random.default_rng(seed)
        ship = draw_layout(rng)
        if ship is None:
            continue
        count = len(ship.thrusters)
        lost = {i for i in range(count) if rng.random() < 0.3}
        shares = rng.uniform(0.05, 1.0, count)
        load = ship.T_e @ (
            rng.normal(size=ship.n_f) * ship.repeat_for_each_force_entry(ship.largest_thrusts_N)
        )
        load *= rng.choice([0.01, 1.0], 3)
        chosen = tuple(Piece(thruster.sector_rad) for thruster in ship.thrusters)
        posed = load, shares, chosen, frozenset(lost)
        polygons = Utilisation(ship, SIDES).least_use(*posed)
        expected = least_use(ship, load, shares, lost, SIDES, outside=False)
        assert polygons == pytest.approx(expected, rel=1e-6), seed
        circles = Utilisation(ship).least_use(*posed)
        most = least_use(ship, load, shares, lost, 360, outside=False)
        least = least_use(ship, load, shares, lost, 360, outside=True)
        assert least * (1.0 - 1e-6) <= circles <= most * (1.0 + 1e-6), seed


def test_what_few_thrusters_cannot_balance_is_never_held() -> None:
    """A main propeller and a tunnel ahead of midships: no moment without a sway force."""
    pair = (
        Thruster("main", "main", -30.0, 0.0, 4e5, 8.0),
        Thruster("tunnel", "tunnel", 30.0, 0.0, 1e5, 8.0),
        Thruster("aft", "tunnel", -30.0, 0.0, 1e5, 8.0),
    )
    use = Utilisation(ThrusterSet(pair))
    chosen, full, lost = (Piece(),) * 3, np.ones(3), frozenset({2})
    assert use.least_use(np.array([0.0, 5e4, 0.0]), full, chosen, lost) == np.inf
    assert use.least_use(np.array([2e5, -5e4, -1.5e6]), full, chosen, lost) == pytest.approx(0.5)


def test_a_small_load_is_as_exact_as_a_large_one() -> None:
    """A use is proportional to its load; a billionth that cannot be balanced is not held either."""
    narrow = (0.4, 0.5)
    trio = (
        Thruster("fore", "tunnel", 30.0, 0.0, 3e4, 8.0),
        Thruster("aft", "tunnel", -36.0, 0.0, 7e4, 8.0),
        Thruster("azimuth", "azimuth", 3.0, -2.0, 7e4, 8.0, sector_rad=narrow),
    )
    use = Utilisation(ThrusterSet(trio), SIDES)
    posed = np.ones(3), (Piece(), Piece(), Piece(narrow)), frozenset[int]()
    load = np.array([-2e4, 3e3, 1e5])
    whole = use.least_use(load, *posed)
    for size in (1e-4, 1e-9):
        assert use.least_use(size * load, *posed) == pytest.approx(size * whole, rel=1e-8)
        assert use.least_use(-size * load, *posed) == np.inf


def test_two_tunnels_a_millimetre_apart_make_a_moment() -> None:
    """The second gives 1000 N for 1 N·m, of which the first takes back 999 N; it has 10 N."""
    trio = (
        Thruster("main", "main", -36.0, 0.0, 4e5, 8.0),
        Thruster("dry", "tunnel", 0.0, 0.0, 1e4, 8.0),
        Thruster("next", "tunnel", 1e-3, 0.0, 2.5e4, 8.0),
    )
    shares = np.array([1.0, 1e-3, 1.0])
    load = np.array([0.0, -1.0, -1.0])
    use = Utilisation(ThrusterSet(trio)).least_use(load, shares, (Piece(),) * 3, frozenset())
    assert use == pytest.approx(99.9, rel=1e-6)


def test_a_tunnel_in_the_bow_alone_is_held_straight_by_the_mains() -> None:
    """A tunnel 18 m ahead; mains 4 m off, with 100 kN astern each, balance a moment of 800 kN·m."""
    mains = [Thruster(f"main {y}", "main", -30.0, y, 200e3, 10.0, astern=0.5) for y in (-4.0, 4.0)]
    reach = ThrusterReach(ThrusterSet((*mains, Thruster("bow", "tunnel", 18.0, 0.0, 100e3, 10.0))))
    low, high = reach.find_least_and_largest_pure_forces()
    # Ahead on one side is at most what the other gives astern: no force in surge is left.
    np.testing.assert_allclose(high, [400e3, 2 * 100e3 * 4.0 / 18.0, 2 * 100e3 * 4.0], rtol=1e-6)
    np.testing.assert_allclose(low, [-200e3, -high[1], -high[2]], rtol=1e-6)
    assert reach.find_least_thrust_share(np.array([0.0, 44.4e3, 0.0])) < 1.0
    assert reach.find_least_thrust_share(np.array([0.0, 44.5e3, 0.0])) > 1.0


def test_the_share_is_that_of_the_attainable_polytope() -> None:
    """The polytope has 48 sides an azimuth, which lose 0.2 % of the thrust, for forces in any
    direction."""
    thrusters = load_vessel("ratownik").thrusters
    assert thrusters is not None
    rows = build_attainable_force_polytope(thrusters, 48).to_linear_limit_rows()
    reach, rng = ThrusterReach(thrusters), np.random.default_rng(3)
    for direction in rng.normal(size=(20, 3)) * [1e5, 1e5, 1e6]:
        along = rows.G @ direction
        expected = np.max(np.where(along > 0.0, along / rows.high, along / rows.low))
        assert reach.find_least_thrust_share(direction) == pytest.approx(expected, rel=3e-3)


def test_a_sector_that_excludes_a_force_leaves_none_of_it() -> None:
    """Two azimuths in line that may push ahead only make no force astern."""
    sector = (-0.5, 0.5)
    bow, stern = (
        Thruster(f"at {x}", "azimuth", x, 0.0, 1e5, 10.0, sector_rad=sector) for x in (30.0, -30.0)
    )
    low, high = ThrusterReach(ThrusterSet((bow, stern))).find_least_and_largest_pure_forces()
    assert low[0] == 0.0
    assert high[0] == pytest.approx(2e5, rel=3e-3)


def test_a_zone_narrower_than_a_half_turn_leaves_no_convex_set() -> None:
    """By hand: barred 30° to both sides of astern, its sway is what two tunnels can meet.

    The convex hull of what the azimuth can give would be 87 kN astern.
    """
    tunnels = [Thruster(f"at {x}", "tunnel", x, 0.0, 1e4, 8.0) for x in (30.0, -30.0)]
    zone = math.radians(210.0), math.radians(510.0)
    azimuth = Thruster("azimuth", "azimuth", 0.0, 0.0, 1e5, 10.0, sector_rad=zone)
    low, high = ThrusterReach(ThrusterSet((*tunnels, azimuth))).find_least_and_largest_pure_forces()
    assert low[0] == pytest.approx(-2e4 / math.tan(math.radians(30.0)), rel=1e-6)
    assert high[0] == pytest.approx(1e5, rel=1e-6)


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
