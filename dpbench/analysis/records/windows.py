"""Windows of hardest steps beside the closed loops of their solvers.

A window holds the steps with the most active limits. A solver may take longer over others: one that
starts from its last answer where the active set changes most, a first-order method where it
converges slowly. The iterations of its closed loop, which passes through all steps, say how much
the window leaves out.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from dpbench.analysis.records.run_record import RunRecord


def relate_windows_to_closed_loops(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return runs, each window with its `untimed_iterations`; those of other runs stay 1."""
    loops = {
        (run.scenario, run.configuration): run.iterations_p99
        for run in runs
        if run.mode == "closed_loop" and not run.study and not run.slowdown > 0.0
    }
    return [
        replace(run, untimed_iterations=_compute_excess(run, loops.get(key, math.nan)))
        if run.steps_searched_for_hardest and (key := (run.scenario, run.configuration)) in loops
        else run
        for run in runs
    ]


def _compute_excess(window: RunRecord, of_loop: float) -> float:
    """Return the iterations of a closed loop over those of a window; 1 where either is unknown.

    A solver without an iteration in the window still makes a step there, which counts as one.
    """
    excess = (1.0 + of_loop) / (1.0 + window.iterations_p99)
    return max(1.0, excess) if math.isfinite(excess) else 1.0
