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
from dpbench.analysis.times.pooled import CommonSteps, PooledConfiguration

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
    rank : its place; other_ranks : other places by the name of the choice that leads to them.
    """

    configuration: PooledConfiguration
    mean_ns: float
    unsolved: float
    rank: int
    other_ranks: dict[str, int]


@dataclass(frozen=True)
class Ranking:
    """Solvers ranked at one accuracy, each in its best way there; `choice` ranks them.

    `others` are the choices it was made again with; `idle` are solvers without a solved step.
    """

    level: float
    choice: Choice
    others: tuple[Choice, ...]
    ranked_configuration: tuple[Ranked, ...]
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


def scale_of(common_steps: CommonSteps, level: float) -> tuple[float, PooledConfiguration]:
    """Median step time of the fastest configuration, and that configuration: the natural shift of
    the data.

    The fastest by median among the configurations that solve every step; among all where none does.
    """
    able = [
        configuration
        for configuration in common_steps.configurations
        if configuration.solved(level).all()
    ] or [
        configuration
        for configuration in common_steps.configurations
        if np.isfinite(configuration.time_ns).all()
    ]
    able = able or list(common_steps.configurations)
    medians = [_median_of(configuration, common_steps.weights) for configuration in able]
    best = int(np.argmin(medians))
    return medians[best], able[best]


def _median_of(configuration: PooledConfiguration, weights: Floats) -> float:
    done = np.isfinite(configuration.time_ns)
    return weighted_median(configuration.time_ns[done], weights[done])


def best_configurations(
    common_steps: CommonSteps, level: float, choice: Choice
) -> list[PooledConfiguration]:
    """The way of each solver that leaves the least unsolved, and of those the smallest mean.

    Solvers without a solved step are left out: a mean of penalties is no speed.
    """
    best: dict[str, tuple[tuple[float, float], PooledConfiguration]] = {}
    for configuration in common_steps.configurations:
        solved = configuration.solved(level)
        if solved.any():
            mean = shifted_mean(configuration.time_ns, solved, common_steps.weights, choice)
            found = (_unsolved(common_steps, configuration, level), mean), configuration
            if configuration.solver not in best or found[0] < best[configuration.solver][0]:
                best[configuration.solver] = found
    return [configuration for _, configuration in best.values()]


def _unsolved(common_steps: CommonSteps, configuration: PooledConfiguration, level: float) -> float:
    return float(common_steps.weights[~configuration.solved(level)].sum())


def rank(common_steps: CommonSteps, level: float, demand: Demand) -> Ranking:
    """Rank the solvers at an accuracy, and mark the places that do not survive other choices."""
    shift, _ = scale_of(common_steps, level)
    base = Choice("", demand.deadline_ns, shift)
    configurations = best_configurations(common_steps, level, base)
    others = _others(common_steps, base, configurations)
    means, places = _places(common_steps, level, configurations, base)
    moved = {other.name: _places(common_steps, level, configurations, other)[1] for other in others}
    ranked_configuration = [
        Ranked(
            configuration,
            means[i],
            _unsolved(common_steps, configuration, level),
            places[i],
            {name: found[i] for name, found in moved.items() if found[i] != places[i]},
        )
        for i, configuration in enumerate(configurations)
    ]
    able = {configuration.solver for configuration in configurations}
    idle = dict.fromkeys(
        configuration.solver
        for configuration in common_steps.configurations
        if configuration.solver not in able
    )
    ordered = sorted(ranked_configuration, key=lambda p: (p.rank, p.configuration.solver))
    return Ranking(level, base, tuple(others), tuple(ordered), tuple(idle))


def _others(
    common_steps: CommonSteps, base: Choice, configurations: Sequence[PooledConfiguration]
) -> list[Choice]:
    """Every other choice, one change at a time."""
    p, s = base.penalty_ns, base.shift_ns
    longest = max(
        (float(np.nanmax(configuration.time_ns)) for configuration in configurations), default=p
    )
    found = [
        Choice("penalty × 10", 10.0 * p, s),
        Choice("penalty of the longest step", longest, s),
        Choice("unsolved steps left out", LEFT_OUT, s),
        Choice("shift × 0.1", p, 0.1 * s),
        Choice("shift × 10", p, 10.0 * s),
    ]
    if len(common_steps.sequences) > 1:
        found += [
            Choice(f"without `{name}`", p, s, i) for i, name in enumerate(common_steps.sequences)
        ]
    return found


def _places(
    common_steps: CommonSteps,
    level: float,
    configurations: Sequence[PooledConfiguration],
    choice: Choice,
) -> tuple[list[float], list[int]]:
    """Means and places of the configurations by one choice; equal means share the better place."""
    weights = common_steps.weights_without(choice.without)
    means = [
        shifted_mean(configuration.time_ns, configuration.solved(level), weights, choice)
        for configuration in configurations
    ]
    places = rankdata(means, method="min").astype(int).tolist() if means else []
    return means, places


def profiles(
    common_steps: CommonSteps, configurations: Sequence[PooledConfiguration], level: float
) -> list[tuple[Floats, Floats]]:
    """Performance profile of each configuration: ratios to the fastest of `configurations` and the
    shares within them.

    Returns
    -------
    Per configuration (ratio (J,), share (J,)), ratios ascending from 1: the weighted share of all
    steps that it solves within so many times the time of the fastest configuration that solves
    them.
    """
    times = np.array(
        [
            np.where(configuration.solved(level), configuration.time_ns, np.inf)
            for configuration in configurations
        ]
    )
    best = times.min(axis=0) if len(configurations) else times
    found = []
    for row in times:
        solved = np.isfinite(row)
        ratios = row[solved] / best[solved]
        order = np.argsort(ratios, kind="stable")
        found.append((ratios[order], np.cumsum(common_steps.weights[solved][order])))
    return found
