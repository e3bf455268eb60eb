"""The steps of every run, packed: times, errors, iterations, active limits, and the ship's track.

The track of a closed loop is stored as its distance from that of the run which follows the exactly
solved loop most closely: most ships sail the same line to a millimetre, and zeros pack to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dpbench.analysis.records.counting_rows import Floats
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.analysis.records.thinning import kept, share
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
        return cls(share(lengths, MOST_STEPS), min(MOST_POINTS_EACH, share(lengths, MOST_POINTS)))


def pack_steps(block: Block, run: RunSteps, most: int) -> dict[str, int]:
    """The steps of a run, as numbers of arrays in `block`, element 0 for step `first`.

    A run of more than `most` steps is thinned, see `kept`; what is left out packs to nothing.
    """
    first, count = int(run.k[0]), int(run.k[-1] - run.k[0]) + 1
    chosen, extra = kept(run, most)

    def spread(values: Floats) -> Floats:
        out = np.full(count, np.nan)
        out[run.k[chosen] - first] = values[chosen]
        return out

    bits = np.zeros(count, dtype=np.int64)
    bits[run.k[chosen] - first] = extra.astype(np.int64) << len(FLAGS)
    bits[run.k[chosen] - first] += sum(
        (1 << bit) * getattr(run, name)[chosen].astype(np.int64) for bit, name in enumerate(FLAGS)
    )
    entry = {
        "first": first,
        "t": block.log(spread(run.time_ns)),
        "e": block.log(spread(run.error)),
        "i": block.count(spread(run.iterations)),
        "a": block.count(spread(run.n_active)),
        "f": block.flag(bits),
    }
    if run.rounds > 1:
        entry["r"] = block.log(spread(run.raw_ns))
    return entry


def track_of(steps: pd.DataFrame, limits: Floats, most: int) -> Track:
    """The track of a closed loop from its rows, at most `most` points; `limits` (3,) of the forces
    [N, N, N·m]."""
    every = max(1, -(-len(steps) // most))

    def thin(names: Iterable[str]) -> Floats:
        return np.column_stack([steps[n].to_numpy(dtype=np.float64)[::every] for n in names])

    return Track(every, thin(TRACK), thin(FORCES) / limits)


def pack_track(block: Block, track: Track, reference: Track | None) -> dict[str, Any]:
    """A track as numbers of arrays: as it is, or its distance from `reference` point by point."""
    position, force = track.position.copy(), track.force.copy()
    if reference is not None:
        count = min(len(position), len(reference.position))
        position, force = position[:count], force[:count]
        position -= reference.position[:count]
        force -= reference.force[:count]
    return {
        "every": track.every,
        "x": [block.linear(position[:, i], s) for i, s in enumerate(TRACK.values())],
        "u": [block.linear(force[:, i], FORCE_SHARE) for i in range(len(FORCES))],
    }
