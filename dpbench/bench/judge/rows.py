"""Rows of `steps.parquet` and `runs.parquet` from an evaluated cell.

Columns of steps are plain arrays, as data frames would take ten times as long as a loop of a
hundred steps. A column that a run has not is left out; a missing integer is `MISSING_INT`.
"""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Ints
from dpbench.bench.judge import rules, timing
from dpbench.bench.judge.control_metrics import shift_forces_by_one_step
from dpbench.bench.judge.evaluation import (
    BACKUP_PREFIX,
    CERTIFICATES,
    EVALUATION,
    SECOND_QP_PREFIX,
    Columns,
    EvaluatedCell,
)
from dpbench.bench.judge.rules import StepColumns
from dpbench.bench.judge.timing import find_disturbed_rounds, make_deadline_columns
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS, Cell, HardestSource, Outcome, QPSource
from dpbench.bench.record.raw_log import PHASES, SOLVER_PHASES
from dpbench.bench.record.schema import (
    AXIS_FORCES,
    MISSING_INT,
    SCHEMA_VERSION,
    STEP_COLUMNS,
    convert_to_step_columns,
)
from dpbench.bench.run.slow_computer import make_delay_of_cell
from dpbench.qp.solution import Status
from dpbench.scenario.scenario import build_or_reuse_scenario
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.table import Availability

SOLVER_COLUMNS = tuple(f"{phase}_ns" for phase in SOLVER_PHASES)
"""Columns of the phases of a solver."""
_STATUS_NAMES = np.array([status.name for status in Status])
_CERTIFICATE_NAMES = np.array(CERTIFICATES)
STATE = ("u_mps", "v_mps", "r_radps", "n_m", "e_m", "psi_rad")
_OF_THRUSTERS = ("thrust_share", "power_share", "undelivered_share")
_OF_CELL = ("mode", *CONFIGURATION_COLUMNS, "slowdown", "seed")


def make_step_columns(cell: Cell, evaluated: EvaluatedCell) -> StepColumns:
    """Return the columns of `steps.parquet` for the recorded steps of a run."""
    columns = evaluated.columns
    asked = columns["asked"] if cell.slowdown > 0.0 else None
    steps = _answer_columns(columns, asked)
    second = _select_columns_by_prefix(columns, SECOND_QP_PREFIX)
    if second:
        steps = join_cascade_steps(steps, _answer_columns(second, None))
    steps |= {"total_ns": sum_step_times_ns(steps), "t_s": columns["t_s"]}
    if cell.mode == "replay":
        disturbed = np.isin(columns["repeat"], find_disturbed_rounds(columns))
        steps["warmup"], steps["disturbed"] = steps["repeat"] == rules.WARM_UP, disturbed
        steps["counts"] = rules.mask_counted_rows(columns["repeat"], disturbed)
        return steps | {
            "unconverged": rules.mask_unfinished_steps(steps),
            "fallback": rules.mask_unusable_steps(steps),
        }
    steps["counts"] = np.ones(len(steps["k"]), dtype=np.bool_)
    delay = make_delay_of_cell(cell, _find_sample_s(cell, evaluated))
    steps |= _backup_step_columns(columns)
    waited_ns: Ints = steps["total_ns"]
    if "backup" in steps:
        waited_ns = waited_ns + np.maximum(steps["backup_ns"], 0)
    steps |= make_deadline_columns(delay, columns["latency_ns"], waited_ns)
    if "backup" in steps and delay.is_simulated:
        ready_ns = columns[f"{BACKUP_PREFIX}ready_ns"]
        steps["late"] |= ready_ns > delay.budget_ns
        steps["backup_failed"] |= ready_ns > delay.sample_ns
    steps |= {name: columns[name] for name in ("fallback", "unconverged", "clipped")}
    return steps | _ship_columns(columns) if "state" in columns else steps


def _select_columns_by_prefix(columns: Columns, prefix: str) -> Columns:
    """Return the step columns whose names have a prefix, under names without it."""
    names = [name for name in columns if name.startswith(prefix)]
    return {name.removeprefix(prefix): columns[name] for name in names}


def _backup_step_columns(columns: Columns) -> StepColumns:
    """Return whether the backup solver acted or failed in each step, its time and error."""
    own = _select_columns_by_prefix(columns, BACKUP_PREFIX)
    if not own:
        return {}
    answers = _answer_columns(own, own["asked"])
    return {
        "backup": own["acted"],
        "backup_failed": own["asked"] & rules.mask_unusable_steps(answers),
        "backup_ns": sum_step_times_ns({phase: answers[phase] for phase in SOLVER_COLUMNS}),
        "backup_error": answers["error_move"],
    }


def _answer_columns(columns: Columns, asked: Flags | None) -> StepColumns:
    """Return times, status, errors and residuals of answers; empty in steps not `asked` (K,)."""
    status, times = _STATUS_NAMES[columns["status"].astype(int)], columns["times"]
    if asked is not None:
        status = np.where(asked, status, "")
        times = np.where(asked[:, None] | (np.array(PHASES) == "overhead"), times, MISSING_INT)
    steps: StepColumns = {
        "repeat": columns["repeat"],
        "k": columns["k"],
        "status": status,
        "claimed": columns["status"] == Status.SOLVED,
        "certificate": _CERTIFICATE_NAMES[columns["certificate"].astype(int)],
    }
    steps |= {f"{phase}_ns": _as_integers(times[:, i]) for i, phase in enumerate(PHASES)}
    steps |= {
        name: _as_integers(columns[name]) for name in ("iterations", "reported_ns", "waited_ns")
    }
    for i, figure in enumerate(EVALUATION):
        values = columns["evaluations"][:, i]
        steps[figure] = values == 1.0 if figure.startswith("true") else values
    steps["n_active"] = np.nan_to_num(steps["n_active"]).astype(np.int32)
    return steps


def join_cascade_steps(first: StepColumns, second: StepColumns) -> StepColumns:
    """Return one set of step columns for a cascade's two QPs, control and thrust allocation.

    A step is claimed, and true, only if both answers are; its time is that of both. Status and
    certificate are those of the first QP, or of the second where the first is solved, or has no
    feasible point, and the second is not solved; where the right answer to either is not known,
    that to the step is not. All else is of the first; `allocation_ns` and `allocation_error` are
    the time and the error of the first move of the second.
    """
    both = first.copy()
    for name in ("claimed", "true", "true_1e4", "true_1e6"):
        both[name] = first[name] & second[name]
    of_second = ~second["claimed"] & (first["claimed"] | (first["certificate"] == rules.INFEASIBLE))
    for name in ("status", "certificate"):
        both[name] = np.where(of_second, second[name], first[name])
    for unknown in (rules.UNDECIDED, rules.UNCERTIFIED):
        either = (first["certificate"] == unknown) | (second["certificate"] == unknown)
        both["certificate"] = np.where(either, unknown, both["certificate"])
    waited = first["waited_ns"], second["waited_ns"]
    both["waited_ns"] = np.where(np.minimum(*waited) > MISSING_INT, sum(waited), MISSING_INT)
    both["allocation_ns"] = sum_step_times_ns({phase: second[phase] for phase in SOLVER_COLUMNS})
    both["allocation_error"] = second["error_move"]
    return both


def _as_integers(values: NDArray[Any]) -> Ints:
    """Return values as int64, with `MISSING_INT` (−1) as the least."""
    return np.maximum(values.astype(np.int64), MISSING_INT)


def _ship_columns(columns: Columns) -> StepColumns:
    """Return pose, velocity, force and command of the ship in each step of a closed loop."""
    state, tau = columns["state"][:-1], columns["tau"].astype(np.float64)
    change = tau - shift_forces_by_one_step(tau)
    ship = {name: state[:, i] for i, name in enumerate(STATE)}
    for i, axis in enumerate(AXIS_FORCES):
        ship[f"tau_{axis}"] = tau[:, i]
        ship[f"dtau_{axis}"] = change[:, i]
        ship[f"cmd_{axis}"] = columns["command"][:, i]
    return ship | {name: columns[name] for name in _OF_THRUSTERS if name in columns}


def sum_step_times_ns(steps: Mapping[str, NDArray[Any]]) -> Ints:
    """Return each step's solver time [ns] (N,), thrust allocation included; −1 if not solved."""
    phases = [steps[phase] for phase in SOLVER_COLUMNS]
    parts = [*phases, steps["allocation_ns"]] if "allocation_ns" in steps else phases
    total = np.zeros(len(phases[0]), dtype=np.int64)
    for part in parts:
        total += np.maximum(part, 0)
    total[np.maximum.reduce(phases) < 0] = MISSING_INT
    return total


def make_step_rows(run_id: str, steps: StepColumns) -> pd.DataFrame:
    """Return a data frame laid out as `steps.parquet`, from one run's id and step columns."""
    columns: dict[str, Any] = {"run_id": np.full(len(steps["k"]), run_id, dtype=object)}
    for name, column in steps.items():
        whole = STEP_COLUMNS[name][0] == "Int64"
        columns[name] = pd.arrays.IntegerArray(column, column == MISSING_INT) if whole else column
    return convert_to_step_columns(pd.DataFrame(columns))


def make_run_row(
    run_id: str,
    cell: Cell,
    outcome: Outcome,
    library: Availability,
    machine_id: str,
    evaluated: EvaluatedCell | None,
    steps: StepColumns | None,
    *,
    concurrency: int | None = None,
    campaign_utc: str = "",
    turns: str = "",
) -> dict[str, Any]:
    """Return the row of one run in `runs.parquet`; without steps only what identifies the run.

    concurrency, campaign_utc, turns : see the columns of these names.
    """
    row: dict[str, Any] = {
        "run_id": run_id,
        **{name: getattr(cell, name) for name in _OF_CELL},
        "scenario": cell.scenario_name,
        "sequence": cell.sequence,
        "solver_version": library.version,
        "build": library.build.text,
        "generic_build": library.build.generic,
        "form": outcome.form,
        **_size_columns(cell, outcome),
        "deadline_s": _deadline_of_cell_s(cell, evaluated),
        "outcome": outcome.outcome,
        "outcome_detail": outcome.detail,
        "process_peak_bytes": np.nan if outcome.peak_bytes is None else outcome.peak_bytes,
        "machine_id": machine_id,
        "schema": SCHEMA_VERSION,
        "cell": cell.to_json(),
        "concurrency": pd.NA if concurrency is None else concurrency,
        "campaign_utc": campaign_utc,
        "judged_utc": datetime.now(UTC).isoformat(timespec="milliseconds") if campaign_utc else "",
        "turns": turns,
        "steps_planned": cell.steps,
        "steps_done": 0,
    }
    if evaluated is None or steps is None or not len(steps["k"]):
        return row
    counts = steps["counts"]
    row |= evaluated.metrics
    if cell.solver not in CALIBRATION:
        row |= _worst_error_columns(rules.select_answered_steps(steps, cell.slowdown))
    if not counts.any():
        # The warm-up counts in no other column.
        return row
    row["steps_done"] = int(np.bincount(steps["repeat"][counts]).max())
    judged = rules.select_answered_steps(rules.select_step_rows(steps, counts), cell.slowdown)
    row["exact_thruster_use"] = evaluated.thruster_use
    row |= timing.compute_timing_percentiles(cell, evaluated, judged)
    if cell.solver not in CALIBRATION:
        row |= _accuracy_columns(judged, cell.source)
    if cell.mode == "closed_loop":
        row |= (
            _fallback_columns(steps)
            | _backup_columns(steps)
            | timing.compute_deadline_metrics(steps, cell.slowdown)
        )
    return row


def _deadline_of_cell_s(cell: Cell, evaluated: EvaluatedCell | None) -> float:
    """Return the time budget of a step [s]; NaN in a replay, which has none."""
    if cell.mode == "replay":
        return float("nan")
    return cell.deadline_s or _find_sample_s(cell, evaluated)


def _find_sample_s(cell: Cell, evaluated: EvaluatedCell | None) -> float:
    """Return the sample [s] of a closed loop; that of a `LinearMPC` is among its metrics alone."""
    measured = {} if evaluated is None else evaluated.metrics
    if "sample_s" in measured:
        return measured["sample_s"]
    return build_or_reuse_scenario(cell.scenario).sample_s


def _size_columns(cell: Cell, outcome: Outcome) -> dict[str, Any]:
    """Return horizons and QP size of a run; null where there are none."""
    scenario = cell.scenario.get("scenario", {}) if cell.source.is_of_controller else {}
    controller = scenario.get("controller", {})
    sizes = {
        "N_p": controller.get("prediction_horizon"),
        "N_c": controller.get("control_horizon"),
        "n": outcome.n,
        "m": outcome.m,
    }
    return {name: pd.NA if value is None else int(value) for name, value in sizes.items()}


def _accuracy_columns(steps: StepColumns, source: QPSource) -> dict[str, Any]:
    """Return the shares of claimed and of correct answers, errors and iterations of a run."""
    known, undecided = rules.mask_decided_steps(steps), steps["certificate"] == rules.UNDECIDED
    charged = rules.select_step_rows(steps, ~undecided)
    moves = rules.compute_first_move_errors(charged)
    moves = moves[~np.isnan(moves)]
    iterations = steps["iterations"][steps["iterations"] > MISSING_INT]
    bounds = steps["optimum_bound"]
    return {
        "claimed_share": _compute_share_of_true(steps["claimed"]),
        "true_share": _compute_share_of_true(steps["true"][known]),
        "true_1e4_share": _compute_share_of_true(steps["true_1e4"][known]),
        "true_1e6_share": _compute_share_of_true(steps["true_1e6"][known]),
        "claimed_not_true": int(rules.mask_claimed_not_true(steps).sum()),
        "true_not_claimed": int(rules.mask_true_not_claimed(steps).sum()),
        "error_move_p50": np.quantile(moves, 0.5, method="higher") if len(moves) else np.nan,
        "primal_max": rules.maximum_of_known(charged["primal"]),
        "dual_max": rules.maximum_of_known(charged["dual"]),
        "optimum_bound_max": rules.maximum_of_known(bounds[np.isfinite(bounds)]),
        "uncertified": int((~known & ~undecided).sum()),
        "undecided_steps": int(undecided.sum()),
        "infeasible_steps": int((steps["certificate"] == rules.INFEASIBLE).sum()),
        "iterations_p50": rules.median_of_known(iterations),
        "iterations_p99": _find_iterations_of_slowest_hundredth(steps, source),
        "iterations_max": rules.maximum_of_known(iterations),
    }


def _find_iterations_of_slowest_hundredth(steps: StepColumns, source: QPSource) -> float:
    """Return the iterations that one in a hundred steps exceeds; NaN without a count.

    Of a window, one in a hundred of the steps that it was chosen from, as `window_p99_ns` is.
    """
    known = steps["iterations"] > MISSING_INT
    if not known.any():
        return math.nan
    _, at = np.unique(steps["k"][known], return_inverse=True)
    by_step = np.zeros(at.max() + 1)
    np.maximum.at(by_step, at, steps["iterations"][known])
    searched = source.of if isinstance(source, HardestSource) else len(by_step)
    return float(np.sort(by_step)[-1 - min(searched // 100, len(by_step) - 1)])


def _worst_error_columns(steps: StepColumns) -> dict[str, Any]:
    """Return a run's largest errors, and how many of its steps fail, in any round or warm-up."""
    charged = rules.select_step_rows(steps, steps["certificate"] != rules.UNDECIDED)
    return {
        "error_move_max": rules.maximum_of_known(rules.compute_first_move_errors(charged)),
        "error_plan_max": rules.maximum_of_known(charged["error_plan"]),
        "failed_steps": len(np.unique(steps["k"][rules.mask_failed_steps(steps)])),
    }


def _compute_share_of_true(flags: Flags) -> float:
    """Return the share of flags that are true; NaN without any."""
    return float(flags.mean()) if len(flags) else float("nan")


def _backup_columns(steps: StepColumns) -> dict[str, Any]:
    """Return how often the backup solver was called, acted and failed; none without one."""
    if "backup" not in steps:
        return {}
    asked = steps["backup_ns"] > MISSING_INT
    times = steps["backup_ns"][asked].astype(np.float64)
    return {
        "backup_asked": int(asked.sum()),
        "backup_acted": int(steps["backup"].sum()),
        "backup_failures": int(steps["backup_failed"].sum()),
        "backup_p50_ns": rules.median_of_known(times),
        "backup_max_ns": rules.maximum_of_known(times),
        "backup_error_max": rules.maximum_of_known(steps["backup_error"][asked]),
    }


def _fallback_columns(steps: StepColumns) -> dict[str, Any]:
    """Return how often the fallback acted, its longest streak, and the steps to recover."""
    failed = steps["fallback"]
    recovered = timing.count_steps_to_recover(failed, steps["true"])
    return {
        "fallbacks": int(failed.sum()),
        "fallback_longest": timing.length_of_longest_streak(failed),
        "recover_steps_max": pd.NA if recovered is None else recovered,
        "unconverged": int(steps["unconverged"].sum()),
        "clipped": int(steps["clipped"].sum()),
    }
