"""Evaluate every configuration of every solver by the suite's demand, from rows alone.

A configuration *meets* the demand when it was run, whole, in every scenario and replay in which its
solver's reference was judged, every judged step has error_move within the demand, no more steps
fail than it allows, and the p99 of its algorithmic step time stays below the demand in every
replayed sequence. What contradicts the demand makes it *miss*: a wrong, failed or late step, a
process that crashed, a call that did not return. What was not run, could not be measured, or was
lost by the harness leaves it *open*, and so does a closed loop whose median timing is beyond what
is allowed of a p99.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.demand import Demand
from dpbench.bench.judge.rules import largest, percentile, supports
from dpbench.bench.record.configuration import Configuration, settings_level
from dpbench.solvers.record import POLICIES

Outcome = Literal["meets", "open", "misses", "not run"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""The best first."""
Cause = Literal["no answer", "inaccurate", "failed", "crashed", "hung", "p99 late", "p95 late"]
Doubt = Literal[
    "stopped",
    "lost",
    "ended",
    "uncertified",
    "remembered",
    "not alone",
    "no step",
    "no p99",
    "slow loop",
    "no closed loop",
    "no replay",
]
Gap = Literal["absent", "refused", "short"]
LATE: tuple[Cause, ...] = ("p99 late", "p95 late", "hung")
"""Causes that say that right answers came too late, or never; all others that one was wrong."""
State = Literal["meets", "open", "late", "wrong", "not run"]
STATES: tuple[State, ...] = get_args(State)
"""The outcomes, with what misses told apart by its causes."""
_OWN_DOING: tuple[Cause, ...] = ("crashed", "hung")
"""Outcomes that are the solver's own doing, and contradict any demand."""


@dataclass(frozen=True, eq=False)
class Finding:
    """Something found against a configuration, or that could not be found out.

    Parameters
    ----------
    runs : the runs it was found in, the worst first.
    value : the figure: an error, a time [ns], or steps where the kind is about steps.
    steps : the steps the figure is from.
    """

    kind: Cause | Doubt | Gap
    runs: tuple[RunRecord, ...] = ()
    value: float = math.nan
    steps: int = 0


@dataclass(frozen=True)
class Verdict:
    """The assessment of one configuration.

    Parameters
    ----------
    causes : why it misses the demand; doubts : what could not be judged.
    gaps : where its solver's reference was judged and this configuration was not, or not whole.
    refusal : why it was not run at all.
    loops, replays : how many of its runs were judged; steps : the steps with a judged answer.
    error_move : the largest error of the first move among them.
    p50_ns, p99_ns : algorithmic step time on the sequence `timed_on`, that of the worst p99, or of
        the worst p50 where none supports a p99.
    rounds_ns : median of the fastest and of the slowest round there.
    algo_max_ns, raw_max_ns : largest algorithmic step time and largest single timing of all
        sequences.
    """

    configuration: Configuration
    outcome: Outcome
    causes: tuple[Finding, ...] = ()
    doubts: tuple[Finding, ...] = ()
    gaps: tuple[Finding, ...] = ()
    refusal: str = ""
    loops: int = 0
    replays: int = 0
    steps: int = 0
    error_move: float = math.nan
    failed_steps: int = 0
    p50_ns: float = math.nan
    p99_ns: float = math.nan
    timed_on: str = ""
    rounds_ns: tuple[float, float] = (math.nan, math.nan)
    algo_max_ns: float = math.nan
    raw_max_ns: float = math.nan

    @property
    def state(self) -> State:
        """The outcome; of one that misses, whether it is late alone or an answer is wrong."""
        if self.outcome != "misses":
            return self.outcome
        return "late" if all(cause.kind in LATE for cause in self.causes) else "wrong"

    @property
    def ranks(self) -> bool:
        """Whether nothing is said against it, and it is timed: of what the suite never runs,
        such as closed loops, nobody has to show any."""
        return not (self.causes or self.doubts or self.gaps) and self.timed_on != ""

    @property
    def missing(self) -> tuple[Finding, ...]:
        """Why it is open: what could not be judged, where it was not run, which kind of run."""
        kinds: tuple[tuple[int, Doubt], ...] = (
            (self.loops, "no closed loop"),
            (self.replays, "no replay"),
        )
        absent = tuple(Finding(kind) for count, kind in kinds if not count)
        return (*self.doubts, *self.gaps, *absent)

    def slowdown(self, demand: Demand) -> float:
        """How much slower a computer may be before the largest algorithmic step is too late."""
        return demand.deadline_ns / self.algo_max_ns


@dataclass(frozen=True, eq=False)
class Verdicts:
    """The verdicts on a result folder: of each solver, its reference first."""

    demand: Demand
    of: Mapping[str, Sequence[Verdict]]

    @property
    def references(self) -> list[Verdict]:
        """The verdict on each solver's reference, in the order of the suite."""
        return [verdicts[0] for verdicts in self.of.values()]

    @property
    def all(self) -> list[Verdict]:
        """The verdicts on all configurations."""
        return [verdict for verdicts in self.of.values() for verdict in verdicts]


def verdicts_of(
    records: Records, demand: Demand, among: Sequence[RunRecord] | None = None
) -> Verdicts:
    """The verdicts on all configurations of all solvers, in the order of the suite.

    Parameters
    ----------
    among : the runs that are judged, of `records.runs`; by default all of them.
    """
    runs = records.runs if among is None else among
    judged = [run for run in runs if run.units == "scaled" and not run.is_baseline_law]
    verdicts: dict[str, list[Verdict]] = {}
    for solver, of_solver in grouped(judged, lambda run: run.solver).items():
        by_configuration = grouped(of_solver, lambda run: run.configuration.in_common_formulation)
        longest = {it: _longest(runs) for it, runs in by_configuration.items()}
        ordered = sorted(longest.items(), key=lambda item: _reference_first(*item))
        asked = [run for run in ordered[0][1].values() if run.outcome != "refused"]
        verdicts[solver] = [
            verdict_of(records, configuration, runs, asked, demand)
            for configuration, runs in ordered
        ]
    return Verdicts(demand, verdicts)


Place = tuple[str, str]
"""Mode, and scenario or sequence."""


def _longest(runs: Iterable[RunRecord]) -> dict[Place, RunRecord]:
    """The longest run of a configuration in each place."""
    best: dict[Place, RunRecord] = {}
    for run in runs:
        place = _place(run)
        if place not in best or run.steps_planned > best[place].steps_planned:
            best[place] = run
    return best


def _place(run: RunRecord) -> Place:
    return run.mode, run.problem


def _reference_first(
    configuration: Configuration, runs: Mapping[Place, RunRecord]
) -> tuple[Any, ...]:
    """Sort key: a solver's reference is its most usual configuration that ran at all, closed loops
    and replays both if there is such a one."""
    ran = [run for run in runs.values() if run.outcome != "refused"]
    kinds = len({run.mode for run in ran})
    default = any(run.default_route for run in runs.values())
    return (
        settings_level(configuration.settings) if ran else (99, ""),
        -kinds,
        not default,
        list(POLICIES).index(configuration.policy),
    )


def verdict_of(
    records: Records,
    configuration: Configuration,
    runs: Mapping[Place, RunRecord],
    asked: Sequence[RunRecord],
    demand: Demand,
) -> Verdict:
    """The verdict on one configuration.

    Parameters
    ----------
    runs : its longest run in each place; asked : the runs of its solver's reference.
    """
    ran = [run for run in runs.values() if run.outcome != "refused"]
    if not ran:
        return Verdict(configuration, "not run", refusal=detail(next(iter(runs.values()))))
    replays = [run for run in ran if run.mode == "replay"]
    late, unsure, timing = _timing(records, replays, demand)
    causes = [*_wrong(ran, demand), *_failing(ran, demand), *_own_doing(ran), *late]
    doubts = [*_unfinished(ran), *unsure, *_slow_loops(ran, demand)]
    gaps = _gaps(runs, asked)
    kinds = len({run.mode for run in ran})
    whole = not (doubts or gaps) and kinds == 2
    return Verdict(
        configuration,
        "misses" if causes else "meets" if whole else "open",
        tuple(causes),
        tuple(doubts),
        tuple(gaps),
        loops=len(ran) - len(replays),
        replays=len(replays),
        steps=sum(_evaluated_steps(run) for run in ran),
        error_move=largest([run.error_move_max for run in ran]),
        failed_steps=sum(_count(run.failed_steps) for run in ran),
        **timing,
    )


def detail(run: RunRecord) -> str:
    """The cause of a run's outcome, in the library's or the harness's words."""
    return run.cause or "no reason was recorded"


def _count(count: float) -> int:
    """A count; a missing one is 0."""
    return int(count) if math.isfinite(count) else 0


def _evaluated_steps(run: RunRecord) -> int:
    """Steps with a judged answer; a replay counts those without in each of its rounds."""
    without = _count(run.uncertified) + _count(run.undecided_steps)
    return max(0, run.steps_done - without // max(1, _count(run.rounds)))


def _gaps(runs: Mapping[Place, RunRecord], asked: Sequence[RunRecord]) -> list[Finding]:
    """Where the reference was run and these runs were not, or not as far."""
    absent: list[RunRecord] = []
    gaps: list[Finding] = []
    for run in asked:
        own = runs.get(_place(run))
        if own is None:
            absent.append(run)
        elif own.outcome == "refused":
            gaps.append(Finding("refused", (own,)))
        elif own.steps_planned < run.steps_planned:
            gaps.append(Finding("short", (own,), steps=run.steps_planned))
    return [Finding("absent", tuple(absent)), *gaps] if absent else gaps


def _wrong(runs: Sequence[RunRecord], demand: Demand) -> list[Finding]:
    """Answers too far from the optimum, and steps without one."""
    off = [run for run in runs if run.error_move_max > demand.error_move]
    silent = tuple(run for run in off if math.isinf(run.error_move_max))
    wrong = [run for run in off if math.isfinite(run.error_move_max)]
    no_answer = [Finding("no answer", silent)] if silent else []
    return [*no_answer, *_worst_first("inaccurate", wrong, lambda run: run.error_move_max)]


def _worst_first(
    kind: Cause | Doubt, runs: Sequence[RunRecord], figure: Callable[[RunRecord], float]
) -> list[Finding]:
    """One finding with the worst run by a figure in front, the others in their order."""
    if not runs:
        return []
    worst = max(runs, key=figure)
    others = (run for run in runs if run is not worst)
    return [Finding(kind, (worst, *others), figure(worst))]


def _failing(runs: Sequence[RunRecord], demand: Demand) -> list[Finding]:
    failing = [run for run in runs if run.failed_steps > demand.failed_steps]
    return _worst_first("failed", failing, lambda run: run.failed_steps)


def _own_doing(runs: Sequence[RunRecord]) -> list[Finding]:
    """Runs that the solver ended, or never came back from."""
    ended = {kind: tuple(run for run in runs if run.outcome == kind) for kind in _OWN_DOING}
    return [Finding(kind, of_kind) for kind, of_kind in ended.items() if of_kind]


def _unfinished(runs: Sequence[RunRecord]) -> list[Finding]:
    """Runs that ended early or could not be judged."""
    doubts = []
    for run in runs:
        done, asked = run.steps_done, run.steps_planned
        if run.outcome in _OWN_DOING:
            continue
        if run.outcome == "timed_out" and run.mode == "replay" and done >= asked:
            # Every step has an answer and a time; fewer rounds make that time no smaller.
            continue
        if run.outcome == "timed_out":
            doubts.append(Finding("stopped", (run,), value=done, steps=asked))
        elif run.outcome == "lost":
            doubts.append(Finding("lost", (run,)))
        elif run.outcome != "finished":
            doubts.append(Finding("ended", (run,)))
        elif _count(run.uncertified):
            doubts.append(Finding("uncertified", (run,), value=_count(run.uncertified)))
    return doubts


def _slow_loops(runs: Sequence[RunRecord], demand: Demand) -> list[Finding]:
    """Closed loops with a median of timings beyond what is allowed of a p99. A loop is timed once
    a step, other work may be in that, so that it contradicts nothing; nor can it be passed over."""
    loops = (run for run in runs if run.mode == "closed_loop" and not run.slowdown > 0.0)
    slow = [run for run in loops if run.raw_p50_ns > demand.p99_ns]
    return _worst_first("slow loop", slow, lambda run: run.raw_p50_ns)


def _timing(
    records: Records, replays: Sequence[RunRecord], demand: Demand
) -> tuple[list[Finding], list[Finding], dict[str, Any]]:
    """What contradicts the time demand, what is doubtful, and the figures behind."""
    late: list[Finding] = []
    unsure: list[Finding] = []
    figures: list[tuple[float, float, str, tuple[float, float]]] = []
    algo_max_ns = raw_max_ns = math.nan
    for run in replays:
        if run.remembers:
            unsure.append(Finding("remembered", (run,)))
        if not records.is_ranked(run):
            unsure.append(Finding("not alone", (run,)))
            continue
        times = records.times(run)
        if times is None:
            if run.outcome == "finished":
                unsure.append(Finding("no step", (run,)))
            continue
        algo = times.algo_ns
        algo_max_ns = float(np.fmax(algo_max_ns, algo.max()))
        raw_max_ns = float(np.fmax(raw_max_ns, times.raw_max_ns))
        p99, p95 = percentile(algo, 99), percentile(algo, 95)
        rounds_ns = float(times.rounds_ns.min()), float(times.rounds_ns.max())
        figures.append((p99, float(np.median(algo)), run.sequence, rounds_ns))
        if p99 > demand.p99_ns:
            late.append(Finding("p99 late", (run,), p99))
        elif p95 > demand.p99_ns:
            late.append(Finding("p95 late", (run,), p95))
        elif not supports(len(algo), 99) and algo.max() > demand.p99_ns:
            unsure.append(Finding("no p99", (run,), float(algo.max()), len(algo)))
    if not figures:
        return late, unsure, {}
    known = [figure for figure in figures if math.isfinite(figure[0])]
    p99, p50, timed_on, rounds_ns = (
        max(known) if known else max(figures, key=lambda figure: figure[1])
    )
    times_ns = {"algo_max_ns": algo_max_ns, "raw_max_ns": raw_max_ns}
    on = {"timed_on": timed_on, "rounds_ns": rounds_ns}
    return late, unsure, {"p50_ns": p50, "p99_ns": p99, **on, **times_ns}
