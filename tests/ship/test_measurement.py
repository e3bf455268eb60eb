"""What the sensors see against plain arithmetic."""

from __future__ import annotations

import numpy as np

from dpbench.ship.environment import Environment, SensorNoise
from dpbench.ship.plant import Sensors
from dpbench.ship.weather.waves import FirstOrderMotion, Sea

CALM = (np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3))


def weather(**more: object) -> Environment:
    return Environment(*CALM, seed=3, **more)  # type: ignore[arg-type] # what the test asks for


def test_ideal_sensors_show_the_state() -> None:
    """Without wave motion and noise the measurement is the state itself."""
    state = np.arange(6.0)
    np.testing.assert_array_equal(Sensors(weather(), 4, 0.3).sense(state, 2), state)


def test_wave_motion_and_noise_are_added_to_pose_and_speed() -> None:
    """The pose gets η_w and noise, the speed R(ψ)ᵀ dη_w/dt, for a ship that heads 40°."""
    sea = Sea(2.0, 8.5, 0.5)
    motion = FirstOrderMotion(sea, 0.6, 0.2, 0.01)
    sky = weather(motion=motion, noise=SensorNoise(np.array([0.1, 0.2, 0.003])))
    state = np.array([0.5, -0.2, 0.01, 3.0, 4.0, np.radians(40.0)])
    k, sample_s = 7, 0.3
    moved, noise = sky.measured_motion(10, sample_s)[k], sky.noise_table(10)[k]
    c, s = np.cos(state[5]), np.sin(state[5])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    found = Sensors(sky, 10, sample_s).sense(state, k)
    np.testing.assert_allclose(found[:3], state[:3] + R.T @ moved[3:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[3:], state[3:] + moved[:3] + noise, rtol=0, atol=1e-14)
    assert np.abs(found - state).min() > 0


def test_measured_speed_is_the_rate_of_the_measured_pose() -> None:
    """For a ship at rest that heads north the measured speed is the derivative of its pose."""
    sky = weather(motion=FirstOrderMotion(Sea(2.0, 8.5, 0.5), 0.6, 0.2, 0.01))
    sample_s = 1e-3
    sensors, rest = Sensors(sky, 3, sample_s), np.zeros(6)
    before, here, after = (sensors.sense(rest, k).copy() for k in range(3))
    slope = (after[3:] - before[3:]) / (2 * sample_s)
    # A central difference over 2 ms of motion with ω up to 3.7 rad/s: ω³h²/6 of a metre.
    np.testing.assert_allclose(here[:3], slope, rtol=0, atol=1e-4)
