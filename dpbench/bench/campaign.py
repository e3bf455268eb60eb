"""Run a suite: plan it, run what is not finished yet, write the tables.

A cell that was finished before with the same key is not run again, so an interrupted campaign
loses at most the cells in flight.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from dpbench.bench.capability.table import CAPABILITY_FILE, write_capability
from dpbench.bench.design import Design, DesignStudy, plan_designs
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.choices import remarks_on, with_choices
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.suite import SuiteFile, load_suite, naming, sequence_suite
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.result_folder import Results, claimed, read_json, write_results
from dpbench.bench.record.revision import Revision, revision, revisions
from dpbench.bench.sequences.at_edge import capability_in
from dpbench.bench.sequences.recording import read_sequence
from dpbench.bench.sequences.source import is_at_edge, is_sound, is_untimed, source_key
from dpbench.bench.tabulate import tabulate
from dpbench.bench.workers.child import template_context
from dpbench.bench.workers.compiled import missing, needed
from dpbench.bench.workers.executor import Bench, CellJob, CellStore, work_of
from dpbench.bench.workers.scratch import Scratch
from dpbench.bench.workers.worker import make_source
from dpbench.errors import InputError
from dpbench.scenario.problem_files import sequence_path
from dpbench.solvers.table import available, load_solver_module


class Campaign:
    """One run of a suite into a folder; see `run_campaign`."""

    def __init__(
        self,
        name: str,
        suite: SuiteFile,
        planned: list[PlannedCell],
        designs: list[Design],
        out: Path,
        jobs: int,
        fresh: bool,
    ) -> None:
        self.machine = describe_machine()
        self._name, self._suite, self._out, self._jobs = name, suite, out, jobs
        self._store = CellStore(out / "cells")
        self._designs = DesignStudy(designs, out / "cells", self.machine["id"], fresh=fresh)
        solvers = {p.cell.solver for p in planned}
        self._libraries = {solver: available(solver) for solver in solvers}
        self.work = [self._job(p) for p in planned]
        self._fresh = fresh
        self._cores = sorted(os.sched_getaffinity(0))

    def _job(self, planned: PlannedCell) -> CellJob:
        library = self._libraries[planned.cell.solver]
        run_id = planned.cell.run_id(library.identity, self.machine["id"], HARNESS_VERSION)
        return CellJob(planned, run_id, library)

    def run(self, progress: Progress) -> Path:
        """Run what is not finished yet and write the tables."""
        started_utc, started_s = datetime.now(UTC), time.monotonic()
        pending = []
        for job in self.work:
            if job.planned.refused:
                job.outcome = Outcome("refused", job.planned.refused)
            elif not self._fresh:
                job.outcome = self._store.finished(job)
            if job.outcome is None:
                pending.append(job)
        work = sum(work_of(job.cell) for job in pending)
        progress.start(work + self._designs.work)
        solvers = [job.cell.solver for job in pending]
        if missing(needed(solvers)):
            progress.remark("compiling the kernels, once after an installation: up to a minute")
        with Scratch(self._store.folder) as scratch:
            context, slots = template_context(solvers), self._jobs
            bench = Bench(context, scratch, self._store, self._cores, slots, progress)
            self._run_cells(bench, pending)
            self._again_with_sound_sources(bench, pending)
            self._designs.run(bench, self._out)
        self._write(started_utc, time.monotonic() - started_s, scratch.remarks)
        return self._out

    def _run_cells(self, bench: Bench, pending: list[CellJob]) -> None:
        """Make the QPs of all cells, then run the cells, mode by mode."""
        sources = self._sources(bench, pending)
        runnable = [job for job in pending if job.outcome is None]
        loops = [job for job in runnable if job.cell.mode == "closed_loop"]
        bench.batches(loops, sources, "closed loops")
        replays = [job for job in runnable if job.cell.mode == "replay"]
        for group in _groups([job for job in replays if not is_untimed(job.cell)]):
            bench.replays(group, sources)
        untimed = [job for job in replays if is_untimed(job.cell)]
        bench.batches(untimed, sources, "problems without a deadline")

    def _again_with_sound_sources(self, bench: Bench, pending: list[CellJob]) -> None:
        """Run what was lost by a source that was damaged since it was looked at, once again."""
        lost = [job for job in pending if job.outcome and job.outcome.outcome == "lost"]
        cells = {_key(job): job.cell for job in lost}
        sound = {key: is_sound(cell, self._source_path(key)) for key, cell in cells.items()}
        to_repeat = [job for job in lost if not sound[_key(job)]]
        for job in to_repeat:
            job.outcome = None
        if to_repeat:
            self._run_cells(bench, to_repeat)

    def _source_path(self, key: str) -> Path:
        return self._store.folder / f"exact-{key}.npz"

    def _sources(self, bench: Bench, pending: list[CellJob]) -> dict[str, Path]:
        """What the QPs of all cells are made from, by key: exactly solved loops and the like."""
        jobs: dict[Path, list[CellJob]] = {}
        for job in pending:
            jobs.setdefault(self._source_path(_key(job)), []).append(job)
        missing = {
            path: of_path[0].cell.to_json()
            for path, of_path in jobs.items()
            if self._fresh or not is_sound(of_path[0].cell, path)
        }
        for errand in bench.make_files(make_source, missing):
            if errand.outcome.outcome != "finished":
                self._without_source(jobs[errand.path], errand.outcome)
        return {_key(of_path[0]): path for path, of_path in jobs.items()}

    def _without_source(self, jobs: list[CellJob], outcome: Outcome) -> None:
        """Cells whose QPs could not be made: by their nature, or by an accident of the harness."""
        what = "exactly solved loop" if jobs[0].cell.scenario else "sequence"
        became = "lost" if outcome.outcome == "lost" else "invalid"
        for job in jobs:
            job.outcome = Outcome(became, f"the {what} failed: {outcome.detail}")
            if became == "lost":
                self._store.finish(job, job.outcome)

    def _earlier_revisions(self) -> list[Revision]:
        """Those of the cells that an interrupted campaign left in the folder."""
        previous = self._out / "suite.json"
        if self._fresh or not previous.is_file():
            return []
        earlier: list[Revision] = read_json(previous).get("revisions", [])
        return earlier

    def _write(self, started: datetime, wall_s: float, remarks: Sequence[str]) -> None:
        runs, steps = tabulate(self.work, self._store, self.machine["id"])
        suite: dict[str, Any] = {
            "name": self._name,
            **self._suite.model_dump(),
            "harness_version": HARNESS_VERSION,
            "revisions": revisions(self._earlier_revisions(), revision()),
            "started_utc": started.isoformat(timespec="seconds"),
            "wall_s": round(wall_s, 1),
            **_accidents(runs, remarks),
        }
        write_results(self._out, Results(runs, steps, self.machine, suite))
        self._write_capability()

    def _write_capability(self) -> None:
        """The capability plots, out of the files that the QPs at their edge come from."""
        keys = dict.fromkeys(_key(job) for job in self.work if is_at_edge(job.cell))
        tables = [capability_in(self._source_path(key)) for key in keys]
        made = [table for table in tables if table is not None]
        if made:
            write_capability(self._out, made)
        elif not keys:
            (self._out / CAPABILITY_FILE).unlink(missing_ok=True)


def _accidents(runs: pd.DataFrame, remarks: Sequence[str]) -> dict[str, Any]:
    """What of `suite.json` is about the harness's own accidents.

    `lost_cells` counts rows; `remarks` are lines for whoever gave the command.
    """
    causes = runs.loc[runs["outcome"] == "lost", "outcome_detail"]
    if causes.empty:
        return {"lost_cells": 0, "remarks": [*remarks]}
    counts = causes.value_counts()
    rest = f" ({len(causes) - counts.iloc[0]} by something else)" if len(counts) > 1 else ""
    line = (
        f"{len(causes)} of {len(runs)} cells were lost by the benchmark, not by their solvers: "
        f"{counts.index[0]}{rest}; when that is mended, the same command runs them again"
    )
    return {"lost_cells": len(causes), "remarks": [*remarks, line]}


def _key(job: CellJob) -> str:
    return source_key(job.cell, HARNESS_VERSION)


def _groups(jobs: list[CellJob]) -> list[list[CellJob]]:
    """Replay jobs that see the same QPs, interleaved with each other."""
    groups: dict[str, list[CellJob]] = {}
    for job in jobs:
        groups.setdefault(job.cell.problem_key, []).append(job)
    return list(groups.values())


def _asked(suite: str | Path | None, sequence: str | Path | None) -> tuple[str, Path, SuiteFile]:
    """Name, file and document of a suite, or of the one that replays a sequence."""
    if suite is not None and sequence is None:
        path, document = load_suite(suite)
        return path.stem, path, document
    if sequence is not None and suite is None:
        meta = read_sequence(sequence_path(sequence)).sequence.meta
        name = f"sequence-{Path(sequence).resolve().stem}"
        return name, Path("suite"), sequence_suite(sequence, meta)
    given = "neither" if suite is None else f"suite {suite} and --sequence {sequence}"
    raise InputError("run", "", given, "a suite, or --sequence PATH")


def run_campaign(
    suite: str | Path | None = None,
    out: str | Path | None = None,
    *,
    solvers: Sequence[str] | None = None,
    scenarios: Sequence[str] | None = None,
    settings: Sequence[str] | None = None,
    steps: int | None = None,
    jobs: int | None = None,
    fresh: bool = False,
    solver_module: str | Path | None = None,
    sequence: str | Path | None = None,
    progress: Progress | None = None,
) -> Path:
    """Run a suite and write `runs.parquet`, `steps.parquet`, `machine.json`, `suite.json`.

    Parameters
    ----------
    suite : a name under `problems/suites/` or a TOML path; None with `sequence`.
    out : result folder; by default `results/<suite>`, `results/sequence-<its file>`, and
        `-part` behind it with a choice of any kind, so that a part never replaces the whole.
    solvers, scenarios, settings : only these; scenarios that the suite does not name, by name or
        TOML file, take the place of its own.
    steps : at most so many of each loop and replay.
    jobs : closed loops or random sequences at a time; all cores by default. Replays along a loop
        always run alone.
    fresh : run every cell again, also those finished before.
    solver_module : a Python file with a plug-in, whose solver then has a name like any other.
    sequence : instead of a suite: a stored sequence by name, a `.npz` of `dpbench export` or a
        folder of qpsolvers problems, replayed through every solver at default and high settings.
    progress : told how far the campaign is.

    Returns
    -------
    The result folder.

    Raises
    ------
    InputError : for a bad suite, scenario, solver or job count, before anything runs.
    """
    if solver_module is not None:
        load_solver_module(solver_module)
    name, path, document = _asked(suite, sequence)
    # A part of a suite is about its solvers and runs; no design depends on them.
    part = bool(solvers or scenarios or settings or steps is not None)
    whole = document.design is not None and not part
    document = with_choices(document, scenarios=scenarios, settings=settings, steps=steps)
    with naming(path, chosen=bool(settings)):
        planned = plan(document, solvers=solvers, scenarios=scenarios, beside=path.parent)
        designs = plan_designs(document.design, path.parent) if document.design and whole else []
    cores = len(os.sched_getaffinity(0))
    if jobs is not None and not 1 <= jobs <= cores:
        raise InputError("--jobs", "", jobs, f"a number from 1 to {cores}, the cores available")
    folder = Path(out) if out is not None else Path("results") / f"{name}{'-part' * part}"
    progress = progress or Silent()
    for remark in remarks_on(planned):
        progress.remark(remark)
    with claimed(folder, name):
        campaign = Campaign(name, document, planned, designs, folder, jobs or cores, fresh)
        return campaign.run(progress)
