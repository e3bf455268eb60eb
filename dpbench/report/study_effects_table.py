"""Effects of the varied keys of a study as tables, for the page and for `tables/`."""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd

from dpbench.analysis.records.machine import GROSS
from dpbench.analysis.statistics import MARKED_WIDENING
from dpbench.analysis.suites.study import Study
from dpbench.analysis.suites.study_effects import (
    MEASURES,
    STEP_TIME,
    Effect,
    Measure,
    compute_study_effects,
    compute_study_interactions,
    find_dominated_effects,
)
from dpbench.report.formats import MISSING, Table, format_estimate_with_bounds, mark_solver, plural

MOST_ROWS = 24
"""The page shows so many rows; `tables/study_effects.csv` has all."""
_HEADS = {
    measure: f"{measure.name} [{measure.unit}]".replace("percentage points", "points")
    for measure in MEASURES
}
_Compute = Callable[[Study], Sequence[Effect]]
_INTERVALS = (
    "Intervals hold at 95 % for each cell alone and not for all at once: without any effect, 1 in "
    "20 excludes zero. They are over realisations, or over points if each has one realisation; in "
    "n of n: the effect has the same sign in all n of them. Skewed, widened: the differences are "
    f"so skewed that the interval is at least {MARKED_WIDENING:g} times as wide as Student's; more "
    "realisations narrow it. "
)
BEYOND_LOAD = f"above +{100 * (GROSS - 1):.0f} % or below −{100 * (1 - 1 / GROSS):.0f} %"
"""Size of an effect on step times that is shown on a disturbed machine."""
WIDENED = " (skewed, widened)"
"""Mark of an interval that skewness widens."""
_KEYS = ("factor", "levels", "configuration")
_WHAT = {"raw_p99_ns": "p99 step time", "raw_p50_ns": "median step time"}
MOST_NAMED = 3
"""Effects that a sentence names."""
COLUMNS = (
    *("study", "configuration", "factor", "levels", "from", "to", "measure", "unit"),
    *("effect", "low", "high", "interval", "widening", "median", "same_sign"),
    *("realisations", "pairs", "points"),
)


def build_effects_table(studies: Sequence[Study]) -> pd.DataFrame:
    """Return a table of every effect of all studies with its 95 % interval, as `COLUMNS`."""
    return _build_table(studies, compute_study_effects)


def build_interactions_table(studies: Sequence[Study]) -> pd.DataFrame:
    """Return a table of the interactions of every two factors of all studies."""
    return _build_table(studies, compute_study_interactions).drop(columns=["from", "to"])


def _build_table(studies: Sequence[Study], compute: _Compute) -> pd.DataFrame:
    """Return a table of effects or interactions of all studies, as `COLUMNS`."""
    rows = [
        (
            *(study.name, effect.configuration, effect.factor, effect.levels_text),
            *(effect.measured.change.start, effect.measured.change.end),
            *(
                _name_measure(effect.measure, study),
                effect.measure.unit,
                *_list_numbers(effect),
            ),
            len(effect.measured.units) or effect.mean_difference.points,
            *(effect.mean_difference.pairs, effect.mean_difference.points),
        )
        for study in studies
        for effect in compute(study)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def tabulate_effects(study: Study) -> Table | None:
    """Return a table of what each factor changes, by configuration and change; None without one."""
    note = (
        "Change from the first value to the second, of runs that differ in nothing else and share "
        "the realisation; a slope is the least-squares change over the range, all points of a "
        f"realisation together. {_INTERVALS}"
        "Step times are from closed loops, which run in parallel unless --jobs is 1. Disturbed: "
        "other load can explain the effect."
    )
    title = f"{study.name}: effect of each factor"
    return _tabulate(study, compute_study_effects, title, note, "study_effects")


def tabulate_interactions(study: Study) -> Table | None:
    """Return a table of how two factors change a result together; None without two factors."""
    note = (
        "How much more the second factor changes the measure at the last level of the first than "
        "at the first level, in the same realisation; 0: each factor acts as if alone. For step "
        f"times: the ratio of the two ratios, minus 1. {_INTERVALS}"
    )
    title = f"{study.name}: interaction of two factors"
    return _tabulate(study, compute_study_interactions, title, note, "study_interactions")


def describe_dominated_effects(study: Study) -> str:
    """Return a sentence on effects that are smaller than an interaction; "" without one."""
    found = find_dominated_effects(study)
    if not found:
        return ""
    named = [
        f"that of `{one.effect.factor}` on the {_name_measure(one.effect.measure, study)} of "
        f"{mark_solver(one.effect.configuration)} depends on `{one.other}`"
        for one in found[:MOST_NAMED]
    ]
    more = len(found) - len(named)
    named += [f"{more} more"] if more > 0 else []
    are = "is" if len(found) == 1 else "are"
    return (
        f"`{study.name}`: {plural(len(found), 'effect')} {are} smaller than an interaction of the "
        f"factor: {'; '.join(named)}. See `tables/study_interactions.csv`."
    )


def _tabulate(study: Study, compute: _Compute, title: str, note: str, file: str) -> Table | None:
    """Return a table of effects or interactions, a row per configuration and change."""
    units = "realisations" if study.seas_per_point > 1 else "points"
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for effect in compute(study):
        key = (effect.factor, effect.levels_text, effect.configuration)
        row = rows.setdefault(key, dict(zip(_KEYS, key, strict=True)))
        row[make_head_of_measure(effect.measure, study)] = _format_effect(effect, units)
    if not rows:
        return None
    heads = [*_KEYS, *(make_head_of_measure(one, study) for one in MEASURES)]
    changes = list(dict.fromkeys(key[:2] for key in rows))
    ordered = sorted(rows.items(), key=lambda item: changes.index(item[0][:2]))
    whole = [{head: row.get(head, MISSING) for head in heads} for _, row in ordered]
    if len(whole) > MOST_ROWS:
        note += f" All rows: tables/{file}.csv."
    return Table.from_rows(whole, title, note=note, text_columns=3, shown=MOST_ROWS)


def _name_measure(measure: Measure, study: Study) -> str:
    """Return the name of a measure; of the step time, with its percentile."""
    return _WHAT[study.step_time_column] if measure == STEP_TIME else measure.name


def make_head_of_measure(measure: Measure, study: Study) -> str:
    """Return the column head of a measure, with its unit."""
    return _HEADS[measure].replace(measure.name, _name_measure(measure, study))


def convert_effect_and_interval(effect: Effect) -> tuple[float, float, float]:
    """Return an effect and the ends of its interval in the unit of its measure; NaN for none.

    An effect that is the same in every realisation has no interval.
    """
    convert = effect.measure.convert
    value, low, high = effect.mean_difference.stated_numbers
    if not np.isfinite(low):
        return convert(value), np.nan, np.nan
    return convert(value), convert(low), convert(high)


def _list_numbers(effect: Effect) -> tuple[float | str, ...]:
    """Return the columns of `COLUMNS` from effect to same_sign; no number where load explains it.

    interval : "95 %", "none", "disturbed" or "in every realisation".
    """
    if effect.is_disturbed:
        return (*[np.nan] * 3, "disturbed", *[np.nan] * 3)
    difference, measured = effect.mean_difference, effect.measured
    interval = "in every realisation" if difference.is_constant else "95 %"
    interval = interval if np.isfinite(difference.mean_interval.low) else "none"
    widening = difference.estimate.widening if interval == "95 %" else np.nan
    median = effect.measure.convert(measured.median_change)
    numbers = convert_effect_and_interval(effect)
    return (*numbers, interval, widening, median, measured.count_with_sign_of_median)


def _format_effect(effect: Effect, units: str) -> str:
    """Return an effect with its interval as text, in its unit, and if all `units` agree."""
    if effect.is_disturbed:
        return "disturbed"
    numbers = (0.0 if abs(n) < 1e-4 else n for n in convert_effect_and_interval(effect))
    value, low, high = format_estimate_with_bounds(*numbers)
    if not np.isfinite(effect.mean_difference.mean_interval.low):
        return f"{value} (no interval: too few pairs)"
    if effect.mean_difference.is_constant:
        return f"{value} in every realisation"
    count = len(effect.measured.units)
    agreed = (
        f" in {count} of {count} {units}"
        if effect.measured.count_with_sign_of_median == count
        else ""
    )
    widened = WIDENED if effect.mean_difference.estimate.is_clearly_widened else ""
    return f"{value} [{low}, {high}]{agreed}{widened}"
