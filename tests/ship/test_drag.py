"""Cross-flow drag against strips summed one by one, another integrator, DNV-ST-0111 and Froude."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from dpbench.scenario.scenario import load_scenario, load_vessel
from dpbench.ship.capability.loads import Condition, compute_mean_environmental_loads
from dpbench.ship.characteristics import compute_mean_weather_force
from dpbench.ship.froude import Froude
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from dpbench.ship.vessel import HullDrag, Vessel, compute_cross_flow_drag_coefficient
from tests.ship.conftest import flowing, rotation

ZERO = np.zeros(3)
START = np.array([0.4, -0.3, 0.01, 1.2, 1.3, 0.7])
STRIPS = 2000
SPEEDS = st.floats(-2.0, 2.0)
TURNS = st.floats(-0.05, 0.05)


def with_drag() -> Vessel:
    """The rescue ship, whose hull below the water is published, with drag and all couplings.

    Its linear damping is small enough that none of it is taken away.
    """
    vessel = load_vessel("ratownik")
    assert vessel.capability is not None
    couplings = np.array([[0.0, 3e4, 2e6], [5e4, 0.0, -4e6], [-1e6, -3e6, 0.0]])
    small = np.diag([1.0, 0.5, 1.0]) * vessel.D
    return replace(vessel, D=small + couplings, drag=HullDrag.from_hull(vessel.capability))


def sum_strips(D: np.ndarray, u: float, v: float, r: float) -> np.ndarray:
    """The force on `ratownik` by the numbers of its file, strip by strip; B/2T is 1.88."""
    length, area, centre = 95.85, 440.9, 4.717
    x = centre + length * ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5)
    w = v + x * r
    strips = 0.5 * 1026.0 * 0.6637 * area / STRIPS * w * np.abs(w)
    speed = math.hypot(u, v)
    left = math.exp(-speed / (0.004 * math.sqrt(9.81 * 86.56)))
    S = np.diag([left**0.5, left**0.5, 1.0])
    along = 0.5 * 1026.0 * 0.07 * 18.8 * 5.0 * speed * u
    force: np.ndarray = S @ D @ S @ [u, v, r] + [along, strips.sum(), (x * strips).sum()]
    return force


@pytest.mark.parametrize(
    ("u", "v", "r"),
    [
        *((0.0, 0.6, 0.0), (0.3, -0.6, 0.0), (0.0, 0.0, 0.02), (-0.5, 0.1, -0.03)),
        *((0.2, 0.9, 0.005), (0.2, -0.9, 0.005), (0.05, 0.05, 0.001)),
    ],
)
def test_the_force_is_that_of_the_strips(u: float, v: float, r: float) -> None:
    """Ahead, astern, to either side and in either turn; 0.6637 has four digits of C_d."""
    ship, velocity = with_drag(), np.array([u, v, r])
    np.testing.assert_allclose(
        ship.force_to_keep_velocity(velocity), sum_strips(ship.D, u, v, r), rtol=2e-4, atol=1.0
    )


@pytest.mark.parametrize(
    ("name", "length_m", "area_m2", "coefficient", "scale"),
    [
        ("supply_mss", 76.2, 76.2 * 6.25, 0.733, 1.0),
        ("supply_tmr", 82.8, 82.8 * 6.0, 0.700, 1.0),
        ("osv", 83.0, 83.0 * 5.0, 0.666, 1.0),
        ("ratownik", 95.85, 440.9, 0.656, 1.0),
        ("cybership2", 1.255, 1.255 * 0.1, 0.731, 70.0),
    ],
)
def test_a_library_ship_meets_the_drag_of_its_strips_in_a_current_abeam(
    name: str, length_m: float, area_m2: float, coefficient: float, scale: float
) -> None:
    """At 0.5 m/s of the full-size ship within 30 %; C_d by the curve as MSS has it digitised."""
    sway_mps = 0.5 / math.sqrt(scale)
    strips = np.full(200, 0.5 * 1026.0 * coefficient * area_m2 / length_m * sway_mps**2)
    expected = strips.sum() * length_m / len(strips)
    force = load_vessel(name).force_to_keep_velocity(np.array([0.0, sway_mps, 0.0]))[1]
    assert force == pytest.approx(expected, rel=0.3)


def test_the_ship_of_the_paper_meets_its_published_damping() -> None:
    """Fossen & Strand 1999: 2.7229e5 N s/m in sway at any speed, in its scenarios."""
    for name in ("paper", "paper_tight"):
        ship = load_scenario(name).true_ship
        assert ship.drag is None
        assert ship.force_to_keep_velocity(np.array([0.0, 0.5, 0.0]))[1] == pytest.approx(
            0.5 * 2.7229e5
        )


@pytest.mark.slow
@given(u=SPEEDS, v=SPEEDS, r=TURNS)
def test_the_force_is_that_of_many_strips(u: float, v: float, r: float) -> None:
    """In any motion, also one in which bow and stern move to different sides."""
    ship = with_drag()
    expected = sum_strips(ship.D, u, v, r)
    scale = 1.0 + math.hypot(u, v, 48.0 * r) ** 2
    error = (ship.force_to_keep_velocity(np.array([u, v, r])) - expected) / np.array(
        [1.0, 1.0, 48.0]
    )
    assert np.abs(error).max() <= 20.0 * scale


@pytest.mark.slow
@given(u=SPEEDS, v=SPEEDS, r=TURNS)
def test_drag_takes_power_from_any_motion(u: float, v: float, r: float) -> None:
    """Whatever D is, if it is positive definite."""
    ship, velocity = with_drag(), np.array([u, v, r])
    D = ship.D.copy()
    D[1, 2] = D[2, 1] = 0.99 * math.sqrt(D[1, 1] * D[2, 2])
    assert replace(ship, D=D).force_to_keep_velocity(velocity) @ velocity >= 0.0


def test_slow_motion_meets_the_linear_damping() -> None:
    """At 0.1 mm/s and as slow a turn; at ten times V_0 nothing of it is left but in yaw."""
    ship = with_drag()
    slow = np.array([1e-4, -1e-4, 2e-6])
    np.testing.assert_allclose(ship.force_to_keep_velocity(slow), ship.D @ slow, rtol=3e-3)
    without = replace(ship, D=1e-6 * ship.D)
    fast = np.array([0.8, -0.9, 0.0])
    force, drag = ship.force_to_keep_velocity(fast), without.force_to_keep_velocity(fast)
    np.testing.assert_allclose(force[:2], drag[:2], rtol=3e-3)
    # Couplings fade with the root.
    assert force[2] == pytest.approx(drag[2], rel=0.03)


@pytest.mark.parametrize("name", ["supply_mss", "supply_tmr", "osv", "ratownik", "cybership2"])
def test_the_force_abeam_never_falls_as_the_speed_rises(name: str) -> None:
    """Up to 1.5 m/s at full size, in steps of 2 mm/s, to either side."""
    ship = load_vessel(name)
    speeds = np.linspace(0.0, 1.5 if ship.length_m > 10.0 else 0.18, 751)
    for sign in (1.0, -1.0):
        velocities = np.zeros((len(speeds), 3))
        velocities[:, 1] = sign * speeds
        forces = [sign * ship.force_to_keep_velocity(one)[1] for one in velocities]
        assert (np.diff(forces) >= -1e-9 * forces[-1]).all()


def test_no_more_damping_is_taken_away_than_must_be() -> None:
    """With 1 % more of it the force would fall; of a ship of which it does not, all is left."""
    ship, other = load_vessel("ratownik"), load_vessel("supply_mss")
    assert ship.drag is not None and other.drag is not None
    v = np.linspace(0.0, 0.5, 5001)
    limited = ship.drag.limit_linear_damping(ship.D)
    assert limited[1, 1] < ship.D[1, 1] and limited[0, 0] == ship.D[0, 0]
    linear = 1.01 * limited[1, 1] * v * np.exp(-v / (0.004 * math.sqrt(9.81 * 86.56)))
    assert np.diff(linear + ship.drag.across * v * v).min() < 0.0
    assert (other.drag.limit_linear_damping(other.D) == other.D).all()


@pytest.mark.parametrize(
    ("half_ratio", "published"),
    [
        *((0.177, 1.966), (0.353, 1.898), (0.4728, 1.584), (0.646, 0.999), (0.834, 0.880)),
        *((0.988, 0.828), (1.308, 0.760), (1.64, 0.691), (1.86, 0.657), (2.31, 0.631)),
        *((2.6, 0.596), (3.01, 0.587), (3.45, 0.586), (4.0, 0.559), (6.0, 0.559)),
    ],
)
def test_the_coefficient_is_hoerners(half_ratio: float, published: float) -> None:
    """Within 2 % of the curve as MSS has it digitised, `Hoerner.m`."""
    assert compute_cross_flow_drag_coefficient(2.0 * half_ratio, 1.0) == pytest.approx(
        published, rel=0.02
    )


def test_the_force_of_a_current_is_near_that_of_the_standard() -> None:
    """Ahead equal to DNV-ST-0111, abeam by C_d over its 0.6, with the moment about x_c."""
    ship = with_drag()
    assert ship.capability is not None
    still = replace(ship, D=1e-9 * ship.D)
    ahead, abeam = (
        compute_mean_environmental_loads(ship.capability, Condition(0.0, 0.0, 3.5, 0.75), from_rad)[
            1
        ]
        for from_rad in (0.0, math.pi / 2)
    )
    np.testing.assert_allclose(
        compute_mean_weather_force(still, flowing(0.75, math.pi)), ahead, rtol=1e-6, atol=1e-3
    )
    felt = compute_mean_weather_force(still, flowing(0.75, -math.pi / 2))
    np.testing.assert_allclose(felt[1:], abeam[1:] * 0.6637 / 0.6, rtol=1e-3)


def test_the_plant_agrees_with_an_adaptive_integrator() -> None:
    """Under thrust in a current and gusts it follows an eighth-order integrator of the strips.

    The gusts change by a tenth between the stages of a sub-step.
    """
    ship = with_drag()
    gust_N, period_s = np.array([4e6, 0.0, 0.0]), 1.1
    sea = replace(flowing(0.6, 2.0), amplitude=gust_N, period_s=np.full(3, period_s))

    def derivative(t: float, s: np.ndarray) -> np.ndarray:
        R = rotation(s[5])
        water = R.T @ [0.6 * np.cos(2.0), 0.6 * np.sin(2.0), 0.0]
        force = 0.2 * ship.tau_max - sum_strips(ship.D, *(s[:3] - water))
        force += R.T @ gust_N * np.sin(2.0 * np.pi * t / period_s)
        return np.concatenate([np.linalg.solve(ship.M, force), R @ s[:3]])

    plant = ShipPlant(ship, START, 0.3, loads=sea.wind_and_drift_coefficients(ship))
    for stages in sea.build_weather_table_at_stages(40, 0.3, SUBSTEPS):
        plant.advance_by_one_sample(0.2 * ship.tau_max, stages)
    theirs = solve_ivp(derivative, (0.0, 12.0), START, method="DOP853", rtol=1e-10, atol=1e-11)
    # C_d above has four digits.
    np.testing.assert_allclose(plant.state, theirs.y[:, -1], rtol=2e-4)


def test_a_model_ship_with_drag_moves_as_its_full_size_ship() -> None:
    """At 1 : 70 by Froude's law, to rounding."""
    ship, law = with_drag(), Froude(70.0)
    assert ship.capability is not None
    lengths = ("length_m", "breadth_m", "draught_m", "submerged_length_m", "current_x_m")
    smaller = {key: getattr(ship.capability, key) * law.length_factor for key in lengths}
    area = ship.capability.submerged_m2 * law.length_factor**2
    arm = np.array([1.0, 1.0, law.length_factor])
    by_mass = law.length_factor**3 * np.outer(arm, arm)
    model = replace(
        ship,
        length_m=ship.length_m * law.length_factor,
        M=by_mass * ship.M,
        D=by_mass * ship.D / law.time_and_speed_factor,
        drag=HullDrag.from_hull(replace(ship.capability, submerged_m2=area, **smaller)),
    )
    at_full_size = np.concatenate([law.velocity_factors, law.pose_factors])
    states = []
    for each, scale, start in ((ship, Froude(), START), (model, law, START * at_full_size)):
        sea = flowing(0.6 * scale.time_and_speed_factor, 2.0)
        plant = ShipPlant(
            each,
            start,
            0.3 * scale.time_and_speed_factor,
            loads=sea.wind_and_drift_coefficients(each),
        )
        for stages in sea.build_weather_table_at_stages(
            200, 0.3 * scale.time_and_speed_factor, SUBSTEPS
        ):
            plant.advance_by_one_sample(0.2 * ship.tau_max * scale.force_and_moment_factors, stages)
        states.append(plant.state)
    np.testing.assert_allclose(states[1], states[0] * at_full_size, rtol=1e-11)


def test_a_free_ship_with_drag_ends_up_drifting_with_the_current() -> None:
    """Carried along until the water around it is at rest."""
    ship, sea = with_drag(), flowing(0.75, 2.0)
    plant = ShipPlant(ship, np.zeros(6), 1.0, loads=sea.wind_and_drift_coefficients(ship))
    stages = sea.build_weather_table_at_stages(1, 1.0, SUBSTEPS)[0]
    for _ in range(5000):
        plant.advance_by_one_sample(ZERO, stages)
    u, v, r, *_, psi = plant.state
    north, east = np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v
    np.testing.assert_allclose([north, east], 0.75 * np.array([np.cos(2), np.sin(2)]), atol=1e-6)
    assert r == pytest.approx(0.0, abs=1e-9)


def test_the_mean_load_is_what_the_plant_feels() -> None:
    """By the momentum that an enormous mass takes up in a current from the quarter."""
    ship, sea = with_drag(), flowing(0.75, -2.2)
    still = replace(ship, M=1e9 * ship.M)
    plant = ShipPlant(still, np.zeros(6), 1.0, loads=sea.wind_and_drift_coefficients(ship))
    plant.advance_by_one_sample(ZERO, sea.build_weather_table_at_stages(1, 1.0, SUBSTEPS)[0])
    np.testing.assert_allclose(
        still.M @ plant.state[:3], compute_mean_weather_force(ship, sea), rtol=1e-6
    )


def test_a_mismatch_of_damping_is_one_of_drag_too() -> None:
    """By the same percentage at any speed."""
    ship = with_drag()
    for velocity in ([1e-3, 1e-3, 1e-5], [0.5, 1.0, 0.01]):
        force, more = (
            one.force_to_keep_velocity(np.array(velocity))
            for one in (ship, ship.copy_with_model_mismatch(damping_percent=20.0))
        )
        np.testing.assert_allclose(more, 1.2 * force, rtol=1e-12)


def test_a_ship_with_drag_needs_the_weather_that_moves_with_it() -> None:
    """Three columns have no velocity of the water."""
    plant = ShipPlant(with_drag(), START, 0.3)
    with pytest.raises(ValueError, match="9 columns"):
        plant.advance_by_one_sample(ZERO, np.zeros((2 * SUBSTEPS + 1, 3)))
