"""Tables of what was run: the population, and the cells that did not finish with the reasons."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite, nan

from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.record.configuration import COMMON
from dpbench.report.formats import MISSING, count_text, plural
from dpbench.report.table import Cell, Mark, Table, row_of

TINTS: dict[str, Mark] = {
    "finished": "",
    "timed_out": "bad",
    "hung": "bad",
    "crashed": "bad",
    "refused": "warn",
    "invalid": "bad",
    "lost": "warn",
}
OUTCOMES = tuple(TINTS)


def population_table(view: Records) -> Table:
    """One row per solver: version, route, and how its cells ended."""
    rows = []
    for solver in dict.fromkeys(row.solver for row in view.all_runs):
        mine = [row for row in view.all_runs if row.solver == solver]
        ended = Counter(row.outcome for row in mine)
        steps = sum(len(view.steps(row)) for row in mine)
        rows.append(
            row_of(
                solver,
                mine[0].solver_version or MISSING,
                mine[0].build or MISSING,
                ", ".join(sorted({row.route for row in mine})),
                _forms(mine),
                count_text(len(mine)),
                *(
                    Cell(count_text(ended[name]), TINTS[name] if ended[name] else "")
                    for name in OUTCOMES
                ),
                count_text(steps),
            )
        )
    return Table(
        title="Solvers",
        note=f"{plural(len(view.all_runs), 'cell')}; a cell is one solver in one configuration "
        "of an "
        "experiment. Build: as the library itself tells it. Form: what the library was given. "
        "Recorded steps include warm-up rounds.",
        heads=(
            "solver",
            "version",
            "build",
            "route",
            "form",
            "cells",
            *(name.replace("_", " ") for name in OUTCOMES),
            "recorded steps",
        ),
        rows=tuple(rows),
        text_columns=5,
    )


def _forms(rows: Sequence[RunRecord]) -> str:
    return ", ".join(sorted({row.form for row in rows if row.form})) or MISSING


def experiments_table(view: Records) -> Table:
    """One row per experiment: mode, problem, units, settings, policy, and its counts."""
    groups: dict[tuple[str, ...], list[RunRecord]] = {}
    names = ("mode", "scenario", "sequence", "units", "settings", "route", "policy", "formulation")
    for row in view.all_runs:
        # The sequences of a random family are too many to stand one by one.
        shown = {name: str(getattr(row, name)) for name in names}
        if row.slowdown > 0.0:
            shown["mode"] += f", {row.slowdown:g} × slower"
        if row.family:
            shown["sequence"] = f"random {row.family}"
        groups.setdefault(tuple(shown.values()), []).append(row)
    rows = []
    for key, mine in groups.items():
        mode, scenario, sequence, units, settings, route, policy, formulation = key
        rows.append(
            row_of(
                mode.replace("_", " "),
                f"`{sequence or scenario}`",
                units,
                settings,
                route,
                policy,
                formulation.replace("_", " "),
                count_text(max(row.steps_planned for row in mine)),
                count_text(_most(mine, "matrix_updates")),
                count_text(len(mine)),
                count_text(sum(row.outcome == "finished" for row in mine)),
            )
        )
    return Table(
        title="Experiments",
        note="Closed loop: every solver steers its own ship. Replay: identical QPs, recorded along "
        "the exactly solved loop or random, through every solver. Matrix updates: steps with new "
        "matrices that a workspace took over without a new set-up.",
        heads=(
            "mode",
            "problem",
            "units",
            "settings",
            "route",
            "policy",
            "formulation",
            "steps",
            "matrix updates",
            "cells",
            "finished",
        ),
        rows=tuple(rows),
        text_columns=7,
        folded=True,
    )


def _most(rows: Sequence[RunRecord], column: str) -> float:
    """The largest entry of a column; NaN without any."""
    return max((x for row in rows if isfinite(x := getattr(row, column))), default=nan)


def unfinished_table(view: Records) -> Table | None:
    """Every cell that did not finish, equal reasons together; None when all finished."""
    groups: dict[tuple[str, str, str], list[RunRecord]] = {}
    for row in view.all_runs:
        if row.outcome != "finished":
            reason = row.outcome_detail or "no reason was recorded"
            groups.setdefault((row.solver, row.outcome, reason), []).append(row)
    if not groups:
        return None
    rows = [
        row_of(
            solver,
            Cell(outcome.replace("_", " "), TINTS[outcome]),
            count_text(len(mine)),
            _where(mine),
            reason,
        )
        for (solver, outcome, reason), mine in sorted(groups.items())
    ]
    return Table(
        title="Cells that did not finish",
        note=f"{plural(sum(map(len, groups.values())), 'cell')} of {len(view.all_runs)}; the "
        "reasons "
        "are the library's or the harness's own words.",
        heads=("solver", "outcome", "cells", "where", "reason"),
        rows=tuple(rows),
        text_columns=5,
        folded=True,
    )


def _where(rows: Sequence[RunRecord]) -> str:
    if len(rows) > 4:
        modes = Counter(row.mode.replace("_", " ") for row in rows)
        return ", ".join(f"{count} × {mode}" for mode, count in modes.items())
    return "; ".join(
        f"{row.sequence or row.scenario} "
        f"({row.units}, {row.settings}, {row.route}, {row.policy}"
        f"{'' if row.formulation == COMMON else ', ' + row.formulation.replace('_', ' ')})"
        for row in rows
    )
