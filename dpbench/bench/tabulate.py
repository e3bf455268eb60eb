"""The two tables of a campaign, made of all parts row group by row group."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
import pyarrow.compute as pc

from dpbench.bench.judge.memory_of_answers import with_loop_ratio
from dpbench.bench.judge.rows import run_row
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.configurations import identity_of
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.cell_store import CellStore, StepFile, public_part
from dpbench.bench.record.schema import RUN_COLUMNS, as_runs, study_columns
from dpbench.bench.record.step_table import of_runs, renamed_runs
from dpbench.bench.workers.jobs import CellJob
from dpbench.errors import InputError


class Wanted:
    """The rows that a campaign is asked for, in their order.

    A cell whose settings have no effect has rows under each of its names.
    """

    def __init__(self, work: Sequence[CellJob]) -> None:
        self.jobs: dict[str, tuple[CellJob, str]] = {}
        """By run_id: the job, and its settings' name."""
        for job in work:
            self.jobs[job.run_id] = job, job.cell.settings
            for settings in job.planned.alias_settings:
                cell = job.cell.with_settings(settings)
                identity = identity_of(cell, job.library)
                run_id = cell.run_id(identity, job.machine_id, HARNESS_VERSION)
                self.jobs[run_id] = job, settings

    def rows(self, finished: pd.DataFrame) -> pd.DataFrame:
        """One row each: of those that are `finished`, or of what became of the others."""
        own = finished[finished.index.isin(self.jobs)]
        aliases = self.aliases(finished)
        others = [
            self._row(run_id, *job)
            for run_id, job in self.jobs.items()
            if run_id not in own.index and run_id not in aliases
        ]
        tables = [own, self._renamed(finished, aliases), as_runs(pd.DataFrame(others))]
        filled = [table.set_index("run_id", drop=False) for table in tables if len(table)]
        if not filled:
            return as_runs(pd.DataFrame())
        return pd.concat(filled).loc[list(self.jobs)].reset_index(drop=True)

    def _renamed(self, finished: pd.DataFrame, aliases: Mapping[str, str]) -> pd.DataFrame:
        """The rows of cells under further names of their settings."""
        settings = [self.jobs[run_id][1] for run_id in aliases]
        cells = [
            self.jobs[run_id][0].cell.with_settings(self.jobs[run_id][1]) for run_id in aliases
        ]
        return finished.loc[list(aliases.values())].assign(
            run_id=list(aliases), settings=settings, cell=[cell.to_json() for cell in cells]
        )

    def _row(self, run_id: str, job: CellJob, settings: str) -> Mapping[str, object]:
        """The row of a cell that is not finished."""
        outcome = job.outcome or Outcome("lost", "it was not run")
        if outcome.outcome not in ("refused", "lost", "invalid"):
            outcome = Outcome("lost", "its record is damaged or gone")
        cell = job.cell.with_settings(settings)
        return run_row(run_id, cell, outcome, job.library, job.machine_id, None, None)

    def aliases(self, finished: pd.DataFrame) -> dict[str, str]:
        """Of the rows that have to be made, what they are made of, by new run_id."""
        return {
            run_id: job.run_id
            for run_id, (job, _) in self.jobs.items()
            if run_id not in finished.index and job.run_id in finished.index
        }


_SELECTED = (
    *("mode", "scenario", "sequence", "solver", "route", "policy", "formulation", "units"),
    *("slowdown", "steps_planned", "study", "study_point", "replicate", "settings"),
)
"""Columns by which a row is the same cell, whichever version and machine ran it."""


def refuse_other_selection(cells: Iterable[PlannedCell], out: Path, remedy: str) -> None:
    """InputError where the tables of `out` have finished runs that none of `cells` is.

    Parameters
    ----------
    remedy : what to do then.
    """
    asked = {
        (*_selected(planned.cell), settings)
        for planned in cells
        for settings in (planned.cell.settings, *planned.alias_settings)
    }
    rows = public_part(out).rows()
    rows = rows[rows["outcome"] != "refused"]
    values = rows[list(_SELECTED)].astype(object).where(rows[list(_SELECTED)].notna(), None)
    others = [row for row in values.itertuples(index=False, name=None) if row not in asked]
    if others:
        first = dict(zip(_SELECTED, others[0], strict=True))
        place = first["sequence"] or first["scenario"]
        example = f"{first['solver']} in {place}, {first['steps_planned']} steps"
        found = f"{out} with {len(others)} finished runs that are not asked for, as of {example}"
        raise InputError("--out", "", found, remedy)


def _selected(cell: Cell) -> tuple[object, ...]:
    """What `_SELECTED` is of a cell, less its settings."""
    asked = (cell.route, cell.policy, cell.formulation, cell.units, cell.slowdown, cell.steps)
    study = (cell.study.get(name) for name in ("point", "replicate"))
    named = (cell.mode, cell.scenario_name, cell.sequence, cell.solver)
    return (*named, *asked, cell.study.get("name", ""), *study)


def is_tabulated(work: Sequence[CellJob], store: CellStore) -> bool:
    """Whether the public tables are those that `tabulate` would make of what is there."""
    wanted = list(Wanted(work).jobs)
    public, *parts = (part.names() for part in store.parts())
    return wanted == public and not set(wanted) & {name for names in parts for name in names}


def tabulate(work: Sequence[CellJob], store: CellStore) -> tuple[pd.DataFrame, int]:
    """Make the public tables of a campaign; cells that it is not asked for stay in a part.

    Memory is that of two row groups, and of the rows of the runs.

    Returns
    -------
    The rows of `runs.parquet`, and how many `steps.parquet` has.
    """
    store.close()
    wanted, finished, old = Wanted(work), store.rows(), store.parts()[1:]
    public, aside = store.public, store.new_part()
    steps = StepFile(public.steps.with_suffix(".parquet.part"))
    others = StepFile(aside.steps.with_suffix(".part"))
    try:
        read = _sort(store, wanted.jobs, wanted.aliases(finished), steps, others)
        # What cannot be read any more is not finished.
        finished = finished[finished.index.isin(read) | (finished["steps_done"] == 0)]
        unasked = finished[~finished.index.isin(wanted.jobs)]
        if len(unasked):
            aside.write_runs(unasked, others.path)
        rows = with_loop_ratio(wanted.rows(finished)[list(RUN_COLUMNS)])
        runs = as_runs(rows.assign(**study_columns(rows)))
        public.write_runs(runs, steps.path)
    finally:
        for file in (steps, others):
            file.close()
            file.path.unlink(missing_ok=True)
    for part in old:
        part.remove()
    return runs, steps.rows


def _sort(
    store: CellStore,
    wanted: Container[str],
    aliases: Mapping[str, str],
    steps: StepFile,
    others: StepFile,
) -> set[str]:
    """Write the steps of all finished runs, the `wanted` ones and their aliases apart from others;
    the names of those that could be read."""
    read: set[str] = set()
    for table in store.steps():
        names = set(pc.unique(table["run_id"]).to_pylist())
        read |= names
        steps.add(of_runs(table, {name for name in names if name in wanted}))
        others.add(of_runs(table, {name for name in names if name not in wanted}))
        here = {new: made_of for new, made_of in aliases.items() if made_of in names}
        for new, made_of in here.items():
            steps.add(renamed_runs(table, {made_of: new}))
    steps.close()
    others.close()
    return read
