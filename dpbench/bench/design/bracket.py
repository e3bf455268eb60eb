"""Find the edge of a set of offsets by doubling, then bisection.

every offset of the grid is tried; between the last that holds and the first that does not:
try ½(holds + fails)   until   fails − holds ≤ width · fails
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["holds", "fails", "undecided"]
Side = Literal["both", "starboard", "port"]


@dataclass(frozen=True)
class Trial:
    """One offset [m] and what became of it; `side` is where it was decided."""

    offset_m: float
    verdict: Verdict
    side: Side = "both"


@dataclass(frozen=True)
class Bracket:
    """The edge of what holds.

    Parameters
    ----------
    holds_m : everything tried up to here holds; 0 when the smallest offset tried does not.
    fails_m : the smallest offset tried that does not hold; None when all of them do.
    above_m : offsets beyond it that hold again.
    tried : all trials by offset.
    """

    holds_m: float
    fails_m: float | None
    above_m: tuple[float, ...]
    tried: tuple[Trial, ...]

    @property
    def largest_m(self) -> float:
        """Upper end of the search."""
        return self.tried[-1].offset_m

    @property
    def edge(self) -> Trial | None:
        """The trial at `fails_m`."""
        return next((trial for trial in self.tried if trial.offset_m == self.fails_m), None)


def bracket_of(trials: Iterable[Trial]) -> Bracket:
    """The edge that some trials show."""
    tried = tuple(sorted(trials, key=lambda trial: trial.offset_m))
    fails = next((trial.offset_m for trial in tried if trial.verdict != "holds"), None)
    holds = [trial.offset_m for trial in tried if trial.verdict == "holds"]
    if fails is None:
        return Bracket(max(holds, default=0.0), None, (), tried)
    below = max((offset for offset in holds if offset < fails), default=0.0)
    return Bracket(below, fails, tuple(offset for offset in holds if offset > fails), tried)


def find_edge(attempt: Callable[[float], Trial], grid: Sequence[float], width: float) -> Bracket:
    """Try the whole grid, then narrow the lowest edge down.

    Parameters
    ----------
    attempt : tries one offset.
    grid : rising offsets. All are tried, so that one that holds beyond one that fails is seen.
    width : of the bracket, relative to its upper end. It is not reached when the lowest offset of
        the grid fails, as then nothing is known to hold.
    """
    trials = [attempt(offset) for offset in grid]
    found = bracket_of(trials)
    while found.fails_m is not None and 0.0 < found.holds_m < (1.0 - width) * found.fails_m:
        trials.append(attempt(0.5 * (found.holds_m + found.fails_m)))
        found = bracket_of(trials)
    return found
