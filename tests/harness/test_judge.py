"""What is judged is what was asked and what was answered, whatever a solver does with either."""

from __future__ import annotations

import numpy as np

from dpbench.bench.grade import GRADES
from dpbench.bench.grade_replay import grade_sequence
from dpbench.bench.rawlog import RawLog, replay_layout
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.solution import Status


def _sequence(steps: int = 4) -> QPSequence:
    """½‖z‖² + qᵀz in a box, z = −q inside it."""
    eye, one = np.eye(3), np.ones(3)
    q = np.linspace(-0.9, 0.9, 3 * steps).reshape(steps, 3)
    base = QuadraticProgram(eye, q[0], eye, -2 * one, 2 * one, -one, one)
    rows = np.ones((steps, 3))
    return QPSequence("made up", base, q, -2 * rows, 2 * rows)


def test_the_status_is_part_of_an_answer() -> None:
    """The same bits called SOLVED once and PRIMAL_INFEASIBLE once are two answers."""
    sequence = _sequence(1)
    log = RawLog.in_memory(replay_layout(3, 1, 3, 3))
    log.z[:], log.y[:], log.y_box[:] = -sequence.q, 0.0, 0.0
    log.status[:, 0] = (Status.SOLVED, Status.SOLVED, Status.PRIMAL_INFEASIBLE)
    log.done[:] = 1
    graded = grade_sequence(log, sequence, 1.0)
    assert graded.columns["grades"][:, GRADES.index("true")].tolist() == [1.0, 1.0, 0.0]
    assert graded.metrics["bit_identical_share"] == 0.0
