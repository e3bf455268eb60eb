"""The options of a solver that are searched, and the point of each in a unit cube."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dpbench.arrays import Vector
from dpbench.errors import InputError
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import parse_choice
from dpbench.solvers.table import find_record

LOGARITHMIC_FROM = 20.0
"""A range whose ends differ by this factor is searched on a logarithmic scale."""
_DIGITS = 3


@dataclass(frozen=True)
class OptionRange:
    """The least and the largest value of an option; whole numbers where both are."""

    name: str
    low: float
    high: float

    def value_at(self, share: float) -> float:
        """Return the value at a share of the range from 0 to 1, to three significant digits."""
        if self.low > 0.0 and self.high >= LOGARITHMIC_FROM * self.low:
            value = math.exp(math.log(self.low) + share * math.log(self.high / self.low))
        else:
            value = self.low + share * (self.high - self.low)
        if isinstance(self.low, int) and isinstance(self.high, int):
            return round(value)
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)


@dataclass(frozen=True)
class SearchSpace:
    """The ranges of all options that are searched; a point is a share of each."""

    ranges: tuple[OptionRange, ...]

    def options_at(self, point: Vector) -> Options:
        """Return the solver options at a point of the unit cube."""
        return {
            own.name: own.value_at(share)
            for own, share in zip(self.ranges, point.tolist(), strict=True)
        }


def make_space(solver: str, ranges: Sequence[str] = ()) -> SearchSpace:
    """Return the option ranges to search for a solver: the stated ones, or those given instead.

    ranges : texts such as `rho=[1e-3,10]`.

    Raises
    ------
    UnknownNameError : there is no such solver.
    InputError : for a text that is no range, or a solver without stated ranges and none given.
    """
    record = find_record(solver)
    if not ranges:
        stated = _stated_ranges()
        found = stated.get(solver) or stated.get(record.module)
        if found is None:
            allowed = f"one of {', '.join(sorted(stated))}; or --range 'OPTION=[LEAST,LARGEST]'"
            raise InputError("tune-solver", "", f"{solver}, which has no stated range", allowed)
        return SearchSpace(tuple(OptionRange(name, *ends) for name, ends in found.items()))
    merged: dict[str, Any] = {}
    for text in ranges:
        merged |= parse_choice(f"{solver}[{text}]")
    return SearchSpace(tuple(_check_range(name, ends) for name, ends in merged.items()))


def _check_range(name: str, ends: object) -> OptionRange:
    """Return a range from a list of two numbers; InputError for anything else."""
    numbers = ends if isinstance(ends, list) else []
    known = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    if len(numbers) != 2 or not known or not -math.inf < numbers[0] < numbers[1] < math.inf:
        raise InputError("--range", name, repr(ends), "two numbers that grow, such as [1e-3,10]")
    return OptionRange(name, *numbers)


@cache
def _stated_ranges() -> dict[str, dict[str, list[float]]]:
    """Read the ranges of all solvers' settings that a search tries."""
    return tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))
