"""The certified optima of a sequence, one referee for all steps with the same matrices."""

from __future__ import annotations

from collections.abc import Iterator

from dpbench.bench.run.exact_loop import brings_other_matrices
from dpbench.qp.program import QPSequence
from dpbench.qp.referee.referee import Optimum, Referee


def each_certified(sequence: QPSequence) -> Iterator[Optimum]:
    """The certified optimum of one step after the other, for a sequence in scaled units."""
    qp = sequence.base
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    for k in range(len(sequence)):
        step = sequence.step(k)
        if brings_other_matrices(qp, step):
            qp = qp.at(step)
            referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
        yield referee.certify(step.q, step.l, step.u)


def certified(sequence: QPSequence) -> list[Optimum]:
    """The certified optimum of every step, for a sequence in scaled units."""
    return list(each_certified(sequence))
