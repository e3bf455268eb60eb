"""Effects of the factors of a study, against textbook tests and effects that were planted."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from dpbench.analysis.suites.study import Study
from dpbench.analysis.suites.study_effects import (
    ERROR,
    LARGEST,
    OUTSIDE,
    STEP_TIME,
    UNTRUE,
    Effect,
    Measure,
    compute_study_effects,
    compute_study_interactions,
    find_dominated_effects,
)
from dpbench.bench.record.disturbance import Disturbance
from dpbench.report.study_effects_table import (
    build_interactions_table,
    describe_dominated_effects,
    tabulate_interactions,
)

HORIZON, EAST, WIND = "controller.prediction_horizon", "start.east_m", "environment.wind.speed_mps"
HEIGHT, PERIOD = "environment.waves.hs_m", "environment.waves.tp_s"


def _study(points: list[dict[str, Any]], results: Any, seas: int = 8, **columns: Any) -> Study:
    """A study of `_runs`."""
    return Study("sea", cast(Any, _runs(points, results, seas, **columns)), 1.0)


def _runs(
    points: list[dict[str, Any]], results: Any, seas: int = 8, **columns: Any
) -> list[SimpleNamespace]:
    """Runs of one solver with a given error [m] of each point (row) and sea (column)."""
    usual = {
        "solver_label": "daqp",
        "solver": "daqp",
        "settings": "default",
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
        "raw_p99_ns": np.nan,
        "closed_loop_cost": 2.0,
        "exact_cost": 1.0,
        "exact_steps": 400.0,
        "exact_left_s": np.nan,
        "r_max_m": 0.5,
        "is_baseline_law": False,
        "campaign_utc": "",
        "has_no_optimum": False,
    }
    return [
        SimpleNamespace(
            **(usual | columns),
            run_id=f"{p} {r}",
            study_point=float(p),
            replicate=float(r + 1),
            x=x,
            r_95_m=float(results[p, r]),
        )
        for p, x in enumerate(points)
        for r in range(seas)
    ]


def _effects(study: Study, measure: Measure = ERROR) -> dict[tuple[str, str], Effect]:
    return {
        (e.factor, e.levels_text): e for e in compute_study_effects(study) if e.measure == measure
    }


def test_the_effect_of_two_levels_is_the_paired_t_test() -> None:
    """Two horizons at two offsets in eight seas: means over the offsets, paired sea by sea."""
    points = [{HORIZON: n, EAST: east} for east in (0.0, 3.0) for n in (60, 20)]
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(4, 8)) + 10.0 * rng.normal(size=8)
    effects = _effects(_study(points, errors))
    assert set(effects) == {(HORIZON, "20 → 60"), (EAST, "0 → 3")}
    found = effects[HORIZON, "20 → 60"].mean_difference
    expected = stats.ttest_rel(errors[[0, 2]].mean(axis=0), errors[[1, 3]].mean(axis=0))
    assert found.estimate.value / found.estimate.error == pytest.approx(expected.statistic)
    assert (found.pairs, found.points, found.estimate.df) == (16, 2, pytest.approx(7.0))


@pytest.mark.parametrize(
    ("factor", "order", "commands", "is_shown"),
    [
        (2.0, "seas", 1, True),
        (0.5, "seas", 1, True),
        (1.4, "seas", 1, False),  # beyond 1, not beyond 1.5
        (2.0, "points", 1, False),  # load during one point alone looks like its effect
        (2.0, "seas", 2, False),  # so does load during one command
    ],
)
def test_an_effect_on_a_disturbed_machine_is_shown_beyond_a_half(
    factor: float, order: str, commands: int, is_shown: bool
) -> None:
    """Medians of 8 seas at two horizons, the second `factor` times the first within 8 %."""
    scatter = np.random.default_rng(3).uniform(0.96, 1.04, size=(2, 8))
    points = [{HORIZON: n} for n in (20, 60)]
    runs = _runs(points, np.ones((2, 8)))
    for run in runs:
        p, r = int(run.study_point), int(run.replicate) - 1
        run.raw_p50_ns = 2e4 * scatter[p, r] * factor**p
        run.raw_p99_ns = 1e6  # of a wait for the core: the median counts
        run.campaign_utc = "later" if commands == 2 and p else "first"
    if order == "seas":
        runs.sort(key=lambda run: run.replicate)
    busy = Disturbance(0.0, 0.0, 0.0, seconds=1.0, involuntary=99.0, steal_s=0.0, throttled=0.0)
    (effect,) = _effects(Study("sea", cast(Any, runs), 1.0, busy), STEP_TIME).values()
    assert effect.is_disturbed != is_shown
    assert effect.mean_difference.mean_interval.low > 0.0 or factor < 1.0


def test_the_interaction_of_two_factors_is_a_difference_of_differences() -> None:
    """0.3 m are planted at the last level of both; the test is that of one sample of seas.

    The middle level of the waves is left out, and both horizons count with equal weight.
    """
    points = [
        {HEIGHT: h, EAST: east, HORIZON: n}
        for n in (20, 60)
        for h in (1.0, 2.1, 3.5)
        for east in (0.0, 3.0)
    ]
    rng = np.random.default_rng(3)
    both = np.array([x[HEIGHT] == 3.5 and x[EAST] == 3.0 for x in points])
    errors = 0.01 * rng.normal(size=(12, 8)) + 10.0 * rng.normal(size=8) + 0.3 * both[:, None]
    study = _study(points, errors)
    found = {
        (one.factor, one.levels_text): one.mean_difference
        for one in compute_study_interactions(study)
        if one.measure == ERROR
    }
    assert len(found) == 3
    planted = found[f"{HEIGHT} × {EAST}", "1 → 3.5 × 0 → 3"]
    corners = errors.reshape(2, 3, 2, 8)[:, ::2].mean(axis=0)
    by_sea = corners[1, 1] - corners[1, 0] - corners[0, 1] + corners[0, 0]
    expected = stats.ttest_1samp(by_sea, 0.0)
    assert planted.estimate.value == pytest.approx(by_sea.mean())
    assert planted.estimate.value / planted.estimate.error == pytest.approx(expected.statistic)
    assert planted.mean_interval.low > 0.0 and (planted.pairs, planted.points) == (16, 2)
    assert found[f"{EAST} × {HORIZON}", "0 → 3 × 20 → 60"].mean_interval.contains(0.0)
    table = build_interactions_table([study])
    assert table["effect"][table["measure"] == ERROR.name].max() == pytest.approx(
        100.0 * by_sea.mean()
    )
    assert "from" not in table and f"{HEIGHT} × {EAST}" in tabulate_interactions(study).rows[0]


@pytest.mark.parametrize(
    ("horizon_m", "interaction_m", "dominated"),
    [(0.0, 0.4, {HORIZON}), (0.1, 0.4, {HORIZON}), (1.0, 0.4, set()), (0.0, 0.0, set())],
)
def test_an_effect_that_an_interaction_exceeds_is_named(
    horizon_m: float, interaction_m: float, dominated: set[str]
) -> None:
    """The horizon acts by `horizon_m` on average, by half of the interaction more at one offset.

    The offset itself acts by 2 m; the noise is 1 cm.
    """
    points = [{EAST: east, HORIZON: n} for east in (0.0, 3.0) for n in (20, 60)]
    rng = np.random.default_rng(3)
    signs = np.array([-1.0, 1.0, 1.0, -1.0]) / 4.0
    means = np.array([0.0, horizon_m, 2.0, 2.0 + horizon_m]) - interaction_m * signs
    study = _study(points, means[:, None] + 0.01 * rng.normal(size=(4, 8)))
    found = [one for one in find_dominated_effects(study) if one.effect.measure == ERROR]
    assert {one.effect.factor for one in found} == dominated
    text = describe_dominated_effects(study)
    if not dominated:
        assert text == ""
        return
    assert {one.other for one in found} == {EAST}
    assert f"`{HORIZON}` on the 95 % radial error of `daqp` depends on `{EAST}`" in text
    assert text.startswith("`sea`: 1 effect is smaller than an interaction")


def test_one_factor_or_a_range_has_no_interaction() -> None:
    """Nor have two factors that never meet at both levels."""
    rng = np.random.default_rng(1)
    alone = [{EAST: east} for east in (0.0, 3.0)]
    drawn = [{EAST: float(e), WIND: float(w)} for e, w in rng.uniform(size=(20, 2))]
    cross = [{EAST: 0.0, HORIZON: 20}, {EAST: 3.0, HORIZON: 20}, {EAST: 0.0, HORIZON: 60}]
    for points in (alone, drawn, cross):
        assert compute_study_interactions(_study(points, rng.normal(size=(len(points), 8)))) == ()


def test_keys_that_change_together_are_one_factor() -> None:
    seas = [(1.0, 6.0), (2.1, 7.5), (3.5, 9.0)]
    points = [{HEIGHT: h, PERIOD: t, EAST: e} for e in (0.0, 3.0) for h, t in seas]
    effects = _effects(_study(points, np.random.default_rng(1).normal(size=(6, 8))))
    both = f"{HEIGHT}, {PERIOD}"
    assert set(effects) == {(both, "1, 6 → 2.1, 7.5"), (both, "1, 6 → 3.5, 9"), (EAST, "0 → 3")}


def test_the_values_of_a_key_may_be_arrays() -> None:
    amplitudes = [[100, 80, 3000], [110, 88, 3300]]
    points = [{"amplitude_kN": list(a), EAST: e} for a in amplitudes for e in (0.0, 3.0)]
    study = _study(points, np.random.default_rng(1).normal(size=(4, 8)))
    change = ("amplitude_kN", "[100, 80, 3000] → [110, 88, 3300]")
    assert set(_effects(study)) == {change, (EAST, "0 → 3")}


def test_a_design_has_slopes_that_are_found_again() -> None:
    """Errors of 2 m over the range of the wind and -1 m over that of the offset, and seas."""
    rng = np.random.default_rng(5)
    wind, east = rng.uniform(5.0, 18.0, 20), rng.uniform(0.0, 3.0, 20)
    points = [{WIND: float(w), EAST: float(e)} for w, e in zip(wind, east, strict=True)]
    share_w, share_e = ((x - x.min()) / np.ptp(x) for x in (wind, east))
    truth = 2.0 * share_w - share_e
    noise = 0.1 * rng.normal(size=(20, 8)) + 5.0 * rng.normal(size=8)
    found = list(_effects(_study(points, truth[:, None] + noise)).values())
    assert [effect.factor for effect in found] == [WIND, EAST]
    for effect, expected in zip(found, (2.0, -1.0), strict=True):
        assert effect.levels_text.endswith(", slope") and effect.mean_difference.pairs == 160
        assert effect.mean_difference.mean_interval.contains(expected)
        assert effect.mean_difference.estimate.value == pytest.approx(expected, abs=0.1)


def test_points_that_are_run_once_are_the_sample_of_a_slope() -> None:
    """The interval of one key comes near that of the textbook's regression."""
    rng = np.random.default_rng(6)
    x = rng.uniform(size=60)
    errors = 3.0 * x + 0.2 * rng.normal(size=60)
    study = _study([{WIND: float(value)} for value in x], errors[:, None], seas=1)
    (effect,) = _effects(study).values()
    line = stats.linregress((x - x.min()) / np.ptp(x), errors)
    estimate = effect.mean_difference.estimate
    assert estimate.value == pytest.approx(line.slope)
    assert estimate.error == pytest.approx(line.stderr, rel=0.2)
    assert estimate.df == 58.0


@pytest.mark.slow
def test_intervals_of_slopes_hold_the_truth() -> None:
    """90 % or more of the intervals of 200 slopes hold, whose size varies from sea to sea."""
    rng, inside = np.random.default_rng(8), 0
    x = np.linspace(0.0, 1.0, 12)
    points = [{WIND: float(value)} for value in x]
    for _ in range(200):
        errors = x[:, None] * (1.0 + rng.normal(size=8)) + 0.1 * rng.normal(size=(12, 8))
        (effect,) = _effects(_study(points, errors)).values()
        inside += effect.mean_difference.mean_interval.contains(1.0)
    assert inside >= 180


def test_few_realisations_give_no_interval() -> None:
    points = [{HORIZON: 20}, {HORIZON: 60}]
    study = _study(points, np.random.default_rng(2).normal(size=(2, 5)), seas=5)
    assert np.isinf(_effects(study)[HORIZON, "20 → 60"].mean_difference.mean_interval.low)


def test_a_design_of_few_points_has_no_slope() -> None:
    points = [{WIND: float(w), EAST: float((2 * w) % 5)} for w in range(5)]
    assert _effects(_study(points, np.ones((5, 8)))) == {}


def test_other_measures_are_of_all_runs() -> None:
    """At the long horizon steps take twice the time, a quarter is untrue, no run is within.

    The ship is 10 cm farther off.
    """
    study = _study([{HORIZON: 20}, {HORIZON: 60}], np.ones((2, 8)), raw_p99_ns=3e4)
    long = study.runs["point"] == 1
    study.runs.loc[long, "raw_p99_ns"] *= 2.0
    study.runs.loc[long, "true_share"] = 0.75
    study.runs.loc[long, "within"] = 0.0
    study.runs.loc[long, "r_max_m"] += 0.1
    expected = {STEP_TIME: 100.0, LARGEST: 10.0, OUTSIDE: 100.0, UNTRUE: 25.0}
    for measure, change in expected.items():
        (effect,) = _effects(study, measure).values()
        assert measure.convert(effect.mean_difference.mean_interval.value) == pytest.approx(change)
    assert study.step_time_column == "raw_p99_ns"


def test_a_step_time_without_an_interval_has_no_effect() -> None:
    """One loop a level: its timings show the machine's load, its errors the factor."""
    points = [{HORIZON: 20}, {HORIZON: 60}]
    study = _study(points, np.array([[1.0], [2.0]]), seas=1)
    (error,) = _effects(study).values()
    interval = error.mean_difference.mean_interval
    assert interval.value == 1.0 and np.isinf(interval.low)
    assert _effects(study, STEP_TIME) == {}
    assert len(_effects(_study(points, np.ones((2, 8))), STEP_TIME)) == 1


def test_a_slope_that_no_sea_changes_is_constant() -> None:
    """The seas differ by metres, the wind changes nothing: no interval of a rounding error."""
    points = [{WIND: float(w)} for w in range(12)]
    errors = np.ones((12, 1)) * np.arange(8.0)
    (effect,) = _effects(_study(points, errors)).values()
    assert effect.mean_difference.is_constant and effect.measured.count_with_sign_of_median == 8.0
    assert effect.mean_difference.mean_interval.value == pytest.approx(0.0, abs=1e-12)


def test_units_are_means_over_points_or_the_points_themselves() -> None:
    """Changes of 1 and 3 m at two offsets, twice that in the second sea; then in one sea alone."""
    points = [{HORIZON: n, EAST: east} for east in (0.0, 3.0) for n in (20, 60)]
    errors = np.array([[0.0, 5.0], [1.0, 7.0], [0.0, 4.0], [3.0, 10.0]])
    for seas, units in ((2, (2.0, 4.0)), (1, (1.0, 3.0))):
        effect = _effects(_study(points, errors, seas=seas))[HORIZON, "20 → 60"]
        assert effect.measured.units == units
        assert effect.measured.median_change == sum(units) / 2
