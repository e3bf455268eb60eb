"""The sections on step times and the figures drawn from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.demand import Demand
from dpbench.report.figures import error_against_time, step_times, unanswered
from dpbench.report.formats import and_list, plural
from dpbench.report.formulations import OTHERS, formulation_tables
from dpbench.report.section_harness import machine_blocks
from dpbench.report.sweep import between_ends, sweeps
from dpbench.report.tables_timing import Arm, jitter_table, timed_arms, timing_tables
from dpbench.report.view import View

ENDS_ONLY = (
    "Of a horizon sweep the shortest and the longest horizons stand here in full and those between "
    "are folded; how times grow from one to the next is said in the section on the horizon."
)


def timing_section(view: View, demand: Demand) -> Section:
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


def timing_pictures(view: View, demand: Demand) -> list[Block]:
    """Distributions and error against time, per replayed sequence."""
    blocks: list[Block] = []
    repeated = between_ends(sweeps(view, demand))
    for i, sequence in enumerate(view.sequences):
        arms = timed_arms(view, sequence)
        if not arms or sequence in repeated:
            continue
        usual = [arm for arm in arms if arm[0]["settings"] == "default"] or arms
        shown = _two_of_each(usual)
        steps = plural(max(len(times.algo_ns) for _, times in shown), "step")
        blocks.append(
            Picture(
                f"step_times_{i + 1}",
                f"Step times in the replay of {sequence}",
                f"{plural(len(shown), 'arm')} of {len(usual)}, {steps}, settings default; of each "
                "solver the default route with policy fresh and the fastest by median.",
                step_times(shown, demand),
            )
        )
        fresh = [arm for arm in arms if arm[0]["policy"] == "fresh" and arm[0]["default_route"]]
        native = _fastest_native(arms)
        if fresh:
            blocks.append(_error_picture(f"error_time_{i + 1}", sequence, fresh, demand))
        if any(row["policy"] != "fresh" for row, _ in native):
            name = f"error_time_native_{i + 1}"
            blocks.append(_error_picture(name, sequence, native, demand, native=True))
    return blocks


def _two_of_each(arms: Sequence[Arm]) -> list[Arm]:
    """Of each solver its default arm and its fastest one; `arms` come fastest first."""
    fastest: dict[str, Arm] = {}
    for arm in arms:
        fastest.setdefault(str(arm[0]["solver"]), arm)
    return [
        arm
        for arm in arms
        if (arm[0]["default_route"] and arm[0]["policy"] == "fresh")
        or fastest[str(arm[0]["solver"])] is arm
    ]


def _fastest_native(arms: Sequence[Arm]) -> list[Arm]:
    """The fastest policy on route native of each solver and settings; `arms` fastest first."""
    fastest: dict[tuple[str, str], Arm] = {}
    for arm in arms:
        if arm[0]["route"] == "native":
            fastest.setdefault((str(arm[0]["solver"]), str(arm[0]["settings"])), arm)
    return list(fastest.values())


def _error_picture(
    name: str, sequence: str, arms: Sequence[Arm], demand: Demand, *, native: bool = False
) -> Picture:
    how = "route native, fastest policy by median" if native else "default route, policy fresh"
    steps = plural(max(len(times.algo_ns) for _, times in arms), "step")
    silent = unanswered(arms)
    without = (
        f" Not drawn, as they leave steps without an answer: {and_list(silent)}." if silent else ""
    )
    return Picture(
        name,
        f"Error against time in the replay of {sequence}, {how}",
        "A line joins the settings of one solver; failed: the most steps of one arm. "
        "Errors below 1e-15 are drawn there. "
        f"{plural(len(arms), 'arm')}, {steps}.{without}",
        error_against_time(arms, demand),
    )
