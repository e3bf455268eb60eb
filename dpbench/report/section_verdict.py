"""The first section: the recommendation, in cards, sentences and one table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.times.fastest import (
    fastest_first,
    fastest_of,
    known_record,
    recommend,
    why_not_aboard,
)
from dpbench.analysis.verdict import Verdict, Verdicts, verdicts_of
from dpbench.report.blocks import Bullets, Card, Cards, Paragraph, Section, Tabular, missing
from dpbench.report.formats import (
    MISSING,
    count_text,
    error_text,
    plural,
    rounded_down,
    time_text,
)
from dpbench.report.table import Cell, Mark, Table, row_of
from dpbench.report.tables_levels import level_tables
from dpbench.report.verdict_text import (
    baseline_law,
    demand_text,
    elsewhere,
    judged_on,
    recommendation,
    sentence,
    summary,
    yardstick,
)

MARKS: dict[str, Mark] = {"meets": "good", "misses": "bad", "open": "warn", "not run": "quiet"}
ORDER = tuple(MARKS)


def verdict_lines(view: Records, demand: Demand) -> list[str]:
    """The verdict in a few plain lines without markup, for a terminal."""
    verdicts = verdicts_of(view, demand)
    lines = summary(verdicts)
    if verdicts.of:
        lines += recommendation(view, verdicts)
    return [line.replace("**", "").replace("`", "") for line in lines]


def verdict_section(view: Records, demand: Demand) -> Section:
    """Which configuration to use, which solvers meet the demand, which do not and why."""
    section = Section("verdict", "Verdict")
    verdicts = verdicts_of(view, demand)
    if not verdicts.of:
        nothing = missing("no solver was run in scaled units, nothing is judged.")
        section.add(nothing, Paragraph(baseline_law(view)))
        return section
    section.add(
        Paragraph(" ".join(recommendation(view, verdicts)), lead=True),
        Paragraph(" ".join(summary(verdicts)), lead=True),
        Cards(_cards(verdicts)),
        Paragraph(demand_text(demand)),
        Tabular(verdict_table(verdicts)),
        *(Tabular(table) for table in level_tables(view, demand)),
        Bullets(tuple(sentence(v, demand) + elsewhere(verdicts, v) for v in _ordered(verdicts))),
        Paragraph(baseline_law(view)),
    )
    return section


def _ordered(verdicts: Verdicts) -> list[Verdict]:
    """The references: those that meet the demand first, each group by speed."""
    return sorted(fastest_first(verdicts.references), key=lambda v: ORDER.index(v.outcome))


def _cards(verdicts: Verdicts) -> tuple[Card, ...]:
    references = verdicts.references
    good = [v for v in references if v.outcome == "meets"]
    run = [v for v in references if v.outcome != "not run"]
    cards = [_count_card(run, good)]
    if len(verdicts.all) > len(references):
        only = sorted(
            v.configuration.solver
            for v in run
            if v.outcome != "meets"
            and any(o.outcome == "meets" for o in verdicts.of[v.configuration.solver])
        )
        mark: Mark = "warn" if only else ""
        cards.append(
            Card("only in another configuration", str(len(only)), ", ".join(only) or "none", mark)
        )
    found, demand = recommend(verdicts), verdicts.demand
    if found.chosen is not None:
        title = f"fastest that can go aboard, by {yardstick(found.chosen)}"
        cards.append(Card(title, found.chosen.configuration.solver, _way(found.chosen), "good"))
        cards += _delay_cards(found.chosen, demand)
    if found.faster is not None:
        words = f"{_way(found.faster)}; {found.because}"
        cards.append(
            Card("faster, not to go aboard as it is", found.faster.configuration.solver, words)
        )
    return tuple(cards)


def _delay_cards(chosen: Verdict, demand: Demand) -> list[Card]:
    """How slow a computer may be for the configuration that is recommended, named beside it."""
    stands = f"{chosen.configuration.label}: {{}} takes {demand.deadline_ms:g} ms"
    step = f"its largest algorithmic step, {time_text(chosen.algo_max_ns)},"
    sample = f"its largest sample, {time_text(chosen.raw_max_ns)},"
    return [
        Card("slow-down by step", _times(chosen.slowdown(demand)), stands.format(step)),
        Card("slow-down by sample", _times(chosen.raw_slowdown(demand)), stands.format(sample)),
    ]


def _count_card(run: Sequence[Verdict], good: Sequence[Verdict]) -> Card:
    title = "meet the demand by default"
    unsure = sum(v.outcome == "open" for v in run)
    if unsure and not good:
        return Card(title, "open", f"{unsure} of {len(run)} that ran cannot be judged", "warn")
    return Card(title, f"{len(good)} of {len(run)}", "solvers that ran", "good" if good else "bad")


def _way(verdict: Verdict) -> str:
    figure = (
        f"p99 {time_text(verdict.p99_ns)}"
        if math.isfinite(verdict.p99_ns)
        else f"largest step {time_text(verdict.algo_max_ns)}"
    )
    return f"{verdict.configuration.options}: {figure}, judged on {judged_on(verdict)}"


def verdict_table(verdicts: Verdicts) -> Table:
    """One row per solver: outcomes, and the figures of the fastest configuration that is right, or
    of its reference where none is."""
    rows = [_verdict_row(verdicts, verdict) for verdict in _ordered(verdicts)]
    demand = verdicts.demand
    return Table(
        title="Verdict per solver",
        note=(
            "Outcomes of the default route, policy fresh (or the nearest to it that was run), at "
            "each settings level; open: not run, or not whole, in every scenario and replay in "
            "which the default was judged, or not judged there. The figures are those of the "
            "configuration under *figures of*: the fastest that nothing contradicts, else the "
            "default. Accuracy: every step of its closed loops and replays. Time: algorithmic, "
            "from replays alone; p99 is the worst over the sequences that support one. Slow-down: "
            f"{demand.deadline_ms:g} ms over the largest algorithmic step, and over the largest "
            "single sample, jitter of this machine included; rounded down. Licence, language and "
            f"C code as each project states them. {plural(len(rows), 'solver')}."
        ),
        heads=(
            "solver",
            *(f"settings {level}" for level in verdicts.levels),
            "figures of",
            "can go aboard",
            "licence",
            "language",
            "C code",
            "error_move max",
            "failed",
            "p99",
            "largest step",
            "largest sample",
            "slow-down by step",
            "slow-down by sample",
            "judged steps",
        ),
        rows=tuple(rows),
        text_columns=6 + len(verdicts.levels),
    )


def _verdict_row(verdicts: Verdicts, reference: Verdict) -> tuple[Cell, ...]:
    solver, demand = reference.configuration.solver, verdicts.demand
    shown = fastest_of(verdicts, solver) or reference
    at = [
        next(v for v in verdicts.at(level) if v.configuration.solver == solver)
        for level in verdicts.levels
    ]
    known, why_not = known_record(solver), why_not_aboard(solver)
    facts = (
        (known.project.licence.value, known.project.language.value, known.project.c_code.value)
        if known is not None
        else (MISSING,) * 3
    )
    return row_of(
        solver,
        *(Cell(v.outcome, MARKS[v.outcome]) for v in at),
        shown.configuration.options,
        f"no: {why_not}" if why_not else "yes",
        *facts,
        error_text(shown.error_move),
        count_text(shown.failed_steps) if shown.steps else MISSING,
        time_text(shown.p99_ns),
        time_text(shown.algo_max_ns),
        time_text(shown.raw_max_ns),
        _times(shown.slowdown(demand)),
        _times(shown.raw_slowdown(demand)),
        count_text(shown.steps) if shown.steps else MISSING,
    )


def _times(slowdown: float) -> str:
    return f"× {rounded_down(slowdown)}" if math.isfinite(slowdown) else MISSING
