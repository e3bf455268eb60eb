"""The section on deadlines: what late answers of a slow computer do to the ship."""

from __future__ import annotations

import math

from dpbench.analysis.machine import delayed_runs, disturbance_of
from dpbench.analysis.records import Records
from dpbench.analysis.slowdown import DelayedGroup, cost_ratio, delayed_groups
from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.figures_deadline import slowdown_figure
from dpbench.report.formats import and_list, factor_text, plural
from dpbench.report.machine_verdict import verdict_text
from dpbench.report.tables_deadline import WITHIN, misses_table, survival_table

INTRODUCTION = (
    "The ship's computer is so many times slower than this machine: the measured time of a step "
    "(set-up + update + solve + read; less what the kernel gave to others meanwhile) times the "
    "slow-down is the latency of its answer. Within the budget the answer is applied at its own "
    "sample. A later one is applied at the first sample after it arrived, at the force its plan "
    "has by then; until then the fallback steers, and no other computation begins. Time is "
    "simulated, not waited for. These loops are kept out of every other section."
)


def deadline_section(view: Records) -> Section | None:
    """Cost, misses and survival on slow computers; None where no loop ran on one."""
    groups = delayed_groups(view)
    if not groups:
        return None
    section = Section("deadline", "Slow computers and late answers")
    section.add(Paragraph(INTRODUCTION))
    found = disturbance_of(delayed_runs(view))
    if found.seconds > 0:
        section.add(Paragraph(f"**While the loops ran the machine was {verdict_text(found)}.**"))
    for i, group in enumerate(groups):
        section.add(*_blocks(i, group, view))
    return section


def deadline_lines(view: Records) -> list[str]:
    """Who survives which slow-down, a line per scenario, for a terminal."""
    return [_line(group).replace("**", "") for group in delayed_groups(view)]


def _blocks(i: int, group: DelayedGroup, view: Records) -> list[Block]:
    ran = [
        configuration
        for configuration in group.configurations
        if any(math.isfinite(cost_ratio(r)) for r in configuration.loops.values())
    ]
    cpu = str(view.machine.get("cpu_model", "an unnamed CPU"))
    tables = [Tabular(survival_table(group, cpu)), Tabular(misses_table(group))]
    if not ran:
        return [missing(f"no loop in `{group.scenario}` was run to its end."), *tables]
    picture = Picture(
        f"slowdown_{i + 1}",
        f"Closed-loop cost against slow-down in {group.scenario}",
        f"{plural(len(ran), 'configuration')}, {plural(group.steps, 'step')}; cost over that of "
        "the exactly "
        f"solved loop, in which no answer is late. Dashed: {WITHIN}; hollow: beyond. A line ends "
        "at the last loop that was run to its end.",
        slowdown_figure(group),
    )
    return [Paragraph(_line(group)), picture, *tables]


def _line(group: DelayedGroup) -> str:
    """Which solvers survive which slow-down, the largest first."""
    by_factor: dict[float, list[str]] = {}
    for configuration in group.configurations:
        survives = configuration.survives
        by_factor.setdefault(-1.0 if math.isnan(survives) else survives, []).append(
            configuration.name
        )
    words = [
        f"up to **{factor_text(factor)}**: {and_list(names)}"
        if factor > 0
        else f"at no slow-down: {and_list(names)}"
        for factor, names in sorted(by_factor.items(), reverse=True)
    ]
    within = f"cost {WITHIN} of the exactly solved loop's"
    return f"Scenario `{group.scenario}`, {within} {'; '.join(words)}."
