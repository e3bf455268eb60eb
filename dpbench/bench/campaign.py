"""Run a suite: plan it, run what is not finished yet, write the tables.

An interrupted campaign loses at most the cells in flight.
"""

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench.bench.capability.edge_qps import CAPABILITY_FILE, write_capability_plots
from dpbench.bench.design import Design, DesignStudy, pair_controllers_with_vessels
from dpbench.bench.embedded_counts import EmbeddedCounts, PlannedCount, pair_sequences_with_cores
from dpbench.bench.engines.dispatcher import Dispatcher, find_cell_with_most_steps
from dpbench.bench.engines.engine import Engine, SourceFiles, TlsFiles
from dpbench.bench.engines.open_engine import open_engine
from dpbench.bench.engines.shards import WHOLE, Shard, ShardRecord
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.configurations import identify_libraries_of_cell
from dpbench.bench.plan.run_request import Plan, RunRequest
from dpbench.bench.plan.suite import name_file_in_errors
from dpbench.bench.progress import Progress, Silent, choose_progress
from dpbench.bench.record.cell import HARNESS_VERSION, CapabilitySource, Outcome
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.machine import append_revision, find_running_revision
from dpbench.bench.record.result_folder import (
    MachineDescription,
    Revision,
    load_machine_and_suite,
    lock_result_folder,
    read_suite_description,
    write_json,
)
from dpbench.bench.sequences.capability_boundary import read_capability_plot
from dpbench.bench.sequences.source import is_readable
from dpbench.bench.tabulate import RequestedRuns, is_tabulated, refuse_other_selection, tabulate
from dpbench.bench.workers.jobs import CellJob, Result, count_steps, group_by_source
from dpbench.bench.workers.scratch import clear_scratch_folders
from dpbench.bench.workers.worker import make_source
from dpbench.errors import (
    ResultsError,
    require_lists_of_names,
    require_name_or_file,
    require_type,
)
from dpbench.files.regular_files import write_text_atomically
from dpbench.locks import WaitLimit
from dpbench.solvers.table import PluginFiles, find_solver_availability, list_plugin_files

CELL_KEYS = (
    *("cell_limit_s", "cell_memory_gb", "rounds", "warmup_steps", "replay_budget_s"),
    *("repeat_budget_s", "harness_version"),
)
"""Keys of a suite that are part of many or all of its cells: a change runs these again."""
LIST_ENTRIES = {
    "scenarios": "a name or a file in the list; for other values of keys, a study in the suite",
    "solvers": "a name in the list; for your own solver, a plug-in file in `solver_module`",
}


def make_jobs(
    cells: Sequence[PlannedCell], machine_id: str, campaign_utc: str = ""
) -> list[CellJob]:
    """Return planned runs with their run_ids and the versions of their solvers' libraries."""
    solvers = {planned.cell.solver for planned in cells}
    libraries = {solver: find_solver_availability(solver) for solver in solvers}
    jobs = []
    for planned in cells:
        library = libraries[planned.cell.solver]
        identity = identify_libraries_of_cell(planned.cell, library)
        run_id = planned.cell.run_id(identity, machine_id, HARNESS_VERSION)
        jobs.append(CellJob(planned, run_id, library, machine_id, campaign_utc=campaign_utc))
    return jobs


class Campaign:
    """Execution of all runs of a suite into a result folder; can be interrupted and continued."""

    def __init__(
        self,
        plan: Plan,
        designs: Sequence[Design],
        out: Path,
        machine: MachineDescription,
        *,
        counts: Sequence[PlannedCount] = (),
        fresh: bool = False,
        shard: Shard = WHOLE,
    ) -> None:
        self.machine, self._plan, self._out, self._shard = machine, plan, out, shard
        self.store = CellStore(out)
        self.set_stability_studies(designs, machine["id"], fresh=fresh)
        self.counts = EmbeddedCounts(counts, self.store.folder, fresh=fresh)
        self._started_utc = datetime.now(UTC)
        started = self._started_utc.isoformat(timespec="milliseconds")
        jobs = make_jobs(plan.cells, machine["id"], started)
        self.work = shard.select_jobs(jobs)
        self._fresh = fresh
        if fresh:
            self.store.mark_unfinished(RequestedRuns(self.work).jobs)
            SourceFiles(self.store.folder).clear()
        # Capability plots stand in the files that the QPs at their edge come from.
        at_boundary = [j for j in self.work if isinstance(j.cell.source, CapabilitySource)]
        self._at_boundary = group_by_source(at_boundary)
        self.sources = SourceFiles(self.store.folder, self._at_boundary)

    def set_stability_studies(
        self, designs: Sequence[Design], machine_id: str, *, fresh: bool = False
    ) -> None:
        """Set the controllers whose stability is studied; records are kept by `machine_id`."""
        cells = self.store.folder
        self.designs = DesignStudy(designs, cells, machine_id, fresh=fresh)

    def run(self, engine: Engine, progress: Progress) -> None:
        """Do all unfinished runs and stability studies on an engine; write the result tables."""
        started_s = time.monotonic()
        pending = self.find_unfinished_jobs()
        work = sum(count_steps(job.cell) for job in pending) + self.designs.work
        work += self.counts.work
        if pending and (changed := self._describe_changed_keys()):
            progress.remark(f"{len(pending)} cells are run again, as the suite changed: {changed}")
        progress.start(work)
        if not work and self._has_written_results():
            clear_scratch_folders(self.store.folder)
            return
        engine.prepare(self.sources, pending, progress)
        dispatcher = Dispatcher(engine, self.sources, progress)
        self._make_capability_files(dispatcher, pending)
        by_id = {job.run_id: job for job in pending}
        for result in dispatcher.yield_results_of_jobs(pending):
            self._store_result(by_id[result.run_id], result)
        self.sources.clear()
        self.designs.run(dispatcher, progress)
        self.counts.run(dispatcher, progress)
        wall_s = time.monotonic() - started_s
        self.write_results(self._started_utc, wall_s, engine.remarks, progress=progress)

    def find_unfinished_jobs(self) -> list[CellJob]:
        """Return the runs still to be done; set the outcome of refused and of stored ones."""
        pending = []
        for job in self.work:
            if job.planned.refused:
                job.outcome = Outcome("refused", job.planned.refused)
            elif job.run_id in self.store.finished:
                job.outcome = Outcome(self.store.finished[job.run_id], "")
            else:
                pending.append(job)
        return pending

    def _store_result(self, job: CellJob, result: Result) -> None:
        """Store a run's result on disk; its outcome is "lost" where there is no room for it."""
        job.outcome = result.outcome
        if result.part is None:
            return
        try:
            self.store.write_part_file(result.part)
        except OSError as error:
            job.outcome = Outcome("lost", f"its result could not be stored: {error}")

    def _make_capability_files(self, dispatcher: Dispatcher, pending: list[CellJob]) -> None:
        """Make missing files of capability-plot QPs; a failure shows in the runs that use them."""
        wanted = {job.source_key for job in pending} & set(self._at_boundary)
        cells = {
            self.sources.path(key): find_cell_with_most_steps(self._at_boundary[key])
            for key in wanted
        }
        unmade = {p: cell.to_json() for p, cell in cells.items() if not is_readable(cell, p)}
        for _ in dispatcher.yield_made_files(make_source, unmade):
            pass

    def _has_written_results(self) -> bool:
        """Return whether the result folder has all tables that this campaign would write."""
        try:
            found = load_machine_and_suite(self._out)[1]
        except ResultsError:
            return False
        asked = json.loads(json.dumps(self._describe_request_for_suite_json()))
        same = all(found.get(key) == value for key, value in asked.items())
        if self._at_boundary and not (self._out / CAPABILITY_FILE).is_file():
            return False
        return same and self.counts.is_written(self._out) and is_tabulated(self.work, self.store)

    def _describe_request_for_suite_json(self) -> dict[str, Any]:
        """Return the entries of `suite.json` that describe the requested suite."""
        document = self._plan.document.model_dump()
        asked = {"name": self._plan.name, **document, "harness_version": HARNESS_VERSION}
        return asked if self._shard == WHOLE else asked | {"shard": str(self._shard)}

    def _read_earlier_revisions(self) -> list[Revision]:
        """Return the dpbench revisions that an interrupted campaign noted in `suite.json`."""
        previous = self._out / "suite.json"
        if self._fresh or not previous.is_file():
            return []
        return list(read_suite_description(self._out).get("revisions", []))

    def _describe_changed_keys(self) -> str:
        """Return as text the suite's keys that had other values in this folder; "" without any."""
        if self._fresh or not (self._out / "suite.json").is_file():
            return ""
        found: Mapping[str, Any] = dict(read_suite_description(self._out))
        asked = self._describe_request_for_suite_json()
        changed = [k for k in CELL_KEYS if k in found and found[k] != asked[k]]
        return ", ".join(f"{key} {found[key]} → {asked[key]}" for key in changed)

    def write_results(
        self,
        started: datetime,
        wall_s: float,
        remarks: Sequence[str],
        made_by: list[Revision] | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Write all result files; `made_by` are the revisions that ran the cells, if not this."""
        self.designs.write(self._out)
        not_counted = self.counts.write(self._out)
        runs, step_rows = tabulate(self.work, self.store, progress or Silent())
        suite: dict[str, Any] = {
            **self._describe_request_for_suite_json(),
            "revisions": made_by
            or append_revision(self._read_earlier_revisions(), find_running_revision()),
            "started_utc": started.isoformat(timespec="seconds"),
            "wall_s": round(wall_s, 1),
            **_count_lost_runs_and_studies(runs, self.designs, remarks),
            **({"not_counted": not_counted} if not_counted else {}),
        }
        rows = {"run_rows": len(runs), "step_rows": step_rows}
        write_json(self._out / "machine.json", self.machine)
        write_json(self._out / "suite.json", suite | rows)
        write_text_atomically(self._out / "suite.toml", self._plan.format_suite(self._out))
        self._write_capability_plots()

    def _write_capability_plots(self) -> None:
        """Write the capability plots of the vessels whose edges were replayed."""
        tables = [read_capability_plot(self.sources.path(key)) for key in self._at_boundary]
        made = [table for table in tables if table is not None]
        if made:
            write_capability_plots(self._out, made)
        elif not self._at_boundary:
            (self._out / CAPABILITY_FILE).unlink(missing_ok=True)


def _count_lost_runs_and_studies(
    runs: pd.DataFrame, designs: DesignStudy, remarks: Sequence[str]
) -> dict[str, Any]:
    """Return `suite.json` entries: how many runs and stability studies were lost, and remarks."""
    causes = runs.loc[runs["outcome"] == "lost", "outcome_detail"].tolist()
    lines = [
        _describe_lost_runs(causes, f"{len(runs)} cells", ", not by their solvers"),
        _describe_lost_runs(designs.lost, f"{len(designs)} designs"),
    ]
    return {
        "lost_cells": len(causes),
        "lost_designs": len(designs.lost),
        "remarks": [*remarks, *filter(None, lines)],
    }


def _describe_lost_runs(causes: Sequence[str], of: str, beside: str = "") -> str:
    """Return a line on how many runs or stability studies were lost, and why; "" for none."""
    if not causes:
        return ""
    (cause, count), *others = Counter(causes).most_common()
    rest = f"; {len(causes) - count} for other reasons" if others else ""
    return (
        f"{len(causes)} of {of} were lost by dpbench{beside} ({cause}{rest}); fix the cause and "
        "run the same command again"
    )


def plan_stability_studies(plan: Plan) -> list[Design]:
    """Return the controller-vessel pairs a suite studies for stability; none if run in part."""
    table = None if plan.part else plan.document.design
    with name_file_in_errors(plan.path):
        return pair_controllers_with_vessels(table, plan.path.parent) if table else []


def plan_embedded_counts(plan: Plan) -> list[PlannedCount]:
    """Return what a suite counts on embedded cores; nothing if it is run in part."""
    table = None if plan.part else plan.document.embedded
    with name_file_in_errors(plan.path):
        return pair_sequences_with_cores(table, plan.path.parent) if table else []


def choose_result_folder(plan: Plan, out: str | Path | None) -> Path:
    """Return the result folder: `out`, or `results/<name of the plan>` without one."""
    return Path(out) if out is not None else Path("results") / f"{plan.name}{'-part' * plan.part}"


def run_campaign(
    suite: str | Path | None = None,
    out: str | Path | None = None,
    *,
    solvers: Sequence[str] | None = None,
    scenarios: Sequence[str] | None = None,
    settings: Sequence[str] | None = None,
    routes: Sequence[str] | None = None,
    policies: Sequence[str] | None = None,
    steps: int | None = None,
    jobs: int | None = None,
    fresh: bool = False,
    solver_module: PluginFiles = None,
    sequence: str | Path | None = None,
    engine: str = "local",
    scheduler: str | None = None,
    tls: TlsFiles | None = None,
    shard: str | None = None,
    wait_s: float | None = None,
    may_leave_out: bool = False,
    progress: Progress | bool | None = None,
) -> Path:
    """Run a suite into a result folder and return its path.

    Parameters
    ----------
    suite : a name under `problems/suites/` or a TOML path; None with `sequence`.
    out : result folder; by default `results/<suite>`, `results/sequence-<its file>`, with `-part`
        for any choice, so that a part never replaces the whole.
    solvers, scenarios, settings : only these; scenarios that the suite does not name, by name or
        TOML file, replace its own.
    routes, policies : in place of those of the suite, or with `sequence` of a solver's default,
        such as "native" and "warm".
    steps : at most so many of each loop and replay.
    jobs : closed loops or random sequences at a time; all cores by default. Replays along a loop
        always run alone.
    engine : "local", the processes of this machine, or "dask", the workers of a Dask cluster;
        without a `scheduler` so many as `jobs` on this machine.
    scheduler : the address of a Dask scheduler.
    tls : of a scheduler at tls://HOST:8786 the files of its certificate authority, of a client's
        certificate and of its key; those of Dask's configuration by default.
    shard : "i/n": only the i-th of n parts of about the same work, for `gather`.
    fresh : run every cell again, also finished ones.
    wait_s : the longest wait for another campaign that times replays on this machine; None without
        a limit, 0 for none.
    may_leave_out : whether finished runs may leave the tables of the folder, where they are not
        requested.
    solver_module : a Python file with a plug-in, whose solver then has a name like any other; or
        several such files.
    sequence : instead of a suite: a stored sequence by name, a `.npz` of `dpbench export` or a
        folder of qpsolvers problems, replayed through every solver at default and high settings.
    progress : True prints the lines of `dpbench run` without a terminal on standard error, each
        minute or tenth, and what it waits for; False none; None only in a terminal or a notebook.
        An object receives the progress instead.

    Returns
    -------
    The result folder.

    Raises
    ------
    InputError : for a bad suite, scenario, solver, job count or engine, or a folder with finished
        runs that are not requested, before anything runs.
    SolverUnavailableError : none of the selected `solvers` can be used here.
    TypeError : for a suite or sequence that is neither a name nor a path, or a name for a list.
    dpbench.locks.BusyError : the machine was busy longer than `wait_s`; finished cells are kept.

    Examples
    --------
    >>> run_campaign("smoke", "results/part", solvers=["daqp"], steps=5).name
    'part'
    """
    chosen = {
        "solvers": solvers,
        "scenarios": scenarios,
        "settings": settings,
        "routes": routes,
        "policies": policies,
    }
    require_lists_of_names(LIST_ENTRIES, **chosen)
    if suite is not None:
        file = "a TOML file; for a scenario, its name or file in `scenarios=[...]`"
        require_name_or_file("suite", suite, file)
    if sequence is not None:
        require_name_or_file("sequence", sequence, "a .npz file or a folder")
    asked = RunRequest(
        suite=None if suite is None else str(suite),
        sequence=None if sequence is None else str(sequence),
        steps=steps,
        solver_module=list_plugin_files(solver_module) or None,
        **chosen,
    )
    require_type("jobs", jobs, Integral | None, "a whole number, or None for all cores")
    require_type("out", out, str | PathLike | None, "the path of a folder")
    require_type("wait_s", wait_s, Real | None, "a number of seconds, 0 or more")
    patience = WaitLimit(wait_s)
    plan, some = asked.make_plan(), Shard.from_text(shard)
    plan.require_available_solver()
    designs = plan_stability_studies(plan) if some.index == 1 else []
    counts = plan_embedded_counts(plan) if some.index == 1 else []
    folder = choose_result_folder(plan, out)
    progress = choose_progress(progress)
    with (
        open_engine(engine, jobs, scheduler, tls, patience) as opened,
        lock_result_folder(folder, plan.name, patience),
    ):
        for remark in plan.remarks:
            progress.remark(remark)
        campaign = Campaign(
            plan, designs, folder, opened.machine, counts=counts, fresh=fresh, shard=some
        )
        if not (fresh or may_leave_out):
            work = [job.planned for job in campaign.work]
            refuse_other_selection(work, folder, "`fresh=True` to replace them, or another `out`")
        for remark in campaign.store.remarks:
            progress.remark(remark)
        if shard is not None:
            record = ShardRecord(asked.with_absolute_path(), some, plan.digest, opened.machine)
            record.write(folder)
        campaign.run(opened, progress)
    return folder
