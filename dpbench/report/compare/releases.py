"""Solvers over their releases, in words and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dpbench.analysis.compare.pairs import differences
from dpbench.analysis.compare.releases import (
    Histories,
    History,
    Release,
    histories,
)
from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.verdict.demand import Demand
from dpbench.bench.judge.rules import largest
from dpbench.bench.record.result_folder import load_results
from dpbench.errors import InputError
from dpbench.report.formats import (
    and_list,
    count_text,
    error_text,
    plural,
    significant,
    time_text,
)
from dpbench.report.table import Table, document

BUSY = 0.05
"""A load kernel that changed by more says that the machine was busier in one of two runs."""


@dataclass(frozen=True, eq=False)
class Releases:
    """Solvers over their releases.

    Parameters
    ----------
    lines : what was compared, and what changed, in a few lines; tables : one a solver of several
        versions, and one of all the others; demand : of the first folder.
    """

    histories: Histories
    lead: Sequence[str]
    lines: Sequence[str]
    tables: Sequence[Table]
    demand: Demand

    def markdown(self) -> str:
        """The releases as a Markdown document."""
        return document("Solvers over their releases", [*self.lead, *self.lines], self.tables)


def releases(folders: Sequence[str | Path], *, reference: str | None = None) -> Releases:
    """Each solver of some result folders over its versions.

    Parameters
    ----------
    folders : two or more, of the same suite, in any order; `steps.parquet` is not needed.
    reference : as of `histories`.

    Raises
    ------
    InputError : for a single folder, one given twice, or none with a cell in common; as
        `ResultsError` for one that cannot be read.
    """
    if len({Path(folder).resolve() for folder in folders}) < max(2, len(folders)):
        found = and_list([str(folder) for folder in folders])
        raise InputError("--releases", "", found, "two or more result folders, each once")
    names = [Path(folder).name for folder in folders]
    if len(set(names)) < len(names):
        names = [str(folder) for folder in folders]
    records = {
        name: Records(load_results(folder, without_steps=True))
        for name, folder in zip(names, folders, strict=True)
    }
    over = histories(records, reference)
    demand = Demand.of(next(iter(records.values())).suite)
    return Releases(over, _lead(over), _lines(over, records), _tables(over), demand)


def _changed(histories: Histories) -> dict[str, list[History]]:
    """By solver, the histories of those with several versions."""
    by_solver = grouped(histories.all, lambda history: history.run.solver)
    return {name: own for name, own in by_solver.items() if any(h.changed for h in own)}


def _lead(histories: Histories) -> list[str]:
    """A sentence for each solver of several versions, from its most usual configuration."""
    by_solver = _changed(histories)
    if not by_solver:
        return ["No solver has two versions in these folders."]
    return [_sentence(solver, own_histories) for solver, own_histories in by_solver.items()]


def _sentence(solver: str, own_histories: Sequence[History]) -> str:
    """Times of its most usual replay; errors and failed steps of all that both releases ran."""
    changed = [history for history in own_histories if history.changed]
    ends = [(history.releases[0], history.releases[-1]) for history in changed]
    sides = list(zip(*ends, strict=True))
    errors = " → ".join(error_text(largest([r.error_move for r in side])) for side in sides)
    failed = " → ".join(_count(largest([r.failed_steps for r in side])) for side in sides)
    versions = " → ".join(release.version for release in ends[0])
    return f"{solver} {versions}: {_took(changed)}; largest error {errors}, failed steps {failed}."


def _took(changed: Sequence[History]) -> str:
    timed = next((h for h in changed if math.isfinite(h.whole_change)), None)
    if timed is None:
        return "not timed"
    load = timed.releases[-1].load_ns / timed.releases[0].load_ns
    busier = "busier" if load > 1.0 else "quieter"
    beside = f" on a {busier} machine (load kernel {significant(load)})"
    return (
        f"p50 {significant(timed.whole_change)} times as long"
        f"{beside if abs(load - 1.0) > BUSY else ''}, {timed.run.configuration.options} on "
        f"{timed.run.problem}"
    )


def _lines(histories: Histories, records: Mapping[str, Records]) -> list[str]:
    lines = [
        f"{name}: {view.machine.get('cpu_model', 'an unnamed CPU')}, machine {view.machine['id']}, "
        f"{view.suite.get('started_utc', '')[:10] or 'no date'}"
        for name, view in records.items()
    ]
    machines = [view.machine for view in records.values()]
    differ = {word: None for one in machines[1:] for word in differences(machines[0], one)}
    if differ:
        lines.append(f"the machines differ in {and_list(list(differ))}")
    if histories.reference:
        lines.append(
            f"times are multiples of the p50 of {histories.reference} in the same folder: ratios "
            "carry from machine to machine, microseconds do not"
        )
    if math.isfinite(histories.spread):
        lines.append(
            "what did not change its version differs by a factor of up to "
            f"{significant(histories.spread)} between two folders: a smaller change says nothing"
        )
    if histories.alone:
        lines.append(f"{plural(histories.alone, 'cell')} in one folder only, left out")
    return lines


def _tables(histories: Histories) -> list[Table]:
    changed = _changed(histories)
    note = (
        "To the one before: its p50 over that of the release above it, below 1 is faster; the load "
        "kernel, timed in the same rounds, tells what of that its neighbours on the machine did. "
        "Counts are per round. Closed loops run beside each other and are not timed."
    )
    tables = [
        Table.of(
            [row for history in own_histories for row in _rows(history, histories)],
            f"{solver} over its releases",
            note=note,
            text_columns=4,
        )
        for solver, own_histories in changed.items()
    ]
    rest = [history for history in histories.all if history.run.solver not in changed]
    if rest:
        # With one version there is none before it.
        rows = [{"solver": h.run.solver} | row for h in rest for row in _rows(h, histories)]
        kept = [{head: row[head] for head in row if head not in BEFORE} for row in rows]
        note = "For comparison: what these differ by is no change of a solver."
        title = "Of one version in all folders"
        tables.append(Table.of(kept, title, note=note, text_columns=5))
    return tables


BEFORE = ("to the one before", "load kernel")
"""Columns about the release before."""


def _rows(history: History, histories: Histories) -> list[dict[str, str]]:
    run, unit = history.run, f" [× {histories.reference}]" if histories.reference else ""
    label = run.configuration.label.removeprefix(f"{run.solver} ").strip("()")
    return [
        {
            "configuration": label,
            "problem": f"{run.problem}, {run.mode.replace('_', ' ')}",
            "version": release.version,
            "folders": _folders(release, histories),
            f"p50{unit}": _time(release.p50, histories),
            BEFORE[0]: significant(history.change(i)),
            BEFORE[1]: significant(history.load_change(i)),
            f"p99{unit}": _time(release.p99, histories),
            f"largest step{unit}": _time(release.largest, histories),
            "largest error": error_text(release.error_move),
            "claimed, not true": _count(release.claimed_not_true),
            "failed steps": _count(release.failed_steps),
            "outcome": release.outcome.replace("_", " "),
        }
        for i, release in enumerate(history.releases)
    ]


def _folders(release: Release, histories: Histories) -> str:
    return "all" if len(release.runs) == histories.folders else and_list(list(release.runs))


def _count(value: float) -> str:
    """A count per round, whole where it is in every round."""
    return count_text(value) if math.isnan(value) or value == round(value) else f"{value:.1f}"


def _time(value: float, histories: Histories) -> str:
    return significant(value) if histories.reference else time_text(value)
