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
from dpbench.analysis.times.pooled import Arm, Pool

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
class Placed:
    """An arm with its place.

    Parameters
    ----------
    mean_ns : shifted geometric mean; unsolved : weighted share of unsolved steps.
    rank : its place; flips : other places by the name of the choice that leads to them.
    """

    arm: Arm
    mean_ns: float
    unsolved: float
    rank: int
    flips: dict[str, int]


@dataclass(frozen=True)
class Ranking:
    """Solvers ranked at one accuracy, each in its best way there; `choice` ranks them.

    `others` are the choices it was made again with; `idle` are solvers without a solved step.
    """

    level: float
    choice: Choice
    others: tuple[Choice, ...]
    placed: tuple[Placed, ...]
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


def scale_of(pool: Pool, level: float) -> tuple[float, Arm]:
    """Median step time of the fastest arm, and that arm: the natural shift of the data.

    The fastest by median among the arms that solve every step; among all where none does.
    """
    able = [arm for arm in pool.arms if arm.solved(level).all()] or [
        arm for arm in pool.arms if np.isfinite(arm.time_ns).all()
    ]
    able = able or list(pool.arms)
    medians = [_median_of(arm, pool.weights) for arm in able]
    best = int(np.argmin(medians))
    return medians[best], able[best]


def _median_of(arm: Arm, weights: Floats) -> float:
    done = np.isfinite(arm.time_ns)
    return weighted_median(arm.time_ns[done], weights[done])


def best_ways(pool: Pool, level: float, choice: Choice) -> list[Arm]:
    """The way of each solver that leaves the least unsolved, and of those the smallest mean.

    Solvers without a solved step are left out: a mean of penalties is no speed.
    """
    best: dict[str, tuple[tuple[float, float], Arm]] = {}
    for arm in pool.arms:
        solved = arm.solved(level)
        if solved.any():
            mean = shifted_mean(arm.time_ns, solved, pool.weights, choice)
            found = (_unsolved(pool, arm, level), mean), arm
            if arm.solver not in best or found[0] < best[arm.solver][0]:
                best[arm.solver] = found
    return [arm for _, arm in best.values()]


def _unsolved(pool: Pool, arm: Arm, level: float) -> float:
    return float(pool.weights[~arm.solved(level)].sum())


def rank(pool: Pool, level: float, demand: Demand) -> Ranking:
    """Rank the solvers at an accuracy, and mark the places that do not survive other choices."""
    shift, _ = scale_of(pool, level)
    base = Choice("", demand.deadline_ns, shift)
    arms = best_ways(pool, level, base)
    others = _others(pool, base, arms)
    means, places = _places(pool, level, arms, base)
    moved = {other.name: _places(pool, level, arms, other)[1] for other in others}
    placed = [
        Placed(
            arm,
            means[i],
            _unsolved(pool, arm, level),
            places[i],
            {name: found[i] for name, found in moved.items() if found[i] != places[i]},
        )
        for i, arm in enumerate(arms)
    ]
    able = {arm.solver for arm in arms}
    idle = dict.fromkeys(arm.solver for arm in pool.arms if arm.solver not in able)
    ordered = sorted(placed, key=lambda p: (p.rank, p.arm.solver))
    return Ranking(level, base, tuple(others), tuple(ordered), tuple(idle))


def _others(pool: Pool, base: Choice, arms: Sequence[Arm]) -> list[Choice]:
    """Every other choice, one change at a time."""
    p, s = base.penalty_ns, base.shift_ns
    longest = max((float(np.nanmax(arm.time_ns)) for arm in arms), default=p)
    found = [
        Choice("penalty × 10", 10.0 * p, s),
        Choice("penalty of the longest step", longest, s),
        Choice("unsolved steps left out", LEFT_OUT, s),
        Choice("shift × 0.1", p, 0.1 * s),
        Choice("shift × 10", p, 10.0 * s),
    ]
    if len(pool.sequences) > 1:
        found += [Choice(f"without `{name}`", p, s, i) for i, name in enumerate(pool.sequences)]
    return found


def _places(
    pool: Pool, level: float, arms: Sequence[Arm], choice: Choice
) -> tuple[list[float], list[int]]:
    """Means and places of the arms by one choice; equal means share the better place."""
    weights = pool.weights_without(choice.without)
    means = [shifted_mean(arm.time_ns, arm.solved(level), weights, choice) for arm in arms]
    places = rankdata(means, method="min").astype(int).tolist() if means else []
    return means, places


def profiles(pool: Pool, arms: Sequence[Arm], level: float) -> list[tuple[Floats, Floats]]:
    """Performance profile of each arm: ratios to the fastest of `arms` and the shares within them.

    Returns
    -------
    Per arm (ratio (J,), share (J,)), ratios ascending from 1: the weighted share of all steps
    that it solves within so many times the time of the fastest arm that solves them.
    """
    times = np.array([np.where(arm.solved(level), arm.time_ns, np.inf) for arm in arms])
    best = times.min(axis=0) if len(arms) else times
    found = []
    for row in times:
        solved = np.isfinite(row)
        ratios = row[solved] / best[solved]
        order = np.argsort(ratios, kind="stable")
        found.append((ratios[order], np.cumsum(pool.weights[solved][order])))
    return found
