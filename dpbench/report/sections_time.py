"""The sections on step times and the figures drawn from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.times.horizon_sweep import between_ends, sweeps
from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.figures import step_times
from dpbench.report.formats import plural
from dpbench.report.formulations import OTHERS, formulation_tables
from dpbench.report.section_harness import machine_blocks
from dpbench.report.tables_timing import (
    PooledConfiguration,
    jitter_table,
    timed_configurations,
    timing_tables,
)

ENDS_ONLY = (
    "Of a horizon sweep the shortest and the longest horizons stand here in full and those between "
    "are folded; how times grow from one to the next is said in the section on the horizon."
)


def timing_section(view: Records, demand: Demand) -> Section:
    """Step times from replays alone."""
    section = Section("timing", "Step times")
    section.add(
        Paragraph(
            "Only replays rank step times: there every solver gets byte-identical QPs. Times of "
            "closed loops belong to different QPs and are ranked nowhere."
        )
    )
    section.add(*machine_blocks(view))
    found = False
    repeated = between_ends(sweeps(view, demand))
    if repeated:
        section.add(Paragraph(ENDS_ONLY))
    for sequence in view.sequences:
        ranked, raw = timing_tables(view, sequence, demand), jitter_table(view, sequence)
        if raw is not None:
            found = True
            if sequence in repeated:
                ranked = [replace(table, folded=True) for table in ranked]
            section.add(*(Tabular(table) for table in ranked), Tabular(raw))
    if not found and not view.calibration:
        section.add(missing("no replay left a step, so no time is given."))
    formulated = formulation_tables(view, demand)
    if formulated:
        section.add(Paragraph(OTHERS), *(Tabular(table) for table in formulated))
    return section


def timing_pictures(view: Records, demand: Demand) -> list[Block]:
    """Distributions of step times, per replayed sequence."""
    blocks: list[Block] = []
    repeated = between_ends(sweeps(view, demand))
    for i, sequence in enumerate(view.sequences):
        configurations = timed_configurations(view, sequence)
        if not configurations or sequence in repeated:
            continue
        usual = [
            configuration
            for configuration in configurations
            if configuration[0].settings == "default"
        ] or configurations
        shown = _two_of_each(usual)
        steps = plural(max(len(times.algo_ns) for _, times in shown), "step")
        blocks.append(
            Picture(
                f"step_times_{i + 1}",
                f"Step times in the replay of {sequence}",
                f"{plural(len(shown), 'configuration')} of {len(usual)}, {steps}, settings "
                "default; of each "
                "solver the default route with policy fresh and the fastest by median.",
                step_times(shown, demand),
            )
        )
    return blocks


def _two_of_each(configurations: Sequence[PooledConfiguration]) -> list[PooledConfiguration]:
    """Of each solver its default configuration and its fastest one; `configurations` come fastest
    first."""
    fastest: dict[str, PooledConfiguration] = {}
    for configuration in configurations:
        fastest.setdefault(configuration[0].solver, configuration)
    return [
        configuration
        for configuration in configurations
        if (configuration[0].default_route and configuration[0].policy == "fresh")
        or fastest[configuration[0].solver] is configuration
    ]
