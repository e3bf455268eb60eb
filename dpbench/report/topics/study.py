"""A study: what holds where, what a configuration costs in the same seas, how loose it may be."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from dpbench.analysis.suites.study import (
    NOTHING_M,
    SMALL_COST,
    SMALL_M,
    PairedDifference,
    StudiedConfiguration,
    Study,
)
from dpbench.report.charts.study import behind, held_lines, held_maps
from dpbench.report.formats import MISSING, and_list, plural, significant
from dpbench.report.page.topic import Figure, SmallTable, Topic

MOST_MAPS = 6
"""The reference, and those that hold least, are mapped; more maps than these nobody compares."""
MOST_POINTS, FIELDS = 300, 14
"""A map of more points shows fields instead, so many along each key."""
MOST_DOTS = 1500
"""So many seas a figure draws: of more, some of each configuration at even ranks, the least and the
largest among them."""
_HEAD = (
    "configuration",
    "runs",
    "held",
    "cost over exact",
    "behind [cm]",
    "dearer",
    "shown",
    "seas for 1 cm",
)


def study_topic(known: Sequence[Study]) -> Topic | None:
    """The topic; None without a study."""
    if not known:
        return None
    return Topic(
        id="study",
        title="Studies: many seas, paired",
        lines=tuple(line for study in known for line in _lines(study)),
        figures=tuple(figure for study in known for figure in _figures(study)),
        tables=tuple(table for study in known for table in _tables(study)),
    )


def _lines(study: Study) -> Iterator[str]:
    runs, points = study.runs, len(study.points)
    seas = plural(study.replicates, "sea")
    yield (
        f"{study.name}: {plural(len(runs), 'run')} at {plural(points, 'point')} in {seas}; "
        f"{_separated(study)}"
    )
    held = study.configurations[0].held
    worst = min(study.configurations, key=lambda c: c.held)
    radius = f"within {study.radius_m:g} m in the second half of a run"
    yield (
        f"{study.reference} holds the ship {radius} in {100 * held:.0f} % of them"
        + (f", {worst.name} in {100 * worst.held:.0f} %." if worst.held < held else ", as all do.")
    )
    if study.loosest:
        yield _loosest(study)


def _separated(study: Study) -> str:
    """Who is shown to be behind the reference in the same seas, and who is not."""
    others = [c for c in study.configurations if c.behind is not None]
    worse = [c for c in others if c.behind is not None and c.behind.mean.low > NOTHING_M]
    worse.sort(key=lambda c: -_mean(c))
    said = [f"{c.name} by {_cm(_mean(c))} cm" for c in worse[:3]]
    unnamed = f" and {len(worse) - 3} more" if len(worse) > 3 else ""
    if not worse:
        return f"nobody is shown to be behind {study.reference} in the same sea."
    same = len(others) - len(worse)
    rest = f"; {same} {'is' if same == 1 else 'are'} not shown to be" if same else ""
    return f"behind {study.reference} in the same sea: {', '.join(said)}{unnamed}{rest}."


def _loosest(study: Study) -> str:
    """The loosest tolerance of each solver that costs next to nothing."""
    cheap = {s: c for s, c in study.loosest.items() if c is not None}
    none = [s for s, c in study.loosest.items() if c is None]
    limits = f"less than {100 * SMALL_M:g} cm and {100 * SMALL_COST:g} % of the cost"
    parts = [f"{solver} {c.tolerance:g}" for solver, c in cheap.items()]
    said = f"The loosest tolerance shown to cost {limits}: {and_list(parts)}" if parts else ""
    without = f"No tolerance of {and_list(none)} is shown to cost {limits}" if none else ""
    return ". ".join(filter(None, (said, without))) + "."


def _figures(study: Study) -> Iterator[Figure]:
    name = study.name.replace("@", "-").replace("/", "-")
    maps = _maps(study)
    keys = [str(key) for key in study.points if is_numeric_dtype(study.points[key])]
    title = f"Held within {study.radius_m:g} m, {study.name}"
    if len(keys) > 1:
        own = study.points[keys[0]].nunique() > max(8, len(study.points) // 2)
        drawn = bool(own) or not _fits(study)
        chart = held_maps(maps, title, keys[0], keys[1], drawn=drawn)
        where = "at each point" if _fits(study) else f"in {FIELDS} × {FIELDS} fields"
        caption = f"Share of seas {where}; a run that did not end is not held."
        yield Figure(f"study-held-{name}", chart, caption)
    elif keys:
        chart = held_lines(maps, title, keys[0])
        yield Figure(f"study-held-{name}", chart, "Share of seas at each value.")
    table, seas, seas_all = _behind(study)
    if len(table):
        chart = behind(table, seas, f"Behind {study.reference}, {study.name}", 100 * SMALL_M)
        of = "" if len(seas) == seas_all else f", {len(seas)} of {seas_all} at even ranks"
        caption = (
            f"A dot a sea{of}, the mean with its 95 % interval; the band: 1 cm to either side."
        )
        yield Figure(f"study-behind-{name}", chart, caption)


def _maps(study: Study) -> pd.DataFrame:
    """The maps of the reference and of those that hold least, in columns of the chart."""
    ordered = sorted(study.configurations[1:], key=lambda c: c.held)[: MOST_MAPS - 1]
    numeric = study.points.select_dtypes("number").columns.tolist()
    tables = []
    for configuration in [study.configurations[0], *ordered]:
        table = study.held_map(configuration.name)
        columns = dict(zip(numeric, ("x", "y"), strict=False))
        part = table.rename(columns=columns)[[*columns.values(), "held", "runs"]]
        if not _fits(study):
            part = part.assign(**{name: _fields(part[name]) for name in columns.values()})
        # Points that differ in a third key lie on one another: their seas are counted together.
        seas = part.assign(held=part["held"] * part["runs"])
        summed = seas.groupby(list(columns.values()), as_index=False).sum() if columns else seas
        summed["held"] /= summed["runs"]
        tables.append(summed.assign(configuration=configuration.name))
    return pd.concat(tables, ignore_index=True)


def _fits(study: Study) -> bool:
    """Whether every point has a place of its own on a map."""
    return len(study.points) <= MOST_POINTS


def _fields(values: pd.Series[float]) -> pd.Series[float]:
    """The middle of the field that each value lies in."""
    least, most = float(values.min()), float(values.max())
    width = (most - least) / FIELDS or 1.0
    number = ((values - least) / width).astype(int).clip(upper=FIELDS - 1)
    return least + width * (number + 0.5)


def _behind(study: Study) -> tuple[pd.DataFrame, pd.DataFrame, int]:
    """Means with their intervals, and seas, both in cm; and how many seas there are."""
    reference = study.values(study.reference, "r_95_m")
    most = max(2, MOST_DOTS // max(1, len(study.configurations) - 1))
    rows, seas, count = [], [], 0
    for configuration in study.configurations:
        difference = configuration.behind
        if difference is None or difference.pairs == 0:
            continue
        mean, bounded = difference.mean, np.isfinite(difference.mean.low)
        rows.append(
            {
                "name": configuration.name,
                "mean_cm": 100 * mean.value,
                "low_cm": 100 * mean.low if bounded else 100 * mean.value,
                "high_cm": 100 * mean.high if bounded else 100 * mean.value,
                "pairs": difference.pairs,
            }
        )
        each = 100 * (study.values(configuration.name, "r_95_m") - reference).dropna()
        count += len(each)
        ranks = np.unique(np.linspace(0, len(each) - 1, min(most, len(each))).round().astype(int))
        some = each.sort_values().iloc[ranks] if len(each) > most else each
        seas.append(some.rename("behind_cm").reset_index().assign(name=configuration.name))
    return pd.DataFrame(rows), pd.concat(seas, ignore_index=True) if seas else pd.DataFrame(), count


def _tables(study: Study) -> Iterator[SmallTable]:
    rows = tuple(_row(configuration) for configuration in study.configurations)
    yield SmallTable(_HEAD, rows, f"{study.name}: against {study.reference} in the same sea")
    axes = tuple(
        (str(key), str(values.nunique()), str(values.min()), str(values.max()))
        for key, values in study.points.items()
    )
    if axes:
        yield SmallTable(("key", "values", "least", "largest"), axes, f"{study.name}: its points")


def _row(configuration: StudiedConfiguration) -> tuple[str, ...]:
    behind_cm, dearer = configuration.behind, configuration.dearer
    return (
        configuration.name,
        f"{configuration.finished} of {configuration.runs}",
        f"{100 * configuration.held:.0f} %",
        f"{_percent(configuration.cost)} %",
        "reference" if behind_cm is None else _interval(behind_cm, 100.0),
        "" if dearer is None else f"{_interval(dearer, 100.0)} %",
        "" if behind_cm is None else ("yes" if behind_cm.shown else "no"),
        "" if behind_cm is None else str(behind_cm.replicates_for(SMALL_M) or MISSING),
    )


def _interval(difference: PairedDifference, scale: float) -> str:
    mean = difference.mean
    if not np.isfinite(mean.low):
        return f"{significant(scale * mean.value, 2)} (too few seas)"
    if max(abs(mean.low), abs(mean.high)) < NOTHING_M:
        return "0"
    low, high = (significant(scale * value, 2) for value in (mean.low, mean.high))
    return f"{significant(scale * mean.value, 2)} [{low}, {high}]"


def _percent(share: float) -> str:
    """A share in percent to two digits; what is rounding alone is 0."""
    return "0" if abs(share) < NOTHING_M else significant(100.0 * share, 2)


def _mean(configuration: StudiedConfiguration) -> float:
    return 0.0 if configuration.behind is None else configuration.behind.mean.value


def _cm(metres: float) -> str:
    return significant(100.0 * metres, 2)
