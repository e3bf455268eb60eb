"""The environmental force against plain arithmetic, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dpbench.errors import InputError
from dpbench.ship.environment import Environment

MEAN, AMPLITUDE = [-20e3, 55e3, 500e3], [10e3, 30e3, 300e3]
PERIOD_S, PHASE_RAD = [150.0, 120.0, 100.0], [0.0, 1.0, 2.0]


def sea(ramp_s: float = 0.0) -> Environment:
    """The weather of `calm`."""
    return Environment(
        np.array(MEAN), np.array(AMPLITUDE), np.array(PERIOD_S), np.array(PHASE_RAD), ramp_s
    )


@pytest.mark.parametrize("t_s", [0.0, 0.15, 29.7, 60.0, 137.4, 300.0])
@pytest.mark.parametrize("ramp_s", [0.0, 60.0])
def test_force_is_the_ramped_mean_plus_one_sinusoid_per_axis(t_s: float, ramp_s: float) -> None:
    """b(t) = min(t/ramp, 1)·(mean + amplitude·sin(2πt/T + phase)) in each axis."""
    grown = min(t_s / ramp_s, 1.0) if ramp_s else 1.0
    expected = [
        grown * (m + a * math.sin(2 * math.pi * t_s / T + p))
        for m, a, T, p in zip(MEAN, AMPLITUDE, PERIOD_S, PHASE_RAD, strict=True)
    ]
    np.testing.assert_allclose(sea(ramp_s).force(t_s), expected, rtol=1e-13)


def test_stage_table_holds_the_force_at_start_middle_and_end_of_every_sub_step() -> None:
    """Entry [k, 2i] is the start and [k, 2i + 1] the middle of sub-step i of sample k."""
    steps, sample_s, substeps = 7, 0.3, 10
    table = sea(1.0).stage_table(steps, sample_s, substeps)
    assert table.shape == (steps, 2 * substeps + 1, 3)
    h = sample_s / substeps
    for k in range(steps):
        for i in range(substeps):
            start = k * sample_s + i * h
            for offset, column in ((0.0, 2 * i), (0.5 * h, 2 * i + 1), (h, 2 * i + 2)):
                # Times formed in another order differ by rounding, 1e-15 s · 1e6 N/s.
                np.testing.assert_allclose(
                    table[k, column], sea(1.0).force(start + offset), rtol=1e-12, atol=1e-6
                )


def test_samples_join_without_a_gap() -> None:
    """The end of a sample and the start of the next see the same force."""
    table = sea(60.0).stage_table(50, 0.3, 10)
    np.testing.assert_allclose(table[:-1, -1], table[1:, 0], rtol=1e-12, atol=1e-6)


@pytest.mark.parametrize(
    ("key", "value", "found", "allowed"),
    [
        ("mean", [1.0, 2.0], "shape (2,)", "shape (3,)"),
        ("amplitude", [0.0, np.nan, 0.0], "nan", "finite"),
        ("phase_rad", [0.0, np.inf, 0.0], "inf", "finite"),
        ("period_s", [60.0, 0.0, 60.0], "[60.0, 0.0, 60.0]", "positive"),
        ("ramp_s", -1.0, "-1.0", "0 s or more"),
        ("ramp_s", math.nan, "nan", "0 s or more"),
    ],
)
def test_bad_weather_is_refused_in_one_line(
    key: str, value: object, found: str, allowed: str
) -> None:
    """A wrong shape, a number that is none, a period of zero or a negative ramp is refused."""
    arguments: dict[str, object] = {
        "mean": MEAN,
        "amplitude": AMPLITUDE,
        "period_s": PERIOD_S,
        "phase_rad": PHASE_RAD,
        "ramp_s": 0.0,
        "where": "weather.toml: environment",
    }
    with pytest.raises(InputError) as caught:
        Environment(**{**arguments, key: value})  # type: ignore[arg-type] # bad on purpose
    error = caught.value
    assert (error.where, error.key) == ("weather.toml: environment", key)
    assert found in str(error.found)
    assert allowed in error.allowed
    assert "\n" not in str(error)
