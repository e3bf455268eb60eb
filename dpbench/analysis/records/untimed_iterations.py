"""Replays beside the closed loops of their solvers, by iterations.

A window holds the steps with the most active limits, another replay often a part of the scenario. A
solver may take longer over other steps: one that starts from its last answer where the active set
changes most, a first-order method where it converges slowly. The iterations of its closed loop,
which passes through all steps, say how much the replay leaves out.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from dpbench.analysis.records.run_record import RunRecord


def relate_replays_to_closed_loops(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return runs, each replay with its `untimed_iterations`; those of other runs stay 1."""
    loops = {
        (run.scenario, run.configuration): run
        for run in runs
        if run.mode == "closed_loop" and not run.study and not run.slowdown > 0.0
    }
    # QPs outside verdicts, as of a consequence analysis, are not those of the loop.
    return [
        replace(
            run,
            untimed_iterations=_compute_excess(run, loops[key]),
            untimed_iterations_max=_divide(loops[key].iterations_max, run.iterations_max),
        )
        if run.mode == "replay"
        and not run.is_outside_verdicts
        and (key := (run.scenario, run.configuration)) in loops
        else run
        for run in runs
    ]


def _compute_excess(replay: RunRecord, loop: RunRecord) -> float:
    """Return the factor that bounds a replay's p99 by the iterations of a closed loop; at least 1.

    It is 1 if the iterations that one in a hundred steps of the loop exceeds are not known. The
    p99 is at most the longest step, scaled up too unless the replay has a step with as many
    iterations. A solver without an iteration in the replay still makes a step, which counts as one.
    """
    of_loop = loop.iterations_p99
    p99s = (replay.window_p99_ns, replay.algo_p99_ns)
    p99_ns = next(filter(math.isfinite, p99s), replay.algo_max_ns)
    excess, longest = _divide(of_loop, replay.iterations_p99), replay.algo_max_ns / p99_ns
    if replay.iterations_max >= of_loop:
        excess = min(excess, longest)
    elif math.isfinite(loop.iterations_max):
        excess = min(excess, longest * _divide(loop.iterations_max, replay.iterations_max))
    return max(1.0, excess)


def _divide(of_loop: float, of_replay: float) -> float:
    """Return the ratio of two counts of iterations, each with the step's own; at least 1."""
    ratio = (1.0 + of_loop) / (1.0 + of_replay)
    return max(1.0, ratio) if math.isfinite(ratio) else 1.0
