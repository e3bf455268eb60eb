"""The headline: who is fastest at an accuracy achieved on every step of every sequence."""

from __future__ import annotations

from dataclasses import replace

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.statistics import UNKNOWN, Interval, percentile_interval
from dpbench.analysis.times.fastest import ALIKE, fastest_of, podium, ranked
from dpbench.analysis.verdict import Verdict, Verdicts, verdicts_of
from dpbench.report.formats import and_list, error_text, interval_text, plural, time_text
from dpbench.report.table import Cell, Table, row_of
from dpbench.report.verdict_text import judged_on, yardstick

LEVELS = (1e-2, 1e-4, 1e-6)
"""Accuracies of the first move that are asked for, in rate-limit steps."""
FIRST = 5
"""So many solvers of each accuracy stand in the headline; the others are folded below it."""
HEADS = (
    "achieved error_move",
    "place",
    "solver",
    "route",
    "policy",
    "settings",
    "outcome",
    "judged on",
    "error_move max",
    "p50",
    "p50 95 % [µs]",
    "p99",
    "p99 95 % [µs]",
    "on",
    "largest step",
)


def levels_of(demand: Demand) -> list[float]:
    """The accuracies of the headline, that of the demand among them, the coarsest first."""
    return sorted({*LEVELS, demand.error_move}, reverse=True)


def level_tables(view: Records, demand: Demand) -> list[Table]:
    """The headline table and, folded, the solvers behind the first; none without a right
    configuration."""
    found = {
        level: verdicts_of(view, replace(demand, error_move=level)) for level in levels_of(demand)
    }
    ways = {level: list(enumerate(podium(v), 1)) for level, v in found.items()}
    if not any(ways.values()):
        return []
    some = next(way for ranked_configuration in ways.values() for _, way in ranked_configuration)
    by = yardstick(some)
    head = Table(
        title=f"Fastest at an accuracy achieved on every step, by {by}",
        note=(
            f"The first {FIRST} solvers at each accuracy of the first move, each in its fastest "
            f"configuration. {_population(found, some)} Ordered by {by}; p50 and p99 with "
            "bootstrap intervals are those of the sequence with the worst p99, the largest step "
            "that of all. Only configurations run wherever their solver's default was judged; "
            f"where settings make less than {100 * ALIKE:g} % of difference the more usual ones "
            f"are named. {_absent(found)}"
        ),
        heads=HEADS,
        rows=tuple(
            _row(view, level, place, way, demand)
            for level, ranked_configuration in ways.items()
            for place, way in ranked_configuration[:FIRST]
        ),
        text_columns=8,
    )
    rest = tuple(
        _row(view, level, place, way, demand)
        for level, ranked_configuration in ways.items()
        for place, way in ranked_configuration[FIRST:]
    )
    if not rest:
        return [head]
    note = f"The same for {plural(len(rest), 'further place')}. {_population(found, some)}"
    more = replace(head, title=f"{head.title}: the others", note=note, rows=rest, folded=True)
    return [head, more]


def _population(found: dict[float, Verdicts], some: Verdict) -> str:
    counts = [f"{len(ranked(verdicts))} at {level:g}" for level, verdicts in found.items()]
    return (
        f"Configurations replayed on {plural(some.replays, 'sequence')} in scaled units whose "
        f"every answer is that accurate: {and_list(counts)}."
    )


def _absent(found: dict[float, Verdicts]) -> str:
    """Who has no way to an accuracy, said once for several accuracies."""
    lines = []
    for level, verdicts in found.items():
        ran = [
            verdict.configuration.solver
            for verdict in verdicts.references
            if verdict.outcome != "not run"
        ]
        none = [solver for solver in ran if fastest_of(verdicts, solver) is None]
        if none:
            lines.append(f"at {level:g} {and_list(none)}")
    if not lines:
        return ""
    why = "an answer is less accurate, a step failed, or a run is missing or did not finish"
    return f"No such way: {'; '.join(lines)} ({why})."


def _row(view: Records, level: float, place: int, way: Verdict, demand: Demand) -> tuple[Cell, ...]:
    p50, p99 = _intervals(view, way)
    return row_of(
        Cell(f"≤ {level:g}", "good" if level == demand.error_move else ""),
        str(place),
        way.configuration.solver,
        way.configuration.route,
        way.configuration.policy,
        way.configuration.settings,
        way.outcome,
        judged_on(way),
        error_text(way.error_move),
        time_text(way.p50_ns),
        interval_text(p50.low, p50.high, 1e3),
        Cell(time_text(way.p99_ns), "bad" if way.p99_ns > demand.p99_ns else ""),
        interval_text(p99.low, p99.high, 1e3),
        f"`{way.timed_on}`",
        time_text(way.algo_max_ns),
    )


def _intervals(view: Records, way: Verdict) -> tuple[Interval, Interval]:
    """Bootstrap intervals of p50 and p99 on the sequence they belong to."""
    configuration = {
        "route": way.configuration.route,
        "policy": way.configuration.policy,
        "settings": way.configuration.settings,
    }
    for row in view.replays(way.timed_on, solver=way.configuration.solver, **configuration):
        times = view.times(row)
        if times is not None:
            algo = times.algo_ns
            return percentile_interval(algo, 50), percentile_interval(algo, 99)
    return UNKNOWN, UNKNOWN
