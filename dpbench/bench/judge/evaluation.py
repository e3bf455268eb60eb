"""Evaluation of the raw log of a cell, after the clock has stopped.

Every step is compared with the certified optimum of the *same* QP in scaled units, rebuilt from the
recorded θ; residuals are given in the solver's own units too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Matrix, Vector
from dpbench.bench.judge.answer_caching import compute_caching_metrics
from dpbench.bench.judge.control_metrics import (
    compute_axis_limit_metrics,
    compute_control_metrics,
    compute_joint_limit_metrics,
    compute_thruster_metrics,
    compute_used_thrust_and_power_shares,
    describe_thruster_use_as_json,
)
from dpbench.bench.judge.rules import WARM_UP, mask_disturbed_rounds
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.disturbance import compute_disturbance_metrics
from dpbench.bench.record.energy import compute_energy_per_step_J
from dpbench.bench.record.raw_log import COUNTERS, FOOTPRINT, PHASES, AnswerLog, RawLog
from dpbench.bench.run.assemble import adapt_scenario_to_cell
from dpbench.bench.run.exact_loop import ExactLoop, build_problem_at_rest, compute_station_metrics
from dpbench.bench.run.formulation import Case, QPBuilder
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram, Refresh, Units
from dpbench.qp.referee.optimum import ACTIVE_MULTIPLIER, Optimum
from dpbench.qp.referee.referee import (
    Referee,
    get_shared_referee,
    is_infeasibility_or_unboundedness_claim_true,
    measure_first_move_and_plan_errors_of_many,
)
from dpbench.qp.residuals import (
    TRUE_TOL,
    are_answers_correct,
    compute_residuals_of_many,
    fit_row_and_bound_multipliers,
)
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.controllers.controller import MetricGroup
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario, build_or_reuse_scenario

Columns = dict[str, NDArray[Any]]
"""Arrays of several types over the recorded rows of a cell."""
SECOND_QP_PREFIX = "allocation_"
"""Prefix of columns of a cascade's second QPs."""
BACKUP_PREFIX = "backup_"
"""Prefix of columns of the backup."""
RebuildStep = Callable[[int], tuple[QPStep, QPStep]]
"""The QP of a step in scaled units and in those the solver was given."""
EVALUATION = (
    "primal",
    "dual",
    "complementarity",
    "gap",
    "primal_own",
    "dual_own",
    "error_move",
    "error_plan",
    "optimum_bound",
    "n_active",
    "true",
    "true_1e4",
    "true_1e6",
)
BATCH_SIZE = 128
"""Most answers that are evaluated together: some megabytes where n is 500."""
CERTIFICATES = ("linear", "gap", "rational", "infeasible", "none", "undecided")
_SOLVE = PHASES.index("solve")


METRICS: dict[MetricGroup, Callable[[Scenario, QPBuilder, Columns, Matrix], dict[str, float]]] = {
    "axis_limits": lambda case, qps, steps, _: compute_axis_limit_metrics(
        case, steps["tau"], qps.limits
    ),
    "joint_limits": lambda case, qps, steps, _: compute_joint_limit_metrics(
        case, steps["tau"], qps.limits
    ),
    "thrusters": lambda case, qps, _, f: compute_thruster_metrics(case, f, qps.thruster_limits),
    "delivery": lambda *of: {"undelivered_share": float(of[2]["undelivered_share"].max())},
}
"""Metrics of each group that a controller may name, of its steps and thruster forces (K, n_f)."""


@dataclass(frozen=True, eq=False)
class EvaluatedCell:
    """Evaluated steps of one run as columns, and the metrics of the run.

    thruster_use : the column `exact_thruster_use`.
    """

    columns: Columns
    metrics: dict[str, float]
    thruster_use: str = ""


class StepEvaluator:
    """Evaluator of a solver's answers against certified optima, many steps at once.

    `scaled` and `own` are the base problem in scaled and in the solver's units, which `units`
    relate.
    """

    def __init__(self, scaled: QuadraticProgram, own: QuadraticProgram, units: Units) -> None:
        self._scaled, self._own, self._units = scaled, own, units
        self._same = own is scaled
        self._referee: Referee | None = None
        self._waiting: list[tuple[QPStep, QPStep, Solution, Optimum]] = []
        self._evaluated: list[Matrix] = []

    def take_new_matrices(self, step: QPStep, own: QPStep) -> None:
        """Store a step's QP matrices for the answers queued from now on, where they are new."""
        if self._scaled.changed_by(step):
            self._evaluate_queue()
            self._scaled, self._own = self._scaled.at(step), self._own.at(own)
            self._referee = None

    def certify(self, step: QPStep) -> Optimum:
        """Return the certified optimum of a step's QP, in scaled units."""
        if self._referee is None:
            qp = self._scaled
            self._referee = get_shared_referee(qp.P, qp.A, qp.lb, qp.ub)
        return self._referee.certify_vectors(step.q, step.l, step.u)

    def queue_answer(self, scaled: QPStep, own: QPStep, answer: Solution, optimum: Optimum) -> None:
        """Queue an answer, in the solver's own units, for evaluation against its optimum."""
        self._waiting.append((scaled, own, answer, optimum))
        if len(self._waiting) >= BATCH_SIZE:
            self._evaluate_queue()

    def stack_evaluations(self) -> Matrix:
        """Return the errors and residuals (K, len(EVALUATION)) of all queued answers, in order."""
        self._evaluate_queue()
        return np.concatenate([np.empty((0, len(EVALUATION))), *self._evaluated])

    def _evaluate_queue(self) -> None:
        """Store errors, residuals and correctness of queued answers to QPs of equal matrices."""
        if not self._waiting:
            return
        scaled, own, answers, optima = zip(*self._waiting, strict=True)
        self._waiting = []
        z, y, y_box = (_stack_attribute(answers, part) for part in ("z", "y", "y_box"))
        self._fill_missing_multipliers(own, z, y, y_box)
        in_own = compute_residuals_of_many(self._own, *_stack_q_l_u(own), z, y, y_box)
        q, l, u = _stack_q_l_u(scaled)  # noqa: E741 - l ≤ Az ≤ u, the name of the field
        in_scaled, qp = in_own, self._scaled
        if not self._same:
            z, y, y_box = z / self._units.z, y * self._units.row, y_box * self._units.z
            in_scaled = compute_residuals_of_many(qp, q, l, u, z, y, y_box)
        move, plan = measure_first_move_and_plan_errors_of_many(z, optima, qp.block, qp.moves)
        levels = [are_answers_correct(q, in_scaled, plan, tol) for tol in (TRUE_TOL, 1e-4, 1e-6)]
        for i, answer in enumerate(answers):
            if answer.status.claims_no_optimum_exists:
                claim = Solution(answer.status, z[i], y[i], y_box[i])
                is_so = is_infeasibility_or_unboundedness_claim_true(
                    qp.at(scaled[i]), claim, optima[i]
                )
                for level in levels:
                    level[i] = is_so
        of_scaled = in_scaled.primal, in_scaled.dual, in_scaled.complementarity, in_scaled.gap
        errors = in_own.primal, in_own.dual, move, plan
        self._evaluated.append(
            np.column_stack(
                (*of_scaled, *errors, *_collect_error_bounds_and_active_counts(optima), *levels)
            )
        )

    def _fill_missing_multipliers(
        self, steps: Sequence[QPStep], z: Matrix, y: Matrix, y_box: Matrix
    ) -> None:
        """Fill in best-fitting Lagrange multipliers, in place, where a solver returned none."""
        without = np.isnan(y).any(axis=1) & np.isfinite(z).all(axis=1)
        for i in np.flatnonzero(without).tolist():
            y[i], y_box[i] = fit_row_and_bound_multipliers(self._own.at(steps[i]), z[i], 1e-6)


def _stack_attribute(parts: Sequence[object], name: str) -> Matrix:
    """Return a matrix whose rows are one named attribute of every part."""
    return np.array([getattr(part, name) for part in parts])


def _stack_q_l_u(steps: Sequence[QPStep]) -> tuple[Matrix, Matrix, Matrix]:
    """Stack the vectors of K given steps, one row each: q (K, n), l (K, m) and u (K, m)."""
    return _stack_attribute(steps, "q"), _stack_attribute(steps, "l"), _stack_attribute(steps, "u")


def _collect_error_bounds_and_active_counts(optima: Sequence[Optimum]) -> tuple[Vector, Vector]:
    """Return the error bound (K,) and the number of active limits (K,) of each optimum."""
    bound = np.array([optimum.bound for optimum in optima])
    multipliers = np.concatenate(
        (_stack_attribute(optima, "y"), _stack_attribute(optima, "y_box")), axis=1
    )
    return bound, (np.abs(multipliers) > ACTIVE_MULTIPLIER).sum(axis=1).astype(np.float64)


def read_recorded_answer(log: AnswerLog, r: int, k: int) -> Solution:
    """Return a solver's answer of round r, step k from a raw log, in the solver's own units."""
    return Solution(Status(int(log.status[r, k])), log.z[r, k], log.y[r, k], log.y_box[r, k])


def evaluate_loop_log(
    cell: Cell, log: RawLog, exact: ExactLoop, mpc: LinearMPC | None = None
) -> EvaluatedCell:
    """Evaluate a closed loop's raw log; return its step columns and control metrics.

    mpc : the problem of a plant that is no ship, which has no columns and metrics of a ship.
    """
    case = build_or_reuse_scenario(cell.scenario) if mpc is None else mpc
    scenario = adapt_scenario_to_cell(cell, case.truncate(cell.steps))
    scaled = QPBuilder(scenario)
    own = scaled if cell.units == "scaled" else QPBuilder(scenario, cell.units)
    done = int(log.done[0])
    # On a slow computer a step may pass without a computation: it has no answer to evaluate.
    asked = log.times[0, :done, _SOLVE] >= 0
    columns, matrix_steps = _evaluate_steps_and_count_matrices(
        log, *_make_evaluator_and_rebuilder(scaled, own, log), asked
    )
    columns |= {
        "asked": asked,
        "t_s": columns["k"] * scenario.sample_s,
        "latency_ns": log.latency_ns[:done].copy(),
        "fallback": log.flags[:done, 0].astype(bool),
        "unconverged": log.flags[:done, 1].astype(bool),
        "clipped": log.flags[:done, 2].astype(bool),
    }
    if not done:
        return EvaluatedCell(columns, {})
    metrics, use = {"sample_s": scenario.sample_s, "first_sample": 0.0, "every_sample": 1.0}, ""
    columns |= _evaluate_backup_columns(cell, scenario, log)
    if isinstance(scenario, Scenario):
        thrust = log.thrust[:done]
        columns |= _make_ship_columns(scenario, log) | _make_allocation_columns(
            scenario, scaled, own, log
        )
        metrics |= _compute_ship_metrics(scenario, scaled, columns, thrust, exact)
        metrics |= compute_station_metrics(scenario, exact, cell.steps)
        use = describe_thruster_use_as_json(
            scenario, exact.thrust[: cell.steps], scaled.thruster_limits, metrics["exact_left_s"]
        )
    else:
        metrics |= scenario.problem.horizons_by_name
    metrics["matrix_steps"] = float(matrix_steps)
    metrics |= dict(zip(COUNTERS, log.counters[0].tolist(), strict=True))
    return EvaluatedCell(columns, metrics, use)


def _make_ship_columns(scenario: Scenario, log: RawLog) -> Columns:
    """Return a ship's states, forces, commands and used thrust by name, of all recorded steps."""
    done = int(log.done[0])
    to_force = scenario.controller.convert_commands_to_ship_force
    return {
        "state": log.state[: done + 1].copy(),
        "tau": log.tau[:done].copy(),
        "command": to_force(log.command[:done]).copy(),
        **compute_used_thrust_and_power_shares(scenario, log.thrust[:done]),
    }


def _compute_ship_metrics(
    scenario: Scenario, qps: QPBuilder, columns: Columns, thrust: Matrix, exact: ExactLoop
) -> dict[str, float]:
    """Return control metrics of a ship, with those of its controller's kind."""
    controller = scenario.controller
    applied = controller.select_applied_commands(columns["tau"], thrust)
    metrics = compute_control_metrics(scenario, columns["state"], applied, qps.reference, exact)
    for group in controller.metric_groups:
        metrics |= METRICS[group](scenario, qps, columns, thrust)
    return metrics


def _make_evaluator_and_rebuilder(
    scaled: QPBuilder, own: QPBuilder, log: RawLog
) -> tuple[StepEvaluator, RebuildStep]:
    """Return an evaluator of a controller's QPs, and a function that rebuilds each step's QP."""
    base = build_problem_at_rest(scaled.condensed)
    own_base = base if own is scaled else build_problem_at_rest(own.condensed)

    def rebuilt(k: int) -> tuple[QPStep, QPStep]:
        step = scaled.rebuild(k, log.theta[k])
        return step, step if own is scaled else own.rebuild(k, log.theta[k])

    return StepEvaluator(base, own_base, own.condensed.scale), rebuilt


def _make_allocation_columns(
    scenario: Scenario, scaled: QPBuilder, own: QPBuilder, log: RawLog
) -> Columns:
    """Return a loop's columns of undelivered force and thrust-allocation QPs; none without any."""
    if not scenario.controller.allocates:
        return {}
    done, ship = int(log.done[0]), scenario.vessel
    missing = np.abs(log.demand[:done] - log.tau[:done])
    largest = np.maximum(ship.tau_max, -ship.tau_min)
    columns: Columns = {"undelivered_share": (missing / largest).max(axis=1)}
    answers, second, second_own = log.allocation, scaled.allocation, own.allocation
    if answers is None or second is None or second_own is None:
        return columns
    base = second.make_qp_of_zero_demand()
    own_base = base if own is scaled else second_own.make_qp_of_zero_demand()

    def rebuilt(k: int) -> tuple[QPStep, QPStep]:
        recorded = k, log.demand, log.thrust
        step = scaled.rebuild_allocation(*recorded)
        return step, step if own is scaled else own.rebuild_allocation(*recorded)

    evaluator = StepEvaluator(base, own_base, second_own.scale)
    evaluated, _ = _evaluate_steps_and_count_matrices(
        answers, evaluator, rebuilt, np.ones(done, dtype=np.bool_)
    )
    return columns | {f"{SECOND_QP_PREFIX}{name}": column for name, column in evaluated.items()}


def _evaluate_backup_columns(cell: Cell, scenario: Case, log: RawLog) -> Columns:
    """Return the step columns of the backup solver's answers and their use; none without it."""
    answers = log.backup
    if answers is None:
        return {}
    # Builders that have emitted nothing yet, as matrices are emitted where they change.
    scaled = QPBuilder(scenario)
    own = scaled if cell.units == "scaled" else QPBuilder(scenario, cell.units)
    done = int(log.done[0])
    asked = answers.times[0, :done, _SOLVE] >= 0
    evaluated, _ = _evaluate_steps_and_count_matrices(
        answers, *_make_evaluator_and_rebuilder(scaled, own, log), asked
    )
    acted, ready_ns = answers.acted[:done].astype(bool), answers.ready_ns[:done].copy()
    facts = evaluated | {"asked": asked, "acted": acted, "ready_ns": ready_ns}
    return {f"{BACKUP_PREFIX}{name}": column for name, column in facts.items()}


def _evaluate_steps_and_count_matrices(
    answers: AnswerLog, evaluator: StepEvaluator, rebuilt: RebuildStep, asked: Flags
) -> tuple[Columns, int]:
    """Return columns of answers in the `asked` steps (K,), and how many brought new matrices."""
    evaluations = np.full((len(asked), len(EVALUATION)), np.nan)
    certificates = np.full(len(asked), CERTIFICATES.index("none"), dtype=np.int8)
    matrix_steps = 0
    for k in np.flatnonzero(asked).tolist():
        step, step_own = rebuilt(k)
        evaluator.take_new_matrices(step, step_own)
        optimum = evaluator.certify(step)
        evaluator.queue_answer(step, step_own, read_recorded_answer(answers, 0, k), optimum)
        certificates[k] = CERTIFICATES.index(optimum.kind)
        matrix_steps += Refresh.MATRICES in step.refresh
    evaluations[asked] = evaluator.stack_evaluations()
    return make_answer_columns(answers, [0], [len(asked)], evaluations, certificates), matrix_steps


def make_answer_columns(
    log: AnswerLog,
    rounds: list[int],
    counts: list[int],
    evaluations: Floats,
    certificates: NDArray[np.int8],
) -> Columns:
    """Return times, status and errors of the first `counts` steps of each round, as columns."""

    def rows(array: NDArray[Any]) -> NDArray[Any]:
        parts = [array[r, :count] for r, count in zip(rounds, counts, strict=True)]
        return np.concatenate(parts) if parts else array[0, :0].copy()

    return {
        "repeat": np.repeat(np.array(rounds, dtype=np.int32), counts),
        "k": np.concatenate([np.arange(c, dtype=np.int32) for c in counts or [0]]),
        "times": rows(log.times),
        "status": rows(log.status),
        "iterations": rows(log.iterations),
        "reported_ns": rows(log.reported_ns),
        "waited_ns": rows(log.waited_ns),
        "setup_once_ns": log.setup_once_ns.copy(),
        "matrix_updates": log.matrix_updates.copy(),
        "certificate": certificates,
        "evaluations": evaluations,
    }


def evaluate_replay_log(
    log: RawLog,
    own: QPSequence,
    sample_s: float,
    optima: Sequence[Optimum] | None = None,
    *,
    judged: bool = True,
) -> EvaluatedCell:
    """Evaluate a replay's raw log; return its step columns and metrics.

    `optima` are of the steps, where they are certified; answers that are none are not `judged`.
    """
    rounds = np.flatnonzero(log.done > 0).tolist()
    counts = log.done[rounds].tolist()
    units = own.units
    if units is None or own.scaled is None:
        units = Units(np.ones(own.base.n), np.ones(own.base.n))
    evaluations = np.full((sum(counts), len(EVALUATION)), np.nan)
    certificates = np.full(sum(counts), CERTIFICATES.index("none"), dtype=np.int8)
    if judged:
        evaluations, certificates = _evaluate_errors_and_proofs(log, own, units, optima)
    columns = make_answer_columns(log, rounds, counts, evaluations, certificates)
    first, every = int(own.meta.get("first", 0)), int(own.meta.get("every", 1))
    columns["t_s"] = (first + every * columns["k"]) * sample_s
    for kernel in ("reference_kernel_ns", "load_kernel_ns"):
        columns[kernel] = getattr(log, kernel)[rounds].copy()
    metrics = {"sample_s": sample_s, "first_sample": float(first), "every_sample": float(every)}
    metrics |= measure_repeatability(log, units.z) | compute_disturbance_metrics(log)
    metrics |= dict(zip(FOOTPRINT, log.footprint.tolist(), strict=True))
    counts = (np.arange(len(log.done)) != WARM_UP) & ~mask_disturbed_rounds(log.reference_kernel_ns)
    metrics["energy_J_per_step"] = compute_energy_per_step_J(log.energy_J, log.done, counts)
    return EvaluatedCell(columns, metrics | compute_caching_metrics(log))


def _mask_recorded_steps(log: RawLog) -> Flags:
    """Return a mask (R, K) of the steps that each round of a replay has recorded."""
    recorded: Flags = np.arange(log.z.shape[1]) < log.done[:, np.newaxis]
    return recorded


def _evaluate_errors_and_proofs(
    log: RawLog, own: QPSequence, units: Units, optima: Sequence[Optimum] | None
) -> tuple[Floats, NDArray[np.int8]]:
    """Evaluate a replay's answers; return errors and kinds of optimum proof, round after round."""
    scaled: QPSequence = own if own.scaled is None else own.scaled
    evaluator = StepEvaluator(scaled.base, own.base, units)
    recorded, added = _mask_recorded_steps(log), 0
    # The number of the evaluation of each answer.
    numbers, kinds = np.zeros(recorded.shape, np.intp), np.zeros(recorded.shape, np.int8)
    for k in np.flatnonzero(recorded.any(axis=0)).tolist():
        step = scaled.step(k)
        step_own = step if own is scaled else own.step(k)
        evaluator.take_new_matrices(step, step_own)
        optimum = evaluator.certify(step) if optima is None else optima[k]
        kinds[:, k] = CERTIFICATES.index(optimum.kind)
        seen: dict[bytes, int] = {}
        for r in np.flatnonzero(recorded[:, k]).tolist():
            # Most solvers repeat themselves bit for bit; an equal answer is evaluated once.
            answer = read_recorded_answer(log, r, k)
            identity = answer.bytes_for_comparison
            if identity not in seen:
                evaluator.queue_answer(step, step_own, answer, optimum)
                seen[identity], added = added, added + 1
            numbers[r, k] = seen[identity]
    return evaluator.stack_evaluations()[numbers[recorded]], kinds[recorded]


def measure_repeatability(log: RawLog, own_per_scaled: Floats) -> dict[str, float]:
    """Return how equal a solver's answers and iterations are over all rounds of a replay.

    Of steps with two rounds or more: shares with equal status and bits of z, and with equal
    iterations; largest differences of a z, in scaled units by `own_per_scaled` (n,), and of
    iterations. NaN where no step was repeated, or iterations are not counted.
    """
    z, iterations, recorded = log.z, log.iterations, _mask_recorded_steps(log)
    repeated = recorded.sum(axis=0) >= 2
    if not repeated.any():
        names = ("bit_identical_share", "answer_spread_max")
        return dict.fromkeys((*names, "iterations_identical_share", "iterations_spread"), np.nan)
    first, index = recorded.argmax(axis=0), np.arange(z.shape[1])
    reference = z[first, index]
    # Bits, so that NaN equals NaN and 0.0 is not −0.0.
    same_bits = (z.view(np.uint64) == reference.view(np.uint64)).all(axis=2)
    same_answer = (same_bits & (log.status == log.status[first, index])) | ~recorded
    with np.errstate(invalid="ignore"):  # no answer less no answer
        apart = np.abs(z - reference) / own_per_scaled
    spread = np.where(recorded[:, :, None] & np.isfinite(apart), apart, 0.0).max(axis=(0, 2))
    counted = recorded & (iterations >= 0)
    whole = repeated & (counted.sum(axis=0) == recorded.sum(axis=0))
    most = np.where(counted, iterations, -1).max(axis=0)
    least = np.where(counted, iterations, np.iinfo(np.int64).max).min(axis=0)
    spreads = (most - least)[whole]
    return {
        "bit_identical_share": float(same_answer.all(axis=0)[repeated].mean()),
        "answer_spread_max": float(spread[repeated].max()),
        "iterations_identical_share": float((spreads == 0).mean()) if whole.any() else np.nan,
        "iterations_spread": float(spreads.max()) if whole.any() else np.nan,
    }
