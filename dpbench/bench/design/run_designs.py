"""Look into designs in processes of their own, side by side, and keep what is finished."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from multiprocessing.context import ForkServerContext
from pathlib import Path

from dpbench.bench.design.design import Design, design_record
from dpbench.bench.design.design_file import (
    DESIGN_SCHEMA,
    DesignRecord,
    Designs,
    MissingDesign,
    read_designs,
)
from dpbench.bench.design.region_of_attraction import (
    DURATION_S,
    OFFSETS_M,
    TAIL_S,
    TOLERANCE_M,
    WIDTH,
)
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.record.result_folder import write_json
from dpbench.bench.workers.child import POLL_S, Child
from dpbench.bench.workers.process_setup import pin, settle, verdict_of
from dpbench.errors import ResultsError

LIMIT_S = 600.0
"""Of a design; it takes some eight seconds on a machine of today."""
WORK = 20_000
"""A design for the progress bar, in steps: about as long as so many steps of a solver."""

SEARCH = (OFFSETS_M, WIDTH, DURATION_S, TAIL_S, TOLERANCE_M)


class DesignStore:
    """Finished designs on disk, in the cells folder: `design-<key>.json`, one record each."""

    def __init__(self, cells: Path, machine_id: str, *, fresh: bool = False) -> None:
        self._cells, self._machine_id, self._fresh = cells, machine_id, fresh
        cells.mkdir(parents=True, exist_ok=True)

    def path(self, design: Design) -> Path:
        """Where a design goes, by a hash of all that its record depends on (method.md 5)."""
        made_of = [design.controller, design.files, SEARCH]
        made_by = [HARNESS_VERSION, DESIGN_SCHEMA, self._machine_id]
        text = json.dumps(made_of + made_by, sort_keys=True, ensure_ascii=False)
        return self._cells / f"design-{hashlib.sha256(text.encode()).hexdigest()[:16]}.json"

    def finished(self, design: Design) -> DesignRecord | None:
        """The record of a design that was finished earlier, None if there is none."""
        if self._fresh:
            return None
        return _record(self.path(design))


def _record(path: Path) -> DesignRecord | None:
    try:
        (record,) = read_designs(path).records
    except (ResultsError, ValueError):
        return None
    return record


def work_of_designs(designs: Sequence[Design], store: DesignStore) -> int:
    """What is left to do of some designs, for the progress bar."""
    return WORK * sum(store.finished(design) is None for design in designs)


def run_design(text: str, folder: Path, name: str, core: int, path: Path) -> None:
    """Look into a design, in a process of its own; its record appears in `path`."""
    pin(core)
    settle(folder / f"{name}.noise")
    record = design_record(Design(**json.loads(text)))
    write_json(path, asdict(Designs.of([record])))
    write_json(folder / f"{name}.json", verdict_of("finished", ""))


def run_designs(
    designs: Sequence[Design],
    store: DesignStore,
    *,
    context: ForkServerContext,
    folder: Path,
    cores: Sequence[int],
    progress: Progress,
) -> Designs:
    """Look into the designs that are not finished, one on each core; all of them come back.

    Parameters
    ----------
    designs : of `plan_designs`.
    context, folder : of the campaign: what forks processes, and where they leave their noise.
    """
    found = [store.finished(design) for design in designs]
    reasons = [""] * len(designs)
    waiting = [i for i in reversed(range(len(designs))) if found[i] is None]
    free, running = list(cores), dict[int, tuple[Child, int, float]]()
    while waiting or running:
        while waiting and free:
            i, core = waiting.pop(), free.pop()
            running[i] = _start(designs[i], store, context, folder, core), core, time.monotonic()
        time.sleep(POLL_S)
        for i, (child, core, born) in list(running.items()):
            if not _ended(child, born):
                continue
            del running[i]
            free.append(core)
            found[i], reasons[i] = _record(store.path(designs[i])), child.outcome().detail
            progress.advance(WORK, f"design {designs[i].controller} {designs[i].vessel}")
    return Designs.of(
        (record for record in found if record is not None),
        (
            MissingDesign(design.vessel, design.controller, reason)
            for design, record, reason in zip(designs, found, reasons, strict=True)
            if record is None
        ),
    )


def _ended(child: Child, born: float) -> bool:
    """Whether a process is over, be it because its time is up."""
    if child.process.is_alive():
        if time.monotonic() - born < LIMIT_S:
            return False
        child.kill(f"it took more than {LIMIT_S:g} s and was killed")
    return True


def _start(
    design: Design, store: DesignStore, context: ForkServerContext, folder: Path, core: int
) -> Child:
    path = store.path(design)
    # One that is looked into again must not leave its old record behind if it fails.
    path.unlink(missing_ok=True)
    args = (json.dumps(asdict(design)), folder, path.stem, core, path)
    return Child(context, run_design, args, folder, path.stem, limit_s=None)
