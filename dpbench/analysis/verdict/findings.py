"""Findings on a configuration: its verdict, causes, doubts, and times near a limit."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from dpbench.analysis.records.run_record import RunRecord

State = Literal["pass", "borderline", "inconclusive", "late", "fail", "not run"]
STATES: tuple[State, ...] = get_args(State)
"""The verdicts, the best first."""
MISSED: tuple[State, ...] = ("late", "fail")
"""Verdicts of configurations that something contradicts."""
LateCause = Literal[
    "p99 late",
    "p95 late",
    "window late",
    "deadline late",
    "slow loop",
    "late timings",
    "past the deadline",
    "hung",
]
Cause = LateCause | Literal["no answer", "inaccurate", "failed", "crashed"]
Doubt = Literal[
    "stopped",
    "lost",
    "ended",
    "uncertified",
    "remembered",
    "hidden work",
    "not alone",
    "no step",
    "no p99",
    "p99 waits",
    "deadline waits",
    "few timings",
    "few deadline timings",
    "short slow loop",
    "late at random",
    "late when disturbed",
    "perhaps late timings",
    "perhaps past the deadline",
    "no closed loop",
    "no loop but studied ones",
    "no replay",
]
Near = Literal["p99 borderline", "p95 borderline", "deadline borderline", "loop borderline"]
Gap = Literal["absent", "refused", "short"]
LATE: tuple[Cause, ...] = get_args(LateCause)
"""Causes by which right answers came too late, or never; by all others an answer was wrong."""
DOUBTS: tuple[Doubt, ...] = get_args(Doubt)
NEAR: tuple[Near, ...] = get_args(Near)
OWN_DOING: tuple[Cause, ...] = ("crashed", "hung")
"""Outcomes of runs that the solver itself caused, and that contradict any requirements."""


@dataclass(frozen=True, eq=False)
class Finding:
    """Reason for a verdict on a configuration: fault, doubt, time near a limit, missing run.

    runs : the runs it was found in, the worst first.
    value : an error, a time [ns], a share of timings, or steps, by kind.
    steps : the steps or timings of the figure.
    machine : of a share of late timings, the share that the machine explains; of a time with waits
        for the processor core, the time without them [ns].
    """

    kind: Cause | Doubt | Near | Gap
    runs: tuple[RunRecord, ...] = ()
    value: float = math.nan
    steps: int = 0
    machine: float = math.nan


def make_finding_on_worst_runs(
    kind: Cause | Doubt | Near, runs: Sequence[RunRecord], figure: Callable[[RunRecord], float]
) -> list[Finding]:
    """Return a list of one finding on several runs, the worst first; empty without a run."""
    if not runs:
        return []
    worst = max(runs, key=figure)
    others = (run for run in runs if run is not worst)
    return [Finding(kind, (worst, *others), figure(worst))]
