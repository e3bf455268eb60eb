"""Search for the settings of a solver: a Sobol sample of all ranges, then batches near the best."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import qmc

from dpbench.arrays import Matrix, Vector
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import describe_options
from dpbench.tuning.space import SearchSpace

BATCH = 8
"""Trials that are timed by turns, beside the default settings; a power of two for Sobol."""
FIRST_RADIUS = 0.25
"""Of the first batch near the best, as a share of each range; halved where nothing is gained."""


@dataclass(frozen=True)
class Score:
    """Worth of settings on a set of sequences, lower is better.

    wrong : sequences on which the accuracy requirement is missed.
    excess : log10 of error over requirement, summed over these; a failure counts `FAILED`.
    ratio : geometric mean over the sequences of p99 step time over that of the default settings.
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
class Trial:
    """Settings that were tried, their point in the unit cube and their score."""

    options: Options
    point: Vector = field(repr=False)
    score: Score

    @property
    def name(self) -> str:
        """The options as text."""
        return describe_options(self.options)


Evaluate = Callable[[Sequence[Options]], Sequence[Score]]
"""Scores of several settings, measured side by side."""


class SettingsSearch:
    """A search with a budget of trials; the first half of them spread over all ranges.

    `trials` are in the order of trial; equal settings are tried once.
    """

    def __init__(self, space: SearchSpace, evaluate: Evaluate, seed: int) -> None:
        self._space, self._evaluate = space, evaluate
        self._rng = np.random.default_rng(seed)
        self.trials: list[Trial] = []

    @property
    def best(self) -> Trial | None:
        """The best trial so far; None before the first."""
        return min(self.trials, key=lambda trial: trial.score.key, default=None)

    def run(self, batches: int) -> None:
        """Try so many batches of settings: a half of them spread, the others near the best."""
        spread = math.ceil(batches / 2)
        dimensions = len(self._space.ranges)
        sample = qmc.Sobol(dimensions, seed=self._rng)
        for _ in range(spread):
            self._try_points(sample.random(BATCH))
        radius = FIRST_RADIUS
        for _ in range(batches - spread):
            before = self.best
            assert before is not None
            near = qmc.Sobol(dimensions, seed=self._rng).random(BATCH)
            self._try_points(np.clip(before.point + radius * (2.0 * near - 1.0), 0.0, 1.0))
            if self.best is before:
                radius /= 2.0

    def _try_points(self, points: Matrix) -> None:
        """Evaluate the settings at some points, except those that were tried."""
        known = {trial.name for trial in self.trials}
        new: dict[str, tuple[Options, Vector]] = {}
        for point in points:
            options = self._space.options_at(point)
            name = describe_options(options)
            if name not in known:
                new.setdefault(name, (options, point))
        if not new:
            return
        scores = self._evaluate([options for options, _ in new.values()])
        self.trials += [
            Trial(options, point, score)
            for (options, point), score in zip(new.values(), scores, strict=True)
        ]
