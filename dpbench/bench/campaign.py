"""Run a suite: plan it, run what is not finished yet, write the tables.

A cell that was finished before with the same key is not run again, so an interrupted campaign
loses at most the cells in flight.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Container, Iterator, Sequence
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
from dpbench.bench.record.cell import HARNESS_VERSION, Cell, Outcome
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.result_folder import (
    claimed,
    load_descriptions,
    read_json,
    write_json,
)
from dpbench.bench.record.revision import Revision, revision, revisions
from dpbench.bench.sequences.at_edge import capability_in
from dpbench.bench.sequences.recording import read_sequence
from dpbench.bench.sequences.source import is_at_edge, is_sound, is_untimed
from dpbench.bench.tabulate import is_tabulated, tabulate
from dpbench.bench.workers.child import template_context
from dpbench.bench.workers.compiled import missing, needed
from dpbench.bench.workers.executor import Bench, CellJob, work_of
from dpbench.bench.workers.scratch import Scratch
from dpbench.bench.workers.worker import make_source
from dpbench.errors import InputError, ResultsError
from dpbench.scenario.problem_files import sequence_path
from dpbench.solvers.table import available, load_solver_module

WAVE_STEPS = 100_000
"""Steps of the sources that are kept at a time: some 2 kB each."""
Run = Callable[[list[CellJob], dict[str, Path]], None]
"""Runs cells, from the files behind their QPs."""


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
        self._store = CellStore(out)
        self._designs = DesignStudy(designs, out / "cells", self.machine["id"], fresh=fresh)
        solvers = {p.cell.solver for p in planned}
        self._libraries = {solver: available(solver) for solver in solvers}
        self.work = [self._job(p) for p in planned]
        self._fresh = fresh
        self._at_edge: list[str] = []
        if fresh:
            self._store.forget(job.run_id for job in self.work)
            self._drop_sources()
        # Capability plots stand in the files that the QPs at their edge come from.
        at_edge = [job.source_key for job in self.work if is_at_edge(job.cell)]
        self._at_edge += dict.fromkeys(at_edge)
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
            elif job.run_id in self._store.finished:
                job.outcome = Outcome(self._store.finished[job.run_id], "")
            else:
                pending.append(job)
        work = sum(work_of(job.cell) for job in pending)
        progress.start(work + self._designs.work)
        if not work + self._designs.work and self._is_written():
            return self._out
        solvers = [job.cell.solver for job in pending]
        if missing(needed(solvers)):
            progress.remark("compiling the kernels, once after an installation: up to a minute")
        with Scratch(self._store.folder) as scratch:
            context, slots = template_context(solvers), self._jobs
            bench = Bench(
                context, scratch, self._store, self._cores, slots, progress, self.machine["id"]
            )
            self._run_cells(bench, pending)
            self._drop_sources()
            self._designs.run(bench, self._out)
        self._write(started_utc, time.monotonic() - started_s, scratch.remarks)
        return self._out

    def _run_cells(self, bench: Bench, pending: list[CellJob]) -> None:
        """Run cells mode by mode, in waves of as many sources as are kept at a time."""

        def replay(jobs: list[CellJob], sources: dict[str, Path]) -> None:
            for group in _groups(jobs):
                bench.replays(group, sources)

        def loop(jobs: list[CellJob], sources: dict[str, Path]) -> None:
            bench.batches(jobs, sources, "closed loops")

        def solve(jobs: list[CellJob], sources: dict[str, Path]) -> None:
            bench.batches(jobs, sources, "problems without a deadline")

        loops = [job for job in pending if job.cell.mode == "closed_loop"]
        replays = [job for job in pending if job.cell.mode == "replay"]
        timed = [job for job in replays if not is_untimed(job.cell)]
        untimed = [job for job in replays if is_untimed(job.cell)]
        for run, jobs in ((loop, loops), (replay, timed), (solve, untimed)):
            for wave in _waves(jobs):
                self._run_wave(bench, run, wave)
                self._drop_sources({job.source_key for job in pending if job.outcome is None})

    def _run_wave(self, bench: Bench, run: Run, jobs: list[CellJob]) -> None:
        """Make the sources of cells and run them; once again what was lost by a source that was
        damaged since it was looked at."""
        for _ in range(2):
            for job in jobs:
                job.outcome = None
            sources = self._sources(bench, jobs)
            run([job for job in jobs if job.outcome is None], sources)
            lost = [job for job in jobs if job.is_lost]
            cells = {job.source_key: job.cell for job in lost}
            sound = {key: is_sound(cell, self._source_path(key)) for key, cell in cells.items()}
            jobs = [job for job in lost if not sound[job.source_key]]

    def _source_path(self, key: str) -> Path:
        return self._store.folder / f"exact-{key}.npz"

    def _drop_sources(self, needed: Container[str] = ()) -> None:
        """Remove what QPs are made from, but for what cells still need, and what holds plots."""
        for path in self._store.folder.glob("exact-*.npz"):
            key = path.stem.removeprefix("exact-")
            if key not in needed and key not in self._at_edge:
                path.unlink(missing_ok=True)

    def _sources(self, bench: Bench, jobs: list[CellJob]) -> dict[str, Path]:
        """What the QPs of cells are made from, by key: exactly solved loops and the like, each as
        long as the longest of its cells asks for."""
        of_key: dict[str, list[CellJob]] = {}
        for job in jobs:
            of_key.setdefault(job.source_key, []).append(job)
        paths = {key: self._source_path(key) for key in of_key}
        longest = {key: max((job.cell for job in some), key=_last) for key, some in of_key.items()}
        unmade = {
            paths[key]: cell.to_json()
            for key, cell in longest.items()
            if not is_sound(cell, paths[key])
        }
        by_path = {path: of_key[key] for key, path in paths.items()}
        for errand in bench.make_files(make_source, unmade):
            if errand.outcome.outcome != "finished":
                self._without_source(by_path[errand.path], errand.outcome)
        return paths

    def _without_source(self, jobs: list[CellJob], outcome: Outcome) -> None:
        """Cells whose QPs could not be made: by their nature, or by an accident of the harness."""
        what = "exactly solved loop" if jobs[0].cell.scenario else "sequence"
        became = "lost" if outcome.outcome == "lost" else "invalid"
        for job in jobs:
            job.outcome = Outcome(became, f"the {what} failed: {outcome.detail}")

    def _is_written(self) -> bool:
        """Whether the folder says already what this campaign would write."""
        try:
            found = load_descriptions(self._out)[1]
        except ResultsError:
            return False
        asked = json.loads(json.dumps(self._document()))
        same = all(found.get(key) == value for key, value in asked.items())
        if self._at_edge and not (self._out / CAPABILITY_FILE).is_file():
            return False
        return same and is_tabulated(self.work, self._store, self.machine["id"])

    def _document(self) -> dict[str, Any]:
        """What is asked of the campaign, as in `suite.json`."""
        return {"name": self._name, **self._suite.model_dump(), "harness_version": HARNESS_VERSION}

    def _earlier_revisions(self) -> list[Revision]:
        """Those of the cells that an interrupted campaign left in the folder."""
        previous = self._out / "suite.json"
        if self._fresh or not previous.is_file():
            return []
        earlier: list[Revision] = read_json(previous).get("revisions", [])
        return earlier

    def _write(self, started: datetime, wall_s: float, remarks: Sequence[str]) -> None:
        runs, step_rows = tabulate(self.work, self._store, self.machine["id"])
        suite: dict[str, Any] = {
            **self._document(),
            "revisions": revisions(self._earlier_revisions(), revision()),
            "started_utc": started.isoformat(timespec="seconds"),
            "wall_s": round(wall_s, 1),
            **_accidents(runs, remarks),
        }
        rows = {"run_rows": len(runs), "step_rows": step_rows}
        write_json(self._out / "machine.json", self.machine)
        write_json(self._out / "suite.json", suite | rows)
        self._write_capability()

    def _write_capability(self) -> None:
        """The capability plots, out of the files that the QPs at their edge come from."""
        tables = [capability_in(self._source_path(key)) for key in self._at_edge]
        made = [table for table in tables if table is not None]
        if made:
            write_capability(self._out, made)
        elif not self._at_edge:
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


def _last(cell: Cell) -> int:
    """The sample behind the last that a cell needs of its source."""
    return cell.first + cell.steps


def _waves(jobs: list[CellJob]) -> Iterator[list[CellJob]]:
    """Jobs in groups whose sources have some `WAVE_STEPS` steps together."""
    of_key: dict[str, list[CellJob]] = {}
    for job in jobs:
        of_key.setdefault(job.source_key, []).append(job)
    wave: list[CellJob] = []
    steps = 0
    for some in of_key.values():
        wave += some
        steps += max(_last(job.cell) for job in some)
        if steps >= WAVE_STEPS:
            yield wave
            wave, steps = [], 0
    if wave:
        yield wave


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
