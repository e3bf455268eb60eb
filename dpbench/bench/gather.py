"""Join the shards of a suite that were run apart, on one machine or on several.

Finished cells are copied into one folder, as if they had been run there; missing and damaged ones
are lost cells, which `dpbench run` into that folder runs.
"""

import re
import stat
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from dpbench.bench.campaign import Campaign, plan_embedded_counts, plan_stability_studies
from dpbench.bench.engines.shards import ShardRecord
from dpbench.bench.plan.run_request import Plan
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.result_folder import (
    MachineDescription,
    lock_result_folder,
    read_suite_description,
)
from dpbench.bench.record.step_table import DAMAGE
from dpbench.bench.tabulate import refuse_other_selection
from dpbench.bench.workers.jobs import CellJob
from dpbench.errors import InputError, SituationError
from dpbench.files.regular_files import write_bytes_atomically
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table
from dpbench.solvers.contract import Build
from dpbench.solvers.table import Availability, PluginFiles, list_plugin_files

_WHERE = "gather"
_EXTRA_FILE = re.compile(r"design-\w+\.json|embedded-\w+\.parquet|exact-\w+\.npz")
"""Files of a folder of cells that are shown too: designs, counts, capability plots with QPs."""


def join_result_folders(
    folders: Sequence[str | Path],
    out: str | Path,
    *,
    suite: str | Path | None = None,
    solver_module: PluginFiles = None,
    progress: Progress | None = None,
) -> Path:
    """Join the result folders of a suite that was run in parts into one result folder `out`.

    Parameters
    ----------
    folders : one of each shard; suite : path of the suite, if it was elsewhere.
    solver_module : files of their plug-ins. None is run because a shard names it.
    progress : receiver of the name of each stage.

    Returns
    -------
    `out`.

    Raises
    ------
    InputError : for folders of different suites, plans or versions, one that is in use, a suite
        that has changed since, shards of a plug-in without `solver_module`, or a finished result in
        `out` that has other cells.
    """
    started_utc, started_s, progress = datetime.now(UTC), time.monotonic(), progress or Silent()
    shards = {Path(folder): ShardRecord.read(Path(folder)) for folder in folders}
    plan, records = _make_common_plan(shards, suite, solver_module), list(shards.values())
    designs, remarks = plan_stability_studies(plan), _describe_missing_shards(records)
    with lock_result_folder(Path(out), plan.name):
        refuse_other_selection(plan.cells, Path(out), "another folder")
        finished, ignored = _copy_finished_runs(list(shards), Path(out), plan.name, progress)
        remarks += ignored
        machine, others = _split_main_and_other_machines(records, finished)
        if others:
            remarks.append(
                f"cells ran on {len(others) + 1} kinds of machines: only replay times on "
                f"{machine.get('cpu_model', 'an unnamed CPU')} ({machine['id']}) are ranked"
            )
            machine = {**machine, "others": others}
        campaign = Campaign(plan, designs, Path(out), machine, counts=plan_embedded_counts(plan))
        for folder, record in shards.items():
            if record.shard.index == 1:
                campaign.set_stability_studies(designs, record.machine["id"])
                campaign.counts.take_over_reasons(
                    read_suite_description(folder).get("not_counted", ())
                )
        said = {
            cell: outcome
            for folder in shards
            for cell, outcome in _yield_unfinished_outcomes(folder)
        }
        _fill_jobs_from_finished(campaign.work, finished, said, machine["id"])
        campaign.find_unfinished_jobs()
        made_by = [record.revision for record in records if record.revision]
        made_by = [one for i, one in enumerate(made_by) if one not in made_by[:i]]
        seconds = time.monotonic() - started_s
        campaign.write_results(started_utc, seconds, remarks, made_by, progress=progress)
    return Path(out)


def _make_common_plan(
    shards: Mapping[Path, ShardRecord],
    suite: str | Path | None,
    solver_module: PluginFiles,
) -> Plan:
    """Return the suite's plan that all folders are parts of; InputError where there is none."""
    where, first = next(iter(shards.items()))
    for folder, shard in shards.items():
        if shard.harness_version != HARNESS_VERSION:
            found = f"{folder} of dpbench {shard.harness_version}"
            raise InputError(
                _WHERE, "", found, f"folders of dpbench {HARNESS_VERSION}, which is installed"
            )
        if shard.digest != first.digest:
            found = f"{folder}, whose suite or options differ from those of {where}"
            raise InputError(_WHERE, "", found, "shards of one suite, run with the same options")
        if shard.asked.solver_module is not None and solver_module is None:
            files = ", ".join(list_plugin_files(shard.asked.solver_module))
            fault = f"{folder} was run with plug-ins from {files}"
            remedy = "if you trust them, give each file with --solver-module FILE.py"
            raise SituationError(_WHERE, f"{fault}; {remedy}")
    # The same suite may lie elsewhere on each of their machines.
    asked = next((one.asked for one in shards.values() if one.asked.has_suite), first.asked)
    asked = asked if suite is None else replace(asked, suite=str(suite))
    # What a folder says is data: a file that is run comes from the command line alone.
    asked = replace(asked, solver_module=list_plugin_files(solver_module) or None)
    if not asked.has_suite:
        fault = f"there is no file {asked.suite}; give the path of the suite with --suite"
        raise SituationError(_WHERE, fault)
    plan = asked.make_plan()
    if plan.digest != first.digest:
        found = f"that {plan.path} or a plug-in has changed since {where} was run"
        allowed = "the unchanged suite (--suite), and each plug-in at its original path"
        raise InputError(_WHERE, "", found, allowed)
    return plan


def _describe_missing_shards(shards: Sequence[ShardRecord]) -> list[str]:
    """Return a remark that names the parts of the suite without a folder; none if complete."""
    counts = {shard.shard.count for shard in shards}
    if len(counts) > 1:
        found = f"shards {' and '.join(f'I/{count}' for count in sorted(counts))}"
        raise InputError(_WHERE, "", found, "shards I/N with the same N")
    absent = set(range(1, counts.pop() + 1)) - {shard.shard.index for shard in shards}
    named = ", ".join(str(replace(shards[0].shard, index=i)) for i in sorted(absent))
    return [f"missing shards: {named}"] if absent else []


def _copy_finished_runs(
    folders: Sequence[Path], out: Path, name: str, progress: Progress
) -> tuple[pd.DataFrame, list[str]]:
    """Copy all finished runs into `out`; return their rows, and remarks on the folders."""
    with ExitStack() as stack:
        for folder in folders:
            stack.enter_context(lock_result_folder(folder, name))
        store, others = CellStore(out), [CellStore(folder) for folder in folders]
        _refuse_mixed_versions(pd.concat([one.read_finished_runs() for one in (store, *others)]))
        for i, other in enumerate(others, 1):
            progress.advance(0, f"gather: folder {i} of {len(others)}")
            store.copy_runs_of_other_folder(other)
            for path in other.folder.iterdir():
                # No link to other files.
                if _EXTRA_FILE.fullmatch(path.name) and stat.S_ISREG(path.lstat().st_mode):
                    write_bytes_atomically(store.folder / path.name, path.read_bytes())
        return store.read_finished_runs(), [
            line for one in (store, *others) for line in one.remarks
        ]


def _refuse_mixed_versions(rows: pd.DataFrame) -> None:
    """Raise InputError where runs of one solver used several versions or builds of it."""
    versions = rows["solver_version"].str.cat(rows["build"], " ").str.strip()
    for solver, alike in versions.groupby(rows["solver"]):
        if alike.nunique() > 1:
            found = " and ".join(sorted(alike.unique()))
            raise InputError(_WHERE, str(solver), found, "one version of each solver")


def _split_main_and_other_machines(
    shards: Sequence[ShardRecord], finished: pd.DataFrame
) -> tuple[MachineDescription, list[MachineDescription]]:
    """Return the machine with the most timed replays (else runs), and the other machines."""
    known = {shard.machine["id"]: shard.machine for shard in shards}
    timed = finished.loc[finished["concurrency"].notna(), "machine_id"]
    counts = Counter(timed if len(timed) else finished["machine_id"])
    first = next(
        (name for name, _ in counts.most_common() if name in known), shards[0].machine["id"]
    )
    return known.pop(first), list(known.values())


def _yield_unfinished_outcomes(folder: Path) -> Iterator[tuple[str, Outcome]]:
    """Yield description and outcome of each run in a folder that was lost or invalid."""
    with suppress(*DAMAGE):
        columns = ["cell", "outcome", "outcome_detail"]
        path = folder / "runs.parquet"
        with open_untrusted_parquet_table(path) as file:
            rows = decode_dictionary_columns_to_text(file.read(columns=columns), path).to_pandas()
        for cell, outcome, detail in rows.itertuples(index=False):
            if outcome in ("lost", "invalid"):
                yield str(cell), Outcome(str(outcome), str(detail))


def _fill_jobs_from_finished(
    jobs: Sequence[CellJob],
    finished: pd.DataFrame,
    said: Mapping[str, Outcome],
    machine_id: str,
) -> None:
    """Set each planned run's run_id, solver version and machine from its finished run's row."""
    # Of a cell that ran on several machines, that on the machine of the folder.
    there = finished.iloc[(finished["machine_id"] == machine_id).argsort(kind="stable")]
    by_cell = dict(zip(there["cell"], there.index, strict=True))
    for job in jobs:
        text = job.cell.to_json()
        job.outcome = said.get(text)
        if text in by_cell:
            row = finished.loc[by_cell[text]]
            build = Build(str(row["build"]), bool(row["generic_build"]))
            job.library = Availability(True, str(row["solver_version"]), build=build)
            job.run_id, job.machine_id = str(row["run_id"]), str(row["machine_id"])
