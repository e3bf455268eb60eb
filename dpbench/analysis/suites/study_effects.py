"""Effects of a study's factors: what a horizon, a sea or an offset changes, with an interval.

A factor with a few values is compared level by level: runs that differ in nothing else, in the same
realisation, are paired, so the interval is that of `compute_paired_difference`. A factor drawn from
a range (a Sobol sequence has no two points that differ in one key) gets the least-squares slope
over all points, one of each realisation; of points that are run once, with the error HC3
(MacKinnon & White 1985, J. Econometrics 29, 305-325).

The interaction of two factors with a few values each is how much more the second changes a measure
at the last level of the first than at the first: a difference of differences, paired alike.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from dpbench.analysis.records.machine import GROSS
from dpbench.analysis.statistics import MeanEstimate
from dpbench.analysis.suites.study import (
    LEAST_PAIRS,
    NOTHING,
    PairedDifference,
    Study,
    compute_paired_difference,
    estimate_mean_over_points,
)
from dpbench.arrays import Floats

INTERACTS = " × "
MOST_LEVELS = 8
"""A number with more values counts as drawn from a range."""


@dataclass(frozen=True)
class Measure:
    """One result of a run whose change a factor is judged by.

    unit : of the change; convert : from the mean difference to that unit.
    """

    name: str
    unit: str
    convert: Callable[[float], float]


STEP_TIME = Measure("step time", "%", lambda change: 100.0 * math.expm1(change))
ERROR = Measure("95 % radial error", "cm", lambda change: 100.0 * change)
LARGEST = Measure("largest offset", "cm", lambda change: 100.0 * change)
OUTSIDE = Measure("runs outside the radius", "percentage points", lambda change: 100.0 * change)
UNTRUE = Measure("unverified steps", "percentage points", lambda change: 100.0 * change)
MEASURES = (STEP_TIME, ERROR, LARGEST, OUTSIDE, UNTRUE)


@dataclass(frozen=True)
class Change:
    """Two values of the first key of a factor, or the ends of its range.

    shown_text : the change of all keys of the factor, as the page shows it.
    """

    start: Any
    end: Any
    shown_text: str


@dataclass(frozen=True)
class MeasuredChange:
    """Mean difference over a change of a factor, and the differences that it is the mean of.

    units : of each realisation, the mean over its points, or its slope; of points that are run
    once, of each point; empty of a single slope.
    """

    change: Change
    difference: PairedDifference
    units: tuple[float, ...]

    @property
    def median_change(self) -> float:
        """Median of a measure's change over realisations or points; NaN without any."""
        return float(np.median(self.units)) if self.units else math.nan

    @property
    def count_with_sign_of_median(self) -> float:
        """Number of realisations or points with the median's sign; 0 where that is 0; NaN: none."""
        sign = _compute_sign(self.median_change)
        return (
            float(sum(_compute_sign(one) == sign for one in self.units)) if self.units else math.nan
        )


@dataclass(frozen=True)
class Effect:
    """Change of one measure of a configuration from one value of a factor to another.

    factor : its keys; those of a `zip` change together.
    is_disturbed : True if other load can explain the change.
    """

    configuration: str
    factor: str
    measure: Measure
    measured: MeasuredChange
    is_disturbed: bool

    @property
    def levels_text(self) -> str:
        """Text of the two values of a study's factor, or of its range."""
        return self.measured.change.shown_text

    @property
    def mean_difference(self) -> PairedDifference:
        """Mean difference of the measure between two values of the factor, with interval."""
        return self.measured.difference


@lru_cache(maxsize=4)
def compute_study_effects(study: Study) -> tuple[Effect, ...]:
    """Return the effect of every factor on every measure, configuration by configuration.

    A factor that no two comparable runs vary in has none, and no step time without an interval: one
    timing of each step of one loop shows the load of the machine.
    """
    factors = group_keys_that_vary_together(study.points)
    pairings = {factor: _list_level_changes(study.points, factor) for factor in factors}
    ranged = [
        factor
        for factor in factors
        if not pairings[factor] and is_numeric_dtype(study.points[factor[0]])
    ]
    effects: list[Effect] = []
    for configuration in study.results_by_cost:
        for measure, values in _collect_values_by_measure(study, configuration.name).items():
            found = {
                factor: [_compute_level_effect(values, *change) for change in pairings[factor]]
                for factor in factors
            } | _fit_range_effects(study.points, values, ranged)
            for factor, changes in found.items():
                name = ", ".join(factor)
                effects += _yield_effects(study, configuration.name, name, measure, changes)
    return tuple(effects)


@lru_cache(maxsize=4)
def compute_study_interactions(study: Study) -> tuple[Effect, ...]:
    """Return the interaction of every two factors with levels, configuration by configuration.

    Of more than two levels the first and the last. A factor drawn from a range has none.
    """
    ends = {
        factor: found
        for factor in group_keys_that_vary_together(study.points)
        if (found := _find_end_levels(study.points, factor)) is not None
    }
    corners = {pair: _list_corners(study.points, ends, *pair) for pair in combinations(ends, 2)}
    return tuple(
        effect
        for configuration in study.results_by_cost
        for measure, values in _collect_values_by_measure(study, configuration.name).items()
        for pair, sides in corners.items()
        for name in [INTERACTS.join(map(", ".join, pair))]
        for measured in [_compute_interaction(values, _join_changes(ends, *pair), *sides)]
        for effect in _yield_effects(study, configuration.name, name, measure, [measured])
    )


def _yield_effects(
    study: Study,
    configuration: str,
    factor: str,
    measure: Measure,
    changes: Sequence[MeasuredChange],
) -> Iterator[Effect]:
    """Yield the effects of a factor; of step times those that have an interval.

    Other load can explain a change of the step time on a disturbed machine, unless the points
    alternate, so that all meet the load, and the whole interval is beyond GROSS.
    """
    for measured in changes:
        interval, largest = measured.difference.mean_interval, math.log(GROSS)
        is_beyond = interval.low > largest or interval.high < -largest
        is_explained = study.is_disturbed and not (study.has_alternating_points and is_beyond)
        is_time = measure == STEP_TIME
        if measured.difference.pairs and (math.isfinite(interval.low) or not is_time):
            yield Effect(configuration, factor, measure, measured, is_time and is_explained)


@dataclass(frozen=True)
class DominatedEffect:
    """Effect of a factor that is smaller than its interaction with another one.

    other : the other factor, on whose value the effect depends.
    """

    effect: Effect
    other: str
    interaction: Effect


def find_dominated_effects(study: Study) -> list[DominatedEffect]:
    """Return the effects that are smaller than an interaction, each with the largest of these.

    The whole interval of the interaction is farther from zero than the mean effect. Only effects
    from the first to the last level, as those of the interactions, are compared.
    """
    effects = {
        (one.configuration, one.measure, one.factor, one.levels_text): one
        for one in compute_study_effects(study)
        if not one.is_disturbed
    }
    found: dict[tuple[object, ...], DominatedEffect] = {}
    by_size = sorted(compute_study_interactions(study), key=_compute_least_size, reverse=True)
    for interaction in by_size:
        factors, levels = (
            text.split(INTERACTS) for text in (interaction.factor, interaction.levels_text)
        )
        for factor, other, level in zip(factors, factors[::-1], levels, strict=True):
            key = (interaction.configuration, interaction.measure, factor, level)
            effect = effects.get(key)
            if effect is None or interaction.is_disturbed or key in found:
                continue
            size = abs(effect.mean_difference.mean_interval.value)
            if _compute_least_size(interaction) > size + NOTHING:
                found[key] = DominatedEffect(effect, other, interaction)
    return list(found.values())


def _compute_least_size(effect: Effect) -> float:
    """Return the distance from zero of an effect's interval; 0 where it contains zero."""
    interval = effect.mean_difference.mean_interval
    return 0.0 if interval.contains(0.0) else min(abs(interval.low), abs(interval.high))


_Ends = Mapping[tuple[str, ...], Change]


def _find_end_levels(points: pd.DataFrame, factor: tuple[str, ...]) -> Change | None:
    """Return the change from the first to the last level of a factor; None if it has a range."""
    levels = _list_levels(points[factor[0]])
    if len(levels) < 2:
        return None
    labels = [
        _format_levels(points, factor, (points[factor[0]] == level).idxmax())
        for level in (levels[0], levels[-1])
    ]
    return Change(levels[0], levels[-1], " → ".join(labels))


def _list_corners(
    points: pd.DataFrame, ends: _Ends, first: tuple[str, ...], second: tuple[str, ...]
) -> list[pd.Series]:
    """Return the points of two factors' end levels, mapped to groups that differ in nothing else.

    In the order first and second at their first level, second, first, and both at their last.
    """
    group = _name_groups(points.drop(columns=[*first, *second]))
    of_first, of_second = (
        [points[factor[0]] == level for level in (ends[factor].start, ends[factor].end)]
        for factor in (first, second)
    )
    return [group[one & other] for one in of_first for other in of_second]


def _join_changes(ends: _Ends, first: tuple[str, ...], second: tuple[str, ...]) -> Change:
    """Return the changes of two factors as one."""
    a, b = ends[first], ends[second]
    return Change((a.start, b.start), (a.end, b.end), f"{a.shown_text}{INTERACTS}{b.shown_text}")


def _compute_interaction(values: pd.Series, change: Change, *sides: pd.Series) -> MeasuredChange:
    """Return how much more a measure changes with a second factor at the first one's last level."""
    least, second, first, both = (_select_values_of_side(values, side) for side in sides)
    return _measure_change(change, (both - first).dropna(), (second - least).dropna())


def group_keys_that_vary_together(points: pd.DataFrame) -> list[tuple[str, ...]]:
    """Return the study keys that vary, in groups of those that change together."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for key, values in points.items():
        codes, levels = pd.factorize(values)
        if len(levels) < 2:
            continue
        together: tuple[object, ...] = tuple(codes.tolist())
        distinct = len(levels) == len(values) or len(levels) > MOST_LEVELS
        if distinct and is_numeric_dtype(values):
            # All draws differ; keys change together where one orders the points as the other.
            order = np.argsort(values.to_numpy(), kind="stable").tolist()
            together = ("range", *min(order, order[::-1]))
        groups.setdefault(together, []).append(str(key))
    return [tuple(keys) for keys in groups.values()]


def _list_level_changes(
    points: pd.DataFrame, factor: tuple[str, ...]
) -> list[tuple[Change, pd.Series, pd.Series]]:
    """Return each change from the first level of a factor, with the points on either side.

    A side maps its points to their groups, of points that differ in nothing else.
    """
    first, group = points[factor[0]], _name_groups(points.drop(columns=list(factor)))
    levels = _list_levels(first)
    if not levels:
        return []
    least = group[first == levels[0]]
    labels = [_format_levels(points, factor, (first == level).idxmax()) for level in levels]
    pairs = [(level, group[first == level]) for level in levels[1:]]
    return [
        (Change(levels[0], level, f"{labels[0]} → {label}"), least, other)
        for (level, other), label in zip(pairs, labels[1:], strict=True)
        if other.isin(least).any()
    ]


def _list_levels(values: pd.Series) -> list[Any]:
    """Return the levels of a key, of numbers the smallest first; none if drawn from a range."""
    levels = list(values.unique())
    if not is_numeric_dtype(values):
        return levels
    return sorted(levels) if len(levels) <= MOST_LEVELS else []


def _name_groups(others: pd.DataFrame) -> pd.Series:
    """Return by point a text that is equal for points with the same values of some keys."""
    names = [repr(row) for row in others.to_numpy(dtype=object).tolist()]
    return pd.Series(names, index=others.index)


def _format_levels(points: pd.DataFrame, factor: tuple[str, ...], at: Any, digits: int = 6) -> str:
    """Return the values of all keys of a study's factor at a point, as text."""
    values = [points.at[at, key] for key in factor]
    return ", ".join(f"{v:.{digits}g}" if isinstance(v, float) else str(v) for v in values)


def _collect_values_by_measure(study: Study, configuration: str) -> Mapping[Measure, pd.Series]:
    """Return each measure's values of a configuration's runs, by study point and realisation."""
    runs = study.runs[study.runs["configuration"] == configuration]
    runs = runs.set_index(["point", "replicate"])
    finished = runs[runs["finished"]]
    return {
        STEP_TIME: np.log(
            finished[study.step_time_column].where(finished[study.step_time_column] > 0)
        ).dropna(),
        ERROR: finished["r_95_m"],
        LARGEST: finished["r_max_m"],
        OUTSIDE: (1.0 - runs["within"]).dropna(),
        UNTRUE: (1.0 - finished["true_share"]).dropna(),
    }


def _compute_sign(value: float) -> int:
    """Return the sign of a change as 1 or −1; 0 where its size is within `NOTHING`."""
    return int(value > NOTHING) - int(value < -NOTHING)


def _compute_level_effect(
    values: pd.Series, change: Change, least: pd.Series, other: pd.Series
) -> MeasuredChange:
    """Return a measure's mean change between two levels, over pairs in the same realisation."""
    sides = _select_values_of_side(values, other), _select_values_of_side(values, least)
    return _measure_change(change, *sides)


def _measure_change(change: Change, *sides: pd.Series) -> MeasuredChange:
    """Return the mean difference of two sides' values by group and realisation."""
    pairs = (sides[0] - sides[1]).dropna()
    points, seas = (pairs.index.get_level_values(level) for level in (0, 1))
    units = pairs.groupby(seas).mean() if points.duplicated().any() else pairs
    return MeasuredChange(change, compute_paired_difference(*sides), tuple(units.tolist()))


def _select_values_of_side(values: pd.Series, side: pd.Series) -> pd.Series:
    """Return the values of one side by group and realisation; the mean of points drawn twice."""
    points = values.index.get_level_values("point")
    chosen = values[points.isin(side.index)]
    group = chosen.index.get_level_values("point").map(side.to_dict())
    return chosen.groupby([group, chosen.index.get_level_values("replicate")]).mean()


def _fit_range_effects(
    points: pd.DataFrame, values: pd.Series, ranged: list[tuple[str, ...]]
) -> dict[tuple[str, ...], list[MeasuredChange]]:
    """Return a measure's least-squares change over the range of each factor drawn from one."""
    if not ranged or values.empty:
        return {factor: [] for factor in ranged}
    keys = points[[factor[0] for factor in ranged]].astype(np.float64)
    low, high = keys.min(), keys.max()
    table = values.unstack()
    shares = ((keys - low) / (high - low)).loc[table.index].to_numpy()
    across = np.column_stack([np.ones(len(shares)), shares])
    results = table.to_numpy(dtype=np.float64)
    fits = list(_yield_slope_fits(across, results))
    count = sum(fit.points for fit in fits)
    found = {}
    for i, factor in enumerate(ranged):
        units = tuple(float(fit.slopes[i + 1]) for fit in fits) if len(fits) > 1 else ()
        # A single slope is the same everywhere if all results are.
        same = np.ptp(units or results[np.isfinite(results)]) <= NOTHING
        slope = _estimate_mean_slope(fits, i + 1)
        difference = PairedDifference(slope, count, len(table), math.nan, is_constant=bool(same))
        key = keys.iloc[:, i]
        ends = [_format_levels(points, factor, at, 3) for at in (key.idxmin(), key.idxmax())]
        change = Change(key.min(), key.max(), f"{' → '.join(ends)}, slope")
        found[factor] = [MeasuredChange(change, difference, units)]
    return found


@dataclass(frozen=True)
class _Fit:
    """Least-squares fit of one realisation: intercept and slopes, their errors, its points."""

    slopes: Floats
    errors: Floats
    points: int


def _yield_slope_fits(across: Floats, results: Floats) -> Iterator[_Fit]:
    """Yield a linear fit over a factor, slopes with errors, of each realisation with data."""
    for column in results.T:
        known = np.isfinite(column)
        x, y = across[known], column[known]
        terms = x.shape[1]
        if len(y) < terms + LEAST_PAIRS or np.linalg.matrix_rank(x) < terms:
            continue
        inverse = np.linalg.pinv(x)
        slopes = inverse @ y
        leverage = np.einsum("ij,ji->i", x, inverse)
        away = (y - x @ slopes) / np.maximum(1.0 - leverage, NOTHING)
        yield _Fit(slopes, np.sqrt(inverse**2 @ away**2), len(y))


def _estimate_mean_slope(fits: list[_Fit], term: int) -> MeanEstimate:
    """Return the mean slope over realisations, or over the points of one, with its error."""
    if not fits:
        return MeanEstimate(math.nan)
    if len(fits) > 1:
        return estimate_mean_over_points(np.array([[float(fit.slopes[term]) for fit in fits]]))
    (fit,) = fits
    error = max(float(fit.errors[term]), NOTHING)
    return MeanEstimate(float(fit.slopes[term]), error, float(fit.points - len(fit.slopes)))
