"""The record schema: every column of `runs.parquet` and `steps.parquet`, its type and meaning.

Times are integer nanoseconds, everything else SI; a missing number is NaN (or null in a nullable
integer), never a made-up one.
"""

from __future__ import annotations

import json
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

SCHEMA_VERSION = 7

DType = Literal["str", "bool", "int32", "int64", "Int64", "float64"]
Columns = dict[str, tuple[DType, str]]
"""Type and meaning by name."""

STUDY_PREFIX = "x_"
"""Of the columns that hold the values of a study's keys, before the key's dotted name."""

POSE_AXES = ("n", "e", "psi")
FORCES = ("surge", "sway", "yaw")
AXIS_FORCES = ("x_N", "y_N", "n_Nm")
MISSING_INT = -1
"""A whole number that is not there, in arrays that cannot say null."""

STEP_COLUMNS: Columns = {
    "run_id": ("str", "cell the row belongs to"),
    "repeat": ("int32", "replay round, 0 in closed loop"),
    "warmup": ("bool", "a round recorded before the ones that count"),
    "disturbed": ("bool", "a round in which the reference kernel was slowed"),
    "counts": ("bool", "the row counts: no warm-up, and no disturbed round unless all are"),
    "k": ("int32", "step"),
    "t_s": ("float64", "time of the step; NaN in a random sequence"),
    "emit_ns": ("Int64", "θ → q, l, u; null in replay"),
    "setup_ns": ("Int64", "null where no set-up is part of the step"),
    "update_ns": ("Int64", "null where every step is set up from nothing"),
    "solve_ns": ("Int64", "the solver's call"),
    "read_ns": ("Int64", "copy out, signs, status"),
    "total_ns": ("Int64", "setup + update + solve + read; of a cascade, those of both QPs"),
    "allocation_ns": (
        "Int64",
        "the same of a cascade's second QP alone; all other columns of times are the first's",
    ),
    "overhead_ns": ("Int64", "whole closed-loop step less total_ns; null in replay"),
    "reported_ns": ("Int64", "the solver's own figure"),
    "waited_ns": (
        "Int64",
        "part of total_ns in which the step was ready to run and the machine ran something else; "
        "null where the kernel does not show it",
    ),
    "latency_ns": (
        "Int64",
        "time of the answer on the slow computer; null without, or where no computation began",
    ),
    "status": ("str", "what the solver claims; empty where no computation began"),
    "claimed": ("bool", "the claim is SOLVED"),
    "true": ("bool", "the referee finds the answer true at 1e-3"),
    "true_1e4": ("bool", "the same at 1e-4"),
    "true_1e6": ("bool", "the same at 1e-6"),
    "iterations": ("Int64", "the solver's own count"),
    "primal": ("float64", "largest violation, scaled units"),
    "dual": ("float64", "stationarity residual, scaled units"),
    "complementarity": ("float64", "complementarity residual, scaled units"),
    "gap": ("float64", "duality gap, scaled units"),
    "primal_own": ("float64", "largest violation in the units the solver was given"),
    "dual_own": ("float64", "stationarity residual in the units the solver was given"),
    "error_move": ("float64", "distance of the first move to the optimum, in rate-limit steps"),
    "error_plan": ("float64", "the same over all moves"),
    "allocation_error": (
        "float64",
        "of a cascade's second QP: distance of its thrusters' moves to the optimum, in their steps",
    ),
    "optimum_bound": ("float64", "certified error bound of the optimum itself"),
    "certificate": ("str", "kind of certificate"),
    "n_active": ("int32", "active limits at the optimum"),
    "fallback": (
        "bool",
        "no usable answer of the solver in time, and none arrived late: fallback or backup acted",
    ),
    "unconverged": ("bool", "an inaccurate or unfinished iterate was applied"),
    "clipped": ("bool", "the answer violated a limit and was clipped"),
    "late": ("bool", "no answer by the deadline of the step; a deadline missed"),
    "backup": ("bool", "the plan of the backup solver was applied"),
    "backup_failed": (
        "bool",
        "the backup was asked and had no usable answer by the end of the sample",
    ),
    "backup_ns": ("Int64", "set-up, solve and read of the backup; null where it was not asked"),
    "backup_error": ("float64", "error_move of the backup's answer"),
    "n_m": ("float64", "north position at the start of the step"),
    "e_m": ("float64", "east position"),
    "psi_rad": ("float64", "heading, unwrapped"),
    "u_mps": ("float64", "surge velocity"),
    "v_mps": ("float64", "sway velocity"),
    "r_radps": ("float64", "yaw rate"),
    "tau_x_N": ("float64", "force applied over the step"),
    "tau_y_N": ("float64", "force applied over the step"),
    "tau_n_Nm": ("float64", "moment applied over the step"),
    "dtau_x_N": ("float64", "its change against the step before"),
    "dtau_y_N": ("float64", "its change against the step before"),
    "dtau_n_Nm": ("float64", "its change against the step before"),
    "cmd_x_N": ("float64", "force commanded before clipping"),
    "cmd_y_N": ("float64", "force commanded before clipping"),
    "cmd_n_Nm": ("float64", "moment commanded before clipping"),
    "thrust_share": ("float64", "thrust of all thrusters, of their full; NaN without"),
    "power_share": ("float64", "their power Σ|f|^1.5, of that at full thrust"),
    "undelivered_share": (
        "float64",
        "of a cascade: force demanded that its thrusters do not make, of the limit of its axis, "
        "the largest of the three",
    ),
}

IDENTITY_COLUMNS: Columns = {
    "run_id": ("str", "hash of the cell, its problem, the solver version and the machine"),
    "mode": ("str", "closed_loop | replay"),
    "scenario": ("str", "scenario; empty for a random sequence"),
    "sequence": ("str", "recorded or random sequence; empty in closed loop"),
    "solver": ("str", "solver"),
    "solver_version": ("str", "version of its distribution"),
    "build": ("str", "how its library was built, where that can be read from it; empty else"),
    "generic_build": ("bool", "its library has vectorised kernels, and this build leaves them out"),
    "route": ("str", "qpsolvers | native"),
    "policy": ("str", "fresh | reuse | warm"),
    "settings": ("str", "name of the settings"),
    "options": ("str", "options of settings of one's own, as JSON; empty for a preset"),
    "formulation": ("str", "condensed_box | condensed_stacked | sparse | none"),
    "form": ("str", "dense | csc: what the library was given"),
    "N_p": ("Int64", "prediction horizon; null where no controller predicts"),
    "N_c": ("Int64", "control horizon; null where no controller predicts"),
    "n": ("Int64", "variables of the QP the solver was given; null where it never got one"),
    "m": ("Int64", "its rows, in stacked form the stacked ones, without the box"),
    "units": ("str", "scaled | si"),
    "slowdown": ("float64", "how much slower the ship's computer is; 0: it waits for answers"),
    "deadline_s": ("float64", "budget of a step; NaN in replay"),
    "sample_s": ("float64", "time between samples; NaN in a random sequence"),
    "first_sample": ("Int64", "sample of step 0: where the window of a replay begins"),
    "every_sample": ("Int64", "samples from one step to the next"),
    "seed": ("int64", "seed of the order of replay rounds"),
    "study": ("str", "name of the study it belongs to; empty in no study"),
    "study_point": ("Int64", "point of the study; its keys are in the columns x_<key>"),
    "replicate": ("Int64", "which of the runs at that point, from 1: another sea"),
    "outcome": ("str", "finished | crashed | hung | timed_out | refused | invalid | lost"),
    "outcome_detail": ("str", "cause in the library's or the harness's words"),
    "machine_id": ("str", "hash of the machine description"),
    "schema": ("int64", "version of this schema"),
    "cell": ("str", "JSON that runs the cell again"),
    "concurrency": (
        "Int64",
        "of a timed replay, cells at work on its machine at a time, at most: 1 where it had the "
        "machine to itself, as a ranking demands; null where no times are compared",
    ),
    "steps_planned": ("int64", "steps asked for"),
    "steps_done": ("int64", "steps recorded (in replay: of the counting rounds' fullest)"),
}

ACCURACY_COLUMNS: Columns = {
    "claimed_share": ("float64", "share of steps claimed solved"),
    "true_share": (
        "float64",
        "of the steps whose right answer is known: share the referee finds true at 1e-3",
    ),
    "true_1e4_share": ("float64", "at 1e-4"),
    "true_1e6_share": ("float64", "at 1e-6"),
    "claimed_not_true": (
        "Int64",
        "steps claimed solved that are not; without a certificate no claim counts",
    ),
    "true_not_claimed": ("Int64", "steps with a true optimum that is not claimed"),
    "error_move_p50": ("float64", "median error of the first move"),
    "error_move_max": (
        "float64",
        "largest error of the first move, of a cascade's thrusters too; inf without an answer; of "
        "all rounds, warm-up and disturbed ones too",
    ),
    "error_plan_max": ("float64", "largest error of the plan, of all rounds"),
    "primal_max": ("float64", "largest violation"),
    "dual_max": ("float64", "largest stationarity residual"),
    "optimum_bound_max": ("float64", "largest certified bound of the optima"),
    "uncertified": ("Int64", "steps without a certified optimum or proof that there is none"),
    "undecided_steps": (
        "Int64",
        "steps that are feasible or infeasible only by rounding, charged to nobody",
    ),
    "infeasible_steps": ("Int64", "steps proven to have no feasible point"),
    "failed_steps": (
        "Int64",
        "steps with a fallback, though there was an answer to give, or an unfinished iterate; of "
        "all rounds",
    ),
    "iterations_p50": ("float64", "median iterations"),
    "iterations_max": ("float64", "most iterations"),
}

TIMING_COLUMNS: Columns = {
    "setup_once_ns": ("float64", "one set-up before the first step"),
    "matrix_updates": (
        "Int64",
        "updates with which the workspace took over new matrices, in one pass; 0 if set up anew",
    ),
    "rounds": ("Int64", "replay rounds that count"),
    "disturbed_rounds": ("Int64", "rounds marked as disturbed, which do not count unless all are"),
    "counting_disturbed": (
        "Int64",
        "disturbed rounds among those that count: none, or all of them as nothing better is left",
    ),
    "rerun_rounds": (
        "Int64",
        "rounds run again because the machine was busy; the last attempt counts",
    ),
    "reference_kernel_ns": (
        "float64",
        "the reference kernel, median over rounds: is the machine slower?",
    ),
    "load_kernel_ns": (
        "float64",
        "the load kernel, timed as a step is: what else ran on the machine? (minimum over rounds)",
    ),
    "algo_p50_ns": ("float64", "over steps, of the minimum over rounds: the algorithmic time"),
    "algo_p95_ns": ("float64", "the same, 95 %"),
    "algo_p99_ns": ("float64", "the same, 99 %; NaN below 1000 steps"),
    "algo_max_ns": ("float64", "the same, largest"),
    "algo_median_p50_ns": ("float64", "as algo_p50_ns with the median over rounds"),
    "raw_p50_ns": ("float64", "all samples pooled: the jitter"),
    "raw_p90_ns": ("float64", "the same, 90 %; NaN below 100 samples"),
    "raw_p99_ns": ("float64", "the same, 99 %; NaN below 1000 samples"),
    "raw_p999_ns": ("float64", "the same, 99.9 %; NaN below 10 000 samples"),
    "raw_max_ns": ("float64", "the same, largest"),
    "raw_samples": ("Int64", "how many samples are pooled"),
    "controller_p50_ns": ("float64", "of a cascade, raw_p50_ns of its first QP alone"),
    "controller_p90_ns": ("float64", "the same, 90 %; NaN below 100 samples"),
    "controller_p99_ns": ("float64", "the same, 99 %; NaN below 1000 samples"),
    "allocation_p50_ns": ("float64", "of a cascade, raw_p50_ns of its second QP alone"),
    "allocation_p90_ns": ("float64", "the same, 90 %; NaN below 100 samples"),
    "allocation_p99_ns": ("float64", "the same, 99 %; NaN below 1000 samples"),
    "first_visit_ratio": (
        "float64",
        "a step's first visit over its shortest later one, median: of remembered answers it is "
        "large; NaN with too few first visits",
    ),
    "first_visit_excess": (
        "float64",
        "share of first visits over 4 times the shortest later one, less twice that of later "
        "rounds and the involuntary switches meanwhile",
    ),
    "loop_ratio": (
        "float64",
        "median step of the same configuration's closed loop over that of the replay; NaN without",
    ),
    "loop_tail_ratio": (
        "float64",
        "90th percentile of the same configuration's closed loop over that of the replay",
    ),
    "emit_p50_ns": ("float64", "median of emit_ns"),
    "overhead_p50_ns": ("float64", "median of overhead_ns"),
}

MACHINE_COLUMNS: Columns = {
    "process_peak_bytes": (
        "float64",
        "largest resident memory of the cell's process, harness and shared pages included; of one "
        "that was killed, as it was seen last",
    ),
    "replay_s": (
        "float64",
        "wall time of the rounds of a replay, or of a closed loop, with all between steps",
    ),
    "voluntary_switches": ("Int64", "context switches over them in which the worker waited"),
    "involuntary_switches": ("Int64", "context switches over them against the worker's will"),
    "steal_s": ("float64", "time the host of a virtual machine took from the worker's core"),
    "throttle_events": ("float64", "thermal throttle events of that core; NaN if not visible"),
    "solve_s": (
        "float64",
        "sum of the step times over the same rounds, or over a closed loop, less `waited_ns`; with "
        "`thread_s` it shows who works outside the timed calls",
    ),
    "thread_s": (
        "float64",
        "processor time of the worker's other threads over the counting rounds; of a closed loop, "
        "over its steps",
    ),
    "bit_identical_share": (
        "float64",
        "share of steps with the same status and the same bits in z in every round",
    ),
    "answer_spread_max": ("float64", "largest difference of a z between two rounds, scaled units"),
    "iterations_identical_share": ("float64", "share of steps with the same iterations each round"),
    "iterations_spread": ("Int64", "largest difference of a step's iterations between rounds"),
    "peak_rss_bytes": (
        "float64",
        "peak resident memory of the worker with its library, above the process it is forked "
        "from, less the QPs and the log",
    ),
    "os_threads": ("Int64", "threads of the worker after its last round"),
    "pool_threads": ("Int64", "most threads a loaded BLAS or OpenMP library would use"),
    "python_blocks_per_step": ("float64", "Python memory blocks an answer leaves held, median"),
    "python_peak_bytes_per_step": (
        "float64",
        "peak of what Python and NumPy allocate within a step, median; not a library's own",
    ),
    "heap_growth_bytes_per_step": ("float64", "growth of the C heap a step, over untimed steps"),
}

CONTROL_COLUMNS: Columns = {
    "fallbacks": ("Int64", "steps in which the fallback or the backup acted"),
    "fallback_longest": ("Int64", "longest run of such steps"),
    "recover_steps_max": (
        "Int64",
        "most steps from a failure to the next true answer; null if none or never",
    ),
    "backup_asked": ("Int64", "steps in which the backup solver was asked; null without a backup"),
    "backup_acted": ("Int64", "steps in which the backup's plan was applied"),
    "backup_failures": ("Int64", "steps in which the backup failed"),
    "backup_p50_ns": ("float64", "median time of the backup, of the steps in which it was asked"),
    "backup_max_ns": ("float64", "largest time of the backup"),
    "backup_error_max": ("float64", "largest error of the backup's first move"),
    "deadline_misses": ("Int64", "steps without an answer by their deadline"),
    "longest_miss_streak": ("Int64", "longest run of such steps"),
    "miss_recover_steps_max": (
        "Int64",
        "most steps from a missed deadline to the next true answer in time; null if none or never",
    ),
    "computations": ("Int64", "steps in which a computation began: fewer on a slow computer"),
    "interrupted": (
        "Int64",
        "those during which the kernel ran others; their latency is of processor time",
    ),
    "latency_p50_ns": ("float64", "median latency on the slow computer"),
    "latency_max_ns": ("float64", "largest latency on the slow computer"),
    "unconverged": ("Int64", "steps with an unfinished iterate"),
    "clipped": ("Int64", "steps whose answer violated a limit and was clipped"),
    "limit_violations": ("Int64", "applied forces outside a limit; must be 0"),
    "matrix_steps": ("Int64", "steps that brought new matrices, after re-linearising"),
    "r_rms_m": ("float64", "radial error, root mean square"),
    "r_95_m": ("float64", "radial error, 95 %"),
    "r_max_m": ("float64", "radial error, largest"),
    "r_tail_max_m": ("float64", "largest radial error in the second half of the run"),
    "heading_rms_deg": ("float64", "heading error, root mean square"),
    "heading_max_deg": ("float64", "heading error, largest"),
    **{f"iae_{a}": ("float64", "integral of the absolute error [m·s, rad·s]") for a in POSE_AXES},
    **{f"ise_{a}": ("float64", "integral of the squared error") for a in POSE_AXES},
    **{f"itae_{a}": ("float64", "integral of time times absolute error") for a in POSE_AXES},
    "settle_s": ("float64", "time after which 1 m and 1° hold for 30 s; inf if never"),
    "settle_0p1m_s": ("float64", "time after which 0.1 m holds to the end; inf if never"),
    **{f"overshoot_{a}": ("float64", "furthest excursion beyond the reference") for a in POSE_AXES},
    "share_1m": ("float64", "share of time inside the paper's 1 m circle"),
    "share_green": ("float64", "share of time within 3 m and 3° (IMCA M 220 example)"),
    "share_yellow": ("float64", "share of time between green and red"),
    "share_red": ("float64", "share of time beyond 5 m or 5°"),
    "pose_error": ("float64", "VRX: mean of d + 0.75^d·|Δψ| [m, rad]"),
    "effort_s": ("float64", "∫ Σ(τ/τ_max)² dt"),
    "total_variation": ("float64", "Σ |Δτ|/τ_max: wear"),
    "work_J": ("float64", "∫ |τᵀν| dt"),
    **{f"at_rate_{f}": ("float64", "share of steps at a rate limit") for f in FORCES},
    **{f"at_amplitude_{f}": ("float64", "share of steps at an amplitude limit") for f in FORCES},
    "thrust_share": ("float64", "mean thrust of all thrusters, of their full; NaN without"),
    "power_share": ("float64", "mean power of all thrusters, |f|^1.5, of that at full thrust"),
    "thrust_variation": ("float64", "Σ |Δf|/T over thrusters and steps: wear"),
    "azimuth_travel_deg": ("float64", "how far azimuths turned while they pushed [°]"),
    "thrust_reversals": ("float64", "how often tunnels and main propellers reversed"),
    "at_rate_thrusters": ("float64", "share of steps with a thruster at its rate limit"),
    "at_limit_thrusters": ("float64", "share of steps with a thruster at the limit of its thrust"),
    "undelivered_share": (
        "float64",
        "of a cascade: largest share of the limit of an axis that thrusters did not deliver",
    ),
    "closed_loop_cost": ("float64", "½ Σ (y−y_d)ᵀQ(y−y_d) + ½ Σ ΔuᵀRΔu over the run"),
    "exact_cost": ("float64", "the same of the exactly solved loop, over as many steps"),
    "exact_steps": (
        "Int64",
        "steps of the exactly solved loop that the next columns are of; in a replay, up to its end",
    ),
    "station_radius_m": ("float64", "its ship is on station within this radius and 5°"),
    "exact_offset_max_m": ("float64", "its largest radial error from its arrival on station on"),
    "exact_offset_max_s": ("float64", "when that is"),
    "exact_offset_end_m": ("float64", "its radial error at the end"),
    "exact_heading_max_deg": ("float64", "its largest heading error from its arrival on"),
    "exact_heading_end_deg": ("float64", "its heading error at the end"),
    "exact_left_s": ("float64", "when it first leaves its station; NaN if never"),
    "exact_active_share": ("float64", "share of its steps with an active limit"),
    "dev_position_max_m": ("float64", "largest deviation from the exactly solved loop"),
    "dev_position_rms_m": ("float64", "its root mean square"),
    "dev_heading_max_deg": ("float64", "largest deviation of heading"),
    "dev_heading_rms_deg": ("float64", "its root mean square"),
    "dev_force_max_N": ("float64", "largest deviation of the surge or sway force"),
    "dev_force_rms_N": ("float64", "its root mean square"),
}

RUN_COLUMNS = (
    IDENTITY_COLUMNS | ACCURACY_COLUMNS | TIMING_COLUMNS | MACHINE_COLUMNS | CONTROL_COLUMNS
)


_PANDAS = {dtype: pd.api.types.pandas_dtype(dtype) for dtype in get_args(DType)}


def _missing_column(dtype: DType, rows: int) -> Any:
    """Return a column of a type without a value in any row."""
    fillers: dict[str, object] = {"str": "", "bool": False, "int32": 0, "int64": 0, "Int64": pd.NA}
    return pd.Series(fillers.get(dtype, np.nan), index=range(rows), dtype=dtype).array


def as_columns(frame: pd.DataFrame, columns: Columns) -> pd.DataFrame:
    """Give a data frame exactly these columns and types; absent ones have no values."""
    # Most runs lack most columns: what is absent is made once for each type, not for each column.
    absent = {
        dtype: _missing_column(dtype, len(frame))
        for dtype in {dtype for dtype, _ in columns.values()}
    }
    out = {
        name: _convert_column(frame[name], dtype) if name in frame else absent[dtype]
        for name, (dtype, _) in columns.items()
    }
    return pd.DataFrame(out, index=frame.index)


def _convert_column(column: pd.Series[Any], dtype: DType) -> Any:
    """Return a data-frame column converted to a type, without a copy where it has it already."""
    # Converting a column to the type it has copies it, and takes ten times as long as looking.
    return column.array if column.dtype == _PANDAS[dtype] else column.astype(dtype).array


def as_steps(frame: pd.DataFrame) -> pd.DataFrame:
    """Give a data frame the columns and types of `steps.parquet`; absent ones have no values."""
    return as_columns(frame, STEP_COLUMNS)


def as_runs(frame: pd.DataFrame) -> pd.DataFrame:
    """Give a data frame the columns and types of `runs.parquet`, then its study parameters."""
    runs = as_columns(frame, RUN_COLUMNS)
    keys = [name for name in frame.columns if name.startswith(STUDY_PREFIX)]
    return runs.join(frame[keys]) if keys else runs


def study_columns(runs: pd.DataFrame) -> pd.DataFrame:
    """Return study name, point, repetition and parameter values of runs (N), as columns.

    They are `study`, `study_point` and `replicate`, and an `x_<key>` for each key, a number where
    all its values are numbers and text else, missing in runs of other studies.
    """
    cells = runs["cell"].astype(str)
    of_study = cells.str.contains('"study": {', regex=False)
    if not of_study.any():
        return pd.DataFrame(index=runs.index)
    rows = {i: _study_row(json.loads(cell)["study"]) for i, cell in cells[of_study].items()}
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(runs.index)
    return table.assign(study=table["study"].fillna(""))


def _study_row(study: dict[str, Any]) -> dict[str, Any]:
    """Return a run's study name, point, repetition and parameter values, by column."""
    values = {
        f"{STUDY_PREFIX}{key}": json.dumps(value) if isinstance(value, list) else value
        for key, value in study["x"].items()
    }
    return {
        "study": study["name"],
        "study_point": study["point"],
        "replicate": study["replicate"],
    } | values
