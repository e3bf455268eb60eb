"""Requirements of a controller on a solver, and findings on it: causes, doubts, narrow passes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.record.result_folder import SuiteDescription

MARGIN = 0.1
"""A loop survives a slow computer with a cost within this share of the reference loop's."""


@dataclass(frozen=True)
class Requirements:
    """Limits that a controller sets on a solver: error, failed steps, p99, deadline.

    Where no deadline is known the limits on time are infinite: no step time is judged.
    """

    error_move: float = 1e-2
    failed_steps: int = 0
    p99_ms: float = 3.0
    deadline_ms: float = 300.0

    @classmethod
    def from_suite(cls, suite: SuiteDescription) -> "Requirements":
        """Return the limits on error, failed steps and time of a suite, or the defaults."""
        # Folders of earlier releases have them as `demand`.
        known: dict[str, Any] = {**suite.get("requirements", suite.get("demand", {}))}
        if known.get("deadline_ms") == 0.0:
            known |= {"p99_ms": math.inf, "deadline_ms": math.inf}
        return cls(**{f.name: known[f.name] for f in fields(cls) if f.name in known})

    @property
    def judges_step_times(self) -> bool:
        """Return whether step times have limits; False where no deadline is known."""
        return math.isfinite(self.deadline_ms)

    @property
    def p99_ns(self) -> float:
        """Limit on the p99 step time, each step's fastest repetition [ns]."""
        return self.p99_ms * 1e6

    @property
    def deadline_ns(self) -> float:
        """Deadline for the solution of a step's QP [ns]."""
        return self.deadline_ms * 1e6


def is_right_on_every_step(run: RunRecord, requirements: Requirements) -> bool:
    """Return whether every step of a run was solved within the accuracy requirements.

    A run that its time limit stopped counts if it had done every step at least once by then. A run
    of which no step has a feasible point is right if the solver reported that at every step.
    """
    is_accurate = run.error_move_max <= requirements.error_move
    if run.has_no_optimum:
        is_accurate = run.true_share == 1.0
    return (
        run.outcome in ("finished", "timed_out")
        and run.caching_sign is None
        and run.has_all_steps
        and is_accurate
        and run.failed_steps <= requirements.failed_steps
    )


def is_right_to_the_end(run: RunRecord, requirements: Requirements) -> bool:
    """Return whether a run finished and solved every step accurately enough, in whatever time."""
    return run.outcome == "finished" and is_right_on_every_step(run, requirements)


def compute_cost_ratio(run: RunRecord) -> float:
    """Return a closed loop's cost over that with exact solutions; NaN if it did not end."""
    if not run.has_all_steps:
        return math.nan
    return run.closed_loop_cost / run.exact_cost


def has_survived(run: RunRecord) -> bool:
    """Return whether a closed loop ended within 10 % of the exact cost, without violations."""
    return compute_cost_ratio(run) <= 1.0 + MARGIN and run.limit_violations == 0.0


State = Literal["pass", "borderline", "inconclusive", "late", "fail", "not run"]
STATES: tuple[State, ...] = get_args(State)
"""The verdicts, the best first."""
MISSED: tuple[State, ...] = ("late", "fail")
"""Verdicts of configurations that something contradicts."""
LateCause = Literal[
    "p99 late",
    "p95 late",
    "p50 late",
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
    "no optimum",
    "remembered",
    "hidden work",
    "not alone",
    "no step",
    "no p99",
    "p95 uncertain",
    "p50 uncertain",
    "slow steps untimed",
    "longest step untimed",
    "p99 waits",
    "p95 waits",
    "deadline waits",
    "loop waits",
    "few timings",
    "few p95 timings",
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
PERHAPS_BY_MACHINE: tuple[Doubt, ...] = (
    *("remembered", "hidden work", "p95 uncertain", "p50 uncertain"),
    *("p99 waits", "p95 waits", "deadline waits"),
    "loop waits",
    *("few timings", "few p95 timings", "few deadline timings"),
    *("late at random", "late when disturbed"),
    *("perhaps late timings", "perhaps past the deadline"),
)
"""Doubts on the times of a solver that a disturbed machine may be the reason of."""
OWN_DOING: tuple[Cause, ...] = ("crashed", "hung")
"""Outcomes of runs that the solver itself caused, and that contradict any requirements."""
UNFINISHED = {*OWN_DOING, "stopped", "lost", "ended"}
"""Kinds of findings on runs without an answer to every step."""


@dataclass(frozen=True, eq=False)
class Finding:
    """Reason for a verdict on a configuration: fault, doubt, time near a limit, missing run.

    runs : the runs it was found in, first the worst in which the ship stays on station.
    value : an error, a time [ns], a share of timings, or steps, by kind.
    steps : the steps or timings of the figure; status : that of most failed steps; infeasible :
        the failed steps whose QP is infeasible.
    first : the first failed or inaccurate step of the worst run; −1 where it is not known.
    machine : of a share of late timings, the share that the machine explains; of a time with waits
        for the processor core, the time without them [ns].
    limit, factor : the limit that a time was compared with [ns], and the factor within which the
        time is uncertain.
    """

    kind: Cause | Doubt | Near | Gap
    runs: tuple[RunRecord, ...] = ()
    value: float = math.nan
    steps: int = 0
    machine: float = math.nan
    status: str = ""
    first: int = -1
    infeasible: int = 0
    limit: float = math.nan
    factor: float = math.nan


def make_finding_on_worst_runs(
    kind: Cause | Doubt | Near, runs: Sequence[RunRecord], figure: Callable[[RunRecord], float]
) -> list[Finding]:
    """Return a list of one finding on several runs, the worst first; empty without a run.

    Runs whose ship stays on station come before those in which it is lost whatever the solver.
    """
    if not runs:
        return []
    worst = max(runs, key=lambda run: (math.isnan(run.exact_left_s), figure(run)))
    others = (run for run in runs if run is not worst)
    return [Finding(kind, (worst, *others), figure(worst))]
