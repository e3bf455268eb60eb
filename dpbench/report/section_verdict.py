"""The first section: the verdict, in cards, sentences and one table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dpbench.report.blocks import Bullets, Card, Cards, Paragraph, Section, Tabular, missing
from dpbench.report.demand import Demand, demand_text
from dpbench.report.fastest import Candidate, candidates
from dpbench.report.fastest_text import (
    fastest_arm,
    fastest_usual,
    fastest_way,
    first_ways,
    yardstick,
)
from dpbench.report.formats import (
    MISSING,
    count_text,
    error_text,
    plural,
    rounded_down,
    time_text,
)
from dpbench.report.ranking import Contender, fastest_first
from dpbench.report.table import Cell, Mark, Table, row_of
from dpbench.report.tables_levels import level_tables
from dpbench.report.verdict import Verdict, judge_all
from dpbench.report.verdict_text import contrast, elsewhere, sentence, summary
from dpbench.report.view import View

Verdicts = Mapping[str, Sequence[Verdict]]
MARKS: dict[str, Mark] = {"meets": "good", "misses": "bad", "open": "warn", "not run": "quiet"}
ORDER = tuple(MARKS)


def verdict_lines(view: View, demand: Demand) -> list[str]:
    """The verdict in a few plain lines without markup, for a terminal."""
    verdicts = judge_all(view, demand)
    if not verdicts:
        return summary(verdicts)
    first = next(iter(verdicts))
    lines = [
        *summary(verdicts),
        *fastest_usual(view, verdicts[first], demand),
        *fastest_arm(view, candidates(view, demand)),
    ]
    return [line.replace("**", "").replace("`", "") for line in lines]


def verdict_section(view: View, demand: Demand) -> Section:
    """Which solvers meet the demand, which do not and why."""
    section = Section("verdict", "Verdict")
    verdicts = judge_all(view, demand)
    if not verdicts:
        section.add(missing("no solver was run in scaled units, nothing is judged."))
        return section
    first = next(iter(verdicts))
    ordered = _ordered(verdicts[first])
    found = candidates(view, demand)
    section.add(
        Paragraph(" ".join(summary(verdicts)), lead=True),
        Paragraph(" ".join(fastest_arm(view, found)), lead=True),
        Cards(_cards(verdicts, found, demand)),
        Paragraph(demand_text(demand)),
        *(Paragraph(line) for line in fastest_usual(view, verdicts[first], demand)),
        Tabular(verdict_table(verdicts, demand)),
        *(Tabular(table) for table in level_tables(view, demand, verdicts[first])),
        Bullets(
            tuple(
                sentence(v, demand) + elsewhere(verdicts, v) + fastest_way(found, v.solver)
                for v in ordered
            )
        ),
        Paragraph(contrast(view)),
    )
    return section


def _ordered(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return sorted(fastest_first(verdicts), key=lambda v: ORDER.index(v.outcome))


def _cards(verdicts: Verdicts, found: Sequence[Candidate], demand: Demand) -> tuple[Card, ...]:
    first = next(iter(verdicts))
    default = verdicts[first]
    good = fastest_first([v for v in default if v.outcome == "meets"])
    run = [v for v in default if v.outcome != "not run"]
    rescued = {
        v.solver for level in list(verdicts)[1:] for v in verdicts[level] if v.outcome == "meets"
    } - {v.solver for v in good}
    cards = [_count_card(run, good, first)]
    if len(verdicts) > 1:
        others = ", ".join(sorted(rescued)) or "none"
        mark: Mark = "warn" if rescued else ""
        cards.append(Card("only with other settings", str(len(rescued)), others, mark))
    for arm in first_ways(found)[:1]:
        words = (
            f"{arm.route} {arm.policy}, {arm.settings}: {_figure(arm)}, judged on {arm.judged_on}"
        )
        cards.append(Card(f"fastest way of all, by {yardstick(arm)}", arm.solver, words, "good"))
    return (*cards, *_usual_cards(good, demand))


def _count_card(run: Sequence[Verdict], good: Sequence[Verdict], level: str) -> Card:
    title = f"meet the demand, settings {level}"
    unsure = sum(v.outcome == "open" for v in run)
    if unsure and not good:
        return Card(title, "open", f"{unsure} of {len(run)} that ran cannot be judged", "warn")
    return Card(title, f"{len(good)} of {len(run)}", "solvers that ran", "good" if good else "bad")


def _usual_cards(good: Sequence[Verdict], demand: Demand) -> tuple[Card, ...]:
    """The fastest solver on its default route, policy fresh, and how slow a computer may be."""
    if not good:
        return ()
    best = good[0]
    stands = f"before its largest step, {time_text(best.algo_max_ns)}, takes {demand.deadline_ms:g}"
    return (
        Card(
            f"fastest by {yardstick(best)}, default route",
            best.solver,
            f"{best.route} fresh: {_figure(best)}",
            "good",
        ),
        Card("slow-down it stands", _slowdown(best, demand), f"{stands} ms"),
    )


def _figure(arm: Contender) -> str:
    if math.isfinite(arm.p99_ns):
        return f"p99 {time_text(arm.p99_ns)}"
    return f"largest step {time_text(arm.algo_max_ns)}"


def verdict_table(verdicts: Verdicts, demand: Demand) -> Table:
    """One row per solver: outcome at each settings level and the figures behind the first."""
    first, *others = verdicts
    rows = []
    for verdict in _ordered(verdicts[first]):
        levels = [verdict] + [
            v for level in others for v in verdicts[level] if v.solver == verdict.solver
        ]
        rows.append(
            row_of(
                verdict.solver,
                verdict.route or MISSING,
                *(Cell(v.outcome, MARKS[v.outcome]) for v in levels),
                error_text(verdict.error_move),
                count_text(verdict.failed_steps) if verdict.steps else MISSING,
                time_text(verdict.p99_ns),
                time_text(verdict.algo_max_ns),
                _slowdown(verdict, demand),
                count_text(verdict.steps) if verdict.steps else MISSING,
            )
        )
    return Table(
        title="Verdict per solver",
        note=(
            f"Scaled units, default route, policy fresh; figures of settings {first}. Accuracy: "
            "every step of the longest closed loop per scenario and of the replays. Time: "
            "algorithmic, from replays alone; p99 is the worst over the sequences that support "
            f"one. Slow-down: {demand.deadline_ms:g} ms over the largest algorithmic step time, "
            f"rounded down. {plural(len(rows), 'solver')}."
        ),
        heads=(
            "solver",
            "route",
            *(f"settings {level}" for level in verdicts),
            "error_move max",
            "failed",
            "p99",
            "largest step",
            "slow-down",
            "judged steps",
        ),
        rows=tuple(rows),
        text_columns=2 + len(verdicts),
    )


def _slowdown(verdict: Verdict, demand: Demand) -> str:
    if not math.isfinite(verdict.algo_max_ns):
        return MISSING
    return f"× {rounded_down(verdict.slowdown(demand))}"
