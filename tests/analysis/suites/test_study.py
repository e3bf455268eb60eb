"""Statistics of studies against textbook tests, simulation and counts by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from dpbench.analysis.suites.study import Study, paired_difference

COLUMNS = ["point", "replicate"]


def _values(table: np.ndarray) -> pd.Series:
    """A table (points, replicates) as a series by point and replicate."""
    points, replicates = table.shape
    index = pd.MultiIndex.from_product([range(points), range(1, replicates + 1)], names=COLUMNS)
    return pd.Series(table.ravel(), index=index)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), replicates=st.integers(4, 30))
def test_at_one_point_it_is_the_paired_t_test(seed: int, replicates: int) -> None:
    """The interval is that of scipy's paired t-test."""
    one, other = np.random.default_rng(seed).normal(size=(2, 1, replicates))
    difference = paired_difference(_values(one), _values(other))
    expected = stats.ttest_rel(one[0], other[0]).confidence_interval(0.95)
    assert difference.mean.low == pytest.approx(expected.low, rel=1e-9, abs=1e-12)
    assert difference.mean.high == pytest.approx(expected.high, rel=1e-9, abs=1e-12)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), points=st.integers(4, 40))
def test_points_without_replicates_are_the_sample(seed: int, points: int) -> None:
    """With one sea a point the interval is that of the t-test over points."""
    one, other = np.random.default_rng(seed).normal(size=(2, points, 1))
    difference = paired_difference(_values(one), _values(other))
    expected = stats.ttest_rel(one[:, 0], other[:, 0]).confidence_interval(0.95)
    assert difference.mean.low == pytest.approx(expected.low, rel=1e-9, abs=1e-12)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1))
def test_the_sea_drops_out(seed: int) -> None:
    """What both have of a sea, however large, changes neither mean nor interval."""
    draw = np.random.default_rng(seed)
    one, other = draw.normal(size=(2, 5, 6))
    sea = 50.0 * draw.normal(size=(5, 6))
    alone = paired_difference(_values(one), _values(other))
    together = paired_difference(_values(one + sea), _values(other + sea))
    assert together.mean.low == pytest.approx(alone.mean.low, abs=1e-9)
    assert together.mean.high == pytest.approx(alone.mean.high, abs=1e-9)
    assert together.unpaired > 5.0 * alone.unpaired


@pytest.mark.slow
def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    """Points of other means, counts and spreads: 95 % of 600 intervals hold the true mean."""
    draw = np.random.default_rng(7)
    truth, counts, inside = np.array([0.3, -0.1, 0.7, 0.2]), (3, 5, 8, 4), 0
    spreads = (0.2, 0.1, 0.4, 0.2)
    for _ in range(600):
        index = [(p, r) for p, count in enumerate(counts) for r in range(count)]
        values = [truth[p] + draw.normal(scale=spreads[p]) for p, _ in index]
        one = pd.Series(values, index=pd.MultiIndex.from_tuples(index))
        interval = paired_difference(one, 0.0 * one).mean
        inside += interval.low <= truth.mean() <= interval.high
    # Three standard errors of a share of 600.
    assert abs(inside / 600 - 0.95) < 3 * math.sqrt(0.95 * 0.05 / 600)


def test_only_seas_that_both_ended_are_paired() -> None:
    """A sea that one of the two lacks is in no pair; too few pairs make no interval."""
    one, other = _values(np.arange(8.0).reshape(2, 4)), _values(np.zeros((2, 4)))
    assert paired_difference(one.drop((0, 1)), other.drop((1, 2))).pairs == 6
    few = paired_difference(one.iloc[:3], other)
    assert few.pairs == 3 and few.mean.low == -np.inf and not few.shown
    assert paired_difference(one.iloc[:0], other).pairs == 0


def test_as_many_replicates_as_it_says_tell_the_difference() -> None:
    """The advised count has a half-width within the difference, one fewer has not."""
    values = np.random.default_rng(3).normal(scale=0.05, size=(3, 10))
    difference = paired_difference(_values(values), _values(np.zeros((3, 10))))
    for size in (0.1, 0.03, 0.01):
        count = difference.replicates_for(size)
        assert count is not None

        def reach(replicates: int) -> float:
            freedom = difference.points * (replicates - 1)
            return float(stats.t.ppf(0.975, freedom)) * difference.spread / math.sqrt(replicates)

        assert reach(count) <= size
        assert count == 2 or reach(count - 1) > size


def _runs(away: dict[str, float], *, points: int = 2, seas: int = 6, **odd: str) -> list[Any]:
    """Runs of configurations that are so much behind in every sea; `odd` outcomes of some."""
    draw = np.random.default_rng(11)
    noise = draw.normal(scale=1e-4, size=(len(away), points, seas))
    sea = draw.uniform(0.2, 2.0, size=(points, seas))
    return [
        SimpleNamespace(
            run_id=f"{name} {settings} {p} {r}",
            name=f"{name} ({settings})" if settings else name,
            solver=name.partition(" ")[0],
            settings=settings or "default",
            study_point=float(p),
            replicate=float(r + 1),
            x={"hs": float(p)},
            outcome=odd.get(name, "finished") if (p, r) == (0, 0) else "finished",
            r_tail_max_m=sea[p, r] + behind,
            r_95_m=sea[p, r] + behind + noise[c, p, r],
            closed_loop_cost=sea[p, r] * (1.0 + behind + noise[c, p, r]),
            exact_cost=sea[p, r],
            is_baseline_law=False,
        )
        for c, (label, behind) in enumerate(away.items())
        for name, _, settings in [label.partition("/")]
        for p in range(points)
        for r in range(seas)
    ]


def _study(runs: list[Any], radius_m: float = 1.0) -> Study:
    return Study("sea", cast(Any, runs), radius_m)


def test_the_nearest_to_the_exact_loop_is_the_reference() -> None:
    """The others are set beside it: 3 cm behind is shown, a tenth of a millimetre is not."""
    study = _study(_runs({"far": 0.03, "near": 0.0, "same": 0.0}))
    assert study.reference in ("near", "same")
    by_name = {c.name: c for c in study.configurations}
    behind = by_name["far"].behind
    assert behind is not None and behind.shown
    assert behind.mean.value == pytest.approx(0.03, abs=2e-4)
    assert behind.unpaired > 100.0


def test_who_lost_a_run_is_no_reference_and_its_other_seas_are_paired() -> None:
    """A run that did not end is neither held nor paired, and its configuration is not cheap."""
    study = _study(_runs({"near": 0.0, "far": 0.03}, near="crashed"), radius_m=9.0)
    assert study.reference == "far"
    near = next(c for c in study.configurations if c.name == "near")
    assert (near.runs, near.finished) == (12, 11)
    assert near.held == pytest.approx(11 / 12)
    assert near.behind is not None and near.behind.pairs == 11
    assert not near.is_cheap


def test_the_loosest_tolerance_that_costs_little() -> None:
    """Of 1e-3 (3 cm behind), 1e-4 (2 mm) and 1e-6 it is 1e-4; of a solver with none cheap, none; a
    solver without a tolerance to set is not asked."""
    away = {
        "osqp/1e-6": 0.0,
        "osqp/1e-4": 0.002,
        "osqp/low": 0.03,
        "piqp/1e-4": 0.05,
        "daqp": 0.0,
        "quadprog/1e-4": 0.0,
    }
    study = _study(_runs(away))
    loosest = study.loosest
    assert set(loosest) == {"osqp", "piqp"} and loosest["piqp"] is None
    assert loosest["osqp"] is not None and loosest["osqp"].settings == "1e-4"


def test_a_solver_that_is_not_known_here_has_no_tolerance() -> None:
    """A folder may come from an installation with another plug-in."""
    runs = _runs({"daqp default": 0.0, "daqp 1e-4": 0.001})
    for run in runs:
        run.solver = "somebodys_own"
    assert [c.tolerance for c in _study(runs).configurations] == [None, None]
    assert _study(runs).loosest == {}


def test_the_map_of_what_is_held() -> None:
    """At each point the share of seas whose radial error stays within the radius, by hand."""
    runs = _runs({"a": 0.0}, points=3, seas=8)
    study = _study(runs, radius_m=1.1)
    table = study.held_map("a")
    for point in range(3):
        own = [run.r_tail_max_m <= 1.1 for run in runs if run.study_point == point]
        assert table.loc[point, "held"] == pytest.approx(sum(own) / 8)
        assert table.loc[point, "hs"] == float(point)
    assert study.replicates == 8
