"""Tables of control quality: what each solver's own closed loop did to the ship."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.judge.deadlines import longest_streak
from dpbench.report.formats import (
    MISSING,
    count_text,
    error_text,
    plural,
    seconds_text,
    share_text,
    significant,
)
from dpbench.report.table import Cell, Table, row_of

Writer = Callable[[float], str]


def _short(value: float) -> str:
    return significant(value)


def _exact(value: float) -> str:
    return "0" if value == 0.0 else error_text(value) if value < 1e-3 else significant(value)


def _energy(value: float) -> str:
    return significant(value / 1e6)


MAIN: tuple[tuple[str, str, Writer], ...] = (
    ("r_rms_m", "r RMS [m]", _short),
    ("r_95_m", "r 95 % [m]", _short),
    ("r_max_m", "r max [m]", _short),
    ("heading_max_deg", "heading max [°]", _short),
    ("settle_0p1m_s", "settles in 0.1 m [s]", seconds_text),
    ("share_1m", "inside 1 m", share_text),
    ("total_variation", "total variation", _short),
    ("closed_loop_cost", "cost", _short),
    ("fallbacks", "fallbacks", count_text),
    ("missed", "late", count_text),
    ("clipped", "clipped", count_text),
    ("limit_violations", "violations", count_text),
    ("dev_position_max_m", "deviation max [m]", _exact),
)

MORE: tuple[tuple[str, str, Writer], ...] = (
    ("r_tail_max_m", "r max, 2nd half [m]", _short),
    ("heading_rms_deg", "heading RMS [°]", _short),
    ("settle_s", "settles in 1 m, 1° [s]", seconds_text),
    ("overshoot_n", "overshoot n [m]", _short),
    ("overshoot_e", "overshoot e [m]", _short),
    ("share_green", "green", share_text),
    ("share_yellow", "yellow", share_text),
    ("share_red", "red", share_text),
    ("pose_error", "pose error", _short),
    ("effort_s", "effort [s]", _short),
    ("work_J", "work [MJ]", _energy),
    ("at_rate_surge", "at rate, surge", share_text),
    ("at_rate_sway", "at rate, sway", share_text),
    ("at_rate_yaw", "at rate, yaw", share_text),
    ("at_amplitude_surge", "at amplitude, surge", share_text),
    ("at_amplitude_sway", "at amplitude, sway", share_text),
    ("at_amplitude_yaw", "at amplitude, yaw", share_text),
    ("unconverged", "unfinished", count_text),
    ("fallback_longest", "longest fallback", count_text),
    ("recover_steps_max", "recovery [steps]", count_text),
    ("missed_longest", "longest late", count_text),
    ("dev_position_rms_m", "deviation RMS [m]", _exact),
    ("dev_heading_max_deg", "heading deviation [°]", _exact),
    ("dev_force_max_N", "force deviation [N]", _exact),
)


def control_tables(view: Records, scenario: str, demand: Demand) -> list[Table]:
    """The main table of one scenario and the folded one with the rest; none without runs."""
    found = [row for row in view.full_loops(scenario) if row.has_steps]
    if not found:
        return []
    rows = sorted(found, key=_by_deviation)
    misses = {row.run_id: _misses(view, row, demand) for row in rows}
    note = _note(view, scenario, rows, demand)
    return [
        _table(f"Control in `{scenario}`", note, MAIN, rows, misses, folded=False),
        _table(f"Control in `{scenario}`: further metrics", note, MORE, rows, misses, folded=True),
    ]


def _misses(view: Records, row: RunRecord, demand: Demand) -> dict[str, float]:
    """How many steps took longer than the demand's deadline, and the longest run of such."""
    total = view.steps(row)["total_ns"].to_numpy(dtype=np.float64, na_value=np.nan)
    late = total > demand.deadline_ns
    return {"missed": int(late.sum()), "missed_longest": longest_streak(late)}


def _by_deviation(row: RunRecord) -> tuple[bool, float, str]:
    deviation = row.dev_position_max_m
    return row.is_baseline_law, math.inf if math.isnan(deviation) else deviation, row.short_name


def _note(view: Records, scenario: str, rows: Sequence[RunRecord], demand: Demand) -> str:
    early = [row for row in rows if row.steps_done < row.steps_planned]
    counts = [f"{row.short_name} ({plural(row.steps_done, 'step')})" for row in early]
    cut = f" Stopped early, metrics over what was run: {', '.join(counts)}." if early else ""
    return (
        f"Closed loop of {plural(view.full_steps(scenario), 'step')}, scaled units, settings "
        f"default, {plural(len(rows), 'configuration')}. Deviation: position against the "
        "exactly solved "
        "loop; sorted by it. Fallbacks: steps without a usable answer, in which the shifted plan "
        f"acted. Late: steps that took longer than {demand.deadline_ms:g} ms on this machine; the "
        f"ship waited for them. Violations of an applied force must be 0.{cut}"
    )


def _table(
    title: str,
    note: str,
    columns: Sequence[tuple[str, str, Writer]],
    rows: Sequence[RunRecord],
    misses: Mapping[str, Mapping[str, float]],
    *,
    folded: bool,
) -> Table:
    return Table(
        title=title,
        note=note,
        heads=("solver", *(head for _, head, _ in columns), "steps"),
        rows=tuple(
            row_of(
                _name(row),
                *(_cell(row, misses[row.run_id], column, write) for column, _, write in columns),
                count_text(row.steps_done),
            )
            for row in rows
        ),
        folded=folded,
    )


def _name(row: RunRecord) -> Cell:
    law = row.is_baseline_law
    return Cell(
        f"{row.short_name} (baseline_law)" if law else row.short_name, "quiet" if law else ""
    )


def _cell(row: RunRecord, misses: Mapping[str, float], column: str, write: Writer) -> Cell:
    value = misses[column] if column in misses else getattr(row, column)
    text = MISSING if math.isnan(value) else write(value)
    bad = column in ("limit_violations", "fallbacks", "missed") and value > 0
    return Cell(text, "bad" if bad else "")
