"""The judged columns of a replay whose QPs have the optimum k + 1 at step k, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from dpbench.bench.judge.evaluation import (
    CERTIFICATES,
    EVALUATION,
    EvaluatedCell,
    evaluate_replay_log,
    measure_repeatability,
)
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.qp.program import QPSequence, QuadraticProgram, Units
from dpbench.qp.referee.referee import certify

STEPS, FAR = 3, np.full(1, 50.0)


def sequence(unit: float = 1.0) -> QPSequence:
    """½z² − (k + 1)z, free within ±50, its variable in units of `unit` scaled ones."""
    one, wide = np.ones((1, 1)), np.full((STEPS, 1), 50.0)
    limits = -FAR / unit, FAR / unit
    q = -unit * np.arange(1.0, STEPS + 1)[:, np.newaxis]
    base = QuadraticProgram(unit**2 * one, q[0], unit * one, -FAR, FAR, *limits, 1)
    return QPSequence("made up", base, q, -wide, wide, meta={"first": 5, "every": 2})


def log_of(answers: list[list[float]]) -> RawLog:
    log = RawLog.in_memory(make_replay_layout(len(answers), STEPS, 1, 1))
    for r, row in enumerate(answers):
        log.done[r] = len(row)
        log.z[r, : len(row), 0] = row
    return log


def figure(evaluated: EvaluatedCell, name: str) -> list[float]:
    found: list[float] = evaluated.columns["evaluations"][:, EVALUATION.index(name)].tolist()
    return found


def kinds(evaluated: EvaluatedCell) -> list[str]:
    return [CERTIFICATES[i] for i in evaluated.columns["certificate"]]


def test_each_answer_is_judged_in_its_round_and_step() -> None:
    """Rounds of two, no and three steps: one answer 0.5 off, one 0.25 off, one twice the same."""
    log = log_of([[1.5, 2.0], [], [1.0, 2.0, 2.75]])
    log.reference_kernel_ns[:] = np.arange(3.0)[:, np.newaxis]
    log.load_kernel_ns[:] = np.arange(3.0)[:, np.newaxis, np.newaxis]
    found = evaluate_replay_log(log, sequence(), 0.3)
    assert found.columns["repeat"].tolist() == [0, 0, 2, 2, 2]
    assert found.columns["k"].tolist() == [0, 1, 0, 1, 2]
    assert figure(found, "error_move") == [0.5, 0.0, 0.0, 0.0, 0.25]
    assert figure(found, "dual") == [0.5, 0.0, 0.0, 0.0, 0.25]
    assert figure(found, "true") == [0.0, 1.0, 1.0, 1.0, 0.0]
    assert "none" not in kinds(found)
    assert found.columns["reference_kernel_ns"][:, 0].tolist() == [0.0, 2.0]
    assert found.columns["load_kernel_ns"][:, 0, 0].tolist() == [0.0, 2.0]


def test_the_times_are_those_of_the_recorded_run() -> None:
    """Every second step from the fifth on, 0.3 s apart: 1.5, 2.1 and 2.7 s."""
    found = evaluate_replay_log(log_of([[], [1.0, 2.0, 3.0]]), sequence(), 0.3)
    np.testing.assert_allclose(found.columns["t_s"], [1.5, 2.1, 2.7], rtol=1e-15)
    clock = [found.metrics[name] for name in ("sample_s", "first_sample", "every_sample")]
    assert clock == [0.3, 5.0, 2.0]
    plain = replace(sequence(), meta={})
    found = evaluate_replay_log(log_of([[], [1.0, 2.0, 3.0]]), plain, 0.5)
    assert found.columns["t_s"].tolist() == [0.0, 0.5, 1.0]
    assert (found.metrics["first_sample"], found.metrics["every_sample"]) == (0.0, 1.0)


def test_without_judging_nothing_is_said() -> None:
    log = log_of([[1.0], [1.0, 2.0, 3.0]])
    found = evaluate_replay_log(log, sequence(), 0.3, judged=False)
    assert np.isnan(found.columns["evaluations"]).all() and kinds(found) == ["none"] * 4
    assert found.columns["k"].tolist() == [0, 0, 1, 2]
    assert found.metrics["bit_identical_share"] == 1.0


def test_given_optima_are_those_that_count() -> None:
    qps = sequence()
    optima = [
        replace(certify(qps.problem(k)), kind=kind, z=np.array([float(k)]))
        for k, kind in enumerate(("gap", "rational", "linear"))
    ]
    log = log_of([[1.0, 2.0], [1.0, 3.0, 5.0]])
    found = evaluate_replay_log(log, qps, 0.3, optima)
    assert figure(found, "error_move") == [1.0, 1.0, 1.0, 2.0, 3.0]
    assert kinds(found) == ["gap", "rational", "gap", "rational", "linear"]


def test_answers_in_other_units_are_judged_in_scaled_ones() -> None:
    """0.25 of the own variable is 1 scaled one; errors and spreads are in scaled ones."""
    scaled = sequence()
    own = replace(sequence(4.0), scaled=scaled, units=Units(np.array([0.25]), np.ones(1)))
    log = log_of([[0.25, 0.5], [0.25, 0.625, 0.75]])
    found = evaluate_replay_log(log, own, 0.3)
    assert figure(found, "error_move") == [0.0, 0.0, 0.0, 0.5, 0.0]
    assert figure(found, "dual") == [0.0, 0.0, 0.0, 0.5, 0.0]
    assert figure(found, "dual_own") == [0.0, 0.0, 0.0, 2.0, 0.0]
    assert found.metrics["answer_spread_max"] == 0.5
    assert found.metrics["bit_identical_share"] == 0.5


def test_matrices_of_a_step_hold_for_its_answers_alone() -> None:
    """The curvature doubles at step 1 only: the optima are 1, 1 and 3."""
    P = np.array([1.0, 2.0, 1.0])[:, np.newaxis, np.newaxis]
    found = evaluate_replay_log(log_of([[], [1.0, 1.0, 3.0]]), replace(sequence(), P=P), 0.3)
    assert figure(found, "error_move") == [0.0, 0.0, 0.0] and figure(found, "true") == [1.0] * 3


def test_a_replay_that_never_began_has_no_rows() -> None:
    for answers in ([[], []], [[]]):
        found = evaluate_replay_log(log_of(answers), sequence(), 0.3)
        assert all(len(found.columns[name]) == 0 for name in ("k", "t_s", "times"))
        assert found.columns["evaluations"].shape == (0, len(EVALUATION))


ONES = np.ones(2)


def alike(rounds: int = 3, steps: int = 4) -> RawLog:
    log = RawLog.in_memory(make_replay_layout(rounds, steps, 2, 1))
    log.z[:] = np.arange(2.0 * steps).reshape(steps, 2)
    log.iterations[:] = np.arange(steps)
    log.done[:] = steps
    return log


def test_rounds_that_are_alike_are_identical() -> None:
    log = alike()
    log.z[:, 2] = np.nan
    assert measure_repeatability(log, ONES) == {
        "bit_identical_share": 1.0,
        "answer_spread_max": 0.0,
        "iterations_identical_share": 1.0,
        "iterations_spread": 0.0,
    }


def test_the_last_bit_counts_and_so_does_the_sign_of_zero() -> None:
    log = alike()
    log.z[2, 1, 0] = np.nextafter(2.0, 3.0)
    log.z[1, 0, 0] = -0.0
    found = measure_repeatability(log, ONES)
    assert found["bit_identical_share"] == 0.5
    assert found["answer_spread_max"] == np.spacing(2.0)


def test_spreads_are_the_largest_and_in_scaled_units() -> None:
    """z apart by 3 of a unit that is 2 scaled ones; iterations from 3 to 9 at one step of four."""
    log = alike()
    log.z[2, 3, 1] += 3.0
    log.iterations[:, 3] = (5, 9, 3)
    found = measure_repeatability(log, np.array([1.0, 2.0]))
    assert found["answer_spread_max"] == 1.5
    assert (found["iterations_identical_share"], found["iterations_spread"]) == (0.75, 6.0)


def test_an_answer_that_is_missing_once_is_not_the_same() -> None:
    log = alike()
    log.z[1, 0] = np.nan
    found = measure_repeatability(log, ONES)
    assert (found["bit_identical_share"], found["answer_spread_max"]) == (0.75, 0.0)


def test_only_what_was_recorded_is_compared() -> None:
    log = alike(rounds=2)
    log.done[0] = 2
    log.z[0, 2:] = 99.0
    log.iterations[0, 2:] = 99
    assert measure_repeatability(log, ONES)["bit_identical_share"] == 1.0
    assert measure_repeatability(log, ONES)["iterations_spread"] == 0.0
    log.done[0] = 0
    assert all(np.isnan(value) for value in measure_repeatability(log, ONES).values())


@pytest.mark.parametrize("counts", [(-1, -1, -1), (-1, 4, 4)])
def test_a_solver_that_does_not_count_has_no_repeatability(
    counts: tuple[int, ...],
) -> None:
    """−1 is no number of iterations."""
    log = alike(steps=1)
    log.iterations[:, 0] = counts
    found = measure_repeatability(log, ONES)
    assert np.isnan(found["iterations_identical_share"]) and np.isnan(found["iterations_spread"])
