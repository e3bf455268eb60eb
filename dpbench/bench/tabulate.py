"""The two tables of a campaign, made of all parts row group by row group."""

import json
from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
import pyarrow as pa

from dpbench.bench.judge.answer_caching import add_loop_ratios
from dpbench.bench.judge.rows import make_run_row
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.configurations import identify_libraries_of_cell
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.cell_store import (
    CellStore,
    PublicTables,
    Source,
    StepFile,
    filter_runs_by_run_id,
    select_runs_without_steps,
)
from dpbench.bench.record.schema import (
    RUN_COLUMNS,
    convert_to_run_columns,
    make_study_value_columns,
)
from dpbench.bench.record.step_table import (
    DAMAGE,
    FILE_SCHEMA,
    filter_and_rename_run_ids,
    filter_steps_by_run_id,
    runs_from_frame,
    runs_to_frame,
)
from dpbench.bench.workers.jobs import CellJob
from dpbench.errors import InputError


class RequestedRuns:
    """Runs requested from a campaign, each with a row under every name of its settings."""

    def __init__(self, work: Sequence[CellJob]) -> None:
        self.jobs: dict[str, tuple[CellJob, str]] = {}
        """Jobs by run_id, each with the name of its settings."""
        for job in work:
            self.jobs[job.run_id] = job, job.cell.settings
            for settings in job.planned.alias_settings:
                cell = job.cell.with_settings_name(settings)
                identity = identify_libraries_of_cell(cell, job.library)
                run_id = cell.run_id(identity, job.machine_id, HARNESS_VERSION)
                self.jobs[run_id] = job, settings

    def make_rows(self, finished: pd.DataFrame) -> pd.DataFrame:
        """Return the `runs.parquet` row of each requested run, only the outcome if unfinished."""
        own = finished[finished.index.isin(self.jobs)]
        aliases = self.find_aliases(finished)
        others = [
            self._unfinished_row(run_id, *job)
            for run_id, job in self.jobs.items()
            if run_id not in own.index and run_id not in aliases
        ]
        tables = [
            own,
            self._copy_rows_under_alias_ids(finished, aliases),
            convert_to_run_columns(pd.DataFrame(others)),
        ]
        filled = [table.set_index("run_id", drop=False) for table in tables if len(table)]
        if not filled:
            return convert_to_run_columns(pd.DataFrame())
        return pd.concat(filled).loc[list(self.jobs)].reset_index(drop=True)

    def _copy_rows_under_alias_ids(
        self, finished: pd.DataFrame, aliases: Mapping[str, str]
    ) -> pd.DataFrame:
        """Return copies of finished runs' rows of `runs.parquet` under their aliases' run ids."""
        settings = [self.jobs[run_id][1] for run_id in aliases]
        cells = [
            self.jobs[run_id][0].cell.with_settings_name(self.jobs[run_id][1]) for run_id in aliases
        ]
        return finished.loc[list(aliases.values())].assign(
            run_id=list(aliases), settings=settings, cell=[cell.to_json() for cell in cells]
        )

    def _unfinished_row(self, run_id: str, job: CellJob, settings: str) -> Mapping[str, object]:
        """Return the row of a run without results: its description and outcome."""
        outcome = job.outcome or Outcome("lost", "it was not run")
        if outcome.outcome not in ("refused", "lost", "invalid"):
            outcome = Outcome("lost", "its record is damaged or missing")
        cell = job.cell.with_settings_name(settings)
        return make_run_row(run_id, cell, outcome, job.library, job.machine_id, None, None)

    def find_aliases(self, finished: pd.DataFrame) -> dict[str, str]:
        """Return, by run_id under another name of the same settings, that of the finished run."""
        return {
            run_id: job.run_id
            for run_id, (job, _) in self.jobs.items()
            if run_id not in finished.index and job.run_id in finished.index
        }


_SELECTION_COLUMNS = (
    *("mode", "scenario", "sequence", "solver", "route", "policy", "formulation", "units"),
    *("slowdown", "steps_planned", "study", "study_point", "replicate", "options", "settings"),
)
"""Columns by which a row is the same cell, whichever version and machine ran it."""


def refuse_other_selection(cells: Iterable[PlannedCell], out: Path, remedy: str) -> None:
    """Raise InputError where folder `out` has finished runs other than the planned `cells`."""
    asked = {
        (*_selection_key(planned.cell), settings)
        for planned in cells
        for settings in (planned.cell.settings, *planned.alias_settings)
    }
    names = (*_SELECTION_COLUMNS, "outcome", "run_id")
    rows = PublicTables(out).read_rows(names)
    values = zip(*(rows[name].to_pylist() for name in names), strict=True)
    others = {
        run_id: row
        for *row, outcome, run_id in values
        if outcome != "refused" and tuple(row) not in asked
    }
    if others:
        first = dict(zip(_SELECTION_COLUMNS, next(iter(others.values())), strict=True))
        place = first["sequence"] or first["scenario"]
        example = f"{first['solver']} in {place}, {first['steps_planned']} steps"
        found = f"{out} with {len(others)} finished runs that were not requested, such as {example}"
        if added := len(others.keys() & _read_added_run_ids(out)):
            found += f" ({added} of add_runs, to be added again afterwards)"
        raise InputError("`out`", "", found, remedy)


def _read_added_run_ids(out: Path) -> set[str]:
    """Return the ids of the runs that `add_runs` added to a result folder."""
    try:
        return set(json.loads((out / "suite.json").read_text(encoding="utf-8"))["added_runs"])
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _selection_key(cell: Cell) -> tuple[object, ...]:
    """Return the values that identify a run whatever its version, machine and settings."""
    asked = (cell.route, cell.policy, cell.formulation, cell.units, cell.slowdown, cell.steps)
    study = (s.name, s.point, s.replicate) if (s := cell.study) else ("", None, None)
    named = (cell.mode, cell.scenario_name, cell.sequence, cell.solver)
    return (*named, *asked, *study, cell.options)


def is_tabulated(work: Sequence[CellJob], store: CellStore) -> bool:
    """Return whether the result tables already have exactly the requested runs."""
    wanted = list(RequestedRuns(work).jobs)
    in_parts = {name for part in store.parts for name in part.read_rows()["run_id"].to_pylist()}
    return wanted == store.public.read_run_ids() and not set(wanted) & in_parts


def tabulate(
    work: Sequence[CellJob], store: CellStore, progress: Progress
) -> tuple[pd.DataFrame, int]:
    """Write a campaign's `runs.parquet` and `steps.parquet`; return runs and number of steps."""
    progress.advance(0, "writing the tables")
    wanted, old = RequestedRuns(work), list(store.parts)
    stored, sources = store.collect_rows_and_sources()
    finished = runs_to_frame(stored)
    steps = StepFile(store.public.steps.with_suffix(".parquet.part"))
    try:
        aliases = wanted.find_aliases(finished)
        read = _split_steps(store, stored, sources, wanted.jobs, aliases, steps, progress)
        # What cannot be read any more is not finished.
        finished = finished[finished.index.isin(read) | (finished["steps_done"] == 0)]
        rows = add_loop_ratios(wanted.make_rows(finished)[list(RUN_COLUMNS)])
        runs = convert_to_run_columns(rows.assign(**make_study_value_columns(rows)))
        store.public.write(runs_from_frame(runs), steps, store.last_part)
    finally:
        steps.close()
        steps.path.unlink(missing_ok=True)
    store.delete_parts(old)
    return runs, steps.rows


def _split_steps(
    store: CellStore,
    runs: pa.Table,
    sources: Mapping[str, Source],
    wanted: Container[str],
    aliases: Mapping[str, str],
    steps: StepFile,
    progress: Progress,
) -> set[str]:
    """Write the steps of requested runs to one file, others to batch files; return run_ids read."""
    read: set[str] = set()
    for group in store.yield_step_groups(sources):
        here = {new: made_of for new, made_of in aliases.items() if made_of in group.names}
        others = [name for name in group.names if name not in wanted]
        try:
            table = group.read_table()
        except DAMAGE:
            continue
        steps.add(filter_steps_by_run_id(table, set(group.names) - set(others)))
        store.write_rows_and_steps(filter_runs_by_run_id(runs, others), table)
        for new, made_of in here.items():
            steps.add(filter_and_rename_run_ids(table, {made_of: new}))
        read |= set(group.names)
        progress.advance(0, f"writing the tables: {len(read)} of {len(runs)} runs")
    unasked = select_runs_without_steps(
        runs, read.union(name for name in sources if name in wanted)
    )
    store.write_rows_and_steps(unasked, FILE_SCHEMA.empty_table())
    return read
