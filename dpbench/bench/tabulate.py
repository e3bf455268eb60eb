"""The two tables of a campaign, from the judged cells on disk."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from dpbench.bench.judge.memory_of_answers import with_loop_ratio
from dpbench.bench.judge.rows import run_row, step_rows
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.schema import as_steps
from dpbench.bench.record.study_columns import study_columns
from dpbench.bench.workers.executor import CellJob, CellStore


def tabulate(
    work: Sequence[CellJob], store: CellStore, machine_id: str
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Runs and steps of all cells.

    A cell whose settings have no effect has rows under each of its names.
    """
    rows, frames = [], []
    for job in work:
        outcome = job.outcome or Outcome("lost", "it was not run")
        evaluated = None if outcome.outcome in ("refused", "lost") else store.evaluated(job)
        if outcome.outcome == "finished" and evaluated is None:
            outcome = Outcome("lost", f"{store.evaluated_path(job)} is damaged or gone")
        for settings in (job.cell.settings, *job.planned.alias_settings):
            cell, library = job.cell.with_settings(settings), job.library
            run_id = cell.run_id(library.identity, machine_id, HARNESS_VERSION)
            steps = step_rows(run_id, cell, evaluated) if evaluated else None
            if steps is not None:
                frames.append(steps)
            rows.append(run_row(run_id, cell, outcome, library, machine_id, evaluated, steps))
    steps = pd.concat(frames, ignore_index=True) if frames else as_steps(pd.DataFrame())
    runs = with_loop_ratio(pd.DataFrame(rows))
    return runs.assign(**study_columns(runs)), steps
