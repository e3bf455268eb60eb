"""Stability of the paper's controller and others, and the sway offset each holds."""

from __future__ import annotations

from dpbench.bench.design import STILL, WEATHER, Bracket, DesignRecord, Designs
from dpbench.report.formats import MISSING, rounded_down, rounded_up
from dpbench.report.table import Cell, Table, good_if, row_of


def design_table(designs: Designs) -> Table:
    """A row for every controller and vessel."""
    missing = "".join(
        f" Missing: `{one.controller}` in `{one.vessel}`: {one.reason}." for one in designs.missing
    )
    return Table(
        title="Stability and sway offset held",
        note=(
            "λ are the roots of paper eq. 35: below 1 the loop is stable while no limit is active. "
            "Offset: the largest pure sway offset from which the certified optimum of every step "
            "brings the ship back, from both sides – the smallest from which it does not; ≥ where "
            f"everything tried was held.{missing}"
        ),
        heads=(
            "controller",
            "vessel",
            "largest |λ|",
            f"offset, {STILL} [m]",
            f"offset, `{WEATHER}` [m]",
        ),
        rows=tuple(_row(record) for record in designs.records),
        text_columns=2,
    )


def _row(record: DesignRecord) -> tuple[Cell, ...]:
    radius = record.spectral_radius
    return row_of(
        f"{record.tuning} {record.N_p}/{record.N_c} (`{record.controller}`)",
        f"`{record.vessel}`",
        good_if(f"{radius:.4f}", radius < 1.0),
        *(_bracket(record.held.get(weather)) for weather in (STILL, WEATHER)),
    )


def _bracket(bracket: Bracket | None) -> str:
    """Rounded outwards."""
    if bracket is None:
        return MISSING
    if bracket.fails_m is None:
        return f"≥ {bracket.holds_m:.3g}"
    if bracket.holds_m == 0.0:
        return f"< {rounded_up(bracket.fails_m)}"
    return f"{rounded_down(bracket.holds_m)} – {rounded_up(bracket.fails_m)}"
