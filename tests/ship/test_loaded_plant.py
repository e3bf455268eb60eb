"""The plant in wind, current and drift against a second integrator, its order and its kernels."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dpbench.scenario.scenario import load_vessel
from dpbench.ship.environment import Current, Environment
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import Sea, WaveDrift, Wind
from tests.ship.conftest import flowing, rotation

WAVES = Sea(3.1, 8.5, 0.4)
START = np.array([0.4, -0.3, 0.01, 1.2, 1.3, 0.7])


def weather(gusts: str) -> Environment:
    """Slow forces, wind, current and drift from different sides."""
    return Environment(
        np.array([20e3, -30e3, 500e3]),
        np.array([50e3, 60e3, 2e6]),
        np.array([20.0, 26.0, 16.0]),
        np.array([0.0, 1.0, 2.0]),
        wind=Wind(13.8, -1.0, gusts),  # type: ignore[arg-type] # the name comes from a caller
        current=Current(0.75, 2.0),
        drift=WaveDrift(WAVES),
        seed=9,
    )


def simulate(
    ship: Vessel, sea: Environment, steps: int, sample_s: float, substeps: int
) -> np.ndarray:
    """The state after the given samples under a third of the limits."""
    plant = ShipPlant(ship, START, sample_s, substeps, loads=sea.wind_and_drift_coefficients(ship))
    for stages in sea.build_weather_table_at_stages(steps, sample_s, substeps):
        plant.advance_by_one_sample(0.3 * ship.tau_max, stages)
    return plant.state


def test_the_loaded_plant_agrees_with_an_adaptive_integrator(hull: Vessel) -> None:
    sea = weather("none")
    waves, beam = WAVES.draw_wave_harmonics(9), hull.reflection
    assert beam is not None
    drift = beam.wave_drift_coefficients(hull.length_m, WAVES)
    turns = np.array([-1.0, 2.0, 0.4])

    def derivative(t: float, s: np.ndarray) -> np.ndarray:
        R = rotation(s[5])
        air, water, _ = (
            R.T @ np.array([length * np.cos(to), length * np.sin(to), 0.0])
            for length, to in zip((13.8, 0.75, 0.0), turns, strict=True)
        )
        u, v = s[:2] - air[:2]
        gamma, pressure = -np.arctan2(v, u), 0.5 * 1.226 * (u * u + v * v)
        power = np.abs(waves.evaluate_process_at_times(np.array([t]), np.zeros(1))[0, 0]) ** 2
        side = turns[2] - s[5]
        blown = [-203.0 * np.cos(gamma), 630.0 * np.sin(gamma), 66.5 * 76.2 * np.sin(2 * gamma)]
        drifted = drift * [np.cos(side), np.sin(side), -np.sin(2 * side)]
        force = (
            0.3 * hull.tau_max
            + R.T @ sea.compute_slow_forces_and_squalls(t)
            + pressure * np.array(blown)
        )
        force = force + power * drifted - hull.D @ (s[:3] - water)
        return np.concatenate([np.linalg.solve(hull.M, force), R @ s[:3]])

    ours = simulate(hull, sea, 100, 0.3, SUBSTEPS)
    theirs = solve_ivp(derivative, (0.0, 30.0), START, method="DOP853", rtol=1e-12, atol=1e-13)
    # The waves' fastest difference frequency of 3 rad/s leaves (0.03·3)⁴/120 ≈ 5e-7 of its share.
    np.testing.assert_allclose(ours, theirs.y[:, -1], rtol=2e-8, atol=1e-8)


def test_the_error_falls_with_the_fourth_power_in_gusts_and_waves(hull: Vessel) -> None:
    sea, sample_s = weather("norsok"), 2.4
    exact = simulate(hull, sea, 20, sample_s, 768)
    size = np.abs(exact)
    errors = [
        np.linalg.norm((simulate(hull, sea, 20, sample_s, substeps) - exact) / size)
        for substeps in (12, 24, 48)
    ]
    # h is 0.2, 0.1, 0.05 s at loads of up to 3 rad/s: the next term of the expansion adds O(h).
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.05)


def test_port_and_starboard_are_alike_in_all_weather(hull: Vessel) -> None:
    sea, flip = weather("norsok"), np.array([1.0, -1.0, -1.0])
    mirrored = replace(
        sea,
        mean=flip * sea.mean,
        amplitude=flip * sea.amplitude,
        wind=Wind(13.8, 1.0, "norsok"),
        current=Current(0.75, -2.0),
        drift=WaveDrift(replace(WAVES, to_rad=-WAVES.to_rad)),
    )
    tau, both = 0.3 * hull.tau_max, np.concatenate([flip, flip])
    loads = sea.wind_and_drift_coefficients(hull)
    plant, other = (ShipPlant(hull, start, 0.3, loads=loads) for start in (START, both * START))
    tables = (of.build_weather_table_at_stages(60, 0.3, SUBSTEPS) for of in (sea, mirrored))
    for stages, mirrored_stages in zip(*tables, strict=True):
        plant.advance_by_one_sample(tau, stages)
        other.advance_by_one_sample(flip * tau, mirrored_stages)
    assert abs(plant.state[4] - START[4]) > 1.0
    # The same operations but for signs, so that not even rounding differs but in cos and sin.
    np.testing.assert_allclose(other.state, both * plant.state, rtol=1e-12)


def test_weather_of_no_strength_is_no_weather(hull: Vessel) -> None:
    plain = replace(weather("none"), wind=None, current=None, drift=None)
    nothing = replace(plain, current=Current(0.0, 1.0), drift=WaveDrift(Sea(0.0, 8.0, 0.0)))
    # The kernels add the same terms in the same order; only zeros join them.
    np.testing.assert_allclose(
        simulate(hull, nothing, 50, 0.3, SUBSTEPS),
        simulate(hull, plain, 50, 0.3, SUBSTEPS),
        rtol=1e-14,
    )


@pytest.mark.parametrize("columns", [2, 3, 4, 8, 9, 10])
def test_a_table_of_another_width_is_refused(hull: Vessel, columns: int) -> None:
    stages = np.zeros((2 * SUBSTEPS + 1, columns))
    for width, loads in ((3, None), (9, np.zeros(6))):
        plant = ShipPlant(hull, START, 0.3, loads=loads)
        if columns == width:
            plant.advance_by_one_sample(np.zeros(3), stages)
        else:
            with pytest.raises(ValueError, match=f"{width} columns"):
                plant.advance_by_one_sample(np.zeros(3), stages)


@pytest.mark.parametrize("name", ["supply_fs99", "supply_mss", "supply_tmr"])
def test_a_free_ship_ends_up_drifting_with_the_current(name: str) -> None:
    ship, weather = load_vessel(name), flowing(0.75, 2.0)
    plant = ShipPlant(ship, np.zeros(6), 3.0, loads=weather.wind_and_drift_coefficients(ship))
    # 12 000 s are 100 of the longest time constants; the table of one sample serves for all.
    stages = weather.build_weather_table_at_stages(1, 3.0, SUBSTEPS)[0]
    for _ in range(4000):
        plant.advance_by_one_sample(np.zeros(3), stages)
    u, v, r, *_, psi = plant.state
    north, east = np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v
    np.testing.assert_allclose([north, east], 0.75 * np.array([np.cos(2), np.sin(2)]), atol=1e-9)
    assert r == pytest.approx(0.0, abs=1e-12)
