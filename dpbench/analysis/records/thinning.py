"""Less of long runs, without losing what a picture of them is looked at for."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dpbench.analysis.records.run_steps import MEASURES, RunSteps, hardest
from dpbench.arrays import Flags, Floats, Ints

WORST = 200
"""So many hard steps of a thinned run are kept, at most a third of what is kept of it."""
MOST = 2000
"""So many points of a run a figure draws: four and more a pixel."""


def share(lengths: Sequence[int], most: int) -> int:
    """The largest number at which as much of each length adds up to `most`, or less."""
    shortest_first, rest = sorted(lengths), most
    for i, length in enumerate(shortest_first):
        share = rest // (len(shortest_first) - i)
        if length > share:
            return max(1, share)
        rest -= length
    return max(shortest_first, default=1)


def kept(run: RunSteps, most: int) -> tuple[Ints, Flags]:
    """Which steps of a run are kept, about `most`, rising; and which of them for being hard alone.

    Of a longer run every so manieth stays, and of the rest the hardest by each measure.
    """
    count = len(run.k)
    if count <= most:
        return np.arange(count), np.zeros(count, dtype=np.bool_)
    worst = min(WORST, most // 3)
    each = max(1, worst // len(MEASURES))
    regular = np.arange(0, count, -(-count // max(1, most - worst)))
    hard = [step.at for measure in MEASURES for step in hardest(run, measure, each)]
    both = np.union1d(regular, np.array(hard, dtype=np.int64))
    return both, ~np.isin(both, regular)


def extremes(values: Floats, most: int = MOST) -> Ints:
    """(M,) places of the values to draw, rising: all, or of equal parts the least and largest.

    No more than `most`, of which a line of a few hundred pixels shows no difference.
    """
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(np.int64)
    known = np.nan_to_num(values)
    places = [
        a + extreme(known[a:b]) for a, b in pairwise(edges) for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(places)
