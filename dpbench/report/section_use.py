"""The section on solvers used as a controller would use them: set up once, updated, kept warm."""

from __future__ import annotations

from collections.abc import Sequence

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records
from dpbench.analysis.times.horizon_sweep import between_ends, sweeps
from dpbench.analysis.times.routes import (
    ABOVE,
    LEVELS,
    SLOWER_SHARE,
    WRAPPED,
    RouteComparison,
    native_comparisons,
    route_comparisons,
)
from dpbench.report.blocks import Block, Bullets, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.figures_use import step_down
from dpbench.report.formats import plural
from dpbench.report.routes_text import beside_wrapped, remark_lines
from dpbench.report.table import Table, row_of
from dpbench.report.tables_use import kept_table, missing_table, route_table

INTRODUCTION = (
    "A controller sets its solver up once, then hands over q, l and u at every sample and solves "
    "again. Route `native` does that; route `qpsolvers` sets up anew behind every call. The step "
    "down from qpsolvers fresh to native fresh is what the wrapper costs, from fresh to reuse what "
    "a kept workspace gains, from reuse to warm what a start from the shifted previous answer "
    "gains."
)

MORE = f"measurably and more than {100 * SLOWER_SHARE:g} %"


ENDS_ONLY = "Of a horizon sweep this section holds the shortest and the longest horizons."


def use_section(view: Records, demand: Demand) -> Section:
    """What the wrapper costs, and what a kept workspace and a warm start bring or break."""
    section = Section("use", "As a controller would use it")
    section.add(Paragraph(INTRODUCTION))
    repeated = between_ends(sweeps(view, demand))
    shown = [sequence for sequence in view.sequences if sequence not in repeated]
    if repeated:
        section.add(Paragraph(ENDS_ONLY))
    every = {sequence: route_comparisons(view, sequence) for sequence in shown}
    native = {sequence: native_comparisons(ways) for sequence, ways in every.items()}
    if not any(WRAPPED in w.times for ways in native.values() for w in ways):
        section.add(missing("no solver was replayed both natively and through qpsolvers."))
    for i, (sequence, ways) in enumerate(every.items()):
        section.add(*_routes(i, sequence, native[sequence], demand))
        section.add(*_standing_out(sequence, [w for w in ways if w.settings == "default"]))
        tables = (
            route_table(native[sequence], sequence, others=True),
            _remark_table(sequence, [w for w in ways if w.settings != "default"]),
            kept_table(ways, sequence),
        )
        section.add(*(Tabular(table) for table in tables if table is not None))
    absent = missing_table(native)
    section.add(*([Tabular(absent)] if absent is not None else []))
    return section


def _routes(
    i: int, sequence: str, native: Sequence[RouteComparison], demand: Demand
) -> list[Block]:
    """Table and figure of the settings `default`."""
    table = route_table(native, sequence)
    if table is None:
        return []
    usual = [w for w in native if w.settings == "default"]
    right = [frozenset(way for way in w.times if is_right(w.runs[way], demand)) for w in usual]
    configurations = sum(way in w.times for w in usual for way in LEVELS)
    picture = Picture(
        f"step_down_{i + 1}",
        f"From wrapper to warm start in the replay of {sequence}",
        f"{plural(len(usual), 'solver')}, {plural(configurations, 'configuration')}, settings "
        "default, "
        "fastest by median first; each stair steps down from qpsolvers fresh to native warm. "
        "Hollow: an answer misses the demand.",
        step_down(usual, right),
    )
    lines = [beside_wrapped(sequence, usual)]
    return [*(Paragraph(line) for line in lines if line), Tabular(table), picture]


def _standing_out(sequence: str, ways: Sequence[RouteComparison]) -> list[Block]:
    kept = sum(way in w.times for w in ways for way in ABOVE if way[1] != "fresh")
    if not kept:
        return []
    lines = remark_lines(ways)
    if not lines:
        return [
            Paragraph(
                f"In the replay of `{sequence}` nothing stands out: "
                f"{plural(kept, 'kept configuration')} "
                f"at settings `default`, none of them {MORE} slower than what it is compared with, "
                "and none breaks an answer."
            )
        ]
    return [
        Paragraph(
            f"What stands out in the replay of `{sequence}`, settings `default` (95 % "
            "intervals in brackets):"
        ),
        Bullets(tuple(f"**{solver}**: {text}" for solver, _, text in lines)),
    ]


def _remark_table(sequence: str, ways: Sequence[RouteComparison]) -> Table | None:
    lines = remark_lines(ways)
    if not lines:
        return None
    return Table(
        title=f"What stands out in the replay of `{sequence}`, other settings",
        note=(
            f"{len(lines)} of {plural(len(ways), 'solver')} at a settings level; in the others no "
            f"way is {MORE} slower than what it is compared with, and none breaks an answer."
        ),
        heads=("solver", "settings", "what the rows show"),
        rows=tuple(row_of(*line) for line in lines),
        text_columns=3,
        folded=True,
    )
