"""The sections on step times and the figures drawn from them."""

from __future__ import annotations

from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.demand import Demand
from dpbench.report.figures import error_against_time, step_times, unanswered
from dpbench.report.formats import and_list, plural
from dpbench.report.tables_timing import gain_table, jitter_table, timed_arms, timing_table
from dpbench.report.view import View


def timing_section(view: View, demand: Demand) -> Section:
    """Step times from replays alone."""
    section = Section("timing", "Step times")
    section.add(
        Paragraph(
            "Only replays rank step times: there every solver gets byte-identical QPs. Times of "
            "closed loops belong to different QPs and are ranked nowhere."
        )
    )
    found = False
    for sequence in view.sequences:
        ranked, raw = timing_table(view, sequence, demand), jitter_table(view, sequence)
        if ranked is not None and raw is not None:
            found = True
            section.add(Tabular(ranked), Tabular(raw))
        gain = gain_table(view, sequence)
        if gain is not None:
            section.add(Tabular(gain))
    if not found:
        section.add(missing("no replay left a step, so no time is given."))
    return section


def timing_pictures(view: View, demand: Demand) -> list[Block]:
    """Distributions and error against time, per replayed sequence."""
    blocks: list[Block] = []
    for i, sequence in enumerate(view.sequences):
        arms = timed_arms(view, sequence)
        if not arms:
            continue
        shown = [arm for arm in arms if arm[0]["settings"] == "default"] or arms
        steps = plural(max(len(times.algo_ns) for _, times in shown), "step")
        blocks.append(
            Picture(
                f"step_times_{i + 1}",
                f"Step times in the replay of {sequence}",
                f"{plural(len(shown), 'arm')}, {steps}, settings default; sorted by median.",
                step_times(shown, demand),
            )
        )
        silent = unanswered(arms)
        without = (
            f" Not drawn, as they leave steps without an answer: {and_list(silent)}."
            if silent
            else ""
        )
        blocks.append(
            Picture(
                f"error_time_{i + 1}",
                f"Error against time in the replay of {sequence}",
                "Policy fresh; a line joins the settings of one solver. Errors below 1e-15 are "
                f"drawn there. {plural(len(arms), 'arm')}, {steps}.{without}",
                error_against_time(arms, demand),
            )
        )
    return blocks
