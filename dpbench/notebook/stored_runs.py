"""Closed loops that were run in this process, stored in a result folder and shown on its page."""

import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from dpbench.bench.record.cell import HARNESS_VERSION, Cell
from dpbench.bench.record.cell_store import PublicTables, StepFile
from dpbench.bench.record.result_folder import load_results, lock_for_writing, write_json
from dpbench.bench.record.step_table import FILE_SCHEMA, runs_from_frame
from dpbench.errors import InputError, require_type
from dpbench.notebook.runs import Run
from dpbench.report.formats import plural
from dpbench.report.write import write_report

_OF_LIBRARY = ("solver_version", "build", "generic_build")


def add_runs(out: str | Path, runs: Sequence[Run]) -> Path:
    """Add closed loops to a result folder, write its report again and return its page.

    The folder is one of `run_campaign`, such as that of the sequence of a `LinearMPC`. A run that
    is there already is replaced; of equal runs, the last is added. The next `run_campaign` in the
    folder raises InputError, or with `fresh=True` removes what was added.

    Raises
    ------
    InputError : for a replay: its times would be compared with those of a campaign, which
        interleaves solvers; or for a loop of another length than those of its name.

    Examples
    --------
    >>> from dpbench import replay
    >>> timed = replay("paper-30-5", "daqp", repeats=1)
    >>> add_runs("results/smoke", [timed])  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    dpbench.errors.InputError: `runs`: found a replay, daqp (qpsolvers, fresh); allowed: ...
    """
    require_type("out", out, str | PathLike, "the path of a result folder")
    require_type("runs", runs, list | tuple, "a list of runs of `run_closed_loop()`")
    folder = Path(out)
    for run in runs:
        require_type("runs", run, Run, "a list of runs of `run_closed_loop()`")
        if run.summary["mode"] != "closed_loop":
            allowed = "closed loops; `run_campaign(sequence=...)` for replays"
            raise InputError("`runs`", "", f"a replay, {run.label}", allowed)
    with lock_for_writing(folder):
        stored = load_results(folder)
        _refuse_other_lengths(runs, stored.runs, folder)
        placed = [_place_run(run, stored.runs, stored.machine["id"]) for run in runs]
        new = {str(row["run_id"]): (row, steps) for row, steps in placed}
        kept_runs = stored.runs[~stored.runs["run_id"].isin(new)]
        kept_steps = stored.steps[~stored.steps["run_id"].isin(new)]
        rows = pd.DataFrame([row for row, _ in new.values()])
        table = pd.concat([kept_runs, rows], ignore_index=True)
        count = _write_tables(folder, table, [kept_steps, *(steps for _, steps in new.values())])
        suite = json.loads((folder / "suite.json").read_text(encoding="utf-8"))
        added = sorted({*new, *suite.get("added_runs", [])})
        changes = {"run_rows": len(table), "step_rows": count, "added_runs": added}
        write_json(folder / "suite.json", suite | changes)
    return write_report(folder)


def _refuse_other_lengths(runs: Sequence[Run], stored: pd.DataFrame, folder: Path) -> None:
    """Raise InputError for a loop of another length than those of its name.

    They are the closed loops in the folder and in `runs`, and replays of a sequence of that name
    that has no scenario, such as that of a `LinearMPC`.
    """
    usual = stored[stored["study"] == ""]
    names = usual["scenario"].where(usual["scenario"] != "", usual["sequence"])
    alike = (usual["mode"] == "closed_loop") | (usual["scenario"] == "")
    planned = usual[alike]["steps_planned"].groupby(names).unique()
    lengths = {str(name): {int(steps) for steps in found} for name, found in planned.items()}
    for run in runs:
        name, steps = str(run.summary["scenario"]), int(run.summary["steps_planned"])
        known = lengths.setdefault(name, {steps})
        if steps not in known:
            found = f"a closed loop {name} of {plural(steps, 'step')}"
            others = " and ".join(map(str, sorted(known)))
            allowed = (
                f"{others} steps, like the other runs of that name in {folder}; or another name"
            )
            raise InputError("`runs`", "", found, allowed)


def _place_run(
    run: Run, known: pd.DataFrame, machine_id: str
) -> "tuple[pd.Series[Any], pd.DataFrame]":
    """Return summary row and steps of a run under the id that it has in a result folder."""
    row = run.summary.copy()
    same = known[known["solver"] == row["solver"]]
    if len(same):
        row[[*_OF_LIBRARY]] = same.iloc[0][[*_OF_LIBRARY]]
    cell = Cell.from_json(str(row["cell"]))
    row["machine_id"] = machine_id
    row["run_id"] = cell.run_id(str(row["solver_version"]), machine_id, HARNESS_VERSION)
    return row, run.steps.assign(run_id=row["run_id"])


def _write_tables(folder: Path, runs: pd.DataFrame, steps: Sequence[pd.DataFrame]) -> int:
    """Write the two tables of a result folder; return the number of steps."""
    public = PublicTables(folder)
    file = StepFile(public.steps.with_suffix(".parquet.part"))
    try:
        for part in steps:
            if len(part):
                file.add(pa.Table.from_pandas(part, FILE_SCHEMA, preserve_index=False))
        public.write(runs_from_frame(runs), file, public.read_last_part_number())
    finally:
        file.close()
        file.path.unlink(missing_ok=True)
    return file.rows
