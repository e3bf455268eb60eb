"""Estimates of the time of a campaign: by the runs of its last result folder, or stated rates.

    time = START_S + Σ over loops and replays (CELL_S + TIMED_CELL_S + solving + judging) / slots
         + Σ over sources of QPs (SOURCE_STEP_S · steps) / slots
         + REPORT_S + REPORT_CELL_S · cells, and COMPILE_S where kernels are not compiled yet

    solving = step of its kind · steps, within the limits of the suite

TIMED_CELL_S is of interleaved replays, which have one slot. A kind is one configuration in one
mode. The time of its step, with all between two steps, is the mean over the runs of the folder, or
stated by the size of the QP. Judging and sources take longer with the size, too.
"""

import math
import os
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import pyarrow.parquet as pq

from dpbench.bench.campaign import choose_result_folder, make_jobs
from dpbench.bench.engines.engine import TlsFiles
from dpbench.bench.engines.open_engine import check_engine_options
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.run_request import Plan, RunRequest
from dpbench.bench.record.cell import (
    CONFIGURATION_COLUMNS,
    CapabilitySource,
    Cell,
    RandomSource,
    RecordedSource,
)
from dpbench.bench.record.cell_store import read_finished_outcomes
from dpbench.bench.record.machine import describe_machine
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.sequences.source import read_sequence
from dpbench.bench.workers.child import has_compiled_kernels
from dpbench.bench.workers.interleaved import FEWEST_ROUNDS
from dpbench.bench.workers.jobs import CELL_S
from dpbench.errors import InputError, ResultsError
from dpbench.locks import WaitLimit, find_machine_lock_holders
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import build_scenario_from_documents

START_S, TIMED_CELL_S = 1.0, 0.25
"""Start of a campaign; processes, warm-up, kernels of an interleaved replay, rounds again [s]."""
REPORT_S, REPORT_CELL_S = 4.0, 0.006
"""The report with the libraries it loads, and what each cell adds to it [s]."""
COMPILE_S = 15.0
"""Compilation of the kernels, once after an installation [s]."""
LOADED = 1.1
"""Slowdown by other programs from which a forecast names it."""
JUDGE_STEP_S, SOURCE_STEP_S, USUAL_SIZE = 0.00015, 0.0003, 60
"""A step for the referee and the tables, and a step of a reference loop [s], at this size."""
STEP_BYTES, RUN_BYTES = 90.0, 500.0
"""Size of a step and of a run in the tables, for runs that have nothing in common
(`docs/guide/scale.md`)."""
LONG_CERTIFICATES = (
    "the time is a lower bound: some steps of a reference loop with commanded thrusters take long "
    "to certify"
)
"""Remark on a forecast that takes all steps of a reference loop for equally long."""
_KIND = ["mode", *CONFIGURATION_COLUMNS]
Kind = tuple[str, ...]
SMALL = 30
"""Size of QPs of thrust allocation, of capability plots and of unknown ones."""


@dataclass(frozen=True)
class Rates:
    """Step times [s] of kinds that were run before, else stated ones; and bytes per table row."""

    origin: str
    steps_s: dict[Kind, float] = field(default_factory=dict)
    step_bytes: float = STEP_BYTES
    run_bytes: float = RUN_BYTES

    def estimate_cell_seconds(self, cell: Cell) -> float:
        """Return the expected time of a run [s], by the measured or stated step times."""
        kind, size = tuple(str(getattr(cell, name)) for name in _KIND), measure_qp_size(cell)
        step_s = self.steps_s.get(kind) or estimate_step_s(cell.solver, cell.route, size)
        own_s = CELL_S + TIMED_CELL_S * cell.is_timed
        return own_s + _estimate_solving_s(cell, step_s) + _estimate_judging_s(cell, size)


STATED_RATES = Rates(
    "step times of another machine; a run in the same folder measures this machine"
)


@dataclass(frozen=True)
class Estimate:
    """Expected duration, table size and number of runs of a campaign.

    `cells` are to run; `finished` ones have been, `refused` ones leave rows without running;
    `unmeasured` ones are in no figure of time and size. `time_s` is that on `slots` closed loops at
    a time, with `report_s` for the report and `compile_s` for kernels; `size_bytes` that of the
    tables with finished runs. `refusals` are the refused cells by reason and solver.
    `is_lower_bound`: whether exact loops may take much longer.
    """

    cells: int
    finished: int
    refused: int
    unmeasured: int
    steps: int
    time_s: float
    report_s: float
    compile_s: float
    size_bytes: float
    slots: int
    rates: str
    remarks: Sequence[str] = ()
    is_lower_bound: bool = False
    refusals: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    @property
    def refusal_lines(self) -> list[str]:
        """Lines to print for `--dry-run`: the refused cells by reason, most first."""
        totals = {reason: sum(cells.values()) for reason, cells in self.refusals.items()}
        return [
            f"{totals[reason]} refused ({', '.join(self.refusals[reason])}): {reason}"
            for reason in sorted(totals, key=lambda reason: -totals[reason])
        ]

    @property
    def lines(self) -> list[str]:
        """Lines to print for `--dry-run`: runs, duration, table size, origin of the step times."""
        numbers = self.cells, self.finished, self.refused, self.unmeasured, self.steps
        cells, finished, refused, more, steps = (f"{n:,}".replace(",", " ") for n in numbers)
        done = f"{', ' if self.refused else ' and '}{finished} finished" if self.finished else ""
        without = f" and {refused} refused" if self.refused else ""
        apart = f" {more} more cells, of capability plots, are not included." * bool(
            self.unmeasured
        )
        parts = f"{format_duration(self.report_s)} for the report"
        if self.compile_s:
            parts += f" and {format_duration(self.compile_s)} to compile kernels once"
        loops = "1 closed loop" if self.slots == 1 else f"{self.slots} closed loops in parallel"
        return [
            f"{cells} cells to run{done}{without}; {steps} steps to record",
            f"Estimated time: {'at least ' * self.is_lower_bound}{format_duration(self.time_s)} on "
            f"this machine with {loops}, including {parts}. "
            f"Tables: {self.size_bytes / 1e6:.1f} MB.{apart}",
            *([f"estimated from {self.rates}"] if self.cells else []),
            *([LONG_CERTIFICATES] if self.is_lower_bound else []),
            *self.remarks,
        ]


def format_duration(seconds: float) -> str:
    """Return a duration [s] as text, rounded to two digits."""
    for size, unit in ((86_400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def count_step_rows_of_cell(cell: Cell) -> int:
    """Return the number of rows that a run leaves in `steps.parquet`."""
    return cell.steps * cell.rounds + cell.warmup_steps if cell.mode == "replay" else cell.steps


def _estimate_solving_s(cell: Cell, step_s: float) -> float:
    """Return the expected time of a run's steps [s], within its limit and its budget of rounds."""
    if cell.mode != "replay":
        return min(cell.steps * step_s, cell.limit_s)
    round_s = cell.steps * step_s
    rounds = cell.rounds
    if cell.budget_s > 0.0 and round_s > 0.0:
        rounds = min(rounds, max(FEWEST_ROUNDS, math.ceil(cell.budget_s / round_s)))
    return min(rounds * round_s + cell.warmup_steps * step_s, cell.limit_s)


def _estimate_judging_s(cell: Cell, size: int) -> float:
    """Return the expected time of the referee and the tables for a run [s].

    Most answers of later rounds are those of the first one, and are judged once.
    """
    return JUDGE_STEP_S * size / USUAL_SIZE * cell.steps


def _estimate_sources_s(cells: Iterable[Cell]) -> float:
    """Return the expected time of all reference loops and sequences that runs need [s]."""
    seconds: dict[tuple[object, ...], float] = {}
    for cell in cells:
        # A loop is solved once, whatever is made of it.
        key: tuple[object, ...] = (cell.source.name,)
        if cell.scenario:
            study = cell.study and (cell.study.name, cell.study.point, cell.study.replicate)
            key = (cell.scenario["name"], study)
        steps = cell.steps_needed_in_file
        own = SOURCE_STEP_S * measure_qp_size(cell) / USUAL_SIZE * steps
        seconds[key] = max(seconds.get(key, 0.0), own)
    return sum(seconds.values())


def count_refusals(planned: Sequence[PlannedCell]) -> dict[str, dict[str, int]]:
    """Return the number of refused planned runs by reason and solver."""
    refusals: dict[str, dict[str, int]] = {}
    for cell, reason in ((p.cell, p.refused) for p in planned if p.refused):
        solvers = refusals.setdefault(reason, {})
        solvers[cell.solver] = solvers.get(cell.solver, 0) + 1
    return refusals


def estimate_time_and_size(
    planned: Sequence[PlannedCell],
    slots: int,
    rates: Rates,
    *,
    finished: Collection[int] = (),
    is_compiled: bool = True,
) -> Estimate:
    """Return expected time and table size of planned runs on `slots`, without capability plots.

    finished : indices of planned runs that are not run again.
    """
    stored = [p for p in planned if not p.refused]
    to_run = [p for i, p in enumerate(planned) if not p.refused and i not in finished]
    measured = [p for p in to_run if not isinstance(p.cell.source, CapabilitySource)]
    tabulated = [p for p in stored if not isinstance(p.cell.source, CapabilitySource)]
    report_s = REPORT_S + REPORT_CELL_S * len(planned)
    compile_s = 0.0 if is_compiled or not to_run else COMPILE_S
    return Estimate(
        cells=len(to_run),
        finished=len(stored) - len(to_run),
        refused=len(planned) - len(stored),
        unmeasured=len(to_run) - len(measured),
        steps=sum(count_step_rows_of_cell(p.cell) for p in to_run),
        time_s=estimate_run_seconds(measured, slots, rates) + report_s + compile_s,
        report_s=report_s,
        compile_s=compile_s,
        size_bytes=sum(
            (1 + len(p.alias_settings))
            * (rates.run_bytes + rates.step_bytes * count_step_rows_of_cell(p.cell))
            for p in tabulated
        ),
        slots=slots,
        rates=rates.origin,
        is_lower_bound=any(_commands_thrusters(p.cell) for p in measured),
        refusals=count_refusals(planned),
    )


def _commands_thrusters(cell: Cell) -> bool:
    """Return whether a run needs the reference loop of a ship with commanded thrusters."""
    controller = cell.scenario.get("scenario", {}).get("controller", {})
    return bool(controller.get("kind", "forces") != "forces")


def estimate_run_seconds(measured: Sequence[PlannedCell], slots: int, rates: Rates) -> float:
    """Return the expected time of a campaign's runs on `slots` [s]."""
    return (
        START_S * bool(measured)
        + _estimate_sources_s(p.cell for p in measured) / slots
        + sum(
            rates.estimate_cell_seconds(p.cell) / (1 if p.cell.is_timed else slots)
            for p in measured
        )
    )


def find_finished_cells(planned: Sequence[PlannedCell], folder: Path) -> set[int]:
    """Return the indices of planned runs that are finished in a result folder, which is only read.

    They were run on this machine, with the same versions of dpbench and of the solver's library.
    """
    finished = read_finished_outcomes(folder)
    if not finished:
        return set()
    jobs = make_jobs(planned, describe_machine()["id"])
    return {i for i, job in enumerate(jobs) if not job.planned.refused and job.run_id in finished}


def describe_what_is_not_forecast(slots: int) -> list[str]:
    """Return lines on what a forecast leaves out: other campaigns and other programs' load."""
    lines = [
        "not included: waits for other dpbench commands (--wait) and the load of other programs"
    ]
    if holders := find_machine_lock_holders():
        lines.append(
            f"this machine is in use by {' and '.join(map(str, holders))}, so the run may have to "
            "wait"
        )
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    slower = (load + slots) / cores
    if slower > LOADED:
        lines.append(
            f"other programs load this machine now ({load:.1f} processes, {cores} cores): the run "
            f"may take up to {slower:.2g} times as long"
        )
    return lines


def read_measured_rates(folder: Path) -> Rates:
    """Return the step times measured in a result folder; `STATED_RATES` where it has none."""
    try:
        runs = load_results(folder, without_steps=True).runs
        tables = [folder / f"{name}.parquet" for name in ("runs", "steps")]
        rows = [max(1, int(pq.read_metadata(path).num_rows)) for path in tables]
        run_bytes, step_bytes = (p.stat().st_size / n for p, n in zip(tables, rows, strict=True))
    except (ResultsError, OSError):
        return STATED_RATES
    runs = runs[runs["replay_s"].notna()]
    rounds = runs["rounds"].where(runs["mode"] == "replay", 1)
    runs = runs.assign(recorded=runs["steps_done"] * rounds)
    sums = runs.groupby(_KIND, observed=True)[["replay_s", "recorded"]].sum()
    sums = sums[sums["recorded"] > 0]
    steps_s: dict[Any, float] = (sums["replay_s"] / sums["recorded"]).to_dict()
    return Rates(f"the runs in {folder}", steps_s, step_bytes, run_bytes)


def estimate_plan(plan: Plan, folder: Path, slots: int, *, fresh: bool = False) -> Estimate:
    """Return the expected duration and table size of a plan run into a folder on this machine."""
    estimate = estimate_time_and_size(
        plan.cells,
        slots,
        read_measured_rates(folder),
        finished=set() if fresh else find_finished_cells(plan.cells, folder),
        is_compiled=has_compiled_kernels(),
    )
    if not estimate.cells:
        return replace(estimate, remarks=plan.remarks)
    timed_alone = all(p.cell.is_timed for p in plan.cells if not p.refused)
    aside = describe_what_is_not_forecast(1 if timed_alone else slots)
    return replace(estimate, remarks=[*aside, *plan.remarks])


def estimate_campaign(
    suite: str | Path | None = None,
    out: str | Path | None = None,
    *,
    jobs: int | None = None,
    engine: str = "local",
    scheduler: str | None = None,
    tls: TlsFiles | None = None,
    wait_s: float | None = None,
    fresh: bool = False,
    **asked: Any,
) -> Estimate:
    """Return a campaign's expected duration and table size on this machine, without running it.

    Its options are checked as those of `run_campaign`.
    """
    WaitLimit(wait_s)
    slots = check_engine_options(engine, jobs, scheduler, tls)
    if engine != "local":
        raise InputError("--dry-run", "", f"--engine {engine}", "--engine local")
    plan = RunRequest(None if suite is None else str(suite), **asked).make_plan()
    plan.require_available_solver()
    return estimate_plan(plan, choose_result_folder(plan, out), slots, fresh=fresh)


def estimate_step_s(solver: str, route: str, size: int) -> float:
    """Return the stated time of a step with all around it [s], by the size of its QP.

    It is a power of the size between two stated ones and beyond the largest. A solver without
    stated times has the median of the others.
    """
    sizes, times = _read_stated_times()
    own = times.get(f"{solver} {route}") or [median(of) for of in zip(*times.values(), strict=True)]
    at = max(size, sizes[0])
    i = next((i for i in range(1, len(sizes)) if at <= sizes[i]), len(sizes) - 1)
    power = math.log(own[i] / own[i - 1]) / math.log(sizes[i] / sizes[i - 1])
    return 1e-6 * own[i - 1] * float((at / sizes[i - 1]) ** power)


def measure_qp_size(cell: Cell) -> int:
    """Return the number of variables and rows of a run's QPs, without soft limits."""
    source = cell.source
    if isinstance(source, RandomSource):
        return source.recipe.n + source.recipe.m
    if isinstance(source, RecordedSource):
        return _measure_recorded_size(source.path)
    if not (cell.scenario and (cell.mode == "closed_loop" or source.is_of_controller)):
        return SMALL
    controller = cell.scenario["scenario"]["controller"]
    names = ("kind", "prediction_horizon", "control_horizon")
    key = (cell.scenario["vessel_name"], *(controller.get(name) for name in names))
    if key not in _SIZES:
        problem = build_scenario_from_documents(cell.scenario).controller.problem
        _SIZES[key] = problem.N_c * (problem.model.n_u + len(problem.G))
    return _SIZES[key]


_SIZES: dict[tuple[Any, ...], int] = {}
"""Sizes by ship, kind of controller and horizons: a study has many scenarios of one size."""


@cache
def _measure_recorded_size(path: str) -> int:
    """Return the number of variables and rows of a recorded sequence, by name or file."""
    base = read_sequence(resolve_sequence_path(path)).sequence.base
    return base.n + base.m


@cache
def _read_stated_times() -> tuple[list[int], dict[str, list[float]]]:
    """Read the sizes, and the times [µs] at these by solver and route."""
    text = Path(__file__).with_name("stated_rates.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return table["sizes"], table["times"]
