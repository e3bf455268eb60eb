"""Packed steps of every run, and the ship's track.

The track of a closed loop is stored as its distance from that of the run which follows the exactly
solved loop most closely: most ships sail the same line to a millimetre, and zeros pack to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpbench.analysis.records.kept_runs import FORCES, KeptRun, Track, share
from dpbench.arrays import Floats
from dpbench.report.page.pack import Block

TOLD_APART = (1e-3, 1e-3, 1e-4)
"""Of a track: 1 mm, and 0.006 degrees."""
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


@dataclass(frozen=True)
class Room:
    """How much of one run the page has room for: steps, and points of its track."""

    steps: int
    points: int

    @classmethod
    def of(cls, lengths: Sequence[int]) -> Room:
        """Share the page among runs of these lengths; short ones stay whole."""
        more = max(0, len(lengths) - MANY_RUNS)
        points = share(lengths, max(0, MOST_POINTS - POINTS_A_RUN * more))
        steps = share(lengths, max(0, MOST_STEPS - STEPS_A_RUN * more))
        return cls(steps, min(MOST_POINTS_EACH, points))


def pack_steps(block: Block, run: KeptRun) -> dict[str, int]:
    """Pack the steps of a run, element 0 for step `first`; steps not kept are missing."""
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


def pack_track(block: Block, track: Track, reference: Track | None) -> dict[str, Any]:
    """Pack a track, as its distance from `reference` where both keep the same steps."""
    position, force = track.position.copy(), track.force.copy()
    if reference is not None and reference.every == track.every:
        count = min(len(position), len(reference.position))
        position, force = position[:count], force[:count]
        position -= reference.position[:count]
        force -= reference.force[:count]
    return {
        "every": track.every,
        "x": [block.linear(position[:, i], s) for i, s in enumerate(TOLD_APART)],
        "u": [block.linear(force[:, i], FORCE_SHARE) for i in range(len(FORCES))],
    }
