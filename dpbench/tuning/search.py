"""Search by trials: a Sobol sample of all ranges, then batches near the best of them.

The options that are searched are each a coordinate of a unit cube.
"""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from scipy.stats import qmc

from dpbench.analysis.verdict.requirements import Finding
from dpbench.arrays import Matrix, Vector
from dpbench.errors import InputError, find_nearest_names
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import format_options_as_toml, parse_options_of_choice
from dpbench.solvers.settings import list_options_by_route
from dpbench.solvers.table import find_solver_record, list_all_solver_names

LOGARITHMIC_FROM = 20.0
"""A range whose ends differ by this factor is searched on a logarithmic scale."""
_NUMBERS = "two increasing numbers, such as [1e-3,10]"
_RANGE = "an option and two increasing numbers, such as 'rho=[1e-3,10]'"
_DIGITS = 3
_EDGE = 0.01
"""A value this near to an end is at the edge of its range [share of the range]."""
_WIDER = 100.0
"""Factor by which a wider range goes on, on a logarithmic scale."""
BATCH = 8
"""Trials of one batch, those of a solver interleaved; a power of two for Sobol."""
FIRST_RADIUS = 0.25
"""First distance of new points from the best, as a share of each range; halved where nothing is
gained."""

LimitedEnds = Literal["", "low", "high", "both"]
_Score = TypeVar("_Score")


@dataclass(frozen=True)
class OptionRange:
    """The least and the largest value of an option; whole numbers where both are.

    limited : the ends beyond which the method takes no value, or none much beyond.
    """

    name: str
    low: float
    high: float
    limited: LimitedEnds = ""

    @property
    def is_logarithmic(self) -> bool:
        """Return whether the range of an option is searched on a logarithmic scale."""
        return self.low > 0.0 and self.high >= LOGARITHMIC_FROM * self.low

    @property
    def is_whole(self) -> bool:
        """Return whether the option's values are whole numbers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def value_at(self, share: float) -> float:
        """Return the option's value at a share 0 to 1 of its range, to three significant digits."""
        if self.is_logarithmic:
            value = math.exp(math.log(self.low) + share * math.log(self.high / self.low))
        else:
            value = self.low + share * (self.high - self.low)
        if self.is_whole:
            return round(value)
        return min(max(_round_to_digits(value), self.low), self.high)

    def share_of(self, value: float) -> float:
        """Return the share of the range at which a value is, 0 or 1 for one outside."""
        inside = min(max(value, self.low), self.high)
        if self.is_logarithmic:
            return math.log(inside / self.low) / math.log(self.high / self.low)
        return (inside - self.low) / (self.high - self.low)

    def describe_edge(self, value: float) -> str:
        """Return a remark on a value at its range's edge, with a wider range; "" elsewhere."""
        share, width = self.share_of(value), self.high - self.low
        end = "high" if share > 0.5 else "low"
        if _EDGE < share < 1.0 - _EDGE or self.limited in (end, "both"):
            return ""
        low, high = self.low, self.high
        if end == "high":
            high = _round_to_digits(high * _WIDER) if self.is_logarithmic else high + width
        elif self.is_logarithmic and not self.is_whole:
            low = _round_to_digits(low / _WIDER)
        else:
            low = max(low - width, min(low, int(self.is_whole)))
            low = low if self.is_whole else _round_to_digits(low)
        if (low, high) == (self.low, self.high):
            return ""
        wider = format_options_as_toml({self.name: [low, round(high) if self.is_whole else high]})
        return f"{self.name} = {value:g}: widen it with --widen '{wider}'"


def _round_to_digits(value: float) -> float:
    """Return a number rounded to `_DIGITS` significant digits."""
    return float(f"{value:.{_DIGITS}g}")


@dataclass(frozen=True)
class SearchSpace:
    """The ranges of all options that are searched; a point is a share of each.

    fixed : options that are the same at every point.
    """

    ranges: tuple[OptionRange, ...]
    fixed: Options = field(default_factory=dict)

    def options_at(self, point: Vector) -> Options:
        """Return the solver options at a point of the unit cube."""
        searched = {
            own.name: own.value_at(share)
            for own, share in zip(self.ranges, point.tolist(), strict=True)
        }
        return {**self.fixed, **searched}

    def convert_to_range_types(self, options: Options) -> Options:
        """Return options whose numbers are of the type of their range, whole or not."""
        decimal = {own.name for own in self.ranges if not own.is_whole}
        return {
            name: float(value) if name in decimal and type(value) is int else value
            for name, value in options.items()
        }

    def point_of(self, options: Options) -> Vector:
        """Return the unit-cube point of some options, at the middle of a range without a value."""
        values = ((own, options.get(own.name)) for own in self.ranges)
        return np.array(
            [own.share_of(v) if isinstance(v, int | float) else 0.5 for own, v in values]
        )

    def describe_edges(self, options: Options) -> list[str]:
        """Return a remark on each option at the edge of its range, with a wider range."""
        values = ((own, options.get(own.name)) for own in self.ranges)
        texts = (own.describe_edge(v) for own, v in values if isinstance(v, int | float))
        return [text for text in texts if text]


def make_space(
    solver: str, ranges: Sequence[str] = (), widened: Sequence[str] = (), own: Options | None = None
) -> SearchSpace:
    """Return the option ranges to search for a solver: the stated ones, or those given instead.

    ranges : texts such as `rho=[1e-3,10]`, in place of all stated ranges.
    widened : such texts beside the others, or in place of that of the same option.
    own : the user's options; those that are not searched are fixed.

    Raises
    ------
    UnknownNameError : there is no such solver.
    InputError : for a text that is no range, or a solver without stated ranges and none given.
    """
    record = find_solver_record(solver)
    found: dict[str, OptionRange] = {}
    if not ranges:
        stated = _read_stated_ranges()
        usual = stated.get(solver) or stated.get(record.module)
        if usual is None and not widened:
            names = list_all_solver_names()
            ranged = [n for n in names if {n, find_solver_record(n).module} & stated.keys()]
            nearest = ", ".join(find_nearest_names(solver, ranged))
            which = "no options to tune"
            allowed = f"a solver with predefined ranges, such as {nearest}"
            if record.extra == "plugin" or any(list_options_by_route(solver).values()):
                which, allowed = "no predefined range", f"--range 'OPTION=[MIN,MAX]', or {allowed}"
            raise InputError("tune-solver", "", f"{solver}, which has {which}", allowed)
        found = {name: OptionRange(name, *ends) for name, ends in (usual or {}).items()}
    for option, texts in (("--range", ranges), ("--widen", widened)):
        for text in texts:
            try:
                given = parse_options_of_choice(f"{solver}[{text}]")
            except InputError as error:
                raise InputError(option, "", repr(text)[:80], _RANGE) from error
            for name, ends in given.items():
                limited = found[name].limited if name in found else ""
                found[name] = replace(_parse_range(option, name, ends), limited=limited)
    fixed = {name: value for name, value in (own or {}).items() if name not in found}
    return SearchSpace(tuple(found.values()), fixed)


def _parse_range(option: str, name: str, ends: object) -> OptionRange:
    """Return a range from a list of two numbers; InputError for anything else."""
    numbers = ends if isinstance(ends, list) else []
    known = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    if len(numbers) != 2 or not known or not -math.inf < numbers[0] < numbers[1] < math.inf:
        raise InputError(option, name, repr(ends), _NUMBERS)
    return OptionRange(name, *numbers)


@cache
def _read_stated_ranges() -> dict[str, dict[str, list[Any]]]:
    """Read the ranges of all solvers' settings that a search tries."""
    return tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Score:
    """Worth of settings on a set of sequences, lower is better.

    wrong : sequences on which the accuracy requirement is missed.
    excess : log10 of error over requirement, summed over these; a failure counts `FAILED`.
    ratio : geometric mean over the sequences of step time over that of the default settings.
    late : the finding on each sequence whose step times are above a limit.
    """

    wrong: int
    excess: float
    ratio: float
    late: tuple[Finding, ...] = ()

    @property
    def is_right(self) -> bool:
        """Return whether every step of every sequence was solved within the requirement."""
        return self.wrong == 0

    @property
    def key(self) -> tuple[int, int, float]:
        """Sort key: right before wrong, in time before late; then by step time or excess.

        Wrong settings rank by the size of the error, late ones by that of the times above a limit.
        """
        if not self.is_right:
            return (self.wrong, 0, self.excess)
        if self.late:
            above = sum(math.log10(finding.value / finding.limit) for finding in self.late)
            return (0, len(self.late), above)
        return (0, 0, self.ratio if math.isfinite(self.ratio) else math.inf)


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

    def run(self, trials: int, given: Sequence[Options] = ()) -> None:
        """Try so many options, half of them spread, others near the best; store all in `trials`.

        given : options that are tried with the first batch, beside the others.
        """
        sizes = split_into_batches(trials)
        spread = math.ceil(len(sizes) / 2)
        dimensions = len(self._space.ranges)
        sample = qmc.Sobol(dimensions, seed=self._rng)
        first = [(options, self._space.point_of(options)) for options in given]
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
        """Evaluate given options and those at some points, unless tried; add them to `trials`."""
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
