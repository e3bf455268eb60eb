"""Judge the raw log of a replay; how it repeated itself, what disturbed it, what it took."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dpbench.bench.judge.closed_loop import (
    CERTIFICATES,
    EVALUATION,
    Evaluated,
    StepEvaluator,
    common_columns,
    recorded_answer,
)
from dpbench.bench.judge.memory_of_answers import memory_metrics
from dpbench.bench.judge.repeatability import repeatability
from dpbench.bench.record.disturbance import disturbance_metrics
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.record.step_table import times_of
from dpbench.bench.run.footprint import footprint_metrics
from dpbench.qp.program import QPSequence, Units
from dpbench.qp.referee.referee import Optimum


def evaluate_sequence(
    log: RawLog,
    own: QPSequence,
    sample_s: float,
    optima: Sequence[Optimum] | None = None,
    *,
    judged: bool = True,
) -> Evaluated:
    """The judged columns of a replay of the sequence `own`; `optima` where they are certified.

    Without `judged` the answers are none, and nothing is said of them.
    """
    rounds = [r for r in range(len(log.done)) if log.done[r] > 0]
    counts = [int(log.done[r]) for r in rounds]
    evaluations = np.full((sum(counts), len(EVALUATION)), np.nan)
    certificates = np.full(sum(counts), CERTIFICATES.index("none"), dtype=np.int8)
    units = _units(own)
    if judged:
        _evaluate_rounds(log, own, units, optima, rounds, counts, evaluations, certificates)
    columns = common_columns(log, rounds, counts, evaluations, certificates)
    first, every = int(own.meta.get("first", 0)), int(own.meta.get("every", 1))
    columns["t_s"] = times_of(columns["k"], first, every, sample_s)
    columns["reference_kernel_ns"] = log.reference_kernel_ns[rounds].copy()
    columns["load_kernel_ns"] = log.load_kernel_ns[rounds].copy()
    metrics = {"sample_s": sample_s, "first_sample": float(first), "every_sample": float(every)}
    metrics |= repeatability(log, units.z) | disturbance_metrics(log) | footprint_metrics(log)
    return Evaluated(columns, metrics | memory_metrics(log))


def _units(own: QPSequence) -> Units:
    ones = np.ones(own.base.n)
    return Units(ones, ones) if own.units is None else own.units


def _evaluate_rounds(
    log: RawLog,
    own: QPSequence,
    units: Units,
    optima: Sequence[Optimum] | None,
    rounds: list[int],
    counts: list[int],
    evaluations: NDArray[np.float64],
    certificates: NDArray[np.int8],
) -> None:
    """Judge the answers of all rounds into the rows of `evaluations` and `certificates`."""
    scaled: QPSequence = own if own.scaled is None else own.scaled
    evaluator = StepEvaluator(scaled.base, own.base, units)
    place = np.empty(len(evaluations), dtype=np.intp)  # of the evaluation of each row
    judged_answers = 0
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
    for k in range(max(counts, default=0)):
        step = scaled.step(k)
        step_own = step if own is scaled else own.step(k)
        evaluator.follow(step, step_own)
        optimum = evaluator.certify(step) if optima is None else optima[k]
        seen: dict[bytes, int] = {}
        for r, start, count in zip(rounds, starts, counts, strict=True):
            if k >= count:
                continue
            # Most solvers repeat themselves bit for bit; an identical answer has its assessment.
            answer = recorded_answer(log, r, k)
            identity = answer.identity
            if identity not in seen:
                evaluator.add(step, step_own, answer, optimum)
                seen[identity] = judged_answers
                judged_answers += 1
            place[start + k] = seen[identity]
            certificates[start + k] = CERTIFICATES.index(optimum.kind)
    evaluations[:] = evaluator.evaluations()[place]
