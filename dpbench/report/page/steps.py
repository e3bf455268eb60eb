"""The steps of every run, packed: times, errors, iterations, active limits, and the ship's track.

The track of a closed loop is stored as its distance from that of the run which follows the exactly
solved loop most closely: most ships sail the same line to a millimetre, and zeros pack to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.analysis.run_steps import RunSteps
from dpbench.report.page.pack import Block

TRACK = {"n_m": 1e-3, "e_m": 1e-3, "psi_rad": 1e-4}
"""What is told apart of a track: 1 mm, and 0.006 degrees."""
FORCES = ("tau_x_N", "tau_y_N", "tau_n_Nm")
FORCE_SHARE = 1e-3
"""What is told apart of a force, as a share of its limit."""
MOST_POINTS = 400
"""Points of a track; a longer run is thinned to so many."""
FLAGS = ("claimed", "true", "failed", "late", "fallback", "clipped")
"""Bits of a step's flag, the lowest first."""
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Track:
    """Every `every`-th position (N, 3) [m, m, rad] and force (N, 3), a share of its limit."""

    every: int
    position: Floats
    force: Floats


def pack_steps(block: Block, run: RunSteps) -> dict[str, int]:
    """The steps of a run, as numbers of arrays in `block`, element 0 for step `first`."""
    first, count = int(run.k[0]), int(run.k[-1] - run.k[0]) + 1

    def spread(values: Floats) -> Floats:
        out = np.full(count, np.nan)
        out[run.k - first] = values
        return out

    bits = np.zeros(count, dtype=np.int64)
    bits[run.k - first] = sum(
        (1 << bit) * getattr(run, name).astype(np.int64) for bit, name in enumerate(FLAGS)
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


def track_of(steps: pd.DataFrame, limits: Floats) -> Track:
    """The track of a closed loop from its rows; `limits` (3,) of the forces [N, N, N·m]."""
    every = max(1, -(-len(steps) // MOST_POINTS))

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
