"""Judge every configuration of every solver by the suite's demand, from rows alone.

A configuration *meets* the demand when it was run, whole, in every scenario and replay in which its
solver's reference was judged, every judged step has error_move within the demand, no more steps
fail than it allows, and the p99 of its algorithmic step time stays below the demand in every
replayed sequence. What contradicts the demand makes it *miss*: a wrong, failed or late step, a
process that crashed, a call that did not return. What was not run, could not be measured, or was
lost by the harness leaves it *open*.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records, RunRecord, as_float, is_baseline_law, settings_level
from dpbench.analysis.statistics import percentile, supports
from dpbench.analysis.times.pairs import fastest_first
from dpbench.bench.judge.memory_of_answers import remembers

Outcome = Literal["meets", "misses", "open", "not run"]
ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""
_POLICIES = ("fresh", "reuse", "warm")
Cause = Literal["no answer", "inaccurate", "failed", "crashed", "hung", "p99 late", "p95 late"]
Doubt = Literal[
    "stopped",
    "lost",
    "ended",
    "uncertified",
    "remembered",
    "no step",
    "no p99",
    "no closed loop",
    "no replay",
]
Gap = Literal["absent", "refused", "short"]
_OWN_DOING: tuple[Cause, ...] = ("crashed", "hung")
"""Outcomes that are the solver's own doing, and contradict any demand."""


@dataclass(frozen=True, eq=False)
class Finding:
    """Something found against a configuration, or that could not be found out.

    Parameters
    ----------
    rows : the runs it was found in, the worst first.
    value : the figure: an error, a time [ns], or steps where the kind is about steps.
    steps : the steps the figure is from.
    """

    kind: Cause | Doubt | Gap
    rows: tuple[RunRecord, ...] = ()
    value: float = math.nan
    steps: int = 0


@dataclass(frozen=True)
class Configuration:
    """A solver and how it is run, in scaled units and the common formulation of each problem."""

    solver: str
    route: str
    policy: str
    settings: str

    @classmethod
    def of(cls, row: RunRecord) -> Configuration:
        """The configuration of a run."""
        return cls(*(str(row[name]) for name in ("solver", "route", "policy", "settings")))

    @property
    def way(self) -> str:
        """Route, policy and, where they are not `default`, settings."""
        extra = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{extra}"

    @property
    def label(self) -> str:
        """Solver and way."""
        return f"{self.solver} ({self.way})"


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
    algo_max_ns, raw_max_ns : largest algorithmic step time and largest single sample of all
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
    algo_max_ns: float = math.nan
    raw_max_ns: float = math.nan

    @property
    def solver(self) -> str:
        """Its solver."""
        return self.configuration.solver

    @property
    def route(self) -> str:
        """Its route."""
        return self.configuration.route

    @property
    def policy(self) -> str:
        """Its policy."""
        return self.configuration.policy

    @property
    def settings(self) -> str:
        """Its settings."""
        return self.configuration.settings

    @property
    def label(self) -> str:
        """What it is called beside others."""
        return self.configuration.label

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

    def raw_slowdown(self, demand: Demand) -> float:
        """The same before the largest single sample, jitter of this machine included, is."""
        return demand.deadline_ns / self.raw_max_ns


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
    def every(self) -> list[Verdict]:
        """The verdicts on all configurations."""
        return [verdict for verdicts in self.of.values() for verdict in verdicts]

    @cached_property
    def levels(self) -> list[str]:
        """The settings levels that were run, the most usual first."""
        return sorted({verdict.settings for verdict in self.every}, key=settings_level)

    def at(self, level: str) -> list[Verdict]:
        """Of each solver the verdict on its reference, run at another settings level."""
        return [self._at(verdicts, level) for verdicts in self.of.values()]

    @staticmethod
    def _at(verdicts: Sequence[Verdict], level: str) -> Verdict:
        first = verdicts[0].configuration
        wanted = Configuration(first.solver, first.route, first.policy, level)
        for verdict in verdicts:
            if verdict.configuration == wanted:
                return verdict
        return Verdict(wanted, "not run", refusal="the suite does not run it so")

    @cached_property
    def ranked(self) -> list[Verdict]:
        """The configurations that nothing is said against, timed on as many sequences as any; the
        fastest first, and of two names of one run the more usual settings."""
        ranks = [verdict for verdict in self.every if verdict.ranks]
        widest = max((verdict.replays for verdict in ranks), default=0)
        wide = [verdict for verdict in ranks if verdict.replays == widest]
        return fastest_first(sorted(wide, key=lambda verdict: settings_level(verdict.settings)))

    def fastest(self, solver: str) -> Verdict | None:
        """The fastest configuration of one solver, at its most usual settings where others are
        hardly faster."""
        own = [verdict for verdict in self.ranked if verdict.solver == solver]
        if not own:
            return None
        best, way = own[0], (own[0].route, own[0].policy)
        alike = [v for v in own if (v.route, v.policy) == way and _figure(v) <= _alike(best)]
        return min(alike, key=lambda verdict: settings_level(verdict.settings))

    @cached_property
    def podium(self) -> list[Verdict]:
        """The fastest configuration of each solver, the fastest solver first."""
        solvers = dict.fromkeys(verdict.solver for verdict in self.ranked)
        return [way for way in map(self.fastest, solvers) if way is not None]


def _figure(verdict: Verdict) -> float:
    return verdict.p99_ns if math.isfinite(verdict.p99_ns) else verdict.p50_ns


def _alike(verdict: Verdict) -> float:
    return (1.0 + ALIKE) * _figure(verdict)


def verdicts_of(records: Records, demand: Demand) -> Verdicts:
    """The verdicts on all configurations of all solvers, in the order of the suite."""
    runs: dict[str, dict[Configuration, list[RunRecord]]] = {}
    for row in records.runs:
        if row["units"] == "scaled" and not is_baseline_law(row):
            configurations = runs.setdefault(str(row["solver"]), {})
            configurations.setdefault(Configuration.of(row), []).append(row)
    found: dict[str, list[Verdict]] = {}
    for solver, configurations in runs.items():
        longest = {c: _longest(rows) for c, rows in configurations.items()}
        ordered = sorted(longest.items(), key=lambda item: _reference_first(*item))
        asked = [row for row in ordered[0][1].values() if row["outcome"] != "refused"]
        found[solver] = [verdict_of(records, c, rows, asked, demand) for c, rows in ordered]
    return Verdicts(demand, found)


Place = tuple[str, str]
"""Mode, and scenario or sequence."""


def _longest(rows: Iterable[RunRecord]) -> dict[Place, RunRecord]:
    """The longest run of a configuration in each place."""
    best: dict[Place, RunRecord] = {}
    for row in rows:
        place = _place(row)
        if place not in best or row["steps_planned"] > best[place]["steps_planned"]:
            best[place] = row
    return best


def _place(row: RunRecord) -> Place:
    mode = str(row["mode"])
    return mode, str(row["sequence"] if mode == "replay" else row["scenario"])


def _reference_first(
    configuration: Configuration, rows: Mapping[Place, RunRecord]
) -> tuple[Any, ...]:
    """Sort key: a solver's reference is its most usual configuration that ran at all, closed loops
    and replays both if there is such a one."""
    ran = [row for row in rows.values() if row["outcome"] != "refused"]
    kinds = len({row["mode"] for row in ran})
    default = any(row["default_route"] for row in rows.values())
    return (
        settings_level(configuration.settings) if ran else (99, ""),
        -kinds,
        not default,
        _POLICIES.index(configuration.policy),
    )


def verdict_of(
    records: Records,
    configuration: Configuration,
    rows: Mapping[Place, RunRecord],
    asked: Sequence[RunRecord],
    demand: Demand,
) -> Verdict:
    """The verdict on one configuration.

    Parameters
    ----------
    rows : its longest run in each place; asked : the runs of its solver's reference.
    """
    ran = [row for row in rows.values() if row["outcome"] != "refused"]
    if not ran:
        return Verdict(configuration, "not run", refusal=detail(next(iter(rows.values()))))
    replays = [row for row in ran if row["mode"] == "replay"]
    late, unsure, timing = _timing(records, replays, demand)
    causes = [*_wrong(ran, demand), *_failing(ran, demand), *_own_doing(ran), *late]
    doubts = [*_unfinished(ran), *unsure]
    gaps = _gaps(rows, asked)
    kinds = len({row["mode"] for row in ran})
    whole = not (doubts or gaps) and kinds == 2
    worst = np.array([as_float(row["error_move_max"]) for row in ran])
    known = worst[~np.isnan(worst)]
    return Verdict(
        configuration,
        "misses" if causes else "meets" if whole else "open",
        tuple(causes),
        tuple(doubts),
        tuple(gaps),
        loops=len(ran) - len(replays),
        replays=len(replays),
        steps=sum(_judged(row) for row in ran),
        error_move=float(known.max()) if len(known) else math.nan,
        failed_steps=sum(_count(row, "failed_steps") for row in ran),
        **timing,
    )


def detail(row: RunRecord) -> str:
    """The cause of a run's outcome, in the library's or the harness's words."""
    return str(row["outcome_detail"]).strip().rstrip(".") or "no reason was recorded"


def _count(row: RunRecord, column: str) -> int:
    value = as_float(row[column])
    return int(value) if math.isfinite(value) else 0


def _judged(row: RunRecord) -> int:
    """Steps with a judged answer; a replay counts those without in each of its rounds."""
    without = _count(row, "uncertified") + _count(row, "undecided_steps")
    return max(0, _count(row, "steps_done") - without // max(1, _count(row, "rounds")))


def _gaps(rows: Mapping[Place, RunRecord], asked: Sequence[RunRecord]) -> list[Finding]:
    """Where the reference was run and these rows were not, or not as far."""
    absent: list[RunRecord] = []
    found: list[Finding] = []
    for row in asked:
        own = rows.get(_place(row))
        if own is None:
            absent.append(row)
        elif own["outcome"] == "refused":
            found.append(Finding("refused", (own,)))
        elif own["steps_planned"] < row["steps_planned"]:
            found.append(Finding("short", (own,), steps=int(row["steps_planned"])))
    return [Finding("absent", tuple(absent)), *found] if absent else found


def _wrong(rows: Sequence[RunRecord], demand: Demand) -> list[Finding]:
    """Answers too far from the optimum, and steps without one."""
    off = [row for row in rows if as_float(row["error_move_max"]) > demand.error_move]
    silent = [row for row in off if math.isinf(as_float(row["error_move_max"]))]
    wrong = [row for row in off if row not in silent]
    found = [Finding("no answer", tuple(silent))] if silent else []
    return [*found, *_worst_first("inaccurate", wrong, "error_move_max")]


def _worst_first(kind: Cause, rows: Sequence[RunRecord], column: str) -> list[Finding]:
    """One finding with the worst row by a column in front, the others in their order."""
    if not rows:
        return []
    worst = max(rows, key=lambda row: as_float(row[column]))
    others = (row for row in rows if row is not worst)
    return [Finding(kind, (worst, *others), as_float(worst[column]))]


def _failing(rows: Sequence[RunRecord], demand: Demand) -> list[Finding]:
    failing = [row for row in rows if _count(row, "failed_steps") > demand.failed_steps]
    return _worst_first("failed", failing, "failed_steps")


def _own_doing(rows: Sequence[RunRecord]) -> list[Finding]:
    """Runs that the solver ended, or never came back from."""
    ended = {kind: tuple(row for row in rows if row["outcome"] == kind) for kind in _OWN_DOING}
    return [Finding(kind, found) for kind, found in ended.items() if found]


def _unfinished(rows: Sequence[RunRecord]) -> list[Finding]:
    """Runs that ended early or could not be judged."""
    doubts = []
    for row in rows:
        done, asked = _count(row, "steps_done"), _count(row, "steps_planned")
        if row["outcome"] in _OWN_DOING:
            continue
        if row["outcome"] == "timed_out" and row["mode"] == "replay" and done >= asked:
            # Every step has an answer and a time; fewer rounds make that time no smaller.
            continue
        if row["outcome"] == "timed_out":
            doubts.append(Finding("stopped", (row,), value=done, steps=asked))
        elif row["outcome"] == "lost":
            doubts.append(Finding("lost", (row,)))
        elif row["outcome"] != "finished":
            doubts.append(Finding("ended", (row,)))
        elif _count(row, "uncertified"):
            doubts.append(Finding("uncertified", (row,), value=_count(row, "uncertified")))
    return doubts


def _timing(
    records: Records, replays: Sequence[RunRecord], demand: Demand
) -> tuple[list[Finding], list[Finding], dict[str, Any]]:
    """What contradicts the time demand, what is doubtful, and the figures behind."""
    late: list[Finding] = []
    unsure: list[Finding] = []
    figures: list[tuple[float, float, str]] = []
    algo_max_ns = raw_max_ns = math.nan
    for row in replays:
        if remembers(row):
            unsure.append(Finding("remembered", (row,)))
        times = records.times(row)
        if times is None:
            if row["outcome"] == "finished":
                unsure.append(Finding("no step", (row,)))
            continue
        algo = times.algo_ns
        algo_max_ns = float(np.fmax(algo_max_ns, algo.max()))
        raw_max_ns = float(np.fmax(raw_max_ns, times.raw_ns.max()))
        p99, p95 = percentile(algo, 99), percentile(algo, 95)
        figures.append((p99, float(np.median(algo)), str(row["sequence"])))
        if p99 > demand.p99_ns:
            late.append(Finding("p99 late", (row,), p99))
        elif p95 > demand.p99_ns:
            late.append(Finding("p95 late", (row,), p95))
        elif not supports(len(algo), 99) and algo.max() > demand.p99_ns:
            unsure.append(Finding("no p99", (row,), float(algo.max()), len(algo)))
    if not figures:
        return late, unsure, {}
    known = [figure for figure in figures if math.isfinite(figure[0])]
    p99, p50, timed_on = max(known) if known else max(figures, key=lambda figure: figure[1])
    times_ns = {"algo_max_ns": algo_max_ns, "raw_max_ns": raw_max_ns}
    return late, unsure, {"p50_ns": p50, "p99_ns": p99, "timed_on": timed_on, **times_ns}
