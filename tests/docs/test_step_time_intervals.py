"""The formulas of intervals and p-values in the method, recomputed by plain pandas and SciPy."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from dpbench.analysis.statistics import (
    MeanEstimate,
    estimate_percentile_interval,
    estimate_pooled_ratio,
)
from dpbench.arrays import Floats


def _series(steps: int, correlation: float, seed: int) -> Floats:
    """Logs of step times that follow a first-order autoregression."""
    rng, values = np.random.default_rng(seed), [0.0]
    for shock in rng.standard_normal(steps):
        values.append(correlation * values[-1] + math.sqrt(1 - correlation**2) * shock)
    return 0.1 * np.array(values[1:])


def _error(series: Floats) -> float:
    """The documented error of a mean, by a table with a column for the part of each step."""
    long, least = len(series) % 5, len(series) // 5
    part = np.repeat(np.arange(5), [least + 1] * long + [least] * (5 - long))
    table = pd.DataFrame({"x": series, "part": part})
    a = table.groupby("part")["x"].mean() - table["x"].mean()
    r = (a * a.shift()).sum() / (a**2).sum() + 2 / 5
    rho = min(max(r, 0.0), 0.9)
    return float(np.sqrt((a**2).sum() / 20 * (1 + rho) / (1 - rho)))


@pytest.mark.parametrize("correlation", [0.0, 0.9, 0.99])
def test_a_paired_ratio_has_the_documented_interval(correlation: float) -> None:
    for seed in range(20):
        logs = [_series(500 + seed, correlation, seed), _series(1200, correlation, seed + 50)]
        means, errors = np.array([one.mean() for one in logs]), np.array([*map(_error, logs)])
        df = (errors**2).sum() ** 2 / (errors**4 / 4).sum()
        reach = stats.t.ppf(0.975, df) * np.sqrt((errors**2).sum()) / 2
        ends = np.exp(means.mean() + np.array([0.0, -reach, reach]))
        found = estimate_pooled_ratio([*logs, _series(499, correlation, seed)])
        assert (found.value, found.low, found.high) == pytest.approx(tuple(ends))
        alone = np.exp(means[0] + stats.t.ppf(0.975, 4) * errors[0])
        assert estimate_pooled_ratio(logs[:1]).high == pytest.approx(alone)


@pytest.mark.parametrize("steps", [1003, 6000])
def test_a_p99_has_the_documented_interval(steps: int) -> None:
    infinite = 0
    for seed in range(20):
        times = pd.Series(np.exp(_series(steps, 0.9, seed)))
        value = times.quantile(0.99, interpolation="linear")
        error = _error((times > value).to_numpy(dtype=float))
        widened = stats.t.ppf(0.975, 4) / stats.norm.ppf(0.975) * error
        n = steps / max(0.25, widened**2 * steps / (0.01 * 0.99))
        least = stats.beta.ppf(0.025, 0.01 * n, 0.99 * n + 1)
        most = stats.beta.ppf(0.975, 0.01 * n + 1, 0.99 * n)
        rank = times.rank(method="first")
        below, above = math.floor(steps * (1 - most)), math.ceil(steps * (1 - least))
        low = float(times[rank == below].iloc[0]) if below >= 1 else 0.0
        high = float(times[rank == above].iloc[0]) if above < steps else math.inf
        found = estimate_percentile_interval(times.to_numpy(), 99.0)
        assert (found.value, found.low, found.high) == pytest.approx((value, low, high))
        infinite += math.isinf(high)
    assert infinite < 20


def test_a_p_value_of_a_study_is_the_documented_one() -> None:
    """The skewness counts 1.5 times; where it would help the claim, Student's value holds."""
    for mean, error, df, skew, bound in ((0.3, 0.1, 11, 0.3, 0.01), (-0.2, 0.1, 5, 0.4, 0.0)):
        estimate = MeanEstimate(mean, error, df, skew)
        for sign, p in (
            (1, estimate.compute_p_value_of_mean_above(bound)),
            (-1, estimate.compute_p_value_of_mean_below(bound)),
        ):
            t, s = sign * (mean - bound) / error, sign * 1.5 * skew
            corrected = t + s * t**2 / 3 + s**2 * t**3 / 27 + s / 6
            assert p == pytest.approx(stats.t.sf([t, corrected], df).max())
        both = [estimate.compute_p_value_of_mean_above(1e-6)]
        both += [estimate.compute_p_value_of_mean_below(-1e-6)]
        assert estimate.compute_p_value_of_mean_beyond(1e-6) == pytest.approx(2 * min(both))
