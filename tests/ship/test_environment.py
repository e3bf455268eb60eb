"""The weather against plain arithmetic, its independent sources, and what it refuses."""

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.ship.environment import Current, Environment, SensorNoise, Squall
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import FirstOrderMotion, Sea, WaveDrift, Wind, make_random_generator

MEAN, AMPLITUDE = [-20e3, 55e3, 500e3], [10e3, 30e3, 300e3]
PERIOD_S, PHASE_RAD = [150.0, 120.0, 100.0], [0.0, 1.0, 2.0]


def sea(ramp_s: float = 0.0) -> Environment:
    return Environment(
        np.array(MEAN), np.array(AMPLITUDE), np.array(PERIOD_S), np.array(PHASE_RAD), ramp_s
    )


@pytest.mark.parametrize("t_s", [0.0, 0.15, 29.7, 60.0, 137.4, 300.0])
@pytest.mark.parametrize("ramp_s", [0.0, 60.0])
def test_force_is_the_ramped_mean_plus_one_sinusoid_per_axis(t_s: float, ramp_s: float) -> None:
    grown = min(t_s / ramp_s, 1.0) if ramp_s else 1.0
    expected = [
        grown * (m + a * math.sin(2 * math.pi * t_s / T + p))
        for m, a, T, p in zip(MEAN, AMPLITUDE, PERIOD_S, PHASE_RAD, strict=True)
    ]
    np.testing.assert_allclose(
        sea(ramp_s).compute_slow_forces_and_squalls(t_s), expected, rtol=1e-13
    )


def test_stage_table_holds_the_force_at_start_middle_and_end_of_every_sub_step() -> None:
    """Entry [k, 2i] is the start and [k, 2i + 1] the middle of sub-step i of sample k."""
    steps, sample_s, substeps = 7, 0.3, 10
    table = sea(1.0).build_weather_table_at_stages(steps, sample_s, substeps)
    assert table.shape == (steps, 2 * substeps + 1, 3)
    h = sample_s / substeps
    for k in range(steps):
        for i in range(substeps):
            start = k * sample_s + i * h
            for offset, column in ((0.0, 2 * i), (0.5 * h, 2 * i + 1), (h, 2 * i + 2)):
                # Times formed in another order differ by rounding, 1e-15 s · 1e6 N/s.
                np.testing.assert_allclose(
                    table[k, column],
                    sea(1.0).compute_slow_forces_and_squalls(start + offset),
                    rtol=1e-12,
                    atol=1e-6,
                )


WAVES = Sea(3.1, 8.5, 0.4)
SOURCES = {
    "wind": Wind(13.8, -1.0),
    "current": Current(0.75, 2.0),
    "drift": WaveDrift(WAVES),
    "motion": FirstOrderMotion(WAVES, 0.6, 0.1, 0.01),
    "noise": SensorNoise(np.array([0.1, 0.1, 0.001])),
}
COLUMNS = {"wind": slice(3, 5), "current": slice(5, 7), "drift": slice(7, 9)}
SQUALL = Squall(60.0, 5.0, 105.0, 30.0, np.array([-120e3, 340e3, 3000e3]))


def rough(ramp_s: float = 0.0, seed: int = 4) -> Environment:
    return replace(sea(ramp_s), seed=seed, **SOURCES)  # type: ignore[arg-type] # one type per key


@pytest.mark.parametrize("source", COLUMNS)
def test_a_source_is_the_same_with_and_without_the_others(source: str) -> None:
    alone = replace(sea(), seed=4, **{source: SOURCES[source]})  # type: ignore[arg-type] # one type per key
    together, single = (
        rough().build_weather_table_at_stages(40, 0.3, 10),
        alone.build_weather_table_at_stages(40, 0.3, 10),
    )
    np.testing.assert_array_equal(together[..., COLUMNS[source]], single[..., COLUMNS[source]])
    for other in set(COLUMNS) - {source}:
        np.testing.assert_array_equal(single[..., COLUMNS[other]], 0.0)
        assert np.abs(together[..., COLUMNS[other]]).max() > 0.1


def test_motion_and_noise_do_not_hang_on_the_other_sources() -> None:
    alone = replace(sea(), seed=4, noise=SOURCES["noise"], motion=SOURCES["motion"])  # type: ignore[arg-type] # one type per key
    np.testing.assert_array_equal(
        rough().draw_measurement_noise(50), alone.draw_measurement_noise(50)
    )
    np.testing.assert_array_equal(
        rough().wave_frequency_motion_at_samples(50, 0.3),
        alone.wave_frequency_motion_at_samples(50, 0.3),
    )
    np.testing.assert_array_equal(sea().draw_measurement_noise(5), 0.0)
    np.testing.assert_array_equal(sea().wave_frequency_motion_at_samples(5, 0.3), 0.0)


def test_every_random_source_draws_from_a_stream_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    streams: set[tuple[int, str]] = set()

    def record(seed: int, name: str) -> np.random.Generator:
        streams.add((seed, name))
        return make_random_generator(seed, name)

    for module in ("weather", "environment"):
        monkeypatch.setattr(f"dpbench.ship.{module}.make_random_generator", record)
    rough(seed=6).build_weather_table_at_stages(1, 0.3, 10)
    rough(seed=6).wave_frequency_motion_at_samples(1, 0.3)
    rough(seed=6).draw_measurement_noise(1)
    assert [seed for seed, _ in streams] == [6, 6, 6]


def test_weather_is_a_function_of_its_seed() -> None:
    for table in (
        lambda weather: weather.build_weather_table_at_stages(30, 0.3, 10)[..., [3, 7]],
        lambda weather: weather.wave_frequency_motion_at_samples(30, 0.3)[:, [0, 1, 2]],
        lambda weather: weather.draw_measurement_noise(30),
    ):
        np.testing.assert_array_equal(table(rough(seed=1)), table(rough(seed=1)))
        assert (table(rough(seed=1)) != table(rough(seed=2))).all()


def test_a_shorter_run_meets_the_beginning_of_the_same_weather() -> None:
    weather = rough(60.0)
    for table in (
        lambda steps: weather.build_weather_table_at_stages(steps, 0.3, 10),
        lambda steps: weather.wave_frequency_motion_at_samples(steps, 0.3),
        weather.draw_measurement_noise,
    ):
        np.testing.assert_array_equal(table(1500)[:200], table(200))


def test_columns_are_vectors_along_each_source_at_the_stage_times() -> None:
    weather = rough()
    table = weather.build_weather_table_at_stages(3, 0.3, 10)
    t = np.add.outer(0.3 * np.arange(3), 0.015 * np.arange(21))
    gust = Wind(13.8, -1.0).wind_speed_at_times(t.ravel(), np.zeros(1), 4).reshape(t.shape)
    height = WaveDrift(WAVES).wave_envelope_at_times(t.ravel(), np.zeros(1), 4).reshape(t.shape)
    lengths_and_directions = ((gust, -1.0), (np.full(t.shape, 0.75), 2.0), (height, 0.4))
    for column, (length, to_rad) in zip((3, 5, 7), lengths_and_directions, strict=True):
        # Times formed in another order differ by rounding, 1e-15 s · 3 rad/s.
        np.testing.assert_allclose(
            table[..., column], length * math.cos(to_rad), rtol=1e-10, atol=1e-12
        )
        np.testing.assert_allclose(
            table[..., column + 1], length * math.sin(to_rad), rtol=1e-10, atol=1e-12
        )
    np.testing.assert_array_equal(table[..., :3], sea().build_weather_table_at_stages(3, 0.3, 10))


def test_all_weather_but_squalls_grows_over_the_ramp() -> None:
    grown, full = (
        rough(ramp_s).build_weather_table_at_stages(100, 0.3, 10) for ramp_s in (20.0, 0.0)
    )
    t = np.add.outer(0.3 * np.arange(100), 0.015 * np.arange(21))
    share = np.minimum(t / 20.0, 1.0)[..., np.newaxis]
    np.testing.assert_allclose(grown, share * full, rtol=1e-12, atol=1e-7)


def test_weather_that_ignores_the_ship_keeps_three_columns() -> None:
    weather = replace(sea(), squalls=(SQUALL,), motion=SOURCES["motion"], noise=SOURCES["noise"])  # type: ignore[arg-type] # one type per key
    assert weather.build_weather_table_at_stages(4, 0.3, 10).shape == (4, 21, 3)
    assert not weather.depends_on_ship


@pytest.mark.parametrize(("source", "key"), [("wind", "windage"), ("drift", "reflection")])
def test_weather_that_needs_hull_data_says_so_in_one_line(
    source: str, key: str, hull: Vessel
) -> None:
    weather = replace(sea(), **{source: SOURCES[source]})  # type: ignore[arg-type] # one type per key
    loads = weather.wind_and_drift_coefficients(hull)
    assert loads is not None
    assert np.count_nonzero(loads) == 3
    with pytest.raises(InputError) as caught:
        weather.wind_and_drift_coefficients(replace(hull, **{key: None}))  # type: ignore[arg-type] # None is allowed
    assert (caught.value.where, caught.value.key) == (hull.where, key)
    assert source in caught.value.allowed
    assert "\n" not in str(caught.value)


def test_noise_has_its_standard_deviations() -> None:
    noise = SensorNoise(np.array([0.1, 0.2, 0.001])).draw_noise_table(40_000, 3)
    # 40 000 draws: 0.35 % on a standard deviation, 0.5 % on a correlation; five of those.
    np.testing.assert_allclose(noise.std(axis=0), [0.1, 0.2, 0.001], rtol=0.02)
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(3), atol=0.025)
    neighbours = np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)
    np.testing.assert_allclose(neighbours, 0.0, atol=0.025)


STEADY = Environment(np.array([-30e3, 120e3, 600e3]), np.zeros(3), np.ones(3), np.zeros(3), 60.0)


@pytest.mark.parametrize(
    ("t_s", "share"),
    [(0, 0), (60, 0), (62.5, 0.5), (65, 1), (90, 1), (105, 1), (120, 0.5), (135, 0), (300, 0)],
)
def test_a_squall_rises_holds_and_decays_on_straight_lines(t_s: float, share: float) -> None:
    """The squall of the library grows within 5 s, holds to 105 s and is gone 30 s later."""
    gusty = replace(STEADY, squalls=(SQUALL, SQUALL))
    expected = STEADY.compute_slow_forces_and_squalls(t_s) + 2 * share * SQUALL.force
    np.testing.assert_allclose(gusty.compute_slow_forces_and_squalls(t_s), expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("t_s", "force"),
    [
        # A quarter of the mean after 15 s of a ramp of 60 s, and no squall yet
        (15.0, [-7.5e3, 30e3, 150e3]),
        # Half of the mean and half of the squall; half of the mean and all of it
        (30.0, [-75e3, 230e3, 1800e3]),
        (32.5, [-136.25e3, 405e3, 3325e3]),
        # All of the mean, and half of the squall that decays
        (80.0, [-90e3, 290e3, 2100e3]),
    ],
)
def test_a_squall_does_not_grow_with_the_ramp(t_s: float, force: list[float]) -> None:
    squall = replace(SQUALL, start_s=27.5, hold_until_s=65.0)
    gusty = replace(STEADY, squalls=(squall,))
    np.testing.assert_allclose(gusty.compute_slow_forces_and_squalls(t_s), force, rtol=1e-13)


NAMES = ("wind", "waves", "noise")


def test_sources_draw_from_different_streams() -> None:
    draws = {
        tuple(make_random_generator(seed, name).random(4)) for seed in range(50) for name in NAMES
    }
    assert len(draws) == 150


def test_streams_of_one_seed_are_uncorrelated() -> None:
    draws = np.array([make_random_generator(7, name).standard_normal(40_000) for name in NAMES])
    # The correlation of independent series has a standard deviation of 1/√40000 = 0.005.
    np.testing.assert_allclose(np.corrcoef(draws), np.eye(3), atol=0.025)


@pytest.mark.parametrize("hash_seed", ["0", "1"])
def test_a_stream_is_the_same_in_another_process(hash_seed: str) -> None:
    imported = "from dpbench.ship.weather import make_random_generator"
    script = f"{imported}; print(make_random_generator(3, 'wind').random().hex())"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == make_random_generator(3, "wind").random().hex()
