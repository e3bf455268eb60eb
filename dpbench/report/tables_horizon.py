"""Tables of the horizon sweep: times at each horizon, growth, crossover, what fits a deadline."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.times.growth import LEAST_POINTS, Crossover, crossover
from dpbench.analysis.times.horizon_sweep import Point, Sweep, SweptConfiguration, moves_of
from dpbench.bench.judge.rules import supports
from dpbench.report.formats import (
    MISSING,
    count_text,
    interval_text,
    micro_text,
    plural,
    significant,
)
from dpbench.report.table import Cell, Table, row_of
from dpbench.report.time_marks import marks_legend, timed_name
from dpbench.scenario.horizons import Horizons

SPARSE = "sparse"
LIMITS_MS = (1.0, 10.0, 100.0)
UNSETTLED = "?"
"""Beside horizons that another draw of the steps may change."""
MISSED = "○"
"""Beside a time whose answers miss the demand; such a point is hollow in the figure."""


def horizons_text(horizons: Horizons) -> str:
    """`60/10`."""
    return f"{horizons[0]}/{horizons[1]}"


def growth_table(
    sweep: Sweep, configurations: Sequence[SweptConfiguration], *, every: bool = False
) -> Table:
    """One row per configuration; `every` gives the folded table of all ways to run a solver."""
    compared = any(
        configuration.configuration.formulation == SPARSE for configuration in sweep.swept
    )
    which = "every way" if every else "the best way of each solver"
    return Table(
        title=f"Growth over the horizons of `{sweep.name}`, {which}",
        note=_note(sweep, len(configurations), compared=compared)
        + marks_legend(row for configuration in configurations for row in configuration.runs),
        heads=(
            "solver",
            "formulation",
            "way",
            *(f"n = {moves_of(h)} ({horizons_text(h)}) [µs]" for h in sweep.horizons),
            "exponent",
            "95 %",
            "points",
            "line off by",
            *(("sparse undercuts condensed",) if compared else ()),
            *(f"p99 ≤ {limit:g} ms" for limit in LIMITS_MS if supports(sweep.steps, 99)),
        ),
        rows=tuple(
            _row(sweep, configuration, compared=compared) for configuration in configurations
        ),
        text_columns=3,
        folded=every,
    )


def _note(sweep: Sweep, rows: int, *, compared: bool) -> str:
    meets = (
        "Sparse undercuts condensed: the n from which the fitted line of the sparse form is below "
        "that of the same solver's best condensed way, within the sizes measured. "
        if compared
        else ""
    )
    fits = (
        "p99: the largest horizon measured whose answers meet the demand and whose p99 is within "
        "the limit; ≥ where none longer was measured to its end, "
        f"{UNSETTLED} where the 95 % interval of a p99 holds the limit."
        if supports(sweep.steps, 99)
        else f"{plural(sweep.steps, 'step')} do not support a p99 (it takes 1000), so what fits a "
        "deadline is not said here."
    )
    return (
        f"{plural(rows, 'row')}; replay of identical QPs at each of "
        f"{plural(len(sweep.horizons), 'horizon')}, {plural(sweep.steps, 'step')} each; median "
        "over steps of the algorithmic step time. n counts the moves, whatever else a form adds. "
        f"{MISSED}: an answer misses the demand. Exponent: slope of log time on log n, "
        "least squares over the points with a time, 95 % interval by block bootstrap over "
        f"steps; none below {LEAST_POINTS} sizes. Line off by: the largest factor between a "
        "point and the fitted line; where it is large, time grows by no single power and the "
        f"exponent is an average. {meets}{fits}"
    )


def _row(sweep: Sweep, configuration: SweptConfiguration, *, compared: bool) -> tuple[Cell, ...]:
    growth = configuration.growth
    if growth is None:
        exponent, off = row_of(MISSING, MISSING), MISSING
    else:
        off = f"× {significant(growth.misfit)}"
        found = growth.exponent
        exponent = row_of(
            Cell(significant(found.value), "" if configuration.right else "quiet"),
            interval_text(found.low, found.high),
        )
    return row_of(
        timed_name(configuration.runs[0]),
        configuration.configuration.formulation.replace("_", " "),
        configuration.configuration.options,
        *(_time(configuration.points.get(horizons)) for horizons in sweep.horizons),
        *exponent,
        count_text(len(configuration.timed)),
        off,
        *((_undercuts(sweep, configuration),) if compared else ()),
        *(_within(configuration, limit) for limit in LIMITS_MS if supports(sweep.steps, 99)),
    )


def _time(point: Point | None) -> Cell:
    if point is None:
        return Cell(MISSING, "quiet")
    if point.times is None:
        return Cell(point.run.outcome.replace("_", " "), "bad")
    text = micro_text(point.median_ns)
    return Cell(text) if point.right else Cell(f"{text} {MISSED}", "warn")


def _within(configuration: SweptConfiguration, limit_ms: float) -> Cell:
    if not any(math.isfinite(point.p99_ns) for point in configuration.timed.values()):
        return Cell(MISSING, "quiet")
    largest = configuration.largest_within(limit_ms * 1e6)
    doubt = "" if configuration.settled(limit_ms * 1e6) else f" {UNSETTLED}"
    if largest is None:
        return Cell(f"none{doubt}", "quiet")
    least = "" if configuration.measured_beyond(largest) else "≥ "
    return Cell(f"{least}{horizons_text(largest)}{doubt}")


def _undercuts(sweep: Sweep, configuration: SweptConfiguration) -> Cell:
    if configuration.configuration.formulation != SPARSE:
        return Cell("")
    other = condensed_of(sweep, configuration)
    found = crossover(configuration.growth, other.growth) if other is not None else None
    if found is None:
        return Cell(MISSING, "quiet")
    return Cell(crossover_text(found))


def condensed_of(sweep: Sweep, configuration: SweptConfiguration) -> SweptConfiguration | None:
    """The best condensed way of the same solver; None where it was never given that form."""
    mine = (
        a
        for a in sweep.best
        if a.configuration.solver == configuration.configuration.solver
        and a.configuration.formulation != SPARSE
    )
    return next(mine, None)


def crossover_text(found: Crossover) -> str:
    """Where the sparse line is the lower one, in a few words."""
    low, high = f"{found.n_low:g}", f"{found.n_high:g}"
    if found.faster_low and found.faster_high:
        return f"at every n from {low} to {high}"
    if found.faster_high:
        return f"from n = {found.n:.0f}"
    if found.faster_low:
        return f"up to n = {found.n:.0f} only"
    return f"none up to n = {high}"
