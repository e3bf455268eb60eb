"""Evaluation of the raw log of a replay: its answers, repeatability and disturbance."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats
from dpbench.bench.judge.answer_caching import compute_caching_metrics
from dpbench.bench.judge.closed_loop import (
    CERTIFICATES,
    EVALUATION,
    EvaluatedCell,
    StepEvaluator,
    make_answer_columns,
    read_recorded_answer,
)
from dpbench.bench.record.disturbance import compute_disturbance_metrics
from dpbench.bench.record.raw_log import FOOTPRINT, RawLog
from dpbench.qp.program import QPSequence, Units
from dpbench.qp.referee.optimum import Optimum


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
    if units is None:
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
