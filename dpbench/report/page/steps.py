"""The steps of every run, packed: times, errors, iterations, active limits, and the ship's track.

The track of a closed loop is stored as its distance from that of the run which follows the exactly
solved loop most closely: most ships sail the same line to a millimetre, and zeros pack to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from dpbench.analysis.records.run_steps import MEASURES, Measure, RunSteps, hardest
from dpbench.analysis.records.thinning import kept, share
from dpbench.arrays import Flags, Floats
from dpbench.report.page.pack import Block

TRACK = {"n_m": 1e-3, "e_m": 1e-3, "psi_rad": 1e-4}
"""What is told apart of a track: 1 mm, and 0.006 degrees."""
FORCES = ("tau_x_N", "tau_y_N", "tau_n_Nm")
FORCE_SHARE = 1e-3
"""What is told apart of a force, as a share of its limit."""
FLAGS = ("claimed", "true", "failed", "late", "fallback", "clipped")
"""Bits of a step's flag, the lowest first; the one above them marks a step that a thinned run keeps
only since it is a hard one, so that it stands in no mean."""
MOST_STEPS, MOST_POINTS = 480_000, 240_000
"""So many steps and points of tracks the page has room for, all runs together."""
MOST_POINTS_EACH = 400
MANY_RUNS, STEPS_A_RUN, POINTS_A_RUN = 1000, 25, 12
"""Each run beyond so many takes the room of so many steps and points by being there."""
MOST_HARD = 15_000
"""So many hard steps the page lists, of all runs by all measures; five of each up to a thousand
runs, one at least."""


@dataclass(frozen=True, eq=False)
class Track:
    """Every `every`-th position (N, 3) [m, m, rad] and force (N, 3), a share of its limit."""

    every: int
    position: Floats
    force: Floats


@dataclass(frozen=True)
class Room:
    """How much of one run the page has room for: steps, and points of its track."""

    steps: int
    points: int

    @classmethod
    def of(cls, lengths: Sequence[int]) -> Room:
        """The room when runs of these lengths share the page; short ones stay whole."""
        more = max(0, len(lengths) - MANY_RUNS)
        points = share(lengths, max(0, MOST_POINTS - POINTS_A_RUN * more))
        steps = share(lengths, max(0, MOST_STEPS - STEPS_A_RUN * more))
        return cls(steps, min(MOST_POINTS_EACH, points))


class HardRow(NamedTuple):
    """A hard step: what was said of it there, and `value`, what makes it hard."""

    k: int
    value: float
    status: str
    claimed: bool
    true: bool
    n_active: int


@dataclass(frozen=True, eq=False)
class KeptRun:
    """What is kept of the steps of a run, however many it has.

    Parameters
    ----------
    steps : those that are kept; extra : (K,) which of them for being hard alone.
    last : the last step of the run, kept or not; is_whole : whether all are kept.
    hard : the hardest of all by each measure, the hardest first.
    track : None without a ship.
    """

    steps: RunSteps
    extra: Flags
    last: int
    is_whole: bool
    hard: dict[Measure, list[HardRow]]
    track: Track | None

    @classmethod
    def of(cls, run: RunSteps, most: int, track: Track | None = None) -> KeptRun:
        """Of a run of more than `most` steps it is thinned, see `kept`."""
        chosen, extra = kept(run, most)
        hard = {measure: _hard(run, measure) for measure in MEASURES}
        is_whole = len(chosen) == len(run.k)
        return cls(run.at(chosen), extra, int(run.k[-1]), is_whole, hard, track)


def _hard(run: RunSteps, measure: Measure) -> list[HardRow]:
    return [
        HardRow(
            int(run.k[hard.at]),
            hard.value,
            str(run.status[hard.at]),
            bool(run.claimed[hard.at]),
            bool(run.true[hard.at]),
            int(run.n_active[hard.at]),
        )
        for hard in hardest(run, measure)
    ]


def pack_steps(block: Block, run: KeptRun) -> dict[str, int]:
    """The steps of a run, as numbers of arrays in `block`, element 0 for step `first`; elements of
    steps that were not recorded, or not kept, are missing."""
    steps, first = run.steps, int(run.steps.k[0])
    count = run.last - first + 1
    # Of a whole run the places follow from the missing ones, which pack to nothing.
    at = None if run.is_whole else block.place(steps.k - first, count)

    def spread(values: Floats, missing: float = np.nan) -> Floats:
        if at is not None:
            return values
        out = np.full(count, missing)
        out[steps.k - first] = values
        return out

    flags = enumerate((*(getattr(steps, name) for name in FLAGS), run.extra))
    bits = np.sum([flag.astype(np.float64) * (1 << bit) for bit, flag in flags], axis=0)
    entry = {
        "first": first,
        "t": block.log(spread(steps.time_ns), at),
        "e": block.log(spread(steps.error), at),
        "i": block.count(spread(steps.iterations), at),
        "a": block.count(spread(steps.n_active), at),
        "f": block.flag(spread(bits, 0.0), at),
    }
    if steps.rounds > 1:
        entry["r"] = block.log(spread(steps.raw_ns), at)
    return entry


def track_of(steps: pd.DataFrame, limits: Floats, most: int) -> Track:
    """The track of a closed loop from its rows, at most `most` points; `limits` (3,) of the forces
    [N, N, N·m]."""
    every = max(1, -(-len(steps) // most))

    def thin(names: Iterable[str]) -> Floats:
        return np.column_stack([steps[n].to_numpy(dtype=np.float64)[::every] for n in names])

    return Track(every, thin(TRACK), thin(FORCES) / limits)


def pack_track(block: Block, track: Track, reference: Track | None) -> dict[str, Any]:
    """A track as numbers of arrays: its distance from `reference` where both keep the same steps,
    else as it is."""
    position, force = track.position.copy(), track.force.copy()
    if reference is not None and reference.every == track.every:
        count = min(len(position), len(reference.position))
        position, force = position[:count], force[:count]
        position -= reference.position[:count]
        force -= reference.force[:count]
    return {
        "every": track.every,
        "x": [block.linear(position[:, i], s) for i, s in enumerate(TRACK.values())],
        "u": [block.linear(force[:, i], FORCE_SHARE) for i in range(len(FORCES))],
    }
