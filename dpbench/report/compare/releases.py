"""Solvers over their releases, in words, tables and figures: times and errors of each version."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.compare.pairs import list_machine_differences
from dpbench.analysis.compare.releases import (
    FIGURES,
    Histories,
    History,
    compare_releases,
    tabulate_releases,
)
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import group_by_key
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.bench.judge.rules import maximum_of_known
from dpbench.bench.record.result_folder import load_results
from dpbench.errors import InputError
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.charts import style
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_error,
    format_time,
    join_with_and,
    make_markdown_document,
    plural,
    significant,
    strip_markdown,
)
from dpbench.report.page.write import render_figure_markup, render_page
from dpbench.report.ship.ship_text import summarise_ships

BUSY = 0.05
"""Relative change of the calibration workload that shows a busier machine."""


@dataclass(frozen=True, eq=False)
class Releases:
    """Comparison of solver versions over several result folders, in text and tables.

    warnings, ships : what the controller does to the ship whatever the solver, first everywhere.
    lines : what was compared; tables : one a solver of several versions, and one of all the others.
    requirements : of the first folder.
    """

    histories: Histories
    warnings: Sequence[str]
    ships: Sequence[str]
    lead: Sequence[str]
    lines: Sequence[str]
    tables: Sequence[Table]
    requirements: Requirements

    def markdown(self) -> str:
        """Return the comparison of solver versions as a Markdown document."""
        lines = [*self.warnings, *self.ships, *self.lead, *self.lines]
        return make_markdown_document("Solvers over their releases", lines, self.tables)


def releases(folders: Sequence[str | Path], *, reference: str | None = None) -> Releases:
    """Return the comparison of solvers' versions over result folders, by times of `reference`.

    Parameters
    ----------
    folders : two or more, of the same suite, in any order; `steps.parquet` is not needed.
    reference : as of `compare_releases`.

    Raises
    ------
    InputError : for a single folder, one given twice, or none with a cell in common; as
        `ResultsError` for one that cannot be read.
    """
    if len({Path(folder).resolve() for folder in folders}) < max(2, len(folders)):
        found = join_with_and([str(folder) for folder in folders])
        raise InputError("--releases", "", found, "two or more result folders, each once")
    names = [Path(folder).name for folder in folders]
    if len(set(names)) < len(names):
        names = [str(folder) for folder in folders]
    records = {
        name: Records(load_results(folder, without_steps=True))
        for name, folder in zip(names, folders, strict=True)
    }
    over = compare_releases(records, reference)
    requirements = Requirements.from_suite(next(iter(records.values())).suite)
    changed = _group_histories_by_solver(over)
    lead = [
        _describe_solver_history(solver, own_histories) for solver, own_histories in changed.items()
    ]
    lead = lead or ["No solver has two versions in these folders."]
    ships = {name: summarise_ships(find_ship_results(view)) for name, view in records.items()}
    return Releases(
        over,
        _merge_folders({name: ship.warning for name, ship in ships.items()}),
        _merge_folders(
            {
                name: " ".join(filter(None, (ship.text, ship.caution)))
                for name, ship in ships.items()
            }
        ),
        lead,
        _list_comparability_notes(over, records),
        _make_version_tables(over),
        requirements,
    )


def _merge_folders(texts: Mapping[str, str]) -> list[str]:
    """Return each text of result folders once, with the folders' names where not all have it."""
    by_text = group_by_key((name for name, text in texts.items() if text), texts.__getitem__)
    return [
        text if len(names) == len(texts) else f"{join_with_and(names)}: {text}"
        for text, names in by_text.items()
    ]


def _group_histories_by_solver(histories: Histories) -> dict[str, list[History]]:
    """Return the histories of each solver that was run in more than one version."""
    by_solver = group_by_key(histories.all, lambda history: history.oldest_run.solver)
    return {
        name: own for name, own in by_solver.items() if any(h.has_several_versions for h in own)
    }


def _describe_solver_history(solver: str, own_histories: Sequence[History]) -> str:
    """Return a text on how a solver's step time, error and failed steps changed over versions."""
    changed = [history for history in own_histories if history.has_several_versions]
    ends = [(history.releases[0], history.releases[-1]) for history in changed]
    sides = list(zip(*ends, strict=True))
    errors = " → ".join(
        format_error(maximum_of_known([r.largest_error_move for r in side])) for side in sides
    )
    failed = " → ".join(
        _format_count(maximum_of_known([r.most_failed_steps for r in side])) for side in sides
    )
    versions = " → ".join(release.version for release in ends[0])
    times = _describe_time_change(changed)
    return f"{solver} {versions}: {times}; largest error {errors}, failed steps {failed}."


def _describe_time_change(changed: Sequence[History]) -> str:
    """Return in words the change of a solver's p50 over versions, on its first timed problem."""
    timed = next((h for h in changed if math.isfinite(h.newest_to_oldest_time_ratio)), None)
    if timed is None:
        return "not timed"
    load = timed.releases[-1].mean_load_test_ns / timed.releases[0].mean_load_test_ns
    busier = "busier" if load > 1.0 else "quieter"
    beside = f" on a {busier} machine (calibration workload {significant(load)})"
    return (
        f"p50 {significant(timed.newest_to_oldest_time_ratio)} times as long"
        f"{beside if abs(load - 1.0) > BUSY else ''}, "
        f"{timed.oldest_run.configuration.call_text} on {timed.oldest_run.problem}"
    )


def _list_comparability_notes(histories: Histories, records: Mapping[str, Records]) -> list[str]:
    """Return notes on what limits a comparison of folders: machines, reference, scatter, gaps."""
    lines = [
        f"{name}: {view.machine.get('cpu_model', 'an unnamed CPU')}, machine {view.machine['id']}, "
        f"{view.suite.get('started_utc', '')[:10] or 'no date'}"
        for name, view in records.items()
    ]
    machines = [view.machine for view in records.values()]
    differ = {
        word: None for one in machines[1:] for word in list_machine_differences(machines[0], one)
    }
    if differ:
        lines.append(f"the machines differ in {join_with_and(list(differ))}")
    if histories.reference:
        lines.append(
            f"times are multiples of the p50 of {histories.reference} in the same folder: ratios "
            "carry from machine to machine, microseconds do not"
        )
    if math.isfinite(histories.spread):
        lines.append(
            "solvers of unchanged version differ by a factor of up to "
            f"{significant(histories.spread)} between two folders: do not count a smaller change"
        )
    if histories.alone:
        lines.append(f"{plural(histories.alone, 'cell')} in one folder only, left out")
    return lines


def _make_version_tables(histories: Histories) -> list[Table]:
    """Return a table of versions for each solver, and one of solvers with one version."""
    changed = _group_histories_by_solver(histories)
    note = (
        "Ratio to previous: p50 divided by that of the previous release; below 1 is faster. The "
        "calibration workload, timed in the same rounds, shows the effect of other load. False "
        "claims are per round. Closed loops run in parallel and are not timed."
    )
    tables = [
        Table.from_rows(
            [row for history in own_histories for row in _make_version_rows(history, histories)],
            f"{solver} over its releases",
            note=note,
            text_columns=4,
        )
        for solver, own_histories in changed.items()
    ]
    rest = [history for history in histories.all if history.oldest_run.solver not in changed]
    if rest:
        # With one version there is none before it.
        rows = [
            {"solver": h.oldest_run.solver} | row
            for h in rest
            for row in _make_version_rows(h, histories)
        ]
        kept = [{head: row[head] for head in row if head not in BEFORE} for row in rows]
        note = "For comparison: differences between these times do not come from the solver."
        title = "Solvers of the same version in all folders"
        tables.append(Table.from_rows(kept, title, note=note, text_columns=5))
    return tables


BEFORE = ("ratio to previous", "calibration workload")
"""Columns on the release before."""


def _make_version_rows(history: History, histories: Histories) -> list[dict[str, str]]:
    """Return a table row for each version of a solver on one problem."""
    run, unit = history.oldest_run, f" [× {histories.reference}]" if histories.reference else ""
    label = run.configuration.label.removeprefix(f"{run.solver} ").strip("()")
    return [
        {
            "configuration": label,
            "problem": f"{run.problem}, {run.mode.replace('_', ' ')}",
            "version": release.version,
            "folders": "all"
            if len(release.runs) == histories.folders
            else join_with_and(list(release.runs)),
            f"p50{unit}": _format_time(release.p50, histories),
            BEFORE[0]: significant(history.compute_time_ratio_to_previous(i)),
            BEFORE[1]: significant(
                release.mean_load_test_ns / history.releases[i - 1].mean_load_test_ns
            )
            if i
            else MISSING,
            f"p99{unit}": _format_time(release.p99, histories),
            f"largest step time{unit}": _format_time(release.largest, histories),
            "largest error": format_error(release.largest_error_move),
            "false claims": _format_count(release.most_claimed_not_true_per_round),
            "failed steps": _format_count(release.most_failed_steps),
            "outcome": release.worst_outcome.replace("_", " "),
        }
        for i, release in enumerate(history.releases)
    ]


def _format_count(value: float) -> str:
    """Format a count per repetition: whole if it is a whole number, else with one decimal."""
    return format_count(value) if math.isnan(value) or value == round(value) else f"{value:.1f}"


def _format_time(value: float, histories: Histories) -> str:
    """Format a step time [ns] with its unit, or as multiple of the reference solver's."""
    return significant(value) if histories.reference else format_time(value)


AGES = {0: "newest release", 1: "earlier release"}
_WIDTH = 260
"""Narrow enough for a phone, names included."""
MOST_PANELS = 4


def write_releases(path: Path, releases: Releases) -> Path:
    """Write the page that compares solver versions, without any script; return its path."""
    table = tabulate_releases(releases.histories, MOST_PANELS)
    table["age"] = table["age"].map(AGES)
    unit = f"× {releases.histories.reference}" if releases.histories.reference else "µs"
    charts = {
        "Point p50, bar to p99 where 1000 steps support one, line to the largest step time; "
        "replays, the most usual configuration of each solver.": draw_release_times(table, unit),
        "The same runs; dashed: what the requirements allow. An error of exactly 0 has no point.": (
            draw_release_errors(table, releases.requirements.error_move)
        ),
    }
    figures = [
        (caption, render_figure_markup(chart)) for caption, chart in charts.items() if len(table)
    ]
    text = render_page(
        "releases",
        warnings=[strip_markdown(line) for line in releases.warnings],
        ships=[strip_markdown(line) for line in releases.ships],
        lead=releases.lead,
        lines=releases.lines,
        figures=figures,
        tables=[table for table in releases.tables if table.rows],
        missing=MISSING,
    )
    write_bytes_to_file_or_pipe(path, text.encode())
    return path


def draw_release_times(table: pd.DataFrame, unit: str) -> Any:
    """Return a chart of each solver version's p50, p99 and longest step, a panel a problem.

    table : of `tabulate_releases`, age in words, the first row on top; unit : of the times.
    """
    base = _make_version_rows_chart(table)
    x = alt.X(
        "p50:Q", title=f"step time [{unit}]", scale=style.log_scale(), axis=_make_value_axis("~g")
    )
    line = base.mark_rule(strokeWidth=2).encode(x=x, x2=alt.X2("largest:Q"))
    known = base.transform_filter("isValid(datum.p99)")
    bar = known.mark_rule(strokeWidth=8).encode(x=x, x2=alt.X2("p99:Q"))
    layers = (line, bar, base.mark_point(filled=True, size=60, opacity=1).encode(x=x))
    return _arrange_panels(layers, "Step time", "Step times of each solver, version by version.")


def draw_release_errors(table: pd.DataFrame, allowed: float) -> Any:
    """Return a chart of each solver version's largest error of the first move, with its limit.

    table : as of `draw_release_times`; an error of 0 or none at all has no point.
    """
    title = style.ERROR
    x = alt.X("error:Q", title=title, scale=style.log_scale(), axis=_make_value_axis(".0e"))
    drawn = _make_version_rows_chart(table).transform_filter(
        "isFinite(datum.error) && datum.error > 0"
    )
    limit = alt.Chart(table).transform_calculate(limit=f"{allowed}")
    rule = limit.mark_rule(strokeDash=[4, 3], color=style.FAIL).encode(x=alt.X("limit:Q"))
    layers = (rule, drawn.mark_point(filled=True, size=60, opacity=1).encode(x=x))
    return _arrange_panels(layers, "Error", "Largest error of each solver, version by version.")


def _make_value_axis(form: str) -> alt.Axis:
    """Return a chart axis of values in a given number format."""
    return alt.Axis(format=form, tickCount=5, labelOverlap="greedy", labelSeparation=6)


def _make_version_rows_chart(table: pd.DataFrame) -> Any:
    """Return the base of a chart with a row per solver version, coloured newest or earlier."""
    return alt.Chart(table).encode(
        y=style.named_rows("label", list(dict.fromkeys(table["label"])), labelLimit=170),
        color=style.colour("age", AGES.values(), (style.ACCENT, style.NOT_RUN)),
        shape=alt.Shape("age:N", scale=style.names_scale(AGES.values(), ("circle", "diamond"))),
        tooltip=style.tooltips("label:N", *(style.tooltip(f"{name}:Q") for name in FIGURES)),
    )


def _arrange_panels(layers: Sequence[Any], title: str, description: str) -> Any:
    """Return a chart of given layers with one panel for each problem."""
    chart = alt.layer(*layers, width=_WIDTH, height=alt.Step(20))
    header = alt.Header(title=None, labelAnchor="start", labelOrient="top", labelFontSize=12)
    row = alt.Row("problem:N", title=None, header=header, sort=None)
    return style.set_style(chart.facet(row=row).resolve_scale(y="independent"), title, description)
