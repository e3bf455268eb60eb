"""Claims of studies worked by hand: costs, references, claims of a configuration, tables."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.statistics import MeanEstimate
from dpbench.analysis.suites.study import (
    PairedDifference,
    StudiedConfiguration,
    Study,
    compute_paired_difference,
    estimate_mean_over_points,
    find_studies,
)
from dpbench.analysis.suites.study_tables import (
    tabulate_error_excess_by_sea,
    tabulate_shares_in_position,
)

LOST = math.nan


def _run(name: str, point: int, replicate: int, **columns: Any) -> Any:
    """A finished run of a solver with a cost of 2, where the reference loop has 1."""
    usual = {
        "run_id": f"{name} {point} {replicate}",
        "solver_label": name,
        "solver": name,
        "settings": "default",
        "study_point": float(point),
        "replicate": float(replicate),
        "x": {"hs_m": float(point)},
        "outcome": "finished",
        "r_tail_max_m": 0.5,
        "failed_steps": 0,
        "steps_done": 400,
        "true_share": 1.0,
        "claimed_not_true": 0,
        "error_move_max": 0.0,
        "caching_sign": None,
        "has_all_steps": True,
        "raw_p50_ns": 2e4,
        "raw_p99_ns": LOST,
        "r_95_m": 0.25,
        "closed_loop_cost": 2.0,
        "exact_cost": 1.0,
        "exact_steps": 400.0,
        "exact_left_s": LOST,
        "r_max_m": 0.5,
        "is_baseline_law": False,
        "campaign_utc": "",
        "has_no_optimum": False,
    }
    return SimpleNamespace(**usual | columns)


def _difference(
    value: float, error: float = 1e-9, *, spread: float = LOST, df: float = 9.0
) -> PairedDifference:
    return PairedDifference(MeanEstimate(value, error, df), 6, 1, spread, is_constant=False)


def _configuration(
    error_excess_m: PairedDifference | None,
    log_cost_excess: PairedDifference | None,
    **columns: Any,
) -> StudiedConfiguration:
    usual = {"runs": 6, "finished": 6, "stopped": 0, "within": 1.0, "cost": 0.0, "r_95_m": 0.25}
    usual |= {"accurate": 1.0, "false_claims": 0, "steps": 2400, "error_move": 0.0}
    usual |= {"is_accurate_enough": True}
    return StudiedConfiguration(
        "osqp",
        "osqp",
        "1e-4",
        error_excess_m=error_excess_m,
        log_cost_excess=log_cost_excess,
        **(usual | columns),
    )


@pytest.mark.parametrize(
    ("values", "mean", "error2", "df"),
    [
        ([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]], 3.5, 17.5 / 30, 5.0),
        ([[1.0], [2.0], [3.0], [4.0], [5.0], [6.0]], 3.5, 17.5 / 30, 5.0),
        ([[0.0, 2.0, 4.0], [3.0, 5.0, 7.0]], 3.5, 4.0 / 3.0, 2.0),
        ([[0.0, 2.0, 4.0], [7.0, 5.0, 3.0]], 3.5, 0.0, 2.0),
    ],
)
def test_mean_by_hand(values: list[list[float]], mean: float, error2: float, df: float) -> None:
    """Squares of 1 to 6 about 3.5 are 17.5; opposite deviations at two points cancel."""
    found = estimate_mean_over_points(np.array(values))
    assert (found.value, found.df) == pytest.approx((mean, df))
    assert found.error == pytest.approx(max(1e-6, math.sqrt(error2)))


@pytest.mark.parametrize(
    ("values", "supported"),
    [
        ([[1.0, 2.0, 3.0, 4.0, 5.0]], False),
        ([[1.0], [2.0], [3.0], [4.0], [5.0]], False),
        ([[1.0, 2.0, 4.0, 3.0, 5.0, LOST], [1.0, LOST, LOST, LOST, LOST, LOST]], True),
        ([[1.0, 2.0, 4.0, 3.0, LOST], [1.0, LOST, LOST, LOST, LOST]], False),
        ([[1.0, 2.0], [3.0, 4.0], [5.0, 7.0], *[[1.0, LOST]] * 3], True),
        ([[1.0, 2.0], [3.0, 4.0], *[[1.0, LOST]] * 4], False),
        ([[1.0, 2.0, 4.0, 3.0], [1.0, *[LOST] * 3], [2.0, *[LOST] * 3]], False),
    ],
)
def test_six_values_are_enough(values: list[list[float]], supported: bool) -> None:
    """Fewer than six, of whichever points, have no error; half of the points must be repeated."""
    assert math.isnan(estimate_mean_over_points(np.array(values)).error) is not supported


@pytest.mark.parametrize("unit", [1.0, 3.0])
def test_the_skewness_of_a_mean_by_hand(unit: float) -> None:
    """Deviations -1 five times and 5: squares 30, cubes 120.

    The sum of the cubes of u over the 3/2 power of that of the squares is 120 / 30^1.5 in any unit,
    and the factor of five degrees of freedom sqrt(30) / 4.
    """
    found = estimate_mean_over_points(unit * np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 6.0]]))
    assert found.error == pytest.approx(unit)
    assert found.skew == pytest.approx(math.sqrt(30.0) / 4.0 * 120.0 / 30.0**1.5)


def test_an_error_as_small_as_nothing_has_no_skewness(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is set to the error itself, then to the next smaller number."""
    values = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 6.0]])
    error = estimate_mean_over_points(values).error
    for nothing, is_skewed in ((error, False), (math.nextafter(error, 0.0), True)):
        monkeypatch.setattr("dpbench.analysis.suites.study.NOTHING", nothing)
        found = estimate_mean_over_points(values)
        assert found.error == error and (found.skew > 0.0) is is_skewed


@pytest.mark.parametrize(("extent", "constant"), [(1e-6, True), (2e-6, False)])
def test_differences_within_a_millionth_are_constant(extent: float, constant: bool) -> None:
    index = pd.MultiIndex.from_product([[0], [1, 2, 3]], names=["point", "replicate"])
    one = pd.Series([0.0, extent, 0.0], index=index)
    assert compute_paired_difference(one, 0.0 * one).is_constant is constant


def test_a_paired_difference_by_hand() -> None:
    """Differences 0, 2, 4 at each of two points: mean 2, error sqrt(4/3), spread sqrt(4)."""
    index = pd.MultiIndex.from_product([[0, 1], [1, 2, 3]], names=["point", "replicate"])
    one = pd.Series([10.0, 12.0, 14.0, 20.0, 22.0, 24.0], index=index)
    other = pd.Series([10.0, 10.0, 10.0, 20.0, 20.0, 20.0], index=index)
    found = compute_paired_difference(one, other)
    assert (found.pairs, found.points, found.is_constant) == (6, 2, False)
    assert found.estimate.value == pytest.approx(2.0)
    assert found.estimate.error == pytest.approx(math.sqrt(4.0 / 3.0))
    assert found.spread == pytest.approx(2.0)
    lost = compute_paired_difference(one.iloc[:5], other)
    assert (lost.pairs, lost.points) == (5, 2)
    longer = one.reindex(pd.MultiIndex.from_product([[0, 1], [1, 2, 3, 4]], names=index.names))
    longer[0, 4] = 11.0
    seven = compute_paired_difference(longer, 0.0 * longer)
    assert seven.pairs == 7
    assert seven.spread == pytest.approx(seven.estimate.error * math.sqrt(3.5))
    empty = compute_paired_difference(one.iloc[:0], other)
    assert (empty.pairs, empty.points, empty.is_constant) == (0, 0, False)
    assert math.isnan(empty.spread)


@pytest.mark.parametrize(
    ("difference", "count"), [(9.0, 2), (8.98, 3), (2.49, 3), (2.48, 4), (1.6, 4), (1.59, 5)]
)
def test_replicates_for_a_difference(difference: float, count: int) -> None:
    """The quantiles 12.71, 4.303, 3.182 over the roots of 2, 3, 4 are 8.98, 2.48, 1.591."""
    assert _difference(0.0, spread=1.0).count_seas_needed_for(difference) == count
    assert _difference(0.0).count_seas_needed_for(difference) is None


@pytest.mark.parametrize(
    ("behind", "dearer", "cheap"),
    [(0.0099, 0.0099, True), (0.0101, 0.0, False), (0.0, 0.01, False), (-1.0, -1.0, True)],
)
def test_a_cheap_configuration_costs_less_than_a_percent_and_a_centimetre(
    behind: float, dearer: float, cheap: bool
) -> None:
    """The logarithm of 1.01 is 0.00995; both have to be below their limit."""
    found = _configuration(_difference(behind), _difference(dearer))
    p = found.unadjusted_p_values[1]
    assert (p < 1e-3) is cheap and (p > 0.999) is not cheap


def test_a_configuration_differs_on_either_side() -> None:
    p_values = [
        _configuration(_difference(value), _difference(0.0)).unadjusted_p_values[0]
        for value in (1e-3, -1e-3, 1e-7)
    ]
    assert [p < 1e-3 for p in p_values] == [True, True, False]
    for lacking in ((None, None), (None, _difference(0.0)), (_difference(0.0), None)):
        assert _configuration(*lacking).unadjusted_p_values == (1.0, 1.0)


@pytest.mark.parametrize(
    ("p", "value", "differs", "behind"),
    [
        (0.05, 0.1, True, True),
        (0.051, 0.1, False, False),
        (0.05, -0.1, True, False),
        (0.05, 0.0, True, False),
    ],
)
def test_who_is_significantly_behind(p: float, value: float, differs: bool, behind: bool) -> None:
    """At a family-wise error of 5 %, and with a larger radial error."""
    found = _configuration(_difference(value), None, p_differs=p)
    assert (found.differs_from_reference, found.has_larger_error_than_reference) == (
        differs,
        behind,
    )
    assert not _configuration(None, None, p_differs=p).has_larger_error_than_reference


def test_who_is_cheap() -> None:
    """The reference always is, others at 5 %; a lost run excludes it."""
    difference = _difference(0.0)
    assert _configuration(difference, None, p_cheap=0.05).adds_little_error_and_cost
    assert not _configuration(difference, None, p_cheap=0.051).adds_little_error_and_cost
    assert _configuration(None, None).adds_little_error_and_cost
    assert not _configuration(None, None, finished=5).adds_little_error_and_cost


@pytest.mark.parametrize(
    ("leaving", "left_out", "pairs", "excess_m"),
    [((), [], 6, 0.34), ((0,), [0], 3, 0.01), ((0, 1), [], 6, 0.34)],
)
def test_points_whose_exact_loop_leaves_its_station_are_in_no_difference(
    leaving: tuple[int, ...], left_out: list[int], pairs: int, excess_m: float
) -> None:
    """The law is 67 cm behind at point 0, and 1 cm at point 1; none is left out if all leave."""
    runs = [
        _run(
            name,
            point,
            sea,
            r_95_m=0.25 + (behind if name == "law" else 0.0),
            is_baseline_law=name == "law",
            exact_left_s=60.0 if point in leaving and sea == 2 else LOST,
        )
        for point, behind in ((0, 0.67), (1, 0.01))
        for sea in (1, 2, 3)
        for name in ("osqp", "law")
    ]
    study = Study("seas", runs, 1.0)
    law = study.results_by_cost[1]
    assert study.points_left_out == left_out
    for difference in (law.error_excess_m, law.log_cost_excess):
        assert difference is not None and difference.pairs == pairs
    assert law.error_excess_m is not None
    assert law.error_excess_m.estimate.value == pytest.approx(excess_m)
    table, seas, count = tabulate_error_excess_by_sea(study)
    assert len(table) == 1 and len(seas) == count == pairs


def test_the_figures_of_a_configuration() -> None:
    """Means over its judged runs: one beyond the radius is not within, a stopped one not judged."""
    runs = [
        _run("osqp", 0, 1, closed_loop_cost=3.0, exact_cost=2.0, r_95_m=0.5),
        _run("osqp", 0, 2, r_tail_max_m=1.0),
        _run("osqp", 1, 1, r_tail_max_m=1.001),
        _run("osqp", 1, 2, outcome="timed_out"),
        _run("law", 0, 1, is_baseline_law=True, solver="daqp"),
    ]
    study = Study("seas", runs, 1.0)
    assert study.reference_name == "osqp"
    reference, law = study.results_by_cost
    assert (reference.runs, reference.finished, reference.within) == (4, 3, 2 / 3)
    assert reference.cost == pytest.approx((0.5 + 1.0 + 1.0) / 3)
    assert reference.r_95_m == pytest.approx((0.5 + 0.5) / 3)
    assert (reference.error_excess_m, reference.log_cost_excess, law.name) == (None, None, "law")
    assert (reference.p_differs, reference.p_cheap) == (1.0, 1.0)
    assert law.error_excess_m is not None and law.error_excess_m.pairs == 1
    assert (study.seas_per_point, study.sample_count) == (2, 2)
    assert study.points["hs_m"].to_dict() == {0: 0.0, 1: 1.0}
    maps = tabulate_shares_in_position(study)
    assert maps["configuration"].tolist() == ["osqp", "osqp", "law"]
    assert maps["runs"].tolist() == [2, 1, 1] and maps["within"].tolist() == [1.0, 0.0, 1.0]


@pytest.mark.parametrize(
    "order", [["paper_active_set", "daqp", "osqp (1e-9)"], ["daqp", "daqp (1e-9)", "daqp (1e-6)"]]
)
def test_the_reference_is_the_most_exact(order: list[str]) -> None:
    runs = [
        _run(name, 0, 1, solver=name.split()[0], settings=name.partition("(")[2].rstrip(")"))
        for name in order
    ]
    while runs:
        assert Study("seas", runs, 1.0).reference_name == runs.pop(0).solver_label


def test_points_that_are_run_once_are_the_realisations() -> None:
    """Three points with one sea each are three draws, with two seas they are two; the law alone is
    its own reference."""
    study = Study("seas", [_run("law", p, 4, is_baseline_law=True) for p in (2, 0, 1)], 1.0)
    assert (study.seas_per_point, study.sample_count, study.reference_name) == (1, 3, "law")
    assert list(study.points.index) == [0, 1, 2]
    twice = [_run("law", p, r, is_baseline_law=True) for p in (0, 1, 2) for r in (1, 2)]
    assert Study("seas", twice, 1.0).sample_count == 2


def test_configurations_are_in_the_order_of_their_cost() -> None:
    """After the reference the nearest to the cost of the reference loop, on either side."""
    costs = {"c": 0.7, "a": 1.2, "daqp": 5.0, "d": LOST, "b": 1.1}
    runs = [_run(name, 0, 1, closed_loop_cost=cost) for name, cost in costs.items()]
    study = Study("seas", runs, 1.0)
    assert [c.name for c in study.results_by_cost] == ["daqp", "b", "a", "c", "d"]


def test_the_studies_of_a_folder(records: Any) -> None:
    """Each has the radius of its table, 1 m without one."""
    records.suite["study"] = [
        {"base": "paper", "name": "seas", "radius_m": 3.0},
        {"base": "calm", "radius_m": 4.0},
        {"base": "rough", "name": "plain"},
    ]
    records.sea("daqp", 0, 1, {"hs_m": 1.0})
    records.sea("scs", 0, 1, {"hs_m": 1.0})
    for name in ("calm", "plain", "other"):
        records.loop("daqp", study=name, study_point=0, replicate=1)
    found = [(s.name, len(s.runs), s.radius_m) for s in find_studies(records.view())]
    assert found == [("seas", 2, 3.0), ("calm", 1, 4.0), ("plain", 1, 1.0), ("other", 1, 1.0)]


@pytest.mark.parametrize(("step", "is_constant"), [(1.0, False), (1e-8, True)])
def test_points_that_are_run_once_are_compared_with_each_other(
    step: float, is_constant: bool
) -> None:
    """Ten points of one realisation differ by 0 to 9 steps: only rounding is the same in all."""
    at = pd.MultiIndex.from_product([range(10), [1]])
    found = compute_paired_difference(
        pd.Series(step * np.arange(10.0), at), pd.Series(np.zeros(10), at)
    )
    assert found.is_constant == is_constant
    assert (found.stated_numbers[0] == 0.0) == is_constant
    assert math.isfinite(found.stated_numbers[1]) != is_constant
