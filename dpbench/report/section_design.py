"""The section on the design of the controllers: what no solver can mend."""

from __future__ import annotations

from collections.abc import Sequence

from dpbench.bench.design.design_file import DesignRecord, Designs
from dpbench.bench.design.region_of_attraction import (
    DURATION_S,
    OFFSETS_M,
    TAIL_S,
    TOLERANCE_M,
    WIDTH,
)
from dpbench.report.blocks import Bullets, Paragraph, Picture, Section, Tabular
from dpbench.report.figures_design import eigenvalues, regions
from dpbench.report.formats import and_list, plural
from dpbench.report.tables_design import (
    condition_text,
    count_of,
    design_table,
    gains_table,
    held_text,
    horizon_text,
    names_of,
    region_text,
    trials_table,
    weather_text,
    weathers,
)

INTRODUCTION = (
    "What the design of a controller gives before any solver plays a part: it is the same for all "
    "of them. While no limit is active the loop is linear, and its eigenvalues say how fast errors "
    "decay. The limits bound how far the ship may be thrown off: its region is measured with the "
    "certified optimum of every step."
)
METHOD = (
    f"The ship starts at rest, {OFFSETS_M[0]:g} m to {OFFSETS_M[-1]:g} m to starboard, then to "
    f"port. An offset is held when from both sides the ship stays within {TOLERANCE_M:g} m of the "
    f"reference over the last {TAIL_S:g} s of {DURATION_S:g} s, so weather that helps from one "
    "side does not count. Offsets are doubled, all of them tried, and the edge is bisected to "
    f"{100 * WIDTH:g} %."
)
REMARKS = {
    ("paper", 30, 5): " This is the paper's design.",
    ("robust", 60, 10): " This is the robust variant.",
}
"""What is known of a controller by its tuning and horizons."""


def design_section(designs: Designs) -> Section:
    """Eigenvalues, conditioning and region of each controller in each vessel."""
    section = Section("design", "Stability and design")
    records = designs.records
    section.add(Paragraph(INTRODUCTION))
    if records:
        section.add(
            Bullets(tuple(_controllers(records))),
            Tabular(design_table(records)),
            Paragraph(condition_text(records)),
            _eigenvalues(records),
            Paragraph(f"{METHOD} {_surprises(records)}"),
            _regions(records),
            Tabular(trials_table(records)),
            Tabular(gains_table(records)),
        )
    if designs.missing:
        section.add(
            Paragraph("Missing:"),
            Bullets(
                tuple(f"`{m.controller}` in `{m.vessel}`: {m.reason}" for m in designs.missing)
            ),
        )
    return section


def _controllers(records: Sequence[DesignRecord]) -> list[str]:
    """What each controller can see and hold."""
    lines = []
    for controller, name in names_of(records).items():
        theirs = [record for record in records if record.controller == controller]
        first = theirs[0]
        remark = REMARKS.get((first.tuning, first.N_p, first.N_c), "")
        end = "no terminal cost" if first.terminal == "none" else f"terminal cost {first.terminal}"
        held = " ".join(held_text(theirs, sea) for sea in weathers(theirs))
        of = f"(scenario `{controller}`)"
        lines.append(f"**{name}** {of} {horizon_text(theirs)}; {end}.{remark} {held}")
    return lines


def _surprises(records: Sequence[DesignRecord]) -> str:
    """Offsets that hold beyond one that does not, and trials without a verdict."""
    names = names_of(records)
    odd = [
        f"{record.model_scale * offset:.3g} m ({names[record.controller]} in `{record.vessel}`, "
        f"{weather_text(region.weather)}, edge {region_text(record, region)} m)"
        for record in records
        for region in record.regions
        for offset in region.bracket.above_m
    ]
    found = "No offset was held beyond one that was not."
    if odd:
        found = f"Held again beyond the edge: {and_list(odd)}."
    undecided = count_of(records, "undecided")
    if undecided:
        found += (
            f" {plural(undecided, 'trial')} met a step without a certified optimum and stayed "
            "undecided; no such offset counts as held."
        )
    return found


def _eigenvalues(records: Sequence[DesignRecord]) -> Picture:
    return Picture(
        "design_eigenvalues",
        "Eigenvalues of the unconstrained loop",
        f"{plural(len(records), 'design')}; the part of the upper half plane they lie in (the "
        "lower one mirrors it), unit circle in black. On a grey arc an error decays by 1/e in so "
        "many samples.",
        eigenvalues(records),
    )


def _regions(records: Sequence[DesignRecord]) -> Picture:
    return Picture(
        "design_regions",
        "How large a sway offset each controller holds",
        f"{plural(len(records), 'design')}; held – not held, ≥ where everything tried was held. "
        "Metres at full size, weather as named.",
        regions(records),
    )
