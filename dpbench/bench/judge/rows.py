"""Rows of `steps.parquet` and `runs.parquet` from the columns of an evaluated cell."""

from typing import Any

import numpy as np
import pandas as pd

from dpbench.arrays import Flags
from dpbench.bench.judge import rules, timing
from dpbench.bench.judge.closed_loop import EvaluatedCell
from dpbench.bench.judge.rules import StepColumns
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.configuration import CONFIGURATION_COLUMNS
from dpbench.bench.record.schema import (
    MISSING_INT,
    SCHEMA_VERSION,
    STEP_COLUMNS,
    convert_to_step_columns,
)
from dpbench.scenario.scenario import build_or_reuse_scenario
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.table import Availability

_OF_CELL = ("mode", *CONFIGURATION_COLUMNS, "slowdown", "seed")


def make_step_rows(run_id: str, steps: StepColumns) -> pd.DataFrame:
    """Return the step columns of one run as rows of `steps.parquet`."""
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
) -> dict[str, Any]:
    """Return the row of one run in `runs.parquet`; without steps only what identifies the run."""
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
        "deadline_s": _deadline_of_cell_s(cell),
        "outcome": outcome.outcome,
        "outcome_detail": outcome.detail,
        "process_peak_bytes": np.nan if outcome.peak_bytes is None else outcome.peak_bytes,
        "machine_id": machine_id,
        "schema": SCHEMA_VERSION,
        "cell": cell.to_json(),
        "concurrency": pd.NA if concurrency is None else concurrency,
        "steps_planned": cell.steps,
        "steps_done": 0,
    }
    if evaluated is None or steps is None or not len(steps["k"]):
        return row
    counts = steps["counts"]
    if not counts.any():
        # The warm-up does not count.
        return row | evaluated.metrics
    row["steps_done"] = int(np.bincount(steps["repeat"][counts]).max())
    judged = rules.select_answered_steps(rules.select_step_rows(steps, counts), cell.slowdown)
    row |= evaluated.metrics | timing.compute_timing_percentiles(cell, evaluated, judged)
    if cell.solver not in CALIBRATION:
        row |= _accuracy_columns(judged) | _worst_error_columns(
            rules.select_answered_steps(steps, cell.slowdown)
        )
    if cell.mode == "closed_loop":
        row |= (
            _fallback_columns(steps)
            | _backup_columns(steps)
            | timing.compute_deadline_metrics(steps, cell.slowdown)
        )
    return row


def _deadline_of_cell_s(cell: Cell) -> float:
    """Return the time budget of a step [s]; NaN in a replay, which has none."""
    if cell.mode == "replay":
        return float("nan")
    return cell.deadline_s or build_or_reuse_scenario(cell.scenario).sample_s


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


def _accuracy_columns(steps: StepColumns) -> dict[str, Any]:
    """Return the shares of claimed and of correct answers, errors and iterations of a run."""
    known, undecided = rules.mask_decided_steps(steps), steps["certificate"] == rules.UNDECIDED
    charged = rules.select_step_rows(steps, ~undecided)
    moves = rules.compute_first_move_errors(charged)
    moves = moves[~np.isnan(moves)]
    iterations = steps["iterations"][steps["iterations"] > MISSING_INT]
    bounds = steps["optimum_bound"]
    return {
        "claimed_share": _share_of_true(steps["claimed"]),
        "true_share": _share_of_true(steps["true"][known]),
        "true_1e4_share": _share_of_true(steps["true_1e4"][known]),
        "true_1e6_share": _share_of_true(steps["true_1e6"][known]),
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
        "iterations_max": rules.maximum_of_known(iterations),
    }


def _worst_error_columns(steps: StepColumns) -> dict[str, Any]:
    """Return a run's largest errors and number of failed steps, of all rounds with warm-up."""
    charged = rules.select_step_rows(steps, steps["certificate"] != rules.UNDECIDED)
    return {
        "error_move_max": rules.maximum_of_known(rules.compute_first_move_errors(charged)),
        "error_plan_max": rules.maximum_of_known(charged["error_plan"]),
        "failed_steps": int(rules.mask_failed_steps(steps).sum()),
    }


def _share_of_true(flags: Flags) -> float:
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
