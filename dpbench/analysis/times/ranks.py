"""Rankings by shifted geometric mean, performance profiles, and what makes a rank flip.

The mean is that of Mittelmann's benchmarks, exp(Σ w ln(t + s)) − s. A shift s of seconds turns it
into an arithmetic mean of microseconds, so s is on the scale of the data here. An unsolved step
costs a penalty, whose choice can decide a rank; so can the shift, and so can one sequence. Every
ranking is therefore made again with other choices, one at a time.

Performance profiles: Dolan & Moré, *Benchmarking optimization software with performance profiles*,
Mathematical Programming 91 (2002). A problem is a step here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from dpbench.analysis.demand import Demand
from dpbench.analysis.statistics import Floats
from dpbench.analysis.times.pooled import CommonSteps, PooledTimes

LEFT_OUT = math.nan
"""The penalty that leaves unsolved steps out."""


@dataclass(frozen=True)
class Choice:
    """What a ranking depends on: penalty and shift [ns], and the sequence left out (-1: none)."""

    name: str
    penalty_ns: float
    shift_ns: float
    without: int = -1


@dataclass(frozen=True)
class Ranked:
    """A configuration with its place.

    Parameters
    ----------
    mean_ns : shifted geometric mean; unsolved : weighted share of unsolved steps.
    place : its place; other_places : other places by the name of the choice that leads to them.
    """

    pooled: PooledTimes
    mean_ns: float
    unsolved: float
    place: int
    other_places: dict[str, int]


@dataclass(frozen=True)
class Ranking:
    """Solvers ranked at one accuracy, each in its best configuration there; `choice` ranks them.

    `others` are the choices it was made again with; `idle` are solvers without a solved step.
    """

    level: float
    choice: Choice
    others: tuple[Choice, ...]
    ranked: tuple[Ranked, ...]
    idle: tuple[str, ...]


def shifted_mean(
    time_ns: Floats, solved: NDArray[np.bool_], weights: Floats, choice: Choice
) -> float:
    """Shifted geometric mean [ns] of the step times, with the penalty on unsolved steps.

    Parameters
    ----------
    time_ns, solved, weights : (K,); weights sum to 1. With penalty `LEFT_OUT` the unsolved steps
        have no weight; infinite when nothing is left.
    """
    if math.isnan(choice.penalty_ns):
        weights = np.where(solved, weights, 0.0)
    total = float(weights.sum())
    if total == 0.0:
        return math.inf
    times = np.where(solved, time_ns, choice.penalty_ns)[weights > 0]
    logs = np.log(times + choice.shift_ns)
    return float(np.exp(weights[weights > 0] @ logs / total) - choice.shift_ns)


def weighted_median(values: Floats, weights: Floats) -> float:
    """The smallest value that half of the weight does not exceed; values (K,), weights (K,)."""
    order = np.argsort(values)
    running = np.cumsum(weights[order])
    # Sums of equal weights reach the half up to rounding only.
    at = int(np.searchsorted(running, (0.5 - 1e-12) * running[-1]))
    return float(values[order[min(at, len(order) - 1)]])


def scale_of(common_steps: CommonSteps, level: float) -> tuple[float, PooledTimes]:
    """Median step time of the fastest configuration, and its times: the natural shift of the data.

    The fastest by median among the configurations that solve every step; among all where none does.
    """
    pooled = common_steps.pooled
    able = (
        [times for times in pooled if times.solved(level).all()]
        or [times for times in pooled if np.isfinite(times.time_ns).all()]
        or list(pooled)
    )
    medians = [_median_of(times, common_steps.weights) for times in able]
    best = int(np.argmin(medians))
    return medians[best], able[best]


def _median_of(times: PooledTimes, weights: Floats) -> float:
    done = np.isfinite(times.time_ns)
    return weighted_median(times.time_ns[done], weights[done])


def best_configurations(
    common_steps: CommonSteps, level: float, choice: Choice
) -> list[PooledTimes]:
    """Of each solver the configuration that leaves the least unsolved, and of those the smallest
    mean.

    Solvers without a solved step are left out: a mean of penalties is no speed.
    """
    best: dict[str, tuple[tuple[float, float], PooledTimes]] = {}
    for times in common_steps.pooled:
        solved, solver = times.solved(level), times.configuration.solver
        if solved.any():
            mean_ns = shifted_mean(times.time_ns, solved, common_steps.weights, choice)
            score = _unsolved(common_steps, times, level), mean_ns
            if solver not in best or score < best[solver][0]:
                best[solver] = score, times
    return [times for _, times in best.values()]


def _unsolved(common_steps: CommonSteps, times: PooledTimes, level: float) -> float:
    return float(common_steps.weights[~times.solved(level)].sum())


def rank(common_steps: CommonSteps, level: float, demand: Demand) -> Ranking:
    """Rank the solvers at an accuracy, and mark the places that do not survive other choices."""
    shift_ns, _ = scale_of(common_steps, level)
    base = Choice("", demand.deadline_ns, shift_ns)
    pooled = best_configurations(common_steps, level, base)
    others = _others(common_steps, base, pooled)
    means_ns, places = _places(common_steps, level, pooled, base)
    moved = {other.name: _places(common_steps, level, pooled, other)[1] for other in others}
    ranked = [
        Ranked(
            times,
            means_ns[i],
            _unsolved(common_steps, times, level),
            places[i],
            {name: elsewhere[i] for name, elsewhere in moved.items() if elsewhere[i] != places[i]},
        )
        for i, times in enumerate(pooled)
    ]
    able = {times.configuration.solver for times in pooled}
    solvers = dict.fromkeys(times.configuration.solver for times in common_steps.pooled)
    return Ranking(
        level,
        base,
        tuple(others),
        tuple(sorted(ranked, key=lambda r: (r.place, r.pooled.configuration.solver))),
        tuple(solver for solver in solvers if solver not in able),
    )


def _others(common_steps: CommonSteps, base: Choice, pooled: Sequence[PooledTimes]) -> list[Choice]:
    """Every other choice, one change at a time."""
    p, s = base.penalty_ns, base.shift_ns
    longest_ns = max((float(np.nanmax(times.time_ns)) for times in pooled), default=p)
    without = common_steps.sequences if len(common_steps.sequences) > 1 else ()
    return [
        Choice("penalty × 10", 10.0 * p, s),
        Choice("penalty of the longest step", longest_ns, s),
        Choice("unsolved steps left out", LEFT_OUT, s),
        Choice("shift × 0.1", p, 0.1 * s),
        Choice("shift × 10", p, 10.0 * s),
        *(Choice(f"without `{name}`", p, s, i) for i, name in enumerate(without)),
    ]


def _places(
    common_steps: CommonSteps, level: float, pooled: Sequence[PooledTimes], choice: Choice
) -> tuple[list[float], list[int]]:
    """Means and places of the configurations by one choice; equal means share the better place."""
    weights = common_steps.weights_without(choice.without)
    means_ns = [
        shifted_mean(times.time_ns, times.solved(level), weights, choice) for times in pooled
    ]
    places = rankdata(means_ns, method="min").astype(int).tolist() if means_ns else []
    return means_ns, places


def profiles(
    common_steps: CommonSteps, pooled: Sequence[PooledTimes], level: float
) -> list[tuple[Floats, Floats]]:
    """Performance profile of each configuration: ratios to the fastest of `pooled` and the shares
    within them.

    Returns
    -------
    Per configuration (ratio (J,), share (J,)), ratios ascending from 1: the weighted share of all
    steps that it solves within so many times the time of the fastest configuration that solves
    them.
    """
    times_ns = np.array([np.where(times.solved(level), times.time_ns, np.inf) for times in pooled])
    best_ns = times_ns.min(axis=0) if len(pooled) else times_ns
    curves = []
    for own_ns in times_ns:
        solved = np.isfinite(own_ns)
        ratios = own_ns[solved] / best_ns[solved]
        order = np.argsort(ratios, kind="stable")
        curves.append((ratios[order], np.cumsum(common_steps.weights[solved][order])))
    return curves
