"""Tables of rankings: paired ratios to a baseline, and places that other choices move."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan

import numpy as np

from dpbench.analysis.times.pooled import CommonSteps, PooledTimes
from dpbench.analysis.times.ranks import Ranked, Ranking
from dpbench.analysis.times.ratios import Ratio
from dpbench.report.formats import (
    and_list,
    count_text,
    interval_text,
    micro_text,
    plural,
    share_text,
    significant,
    time_text,
)
from dpbench.report.table import Cell, Table, row_of

COLUMNS = 4
"""Of more sequences the least and the largest ratio are shown instead of each."""


def population(common_steps: CommonSteps) -> str:
    """What the figures of a common_steps are taken from."""
    names = and_list([f"`{name}`" for name in common_steps.sequences])
    more = (
        f" {plural(common_steps.left_out, 'further configuration')} replayed on fewer sequences "
        "stay out."
        if common_steps.left_out
        else ""
    )
    weighing = ", each sequence of equal weight" if len(common_steps.sequences) > 1 else ""
    return (
        f"Replay of {names}: {plural(len(common_steps.sequence_of), 'step')}{weighing}, "
        f"{plural(len(common_steps.pooled), 'configuration')} in scaled units, "
        f"algorithmic time.{more}"
    )


def ratio_tables(
    common_steps: CommonSteps, baseline: PooledTimes, found: Sequence[Ratio]
) -> list[Table]:
    """The fastest right way of each solver against the baseline, and folded all other
    configurations."""
    first = _first_of_each(found)
    rest = [ratio for ratio in found if ratio not in first]
    title = f"Step times against {baseline.configuration.label}"
    tables = [_ratio_table(common_steps, title, first, len(found), folded=False)] if first else []
    if rest:
        tables.append(
            _ratio_table(common_steps, f"{title}: other ways", rest, len(found), folded=True),
        )
    return tables


def _first_of_each(found: Sequence[Ratio]) -> list[Ratio]:
    """Of each solver its fastest configuration, among those that meet the demand where there is
    one."""
    best: dict[str, Ratio] = {}
    for ratio in found:
        known = best.setdefault(ratio.pooled.configuration.solver, ratio)
        if ratio.pooled.right and not known.pooled.right:
            best[ratio.pooled.configuration.solver] = ratio
    return [ratio for ratio in found if best[ratio.pooled.configuration.solver] is ratio]


def _ratio_table(
    common_steps: CommonSteps, title: str, shown: Sequence[Ratio], comparisons: int, *, folded: bool
) -> Table:
    return Table(
        title=title,
        note=(
            f"{population(common_steps)} How many times as long a configuration takes per step: "
            "geometric mean of "
            f"the paired ratios. The intervals of all {plural(comparisons, 'comparison')} hold "
            "together with 95 % (Bonferroni; standard error by block bootstrap). Where one holds "
            "1 the two cannot be told apart. "
            f"{plural(len(shown), 'configuration')} shown here."
        ),
        heads=(
            "solver",
            "route",
            "policy",
            "settings",
            "answers meet the demand",
            "than the baseline",
            "ratio",
            "simultaneous interval",
            *_sequence_heads(common_steps.sequences),
            "common steps",
        ),
        rows=tuple(_ratio_row(ratio) for ratio in shown),
        text_columns=6,
        folded=folded,
    )


def _sequence_heads(names: Sequence[str]) -> tuple[str, ...]:
    """A column per sequence; of many sequences the extremes."""
    if len(names) > COLUMNS:
        return "least on a sequence", "most on a sequence"
    return tuple(f"on `{name}`" for name in names) if len(names) > 1 else ()


def _sequence_values(found: Sequence[float]) -> tuple[float, ...]:
    """The numbers below `_sequence_heads`."""
    if len(found) > COLUMNS:
        return float(np.fmin.reduce(found)), float(np.fmax.reduce(found))
    return tuple(found) if len(found) > 1 else ()


def _ratio_row(ratio: Ratio) -> tuple[Cell, ...]:
    configuration = ratio.pooled
    return row_of(
        configuration.configuration.solver,
        configuration.configuration.route,
        configuration.configuration.policy,
        configuration.configuration.settings,
        Cell("yes" if configuration.right else "no", "good" if configuration.right else "bad"),
        _order(ratio),
        significant(ratio.mean.value),
        interval_text(ratio.mean.low, ratio.mean.high),
        *(significant(value) for value in _sequence_values(ratio.per_sequence)),
        count_text(ratio.steps),
    )


def _order(ratio: Ratio) -> Cell:
    """Whether the configuration is slower or faster, and whether that is the same everywhere."""
    if isnan(ratio.mean.value):
        return Cell("not compared", "quiet")
    if ratio.mean.spans(1.0):
        return Cell("cannot be told apart", "warn")
    word = "slower" if ratio.mean.value > 1.0 else "faster"
    return Cell(f"{word}, not on every sequence", "warn") if ratio.turns else Cell(word)


def rank_table(common_steps: CommonSteps, ranking: Ranking, *, folded: bool) -> Table:
    """The places at one accuracy, the unstable ones marked with what other_ranks them."""
    penalty, shift = ranking.choice.penalty_ns, ranking.choice.shift_ns
    idle = (
        f" Not ranked, as no step is solved: {and_list(list(ranking.idle))}."
        if ranking.idle
        else ""
    )
    first = ranking.ranked[0].mean_ns if ranking.ranked else float("nan")
    return Table(
        title=f"Ranks at error_move ≤ {ranking.level:g}, by shifted geometric mean",
        note=(
            f"{population(common_steps)} {plural(len(ranking.ranked), 'solver')}, "
            "each in the way that "
            "leaves the least unsolved and then has the smallest mean. A step is unsolved if it "
            "failed, its answer is not true or its error_move is larger; it costs "
            f"{time_text(penalty)}, the deadline. Shift {time_text(shift)}: the median of the "
            "fastest configuration that solves every step. "
            f"Places were found again with {and_list([c.name for c in ranking.others])}; a place "
            f"that another choice changes is marked with what it becomes.{idle}"
        ),
        heads=(
            "place",
            "solver",
            "route",
            "policy",
            "settings",
            "place other_ranks to",
            "shifted mean [µs]",
            "to the first",
            "unsolved",
            "places",
        ),
        rows=tuple(
            _rank_row(ranked_configuration, first) for ranked_configuration in ranking.ranked
        ),
        text_columns=6,
        folded=folded,
    )


def _rank_row(ranked_configuration: Ranked, first: float) -> tuple[Cell, ...]:
    configuration = ranked_configuration.pooled
    ranks = [ranked_configuration.place, *ranked_configuration.other_places.values()]
    low, high = min(ranks), max(ranks)
    return row_of(
        Cell(
            str(ranked_configuration.place), "warn" if ranked_configuration.other_places else "good"
        ),
        configuration.configuration.solver,
        configuration.configuration.route,
        configuration.configuration.policy,
        configuration.configuration.settings,
        Cell(
            sensitivity_text(ranked_configuration),
            "warn" if ranked_configuration.other_places else "",
        ),
        micro_text(ranked_configuration.mean_ns),
        significant(ranked_configuration.mean_ns / first),
        share_text(ranked_configuration.unsolved),
        str(low) if low == high else f"{low}-{high}",
    )


def sensitivity_text(ranked_configuration: Ranked) -> str:
    """`3: shift × 10 and without paper; 5: penalty × 10`, or `stable`."""
    if not ranked_configuration.other_places:
        return "stable"
    by_place: dict[int, list[str]] = {}
    for name, place in ranked_configuration.other_places.items():
        by_place.setdefault(place, []).append(name)
    return "; ".join(f"{place}: {and_list(names)}" for place, names in sorted(by_place.items()))
