"""Step times of closed loops against those of replays, over the steps that both have.

`runs.parquet` compares the median of a whole loop with that of the replay. A replay of the steps
before a loss has easier QPs than the whole loop: the ratio then shows no cached answers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from dpbench.analysis.records.run_record import RunRecord

SOLVE_TIME_COLUMNS = ("k", "total_ns")
LOOP_SIGNS = ("loop", "loop tail")
"""Signs of cached answers that compare a replay with the closed loop of its configuration."""


def compare_loops_over_replayed_steps(
    runs: Sequence[RunRecord], read_steps: Callable[[RunRecord], pd.DataFrame]
) -> list[RunRecord]:
    """Return runs, the ratios of suspicious replays over the steps of the replay alone.

    read_steps : returns `SOLVE_TIME_COLUMNS` of a run's counting steps. The stored ratios stay
    where no sound loop has all these steps, and of cascades, whose steps hold more than the QP.
    """
    sound = sorted(filter(_is_sound_loop, runs), key=lambda run: run.steps_done)
    # The longest loop of each comes last.
    loops = {(run.scenario, run.configuration): run for run in sound}
    return [
        _compare(run, loop, read_steps)
        if run.mode == "replay"
        and run.caching_sign is not None
        and run.caching_sign[0] in LOOP_SIGNS
        and (loop := loops.get((run.scenario, run.configuration))) is not None
        else run
        for run in runs
    ]


def _is_sound_loop(run: RunRecord) -> bool:
    """Return whether a run is a closed loop that meets the QPs of the reference loop."""
    scenario = (run.scenario_documents or {}).get("scenario") or {}
    kind = (scenario.get("controller") or {}).get("kind", "forces")
    is_plain = run.mode == "closed_loop" and not run.study and not run.slowdown > 0.0
    is_right = run.outcome == "finished" and run.failed_steps == 0
    return is_plain and is_right and kind in ("forces", "thrusters")


def _compare(
    replay: RunRecord, loop: RunRecord, read_steps: Callable[[RunRecord], pd.DataFrame]
) -> RunRecord:
    """Return a replay with its ratios over its own steps; unchanged where the loop lacks some."""
    replayed, looped = read_steps(replay), read_steps(loop)
    steps = replay.first_step + replayed["k"].to_numpy()
    same = looped[looped["k"].isin(steps)]
    if not len(same) or same["k"].nunique() < len(np.unique(steps)):
        return replay
    ratios = [
        float(np.percentile(same["total_ns"], percent))
        / float(np.percentile(replayed["total_ns"], percent))
        for percent in (50, 90)
    ]
    tail = ratios[1] if math.isfinite(replay.loop_tail_ratio) else replay.loop_tail_ratio
    return replace(replay, loop_ratio=ratios[0], loop_tail_ratio=tail)
