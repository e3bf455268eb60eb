"""Tables of accuracy: the full-length closed loops, and the effect of units and settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.report.formats import MISSING, count_text, error_text, plural, share_text
from dpbench.report.table import Cell, Table, good_if, row_of

ARMS = (("scaled", "default"), ("scaled", "high"), ("si", "default"), ("si", "high"))
"""Units and settings of the units table, in its column order."""


def by_error(row: RunRecord) -> tuple[bool, float, str]:
    """Sort key: ranked solvers by their largest error, then the baseline law."""
    worst = row.error_move_max
    return row.is_baseline_law, math.inf if math.isnan(worst) else worst, row.short_name


def accuracy_table(view: Records, scenario: str, demand: Demand) -> Table | None:
    """The answers of the full-length closed loops of one scenario; None when there is none."""
    rows = [row for row in view.full_loops(scenario) if row.has_steps]
    if not rows:
        return None
    steps = view.full_steps(scenario)
    bound = np.array([row.optimum_bound_max for row in rows])
    certified = float(np.nanmax(bound)) if np.isfinite(bound).any() else math.nan
    undecided = np.nansum([row.undecided_steps for row in rows])
    return Table(
        title=f"Accuracy in `{scenario}`",
        note=(
            f"Closed loop, scaled units, settings default, {plural(steps, 'step')} asked of "
            f"each of {plural(len(rows), 'configuration')}; each steers its own ship, so the "
            "QPs differ. "
            f"Errors against the certified optimum of the same QP (largest certified bound "
            f"{error_text(certified)}). Failed: the fallback acted or an unfinished iterate was "
            "applied. An infinite error is printed as no answer."
            + (
                f" {plural(undecided, 'step')} of them all are feasible or infeasible only by "
                "rounding: undecided, charged to nobody."
                if undecided
                else ""
            )
        ),
        heads=(
            "solver",
            "route",
            "steps",
            "claimed",
            "true",
            "claimed, not true",
            "true, not claimed",
            "error_move p50",
            "error_move max",
            "error_plan max",
            "failed",
            "not certified",
        ),
        rows=tuple(_accuracy_row(row, demand) for row in sorted(rows, key=by_error)),
        text_columns=2,
    )


def _accuracy_row(row: RunRecord, demand: Demand) -> tuple[Cell, ...]:
    move, done = row.error_move_max, row.steps_done
    lied, failed = row.claimed_not_true, row.failed_steps
    law = row.is_baseline_law
    return row_of(
        Cell(f"{row.short_name} (baseline_law)" if law else row.short_name, "quiet" if law else ""),
        row.route,
        good_if(count_text(done), done >= row.steps_planned),
        share_text(row.claimed_share),
        good_if(share_text(row.true_share), row.true_share == 1.0),
        good_if(count_text(lied), not lied > 0),
        count_text(row.true_not_claimed),
        error_text(row.error_move_p50),
        good_if(error_text(move), not move > demand.error_move),
        error_text(row.error_plan_max),
        good_if(count_text(failed), not failed > demand.failed_steps),
        count_text(row.uncertified),
    )


@dataclass(frozen=True)
class UnitsCell:
    """What one configuration of the units comparison did in its first steps.

    true_share and error_move (largest; inf without an answer) over `steps` of `asked` steps.
    """

    true_share: float
    error_move: float
    steps: int
    asked: int


@dataclass(frozen=True)
class UnitsMatrix:
    """Solver × (scenario, units, settings): the units comparison."""

    solvers: tuple[str, ...]
    columns: tuple[tuple[str, str, str], ...]
    cells: dict[tuple[str, tuple[str, str, str]], UnitsCell]
    steps: dict[str, int]


def units_matrix(view: Records) -> UnitsMatrix | None:
    """All solvers in both unit systems; None when the suite ran only one system."""
    loops = [
        row
        for row in view.select(mode="closed_loop", policy="fresh", default_route=True)
        if not row.is_baseline_law and row.outcome != "refused"
    ]
    si = [row for row in loops if row.units == "si"]
    scenarios = list(dict.fromkeys(row.scenario for row in si))
    if not scenarios:
        return None
    steps = {s: int(min(r.steps_planned for r in loops if r.scenario == s)) for s in scenarios}
    seen = {(r.scenario, r.units, r.settings) for r in loops}
    columns = tuple((s, u, a) for s in scenarios for u, a in ARMS if (s, u, a) in seen)
    cells: dict[tuple[str, tuple[str, str, str]], UnitsCell] = {}
    for row in loops:
        column = (row.scenario, row.units, row.settings)
        if column in columns:
            cells[row.solver, column] = _units_cell(view, row, steps[column[0]])
    names = {solver for solver, _ in cells}

    def worst(solver: str) -> tuple[int, str]:
        mine = [cells[solver, c].true_share for c in columns if (solver, c) in cells]
        return -sum(share == 1.0 for share in mine), solver

    return UnitsMatrix(tuple(sorted(names, key=worst)), columns, cells, steps)


def _units_cell(view: Records, row: RunRecord, asked: int) -> UnitsCell:
    steps = view.steps(row)
    first = steps[steps["k"] < asked]
    if first.empty:
        return UnitsCell(math.nan, math.nan, 0, asked)
    # A step that was never reached is a step without a true answer.
    true = float(first["true"].to_numpy(dtype=bool).sum()) / asked
    error = first["error_move"].to_numpy(dtype=np.float64)
    known = error[~np.isnan(error)]
    largest = float(known.max()) if len(known) else math.nan
    return UnitsCell(true, largest, len(first), asked)


def units_table(matrix: UnitsMatrix) -> Table:
    """Share of true answers and the largest error of the first move, per configuration."""
    counts = ", ".join(f"first {plural(n, 'step')} of `{s}`" for s, n in matrix.steps.items())
    rows = []
    for solver in matrix.solvers:
        cells = [_units_text(matrix.cells.get((solver, column))) for column in matrix.columns]
        rows.append(row_of(solver, *cells))
    return Table(
        title="Who still answers right in raw units",
        note=(
            f"Closed loop, default route, policy fresh; {counts}. Each cell: share of steps with "
            "a true answer (a step that was never reached counts as not true), then the largest "
            "error_move of the steps that were reached to one digit (∞: a step without an answer), "
            "and in brackets how many were reached where not all. Sorted by the number of "
            "configurations that are right on every step."
        ),
        heads=("solver", *(f"{s}: {u}, {a}" for s, u, a in matrix.columns)),
        rows=tuple(rows),
    )


def _units_text(cell: UnitsCell | None) -> Cell:
    if cell is None or cell.steps == 0:
        return Cell(MISSING, "quiet")
    early = f" ({count_text(cell.steps)})" if cell.steps < cell.asked else ""
    text = f"{share_text(cell.true_share)}, {_short_error(cell.error_move)}{early}"
    if cell.true_share == 1.0:
        return Cell(text, "good")
    return Cell(text, "warn" if cell.true_share >= 0.99 else "bad")


def _short_error(value: float) -> str:
    """An error to one digit, so that all configurations fit beside each other on a page."""
    if not math.isfinite(value) or value == 0.0:
        return "∞" if math.isinf(value) else error_text(value)
    digits, exponent = f"{value:.0e}".split("e")
    return f"{digits}e{int(exponent)}" if not 1e-2 <= value < 1e3 else f"{value:.1g}"


def settings_without_effect(rows: Sequence[RunRecord]) -> list[str]:
    """Solvers whose configurations at two settings levels are one run shown under both names."""
    from_levels: dict[str, dict[str, tuple[object, ...]]] = {}
    for row in rows:
        if row.has_steps:
            figures = (row.raw_max_ns, row.raw_p50_ns, row.steps_done)
            key = f"{row.solver}|{row.route}|{row.policy}|{row.sequence}"
            from_levels.setdefault(key, {})[row.settings] = figures
    same = {
        key.split("|")[0]
        for key, levels in from_levels.items()
        if len(levels) > 1 and len(set(levels.values())) == 1
    }
    return sorted(same)
