"""Search by trials: a Sobol sample of all ranges, then batches near the best of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from scipy.stats import qmc

from dpbench.arrays import Matrix, Vector
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.space import SearchSpace

BATCH = 8
"""Trials of one batch, those of a solver timed by turns; a power of two for Sobol."""
FIRST_RADIUS = 0.25
"""First distance of new points from the best, as a share of each range; halved where nothing is
gained."""

_Score = TypeVar("_Score")


@dataclass(frozen=True)
class Score:
    """Worth of settings on a set of sequences, lower is better.

    wrong : sequences on which the accuracy requirement is missed.
    excess : log10 of error over requirement, summed over these; a failure counts `FAILED`.
    ratio : geometric mean over the sequences of step time over that of the default settings.
    """

    wrong: int
    excess: float
    ratio: float

    @property
    def is_right(self) -> bool:
        """Return whether every step of every sequence was solved within the requirement."""
        return self.wrong == 0

    @property
    def key(self) -> tuple[int, float]:
        """Sort key: right before wrong, then by time or by the size of the error."""
        time = self.ratio if math.isfinite(self.ratio) else math.inf
        return (self.wrong, time if self.is_right else self.excess)


@dataclass(frozen=True)
class Trial(Generic[_Score]):
    """Options that were tried, their point in the unit cube and their score."""

    options: Options
    point: Vector = field(repr=False, compare=False)
    score: _Score

    @property
    def name(self) -> str:
        """Name of the trial: its options as text."""
        return format_options_as_toml(self.options)


Evaluate = Callable[[Sequence[Options]], Sequence[_Score]]
"""Scores of several options, measured side by side."""
Choose = Callable[[Sequence[Trial[_Score]]], Sequence[Trial[_Score]]]
"""The best of the trials so far, near which the next ones are drawn."""


def split_into_batches(trials: int) -> list[int]:
    """Return the sizes of the batches of a search: two or more, each of at most `BATCH`.

    Of up to `BATCH` trials one half is a batch of its own, so that these, too, go near the best.
    """
    first = -(-trials // 2) if trials <= BATCH else BATCH
    return [min(first, trials - done) for done in range(0, trials, first)]


class TrialSearch(Generic[_Score]):
    """A search with a budget of trials; the first half of them spread over all ranges.

    `trials` are in the order of trial; equal options are tried once. `drawn` counts the options of
    all batches that were evaluated, equal ones and without those given.
    """

    def __init__(
        self, space: SearchSpace, evaluate: Evaluate[_Score], choose: Choose[_Score], seed: int
    ) -> None:
        self._space, self._evaluate, self._choose = space, evaluate, choose
        self._rng = np.random.default_rng(seed)
        self.trials: list[Trial[_Score]] = []
        self.drawn = 0

    def run(self, trials: int, start: Options | None = None) -> None:
        """Try so many options: a half of the batches spread, the others near the best.

        start : options that are tried with the first batch, beside the others.
        """
        sizes = split_into_batches(trials)
        spread = math.ceil(len(sizes) / 2)
        dimensions = len(self._space.ranges)
        sample = qmc.Sobol(dimensions, seed=self._rng)
        first = [] if start is None else [(start, self._space.point_of(start))]
        for size in sizes[:spread]:
            self._try_points(sample.random(BATCH)[:size], first)
        radius = FIRST_RADIUS
        for size in sizes[spread:]:
            before = self._choose(self.trials)
            centres = np.array([before[i % len(before)].point for i in range(size)])
            near = qmc.Sobol(dimensions, seed=self._rng).random(BATCH)[:size]
            self._try_points(np.clip(centres + radius * (2.0 * near - 1.0), 0.0, 1.0))
            if self._choose(self.trials) == before:
                radius /= 2.0

    def _try_points(self, points: Matrix, given: Sequence[tuple[Options, Vector]] = ()) -> None:
        """Evaluate options that are given and those at some points, except what was tried."""
        known = {trial.name for trial in self.trials}
        new: dict[str, tuple[Options, Vector]] = {}
        for options, point in [*given, *((self._space.options_at(p), p) for p in points)]:
            name = format_options_as_toml(options)
            if name not in known:
                new.setdefault(name, (options, point))
        if new:
            scores = self._evaluate([options for options, _ in new.values()])
            self.trials += [
                Trial(options, point, score)
                for (options, point), score in zip(new.values(), scores, strict=True)
            ]
        self.drawn += len(points)


class SettingsSearch(TrialSearch[Score]):
    """A search for the settings of a solver, near the one best of them."""

    def __init__(self, space: SearchSpace, evaluate: Evaluate[Score], seed: int) -> None:
        super().__init__(space, evaluate, lambda trials: [find_best(trials)], seed)

    @property
    def best(self) -> Trial[Score]:
        """The best trial of the search so far; ValueError before the first."""
        return find_best(self.trials)


def find_best(trials: Sequence[Trial[Score]]) -> Trial[Score]:
    """Return the trial with the best score, the first of equal ones."""
    return min(trials, key=lambda trial: trial.score.key)
