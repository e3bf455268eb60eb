"""Measure the cost of a cell in a campaign and of its report: the tables of docs/guide/scale.md.

    python benchmarks/scale.py OUT [--cells 10000] [--steps 1000] [--only cells,campaign,report]

    cells       loops of `weather` with DAQP, by steps and horizon: what a cell costs, and a sea
    campaign    --cells cells of one step with a solver that does nothing, run, and run again
    report      a folder of --cells runs of --steps steps, made of some real ones by the campaign's
                own writers, and `dpbench report` on it

Times are processor time of all processes together, so that a busy machine changes them by some
tens of percent and not by factors; memory is that of the largest process. OUT is a new folder; it
takes a gigabyte.
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.bench.record.cell import HARNESS_VERSION
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.record.step_table import STEPS_SCHEMA, Row, make_batch_part
from dpbench.bench.workers.jobs import BATCH_CELLS
from dpbench.solvers.table import find_solver_availability

EMPTY = Path(__file__).parent / "empty_solver.py"
CONFIGURATIONS = 12
"""Configurations of the empty solver: its settings times its policies."""
TOLERANCES = ("default", "1e-3", "1e-5", "1e-7", "1e-9")
LEVELS = ("default", *(f"1e-{i}" for i in range(1, 10)))
POINTS = {"environment.wind.speed_mps": [6.0, 10.7], "start.east_m": [0.0, 3.0]}
"""Points of the made-up folder, each with as many configurations."""
RUN = "import sys; from dpbench import run_campaign; run_campaign(*sys.argv[1:3], {module})"
REPORT = "import sys; from dpbench import write_report; write_report(sys.argv[1])"
SUBREAPER = 36
"""`PR_SET_CHILD_SUBREAPER` of Linux: processes whose parent ended are then waited for here."""


@dataclass(frozen=True)
class Cost:
    """Processor time of a command and all its processes [s], its wall time [s], and the memory of
    the largest of them [MB]."""

    cpu_s: float
    wall_s: float
    peak_mb: float


def run_measured(code: str, *arguments: object) -> Cost:
    """Run Python code in a process of its own and return its cost."""
    began = time.monotonic()
    command = [sys.executable, "-c", code, *map(str, arguments)]
    main = subprocess.Popen(command)
    cpu_s, peak_mb, wall_s = 0.0, 0.0, 0.0
    while True:
        try:
            pid, status, used = os.wait4(-1, 0)
        except ChildProcessError:
            return Cost(cpu_s, wall_s, peak_mb)
        cpu_s += used.ru_utime + used.ru_stime
        peak_mb = max(peak_mb, used.ru_maxrss / 1e3)
        if pid == main.pid:
            main.returncode, wall_s = status, time.monotonic() - began
            if status:
                sys.exit(f"{' '.join(command)} failed")


def campaign(suite: Path, out: Path, module: Path | None = None) -> Cost:
    """Run a suite and return its cost."""
    chosen = "" if module is None else f"solver_module={str(module)!r}"
    return run_measured(RUN.format(module=chosen), suite, out)


def suite_of(path: Path, solver: str, seas: int, steps: int, **study: object) -> Path:
    """Write a suite of one study of `weather` in so many seas."""
    lines = "".join(f"{name} = {_toml(value)}\n" for name, value in study.items())
    path.write_text(
        f'title = "Scale"\nsolvers = ["{solver}"]\nbaseline_law = false\ncell_limit_s = 600.0\n'
        f'[[study]]\nbase = "weather"\nsteps = {steps}\nreplicates = {{ count = {seas} }}\n{lines}'
    )
    return path


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{k}" = {json.dumps(v)}' for k, v in value.items()) + " }"
    return json.dumps(value)


def stored(out: Path) -> tuple[int, int]:
    """Bytes and number of the files that a campaign left."""
    files = [path for path in out.rglob("*") if path.is_file()]
    return sum(path.stat().st_size for path in files), len(files)


def cell_costs(out: Path, whole: int, seas: int = 4) -> Iterator[tuple[str, ...]]:
    """A row for each length and horizon: a cell, and a sea, which all its cells share."""
    # One configuration and five in the same seas differ by cells alone.
    start = _twice(out / "start", seas, 1, 10)[0]
    for steps, moves in ((whole // 10, 10), *((whole, moves) for moves in (10, 5, 20, 40))):
        name = f"{steps}-{moves}"
        one, five = _twice(out / name, seas, steps, moves)
        cells = seas * len(TOLERANCES)
        cell_s = (five.cpu_s - one.cpu_s) / (cells - seas)
        sea_s = (one.cpu_s - start.cpu_s) / seas - cell_s
        size = (out / name / "five" / "steps.parquet").stat().st_size
        yield (
            *(str(steps), str(3 * moves), f"{1e3 * cell_s:.0f}", f"{1e3 * max(0.0, sea_s):.0f}"),
            *(f"{1e6 * cell_s / steps:.0f}", f"{size / (cells * steps):.0f}"),
        )


def _twice(folder: Path, seas: int, steps: int, moves: int) -> list[Cost]:
    """A campaign with one configuration, and with all of `TOLERANCES`."""
    folder.mkdir(parents=True)
    fixed = {"product": {"controller.control_horizon": [moves]}}
    costs = []
    for name, settings in (("one", TOLERANCES[:1]), ("five", TOLERANCES)):
        path = folder / f"{name}.toml"
        suite = suite_of(path, "daqp", seas, steps, settings=list(settings), **fixed)
        costs.append(campaign(suite, folder / name))
    return costs


def empty_suite(folder: Path, cells: int, steps: int = 1) -> Path:
    """Some `cells` cells of the solver that does nothing."""
    modes: dict[str, object] = {"settings": ["default", "low", "mid", "high"]}
    modes["policies"] = ["fresh", "reuse", "warm"]
    folder.mkdir(parents=True, exist_ok=True)
    return suite_of(folder / "empty.toml", "empty", -(-cells // CONFIGURATIONS), steps, **modes)


def empty_campaign(out: Path, cells: int) -> Iterator[tuple[str, ...]]:
    """Rows of what a campaign of empty cells takes, and the same command again."""
    suite, folder = empty_suite(out, cells), out / "results"
    whole = campaign(suite, folder, EMPTY)
    again = campaign(suite, folder, EMPTY)
    count = len(load_results(folder).runs)
    size, files = stored(folder)
    yield "cells", str(count)
    yield "processor time a cell", f"{1e3 * whole.cpu_s / count:.1f} ms"
    yield "the whole campaign", f"{whole.cpu_s:.0f} s, {whole.wall_s:.0f} s by the clock"
    yield "largest process", f"{whole.peak_mb:.0f} MB"
    yield "on disk a cell", f"{size / count / 1e3:.2f} kB, {files / count:.4f} files"
    yield "the same command again", f"{again.cpu_s:.1f} s, {again.peak_mb:.0f} MB"
    report = run_measured(REPORT, folder)
    yield "its report", f"{report.cpu_s:.1f} s, {report.peak_mb:.0f} MB"


def big_report(out: Path, cells: int, steps: int) -> Iterator[tuple[str, ...]]:
    """Rows of what writing and reading a large folder takes."""
    folder = out / "results"
    began = time.process_time()
    suite = made_folder(out, cells, steps)
    kept_s = time.process_time() - began
    assembled = campaign(suite, folder)
    results = load_results(folder)
    runs, rows = len(results.runs), results.recorded.rows
    report = run_measured(REPORT, folder)
    size = (folder / "steps.parquet").stat().st_size
    yield "runs, steps", f"{runs}, {rows}"
    yield "kept in parts", f"{1e3 * kept_s / runs:.2f} ms a cell"
    yield "parts to tables", f"{1e3 * assembled.cpu_s / runs:.2f} ms a cell"
    yield "largest process of it", f"{assembled.peak_mb:.0f} MB"
    yield "steps.parquet", f"{size / 1e6:.0f} MB, {size / rows:.1f} bytes a step"
    page = (folder / "report.html").stat().st_size
    yield "page and tables", f"{report.cpu_s:.1f} s, {report.peak_mb:.0f} MB"
    yield "report.html", f"{page / 1e6:.2f} MB"


def made_folder(out: Path, cells: int, steps: int) -> Path:
    """Fill a result folder with finished cells; the suite that takes them for its own.

    A sea multiplies the numbers of real cells by one factor, so that steps pack as real ones do.
    """

    def suite_in(folder: Path, seas: int) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        modes: dict[str, object] = {"settings": list(LEVELS), "product": POINTS}
        return suite_of(folder / "made.toml", "daqp", seas, steps, **modes)

    suite, small = suite_in(out, -(-cells // (4 * len(LEVELS)))), suite_in(out / "real", 1)
    campaign(small, out / "real" / "results")
    real = _real_cells(out / "real" / "results")
    identity, machine = (
        find_solver_availability("daqp").version_and_build_text,
        describe_machine()["id"],
    )
    rng, store = np.random.default_rng(1), CellStore(out / "results")
    factors: dict[tuple[int, int], float] = {}
    batches: dict[str, dict[str, tuple[Row, pa.RecordBatch]]] = {}
    for planned in plan_suite(load_path_and_suite(suite)[1], beside=out):
        study = planned.cell.study
        row, batch = real[planned.cell.settings, study.point]
        sea = study.point, study.replicate
        factor = factors.setdefault(sea, float(np.exp(0.1 * rng.standard_normal())))
        run_id = planned.cell.run_id(identity, machine, HARNESS_VERSION)
        own = _changed_row(row, factor) | {"run_id": run_id, "cell": planned.cell.to_json()}
        waiting = batches.setdefault(planned.cell.settings, {})
        waiting[run_id] = own, _changed(batch, factor, rng)
        if len(waiting) == BATCH_CELLS:
            store.write_part_file(make_batch_part(batches.pop(planned.cell.settings)))
    for waiting in batches.values():
        store.write_part_file(make_batch_part(waiting))
    return suite


def _real_cells(folder: Path) -> dict[tuple[str, int], tuple[dict[str, Any], pa.RecordBatch]]:
    """Row and steps of each run of a folder, by its settings and point."""
    cells = {}
    for row in load_results(folder).runs.to_dict("records"):
        own = [("run_id", "==", row["run_id"])]
        steps = pq.read_table(folder / "steps.parquet", columns=STEPS_SCHEMA.names, filters=own)
        (batch,) = steps.cast(STEPS_SCHEMA).combine_chunks().to_batches()
        key = str(row["settings"]), int(row["study_point"])
        cells[key] = {str(name): value for name, value in row.items()}, batch
    return cells


def _changed_row(row: dict[str, Any], factor: float) -> dict[str, Any]:
    """The same run in a sea that is a little worse or better."""
    names = ("r_rms_m", "r_95_m", "r_max_m", "r_tail_max_m", "closed_loop_cost")
    return row | {name: factor * row[name] for name in names}


def _changed(batch: pa.RecordBatch, factor: float, rng: np.random.Generator) -> pa.RecordBatch:
    """The same steps with other numbers that pack neither better nor worse."""
    columns = []
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if not (pa.types.is_floating(field.type) or field.name.endswith("_ns")):
            columns.append(column)
            continue
        known = column.fill_null(0).to_numpy()
        is_time = field.name.endswith("_ns")
        other = known * (np.exp(0.1 * rng.standard_normal(len(known))) if is_time else factor)
        mask = column.is_null().to_numpy(zero_copy_only=False)
        columns.append(pa.array(other.astype(known.dtype), field.type, mask=mask))
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)


def table(head: Sequence[str], rows: Iterator[tuple[str, ...]]) -> None:
    """Print a table of Markdown, row by row as it is measured."""
    print(f"\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what is asked for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--cells", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--only", default="cells,campaign,report")
    asked = parser.parse_args(arguments)
    out = asked.out.resolve()
    ctypes.CDLL(None).prctl(SUBREAPER, 1, 0, 0, 0)
    print(f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    if "cells" in asked.only:
        head = ("steps", "n", "cell [ms]", "sea [ms]", "cell [µs a step]", "bytes a step")
        table(head, cell_costs(out / "cells", asked.steps))
    if "campaign" in asked.only:
        table(("empty cells", ""), empty_campaign(out / "campaign", asked.cells))
    if "report" in asked.only:
        table(("reading", ""), big_report(out / "report", asked.cells, asked.steps))


if __name__ == "__main__":
    main()
