"""The least use of thrust against a linear program of the corners of each thruster's forces."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from dpbench.bench.capability.utilisation import Utilisation
from dpbench.errors import InputError
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Thruster, ThrusterKind, ThrusterSet

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
