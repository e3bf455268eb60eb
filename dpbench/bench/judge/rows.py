"""Turn a judged cell into its rows of `steps.parquet` and its row of `runs.parquet`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.bench.judge.closed_loop import CERTIFICATES, EVALUATION, OF_SECOND, Columns, Evaluated
from dpbench.bench.judge.deadlines import (
    deadline_metrics,
    late_columns,
    longest_streak,
    steps_to_recover,
)
from dpbench.bench.judge.rules import (
    INFEASIBLE,
    UNDECIDED,
    WARM_UP,
    claimed_not_true,
    counting_rows,
    decided,
    errors,
    failed_steps,
    joined,
    true_not_claimed,
    unusable,
)
from dpbench.bench.judge.timing import disturbed_rounds_of, timing_metrics
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import TIMES
from dpbench.bench.record.schema import SCHEMA_VERSION, as_steps
from dpbench.bench.run.slow_computer import delay_of
from dpbench.qp.solution import Status
from dpbench.scenario.scenario import scenario_once
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.table import Availability

_STATUS_NAMES = np.array([status.name for status in Status])


def step_rows(run_id: str, cell: Cell, evaluated: Evaluated) -> pd.DataFrame:
    """The rows of `steps.parquet` of one cell."""
    columns = evaluated.columns
    asked = columns["asked"] if cell.slowdown > 0.0 else None
    frame = _of_qps(columns, asked)
    second = {
        name.removeprefix(OF_SECOND): column
        for name, column in columns.items()
        if name.startswith(OF_SECOND)
    }
    if second:
        frame = joined(frame, _of_qps(second, None))
    frame.insert(0, "run_id", run_id)
    frame["t_s"] = columns["t_s"]
    if cell.mode == "replay":
        disturbed = np.isin(columns["repeat"], disturbed_rounds_of(columns))
        frame["warmup"], frame["disturbed"] = frame["repeat"] == WARM_UP, disturbed
        frame["counts"] = counting_rows(columns["repeat"], disturbed)
        frame["unconverged"] = frame["status"].isin(["INACCURATE", "MAX_ITERATIONS"])
        frame["fallback"] = unusable(frame)
        return as_steps(frame)
    frame["counts"] = True
    delay = delay_of(cell, scenario_once(cell.scenario).sample_s)
    frame = frame.assign(**late_columns(delay, columns["latency_ns"], frame["total_ns"]))
    return as_steps(pd.concat([frame, _ship_columns(columns)], axis=1))


def _of_qps(columns: Columns, asked: NDArray[np.bool_] | None) -> pd.DataFrame:
    """What is said of each answer to a QP; `asked` (K,) in which steps there is one, None for
    all."""
    rows: dict[str, Any] = {
        "repeat": columns["repeat"],
        "k": columns["k"],
        "status": _STATUS_NAMES[columns["status"].astype(int)],
        "claimed": columns["status"] == Status.SOLVED,
        "certificate": np.array(CERTIFICATES)[columns["certificate"].astype(int)],
    }
    frame = pd.DataFrame(rows)
    times = columns["times"]
    if asked is not None:
        frame.loc[~asked, "status"] = ""
        times = np.where(asked[:, None] | (np.array(TIMES) == "overhead"), times, -1)
    for i, phase in enumerate(TIMES):
        frame[f"{phase}_ns"] = _nullable(times[:, i])
    inside = times[:, 1:5]
    total = np.where(inside > 0, inside, 0).sum(axis=1)
    frame["total_ns"] = _nullable(np.where((inside < 0).all(axis=1), -1, total))
    frame["iterations"] = _nullable(columns["iterations"])
    frame["reported_ns"] = _nullable(columns["reported_ns"])
    for i, figure in enumerate(EVALUATION):
        values = columns["evaluations"][:, i]
        frame[figure] = values == 1.0 if figure.startswith("true") else values
    frame["n_active"] = np.nan_to_num(frame["n_active"]).astype(np.int32)
    return frame


def _nullable(values: NDArray[Any]) -> pd.arrays.IntegerArray:
    numbers = values.astype(np.int64)
    return pd.arrays.IntegerArray(np.where(numbers < 0, 0, numbers), numbers < 0)


def _ship_columns(columns: Columns) -> pd.DataFrame:
    state, tau = columns["state"][:-1], columns["tau"].astype(np.float64)
    change = np.diff(tau, axis=0, prepend=np.zeros((1, 3)))
    ship: dict[str, Any] = {name: columns[name] for name in ("fallback", "unconverged", "clipped")}
    names = ("u_mps", "v_mps", "r_radps", "n_m", "e_m", "psi_rad")
    ship |= {name: state[:, i] for i, name in enumerate(names)}
    for i, axis in enumerate(("x_N", "y_N", "n_Nm")):
        ship[f"tau_{axis}"] = tau[:, i]
        ship[f"dtau_{axis}"] = change[:, i]
        ship[f"cmd_{axis}"] = columns["command"][:, i]
    of_thrusters = ("thrust_share", "power_share", "undelivered_share")
    ship |= {name: columns[name] for name in of_thrusters if name in columns}
    return pd.DataFrame(ship)


def run_row(
    run_id: str,
    cell: Cell,
    outcome: Outcome,
    library: Availability,
    machine_id: str,
    evaluated: Evaluated | None,
    steps: pd.DataFrame | None,
) -> dict[str, Any]:
    """The row of `runs.parquet` of one cell; a cell without steps has its identity only."""
    row: dict[str, Any] = {
        "run_id": run_id,
        "mode": cell.mode,
        "scenario": cell.scenario_name,
        "sequence": cell.sequence,
        "solver": cell.solver,
        "solver_version": library.version,
        "build": library.build.text,
        "generic_build": library.build.generic,
        "route": cell.route,
        "policy": cell.policy,
        "settings": cell.settings,
        "formulation": cell.formulation,
        "form": outcome.form,
        **_sizes(cell, outcome),
        "units": cell.units,
        "slowdown": cell.slowdown,
        "deadline_s": _deadline_s(cell),
        "seed": cell.seed,
        "outcome": outcome.outcome,
        "outcome_detail": outcome.detail,
        "machine_id": machine_id,
        "schema": SCHEMA_VERSION,
        "cell": cell.to_json(),
        "steps_planned": cell.steps,
        "steps_done": 0,
    }
    if evaluated is None or steps is None or steps.empty:
        return row
    counting = steps[steps["counts"]]
    if counting.empty:
        # It ended within its warm-up, which says nothing about it.
        return row | evaluated.metrics
    row["steps_done"] = int(counting.groupby("repeat")["k"].count().max())
    judged = _evaluated(cell, counting)
    row |= evaluated.metrics | timing_metrics(cell, evaluated, judged)
    if cell.solver not in CALIBRATION:
        row |= _accuracy(judged)
    if cell.mode == "closed_loop":
        row |= _failures(steps) | deadline_metrics(steps, cell.slowdown)
    return row


def _deadline_s(cell: Cell) -> float:
    """The budget of a step [s]; NaN in a replay, which has none."""
    if cell.mode == "replay":
        return float("nan")
    return cell.deadline_s or scenario_once(cell.scenario).sample_s


def _sizes(cell: Cell, outcome: Outcome) -> dict[str, Any]:
    """Horizons and size of the QP; null where it has none, or the solver never got a QP."""
    scenario = {} if cell.source else cell.scenario.get("scenario", {})
    controller = scenario.get("controller", {})
    sizes = {
        "N_p": controller.get("prediction_horizon"),
        "N_c": controller.get("control_horizon"),
        "n": outcome.n,
        "m": outcome.m,
    }
    return {name: pd.NA if value is None else int(value) for name, value in sizes.items()}


def _evaluated(cell: Cell, steps: pd.DataFrame) -> pd.DataFrame:
    """The steps with an answer to judge; a late one is not for that reason a failed one."""
    if cell.slowdown == 0.0:
        return steps
    asked = steps[steps["total_ns"].notna()]
    return asked.assign(fallback=unusable(asked))


def _accuracy(steps: pd.DataFrame) -> dict[str, Any]:
    known, undecided = steps[decided(steps)], steps["certificate"] == UNDECIDED
    charged = steps[~undecided]
    moves = errors(charged).dropna()
    iterations = steps["iterations"].dropna().astype(float)
    certified = np.isfinite(steps["optimum_bound"])
    return {
        "claimed_share": steps["claimed"].mean(),
        "true_share": known["true"].mean(),
        "true_1e4_share": known["true_1e4"].mean(),
        "true_1e6_share": known["true_1e6"].mean(),
        "claimed_not_true": int(claimed_not_true(steps).sum()),
        "true_not_claimed": int(true_not_claimed(steps).sum()),
        "error_move_p50": moves.quantile(0.5, interpolation="higher") if len(moves) else np.nan,
        "error_move_max": moves.max(),
        "error_plan_max": charged["error_plan"].max(),
        "primal_max": charged["primal"].max(),
        "dual_max": charged["dual"].max(),
        "optimum_bound_max": steps["optimum_bound"].where(certified).max(),
        "uncertified": int((~decided(steps) & ~undecided).sum()),
        "undecided_steps": int(undecided.sum()),
        "infeasible_steps": int((steps["certificate"] == INFEASIBLE).sum()),
        "failed_steps": int(failed_steps(steps).sum()),
        "iterations_p50": iterations.median() if len(iterations) else np.nan,
        "iterations_max": iterations.max() if len(iterations) else np.nan,
    }


def _failures(steps: pd.DataFrame) -> dict[str, Any]:
    failed = steps["fallback"].to_numpy(dtype=bool)
    recovered = steps_to_recover(failed, steps["true"].to_numpy(dtype=bool))
    return {
        "fallbacks": int(failed.sum()),
        "fallback_longest": longest_streak(failed),
        "recover_steps_max": pd.NA if recovered is None else recovered,
        "unconverged": int(steps["unconverged"].sum()),
        "clipped": int(steps["clipped"].sum()),
    }
