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

from dpbench.report.demand import Demand
from dpbench.report.formats import and_list, as_float, count_text, error_text, plural, time_text
from dpbench.report.ranking import fastest_first
from dpbench.report.statistics import percentile, supports
from dpbench.report.view import Row, View, is_contrast

Outcome = Literal["meets", "misses", "open", "not run"]
NO_LOOP = "no closed loop was run"
NO_REPLAY = "no replay was run, so its time is not judged"
ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""
_POLICIES = ("fresh", "reuse", "warm")
_UNDONE = {
    "crashed": "its process ended in {where}: {detail}",
    "hung": "it did not return in {where}: {detail}",
}
"""Outcomes that are the solver's own doing, and contradict any demand."""


@dataclass(frozen=True)
class Configuration:
    """A solver and how it is run, in scaled units and the common formulation of each problem."""

    solver: str
    route: str
    policy: str
    settings: str

    @classmethod
    def of(cls, row: Row) -> Configuration:
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
    """The judgement of one configuration.

    Parameters
    ----------
    causes : why it misses the demand; doubts : what could not be judged. Plain clauses.
    not_run : where its solver's reference was judged and this configuration was not, or not whole.
    loops, replays : how many of its runs were judged; steps : the steps with a judged answer.
    error_move : the largest error of the first move among them.
    p50_ns, p99_ns : algorithmic step time on the sequence `timed_on`, that of the worst p99, or of
        the worst p50 where none supports a p99.
    algo_max_ns, raw_max_ns : largest algorithmic step time and largest single sample of all
        sequences.
    """

    configuration: Configuration
    outcome: Outcome
    causes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    not_run: tuple[str, ...] = ()
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
        return not (self.causes or self.doubts or self.not_run) and self.timed_on != ""

    @property
    def judged_on(self) -> str:
        """What its answers were judged on."""
        loops = plural(self.loops, "closed loop")
        replays = plural(self.replays, "replay")
        return f"{loops} and {replays}" if self.loops else replays

    @property
    def open_for(self) -> tuple[str, ...]:
        """Why it is open, in clauses: what could not be judged, where it was not run."""
        missing = (f"not run {and_list(list(self.not_run))}",) if self.not_run else ()
        return (*self.doubts, *missing, *self._kinds_missing)

    @property
    def _kinds_missing(self) -> tuple[str, ...]:
        kinds = ((self.loops, NO_LOOP), (self.replays, NO_REPLAY))
        return tuple(text for count, text in kinds if not count)

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
        return Verdict(wanted, "not run", doubts=("the suite does not run it so",))

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


def settings_level(settings: str) -> tuple[int, str]:
    """Sort key of a settings level."""
    order = ("default", "low", "mid", "high")
    return (order.index(settings) if settings in order else len(order), settings)


def judge_all(view: View, demand: Demand) -> Verdicts:
    """The verdicts on all configurations of all solvers, in the order of the suite."""
    runs: dict[str, dict[Configuration, list[Row]]] = {}
    for row in view.runs:
        if row["units"] == "scaled" and not is_contrast(row):
            configurations = runs.setdefault(str(row["solver"]), {})
            configurations.setdefault(Configuration.of(row), []).append(row)
    found: dict[str, list[Verdict]] = {}
    for solver, configurations in runs.items():
        longest = {c: _longest(rows) for c, rows in configurations.items()}
        ordered = sorted(longest.items(), key=lambda item: _reference_first(*item))
        asked = [row for row in ordered[0][1].values() if row["outcome"] != "refused"]
        found[solver] = [judge(view, c, rows, asked, demand) for c, rows in ordered]
    return Verdicts(demand, found)


Place = tuple[str, str]
"""Mode, and scenario or sequence."""


def _longest(rows: Iterable[Row]) -> dict[Place, Row]:
    """The longest run of a configuration in each place."""
    best: dict[Place, Row] = {}
    for row in rows:
        place = _place(row)
        if place not in best or row["steps_planned"] > best[place]["steps_planned"]:
            best[place] = row
    return best


def _place(row: Row) -> Place:
    mode = str(row["mode"])
    return mode, str(row["sequence"] if mode == "replay" else row["scenario"])


def _reference_first(configuration: Configuration, rows: Mapping[Place, Row]) -> tuple[Any, ...]:
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


def judge(
    view: View,
    configuration: Configuration,
    rows: Mapping[Place, Row],
    asked: Sequence[Row],
    demand: Demand,
) -> Verdict:
    """The verdict on one configuration.

    Parameters
    ----------
    rows : its longest run in each place; asked : the runs of its solver's reference.
    """
    ran = [row for row in rows.values() if row["outcome"] != "refused"]
    if not ran:
        return Verdict(configuration, "not run", doubts=(_detail(next(iter(rows.values()))),))
    replays = [row for row in ran if row["mode"] == "replay"]
    late, unsure, timing = _timing(view, replays, demand)
    causes = [*_wrong(ran, demand), *_failing(ran, demand), *_undone(ran), *late]
    doubts = [*_unfinished(ran), *unsure]
    not_run = _not_run(rows, asked)
    kinds = len({row["mode"] for row in ran})
    whole = not (doubts or not_run) and kinds == 2
    worst = np.array([as_float(row["error_move_max"]) for row in ran])
    known = worst[~np.isnan(worst)]
    return Verdict(
        configuration,
        "misses" if causes else "meets" if whole else "open",
        tuple(causes),
        tuple(doubts),
        tuple(not_run),
        loops=len(ran) - len(replays),
        replays=len(replays),
        steps=sum(_judged(row) for row in ran),
        error_move=float(known.max()) if len(known) else math.nan,
        failed_steps=sum(_count(row, "failed_steps") for row in ran),
        **timing,
    )


def where(row: Row) -> str:
    """The place of a run in words."""
    if row["mode"] == "replay":
        return f"the replay of `{row['sequence']}`"
    return f"`{row['scenario']}`"


def _detail(row: Row) -> str:
    return str(row["outcome_detail"]).strip().rstrip(".") or "no reason was recorded"


def _count(row: Row, column: str) -> int:
    value = as_float(row[column])
    return int(value) if math.isfinite(value) else 0


def _judged(row: Row) -> int:
    return max(0, _count(row, "steps_done") - _count(row, "uncertified"))


def _not_run(rows: Mapping[Place, Row], asked: Sequence[Row]) -> list[str]:
    """Where the reference was run and these rows were not, or not as far."""
    absent, short, refused = [], [], []
    for row in asked:
        own = rows.get(_place(row))
        if own is None:
            absent.append(row)
        elif own["outcome"] == "refused":
            refused.append(f"in {where(own)} ({_detail(own)})")
        elif own["steps_planned"] < row["steps_planned"]:
            of = f"{count_text(own['steps_planned'])} of {plural(row['steps_planned'], 'step')}"
            short.append(f"whole in {where(own)} ({of})")
    return [*([f"in {_places(absent)}"] if absent else []), *refused, *short]


def _wrong(rows: Sequence[Row], demand: Demand) -> list[str]:
    """Clauses about answers too far from the optimum, the worst run first."""
    off = [row for row in rows if as_float(row["error_move_max"]) > demand.error_move]
    silent = [row for row in off if math.isinf(as_float(row["error_move_max"]))]
    wrong = [row for row in off if row not in silent]
    clauses = []
    if silent:
        clauses.append(f"it leaves steps without an answer in {_places(silent)}")
    if wrong:
        worst = max(wrong, key=lambda row: as_float(row["error_move_max"]))
        others = [row for row in wrong if row is not worst]
        also = f" (over the demand also in {_places(others)})" if others else ""
        error = error_text(as_float(worst["error_move_max"]))
        clauses.append(
            f"its first move is up to {error} of a rate-limit step off the optimum in "
            f"{where(worst)}{also}"
        )
    return clauses


def _failing(rows: Sequence[Row], demand: Demand) -> list[str]:
    failing = [row for row in rows if _count(row, "failed_steps") > demand.failed_steps]
    if not failing:
        return []
    worst = max(failing, key=lambda row: as_float(row["failed_steps"]))
    rounds = max(1, _count(worst, "rounds"))
    of = plural(_count(worst, "steps_done") * rounds, "step")
    others = [row for row in failing if row is not worst]
    also = f" (some also in {_places(others)})" if others else ""
    return [f"{_count(worst, 'failed_steps')} of {of} fail in {where(worst)}{also}"]


def _undone(rows: Sequence[Row]) -> list[str]:
    """Clauses about runs that the solver ended, or never came back from."""
    clauses = []
    for outcome, words in _UNDONE.items():
        ended = [row for row in rows if row["outcome"] == outcome]
        if ended:
            clause = words.format(where=where(ended[0]), detail=_detail(ended[0]))
            also = f" (also in {_places(ended[1:])})" if ended[1:] else ""
            clauses.append(clause + also)
    return clauses


def _places(rows: Sequence[Row]) -> str:
    loops = [f"`{row['scenario']}`" for row in rows if row["mode"] != "replay"]
    replays = [f"`{row['sequence']}`" for row in rows if row["mode"] == "replay"]
    if replays:
        word = "replay" if len(replays) == 1 else "replays"
        loops.append(f"the {word} of {' and '.join(replays)}")
    return and_list(loops)


def _unfinished(rows: Sequence[Row]) -> list[str]:
    """Clauses about runs that ended early or could not be judged."""
    doubts = []
    for row in rows:
        done, asked = _count(row, "steps_done"), _count(row, "steps_planned")
        if row["outcome"] in _UNDONE:
            continue
        if row["outcome"] == "timed_out" and row["mode"] == "replay" and done >= asked:
            # Every step has an answer and a time; fewer rounds make that time no smaller.
            continue
        if row["outcome"] == "timed_out":
            doubts.append(
                f"{where(row)} was stopped at its time limit ({done} of {plural(asked, 'step')})"
            )
        elif row["outcome"] == "lost":
            doubts.append(f"the harness lost {where(row)}: {_detail(row)}")
        elif row["outcome"] != "finished":
            doubts.append(f"{where(row)} {row['outcome']}: {_detail(row)}")
        elif _count(row, "uncertified"):
            unsure = plural(_count(row, "uncertified"), "step")
            doubts.append(f"{unsure} of {where(row)} have no certified optimum")
    return doubts


def _timing(
    view: View, replays: Sequence[Row], demand: Demand
) -> tuple[list[str], list[str], dict[str, Any]]:
    """Clauses that contradict the time demand, clauses of doubt, and the figures behind."""
    late: list[str] = []
    unsure: list[str] = []
    figures: list[tuple[float, float, str]] = []
    algo_max_ns = raw_max_ns = math.nan
    for row in replays:
        times = view.times(row)
        if times is None:
            if row["outcome"] == "finished":
                unsure.append(f"{where(row)} left no counting step")
            continue
        algo = times.algo_ns
        algo_max_ns = float(np.fmax(algo_max_ns, algo.max()))
        raw_max_ns = float(np.fmax(raw_max_ns, times.raw_ns.max()))
        p99, p95 = percentile(algo, 99), percentile(algo, 95)
        figures.append((p99, float(np.median(algo)), str(row["sequence"])))
        if p99 > demand.p99_ns:
            late.append(f"its p99 is {time_text(p99)} in {where(row)}")
        elif p95 > demand.p99_ns:
            late.append(f"its p95 is already {time_text(p95)} in {where(row)}")
        elif not supports(len(algo), 99) and algo.max() > demand.p99_ns:
            steps = plural(len(algo), "step")
            unsure.append(
                f"{steps} of {where(row)} do not support a p99, and the slowest takes "
                f"{time_text(float(algo.max()))}"
            )
    if not figures:
        return late, unsure, {}
    known = [figure for figure in figures if math.isfinite(figure[0])]
    p99, p50, timed_on = max(known) if known else max(figures, key=lambda figure: figure[1])
    times_ns = {"algo_max_ns": algo_max_ns, "raw_max_ns": raw_max_ns}
    return late, unsure, {"p50_ns": p50, "p99_ns": p99, "timed_on": timed_on, **times_ns}
