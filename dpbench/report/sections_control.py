"""The sections on the ship: figures of the paper, control tables, what is reproduced."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized

from matplotlib.figure import Figure

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.bench.design import Designs
from dpbench.report.blocks import (
    Block,
    Bullets,
    Paragraph,
    Picture,
    Section,
    Tabular,
    missing,
)
from dpbench.report.figures import deviations
from dpbench.report.figures_paper import (
    Law,
    forces,
    increments,
    laws_of,
    precision,
    trajectory,
)
from dpbench.report.figures_ship import ship
from dpbench.report.formats import and_list, count_text, plural
from dpbench.report.is_paper_scenario import OF_PAPER, is_of_paper
from dpbench.report.reproduced import (
    BRACKETED,
    DESIGN_LIMITS,
    MISPRINTS,
    NOT_BRACKETED,
    Claim,
    choices,
    claims,
)
from dpbench.report.sections_time import timing_pictures
from dpbench.report.table import Cell, Mark, Table, row_of
from dpbench.report.tables_control import control_tables
from dpbench.report.tables_design import design_table
from dpbench.scenario.scenario import Scenario

Draw = Callable[[Sequence[Law], Scenario], Figure]

FIGURES: dict[str, tuple[tuple[str, str, Draw], ...]] = {
    "paper": (
        ("fig4", "Figure 4 of the paper: trajectory", trajectory),
        ("fig5", "Figure 5 of the paper: precision", precision),
        ("fig6", "Figure 6 of the paper: control forces", forces),
        ("fig7", "Figure 7 of the paper: increments of the control forces", increments),
    ),
    "paper_tight": (
        ("tight_fig4", "Figure 4 with R × 0.7", trajectory),
        ("tight_fig5", "Figure 5 with R × 0.7", precision),
    ),
}


DRAWN = 12
"""Scenarios that get a figure of their own; a campaign may have a hundred."""


def figures_section(view: Records, demand: Demand) -> Section:
    """The figures of the paper, the step times, the deviations."""
    section = Section("figures", "Figures")
    for name, figures in FIGURES.items():
        if is_of_paper(view, name):
            section.add(*_paper_pictures(view, name, figures))
    section.add(*_ship_pictures(view))
    section.add(*timing_pictures(view, demand))
    loops = {s: [r for r in view.full_loops(s) if r.has_steps] for s in view.scenarios}
    every = {scenario: rows for scenario, rows in loops.items() if rows}
    drawn = dict(list(every.items())[:DRAWN])
    if drawn:
        section.add(
            Picture(
                "deviation",
                "Deviation of each closed loop from the exactly solved one",
                "Full length, scaled units, settings default. A number of steps beside a bar "
                f"marks a run that was stopped early.{_left_out(every)}",
                deviations(drawn),
            )
        )
    return section


def _left_out(scenarios: Sized) -> str:
    """A sentence when there are more scenarios than are drawn."""
    if len(scenarios) <= DRAWN:
        return ""
    return f" The first {DRAWN} of {len(scenarios)} scenarios; the tables have all."


def _paper_pictures(
    view: Records, name: str, figures: Sequence[tuple[str, str, Draw]]
) -> list[Block]:
    scenario, laws = view.scenario(name), laws_of(view, name)
    if scenario is None or not laws:
        return [missing(f"no complete closed loop of `{name}`, so its figures are not drawn.")]
    caption = _caption(laws, scenario)
    return [Picture(key, title, caption, draw(laws, scenario)) for key, title, draw in figures]


def _ship_pictures(view: Records) -> list[Block]:
    """One figure for each scenario that is not the paper's and has a whole closed loop."""
    blocks: list[Block] = []
    for i, name in enumerate(view.scenarios):
        scenario = view.scenario(name)
        laws = [law for law in laws_of(view, name) if len(law.steps) >= view.whole_steps(name)]
        if scenario is None or not laws or is_of_paper(view, name):
            continue
        blocks.append(
            Picture(
                f"ship_{i + 1}",
                f"The ship in {name}",
                f"{_caption(laws, scenario)} Dashed: limits.",
                ship(laws, scenario),
            )
        )
        if len(blocks) == DRAWN:
            break
    return blocks


def _caption(laws: Sequence[Law], scenario: Scenario) -> str:
    steps = max(len(law.steps) for law in laws)
    of = f" (of {count_text(scenario.steps)})" if steps < scenario.steps else ""
    shown = and_list([law.label for law in laws])
    return (
        f"Scenario `{scenario.name}`, {plural(steps, 'step')}{of} of {scenario.sample_s:g} s: "
        f"{shown}."
    )


def control_section(view: Records, demand: Demand) -> Section:
    """What every solver's own closed loop did to the ship."""
    section = Section("control", "Control")
    tables = [table for name in view.scenarios for table in control_tables(view, name, demand)]
    section.add(*(Tabular(table) for table in tables))
    if not tables:
        section.add(missing("no full-length closed loop left a step."))
    return section


def reproduced_section(view: Records, designs: Designs | None) -> Section:
    """What of the paper is reproduced and what is not. The designs are those of the suite."""
    section = Section("paper", "The paper, reproduced")
    stability = [Tabular(design_table(designs))] if designs is not None else []
    if not any(is_of_paper(view, name) for name in OF_PAPER):
        section.add(Paragraph("No scenario of the paper was in this suite."), *stability)
        return section
    found = claims(view)
    done = sum(claim.state == "reproduced" for claim in found)
    failed = sum(claim.state == "not reproduced" for claim in found)
    section.add(
        Paragraph(
            f"Of {plural(len(found), 'claim')} {done} are reproduced, {failed} are not, "
            f"{len(found) - done - failed} were not measured. Constrained means the complete "
            "closed loop that follows the exactly solved one most closely; a claim takes one over "
            "the whole scenario."
        ),
        Tabular(_claims_table(found)),
    )
    chosen = choices(view)
    if chosen:
        section.add(
            Paragraph("The paper leaves open what `paper` had to choose:"),
            Bullets(tuple(f"**{what}**: {choice}." for what, choice in chosen)),
        )
    if is_of_paper(view, "paper") and any(row.has_steps for row in view.full_loops("paper")):
        section.add(Paragraph(DESIGN_LIMITS + (BRACKETED if designs else NOT_BRACKETED)))
    section.add(
        *stability,
        Paragraph("Misprints to mind when reading it:"),
        Bullets(MISPRINTS),
    )
    return section


def _claims_table(found: Sequence[Claim]) -> Table:
    marks: dict[str, Mark] = {
        "reproduced": "good",
        "not reproduced": "bad",
        "not measured": "quiet",
    }
    return Table(
        title="Claims of the paper",
        note="Section IV and Figures 4-7 of Xia, Liu, Pang & Xue, against the closed loops of "
        "this report. The paper prints no numbers for these claims.",
        heads=("claim", "", "what the rows say"),
        rows=tuple(row_of(c.claim, Cell(c.state, marks[c.state]), c.found) for c in found),
        text_columns=3,
    )
