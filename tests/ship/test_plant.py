"""The plant against closed forms, balances, symmetries and a second integrator."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Environment, SensorNoise
from dpbench.ship.plant import SUBSTEPS, Sensors, ShipPlant
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import FirstOrderMotion, Sea
from tests.ship.conftest import CALM, linear_vessel, rotation

FULL_SCALE = ("supply_fs99", "supply_mss", "supply_tmr", "osv")
SAMPLE_S = 0.3


def weather(ship: Vessel, period_s: float = 20.0, ramp_s: float = 0.0) -> Environment:
    """Forces of a third of the ship's limits, so that every vessel is driven alike."""
    third = ship.tau_max / 3.0
    return Environment(
        0.5 * third, third, period_s * np.array([1.0, 1.3, 0.8]), np.array([0.0, 1.0, 2.0]), ramp_s
    )


def simulate(
    ship: Vessel,
    state: np.ndarray,
    tau: np.ndarray,
    sea: Environment,
    steps: int,
    sample_s: float = SAMPLE_S,
    substeps: int = SUBSTEPS,
) -> np.ndarray:
    """States (steps + 1, 6) at the samples."""
    plant = ShipPlant(ship, state, sample_s, substeps)
    table = sea.build_weather_table_at_stages(steps, sample_s, substeps)
    states = [plant.state.copy()]
    for stages in table:
        plant.advance_by_one_sample(tau, stages)
        states.append(plant.state.copy())
    return np.array(states)


def equations_of_motion(
    ship: Vessel, tau: np.ndarray, force: Callable[[float], np.ndarray]
) -> Callable[[float, np.ndarray], np.ndarray]:
    """Paper eq. 3-4 in matrix form."""

    def derivative(t: float, s: np.ndarray) -> np.ndarray:
        nu, R = s[:3], rotation(s[5])
        nu_dot = np.linalg.solve(ship.M, tau + R.T @ force(t) - ship.D @ nu)
        return np.concatenate([nu_dot, R @ nu])

    return derivative


def turning(ship: Vessel) -> np.ndarray:
    """A start that moves and turns, scaled to the ship's length and limits."""
    speed = np.abs(np.linalg.solve(ship.D, ship.tau_max)) * np.array([0.05, 0.05, 0.05])
    return np.concatenate([speed * [1.0, -1.0, 1.0], [1.2, 1.3, 0.7]])


def test_constant_surge_force_follows_the_closed_form() -> None:
    """Under a constant surge force a ship at zero heading follows u = τ/D·(1 − e^{−Dt/M})."""
    ship = load_vessel("supply_fs99")
    tau = np.array([300e3, 0.0, 0.0])
    states = simulate(ship, np.zeros(6), tau, CALM, 200)
    t = SAMPLE_S * np.arange(201)
    m, d = ship.M[0, 0], ship.D[0, 0]
    grown = -np.expm1(-d * t / m)
    # Truncation is (hd/m)^5, about 1e-18; what remains is the rounding of 2000 sub-steps.
    np.testing.assert_allclose(states[:, 0], tau[0] / d * grown, rtol=1e-12, atol=1e-14)
    north = tau[0] / d * (t - m / d * grown)
    np.testing.assert_allclose(states[:, 3], north, rtol=1e-12, atol=1e-11)
    np.testing.assert_array_equal(states[:, [1, 2, 4, 5]], 0.0)


def test_a_constant_force_is_balanced_by_damping_in_the_end() -> None:
    """Without heading change the velocities settle where D ν = τ + w, sway-yaw coupling included.

    The moment is chosen so that the settled yaw rate is zero and the ship does not turn.
    """
    ship = load_vessel("supply_fs99")
    nu_end = np.array([0.4, -0.3, 0.0])
    tau = ship.D @ nu_end
    # Starting at ν_end the ship must stay: any wrong sign or transpose of D moves it.
    states = simulate(ship, np.concatenate([nu_end, np.zeros(3)]), tau, CALM, 400)
    np.testing.assert_allclose(states[:, :3], np.tile(nu_end, (401, 1)), rtol=0, atol=1e-12)
    t = SAMPLE_S * np.arange(401)
    np.testing.assert_allclose(states[:, 3:5], np.outer(t, nu_end[:2]), rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("name", FULL_SCALE)
def test_kinetic_energy_changes_by_work_less_dissipation(name: str) -> None:
    """½νᵀMν grows by exactly the work of τ and Rᵀb less what damping takes."""
    ship = linear_vessel(name)
    tau = 0.3 * ship.tau_max
    sea = weather(ship)
    fine_s, steps = 0.01, 1000
    states = simulate(ship, turning(ship), tau, sea, steps, fine_s, 1)
    t = fine_s * np.arange(steps + 1)
    nu, psi = states[:, :3], states[:, 5]
    b = sea.compute_slow_forces_and_squalls(t)
    w = b.copy()
    w[:, 0] = np.cos(psi) * b[:, 0] + np.sin(psi) * b[:, 1]
    w[:, 1] = -np.sin(psi) * b[:, 0] + np.cos(psi) * b[:, 1]
    power = np.einsum("ki,ki->k", nu, tau + w - nu @ ship.D.T)
    weights = np.ones(steps + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    work = fine_s / 3.0 * weights @ power
    energy = 0.5 * np.einsum("ki,ij,kj->k", nu, ship.M, nu)
    # Simpson and the integrator are both of order h⁴: (0.01 s · 1/s)⁴ = 1e-8 for the fastest mode.
    assert work == pytest.approx(energy[-1] - energy[0], rel=1e-8)


@pytest.mark.parametrize("angle_rad", [0.4, np.pi / 2, -2.0])
def test_the_plant_has_no_preferred_compass_direction(angle_rad: float) -> None:
    ship = linear_vessel("supply_mss")
    R, start, tau = rotation(angle_rad), turning(ship), 0.2 * ship.tau_max
    straight = ShipPlant(ship, start, SAMPLE_S)
    turned_start = start.copy()
    turned_start[3:] = R @ start[3:]
    turned_start[5] += angle_rad
    turned = ShipPlant(ship, turned_start, SAMPLE_S)
    for stages in weather(ship).build_weather_table_at_stages(100, SAMPLE_S, SUBSTEPS):
        straight.advance_by_one_sample(tau, stages)
        turned.advance_by_one_sample(tau, np.ascontiguousarray(stages @ R.T))
    # Only rounding differs, grown over 1000 sub-steps.
    np.testing.assert_allclose(turned.state[:3], straight.state[:3], rtol=0, atol=1e-11)
    np.testing.assert_allclose(turned.state[3:5], R[:2, :2] @ straight.state[3:5], atol=1e-10)
    assert turned.state[5] == pytest.approx(straight.state[5] + angle_rad, abs=1e-11)


@pytest.mark.parametrize("name", [*FULL_SCALE, "cybership2"])
def test_the_plant_agrees_with_an_adaptive_integrator(name: str) -> None:
    ship = linear_vessel(name)
    scale = 1.0 if name != "cybership2" else 1.0 / np.sqrt(70.0)
    sample_s, steps = SAMPLE_S * scale, 100
    sea = weather(ship, 20.0 * scale, 6.0 * scale)
    tau, start = 0.3 * ship.tau_max, turning(ship)
    ours = simulate(ship, start, tau, sea, steps, sample_s)
    derivative = equations_of_motion(ship, tau, sea.compute_slow_forces_and_squalls)
    # The ramp has a kink at 6 s, a sample's end; the reference is restarted there.
    state = start
    for begin, end in ((0.0, 6.0 * scale), (6.0 * scale, sample_s * steps)):
        state = solve_ivp(
            derivative, (begin, end), state, method="DOP853", rtol=1e-13, atol=1e-14
        ).y[:, -1]
    # RK4 at 0.03 s on osv's yaw mode of 1/s leaves (0.03)^4/120 ≈ 7e-9 of a transient.
    np.testing.assert_allclose(ours[-1], state, rtol=2e-9, atol=1e-9)


@pytest.mark.parametrize("name", FULL_SCALE)
def test_ten_sub_steps_leave_less_than_a_nanometre_per_sample(name: str) -> None:
    ship = linear_vessel(name)
    sea, tau, start = weather(ship), 0.3 * ship.tau_max, turning(ship)
    coarse = simulate(ship, start, tau, sea, 1)[-1]
    fine = simulate(ship, start, tau, sea, 1, substeps=80)[-1]
    np.testing.assert_allclose(coarse[3:], fine[3:], rtol=0, atol=1e-10)


def test_a_sample_has_ten_sub_steps_unless_stated() -> None:
    """A plant that states none takes 21 rows of weather a sample, as one with ten does."""
    ship = linear_vessel("osv")
    default, ten = (
        ShipPlant(ship, turning(ship), SAMPLE_S),
        ShipPlant(ship, turning(ship), SAMPLE_S, 10),
    )
    stages = weather(ship).build_weather_table_at_stages(1, SAMPLE_S, 10)[0]
    for plant in (default, ten):
        plant.advance_by_one_sample(0.3 * ship.tau_max, stages)
    np.testing.assert_array_equal(default.state, ten.state)


def test_the_start_state_is_copied() -> None:
    ship = load_vessel("supply_fs99")
    start = np.zeros(6)
    plant = ShipPlant(ship, start, SAMPLE_S)
    plant.advance_by_one_sample(
        ship.tau_max, CALM.build_weather_table_at_stages(1, SAMPLE_S, SUBSTEPS)[0]
    )
    np.testing.assert_array_equal(start, 0.0)
    assert plant.state[0] > 0.0


def test_the_heading_is_never_wrapped() -> None:
    ship = load_vessel("supply_fs99")
    states = simulate(
        ship, np.array([0.0, 0.0, 0.05, 0.0, 0.0, 3.0]), np.array([0.0, 0.0, 18e6]), CALM, 200
    )
    assert states[-1, 5] > np.pi
    assert np.abs(np.diff(states[:, 5])).max() < 0.05


def measured_weather(**more: object) -> Environment:
    return replace(CALM, seed=3, **more)  # type: ignore[arg-type] # fields of several types


def test_ideal_sensors_show_the_state() -> None:
    state = np.arange(6.0)
    np.testing.assert_array_equal(
        Sensors(measured_weather(), 4, 0.3).measure_state(state, 2), state
    )


def test_wave_motion_and_noise_are_added_to_pose_and_speed() -> None:
    """The pose gets η_w and noise, the speed R(ψ)ᵀ dη_w/dt, for a ship that heads 40°."""
    sea = Sea(2.0, 8.5, 0.5)
    motion = FirstOrderMotion(sea, 0.6, 0.2, 0.01)
    sky = measured_weather(motion=motion, noise=SensorNoise(np.array([0.1, 0.2, 0.003])))
    state = np.array([0.5, -0.2, 0.01, 3.0, 4.0, np.radians(40.0)])
    k, sample_s = 7, 0.3
    moved, noise = (
        sky.wave_frequency_motion_at_samples(10, sample_s)[k],
        sky.draw_measurement_noise(10)[k],
    )
    found = Sensors(sky, 10, sample_s).measure_state(state, k)
    speed = state[:3] + rotation(state[5]).T @ moved[3:]
    np.testing.assert_allclose(found[:3], speed, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[3:], state[3:] + moved[:3] + noise, rtol=0, atol=1e-14)
    assert np.abs(found - state).min() > 0


def test_measured_speed_is_the_rate_of_the_measured_pose() -> None:
    sky = measured_weather(motion=FirstOrderMotion(Sea(2.0, 8.5, 0.5), 0.6, 0.2, 0.01))
    sample_s = 1e-3
    sensors, rest = Sensors(sky, 3, sample_s), np.zeros(6)
    before, here, after = (sensors.measure_state(rest, k).copy() for k in range(3))
    slope = (after[3:] - before[3:]) / (2 * sample_s)
    # A central difference over 2 ms of motion with ω up to 3.7 rad/s: ω³h²/6 of a metre.
    np.testing.assert_allclose(here[:3], slope, rtol=0, atol=1e-4)
