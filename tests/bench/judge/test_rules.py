"""Rounds and steps that count, and the charge of a step: one rule for every table."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.run_steps import yield_step_times_by_run
from dpbench.bench.judge import rules
from dpbench.bench.judge.evaluation import (
    CERTIFICATES,
    EVALUATION,
    EvaluatedCell,
    evaluate_replay_log,
)
from dpbench.bench.judge.rows import make_run_row, make_step_columns, make_step_rows
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import PHASES, RawLog, make_replay_layout
from dpbench.bench.record.schema import convert_to_run_columns
from dpbench.bench.run.exact_loop import ExactWorkspace
from dpbench.bench.worst_case.search import find_worst_step
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.table import Availability

WARM_UP_STEPS, STEPS, N = 50, 120, 2
CALM, SLOWED = 5e4, 9e4


def _log(kernel_ns: list[float], statuses: list[Status] | None = None) -> RawLog:
    """A warm-up and full rounds with the reference kernel as given, every answer the optimum 0."""
    log = RawLog.in_memory(make_replay_layout(len(kernel_ns), STEPS, N, N))
    log.done[:] = [WARM_UP_STEPS] + [STEPS] * (len(kernel_ns) - 1)
    log.reference_kernel_ns[:] = np.array(kernel_ns)[:, None]
    log.times[:] = -1
    log.times[:, :, PHASES.index("solve")] = 1000 + np.arange(len(kernel_ns))[:, None]
    log.counters[:] = 1.0
    if statuses is not None:
        log.status[:, : len(statuses)] = statuses
    return log


def _sequence() -> QPSequence:
    eye, one, zero = np.eye(N), np.ones(N), np.zeros((STEPS, N))
    base = QuadraticProgram(eye, zero[0], eye, -one, one, -one, one)
    return QPSequence("made up", base, zero, zero - 1, zero + 1)


def _tables(evaluated: EvaluatedCell) -> tuple[pd.DataFrame, Any]:
    configuration = {"name": "made up"}, "planted", "native", "fresh", "default", STEPS
    cell = Cell("replay", *configuration, rounds=3)
    steps = make_step_columns(cell, evaluated)
    outcome, library = Outcome("finished", ""), Availability(True)
    row = make_run_row("planted", cell, outcome, library, "", evaluated, steps)
    return make_step_rows("planted", steps), convert_to_run_columns(pd.DataFrame([row])).iloc[0]


def _judged(log: RawLog) -> EvaluatedCell:
    return evaluate_replay_log(log, _sequence(), 0.3)


@pytest.mark.parametrize(
    ("slowed", "rounds", "disturbed", "counting_disturbed"),
    [((), 3, 0, 0), ((2,), 2, 1, 0), ((1, 2, 3), 3, 3, 3), ((0,), 3, 0, 0)],
)
def test_the_run_counts_the_rounds_that_the_report_counts(
    slowed: tuple[int, ...], rounds: int, disturbed: int, counting_disturbed: int
) -> None:
    steps, run = _tables(_judged(_log([SLOWED if r in slowed else CALM for r in range(4)])))
    (shown,) = dict(yield_step_times_by_run(steps)).values()
    assert (run["rounds"], run["raw_samples"]) == (rounds, rounds * STEPS)
    assert shown.raw_max_ns == run["raw_max_ns"] and shown.algo_ns.max() == run["algo_max_ns"]
    assert (run["disturbed_rounds"], run["counting_disturbed"]) == (disturbed, counting_disturbed)
    assert run["steps_done"] == STEPS


def test_a_replay_that_ended_in_its_warm_up_has_only_errors_and_failed_steps() -> None:
    log = _log([CALM] * 4)
    log.done[1:] = 0
    log.status[0, 1], log.z[0, 1] = Status.TIME_LIMIT, np.nan
    steps, run = _tables(_judged(log))
    assert len(steps) == WARM_UP_STEPS and not dict(yield_step_times_by_run(steps))
    assert run["steps_done"] == 0
    assert pd.isna(run["raw_samples"]) and np.isnan(run["true_share"])
    assert (run["error_move_max"], run["failed_steps"]) == (np.inf, 1)


def test_a_round_is_disturbed_beyond_the_factor_of_the_best_kernel_seen() -> None:
    """Kernels of 4 and at most 5 are calm, 5.01 is not; one that was never timed spoils nothing."""
    kernel_ns = np.array([[4.0, 5.0], [5.0, 5.0], [4.0, 5.01], [0.0, 4.5], [0.0, 0.0]])
    assert rules.mask_disturbed_rounds(kernel_ns).nonzero()[0].tolist() == [2]
    assert not rules.mask_disturbed_rounds(np.zeros((5, 2))).any()


def test_rounds_that_count_are_those_undisturbed_while_there_are_any() -> None:
    """Rounds 0 1 1 2 2: of round 1 disturbed, of both disturbed, of none; a warm-up alone."""
    repeat = np.array([0, 1, 1, 2, 2], dtype=np.int32)
    no, yes = False, True
    assert rules.mask_counted_rows(repeat, repeat == 1).tolist() == [no, no, no, yes, yes]
    assert rules.mask_counted_rows(repeat, repeat >= 0).tolist() == [no, yes, yes, yes, yes]
    assert rules.mask_counted_rows(repeat, repeat > 2).tolist() == [no, yes, yes, yes, yes]
    assert not rules.mask_counted_rows(0 * repeat, repeat == 1).any()


def _certified(kind: str, count: int, log: RawLog) -> EvaluatedCell:
    """Return a judged log whose first steps of each round have no optimum."""
    evaluated = _judged(log)
    first = evaluated.columns["k"] < count
    evaluated.columns["certificate"][first] = CERTIFICATES.index(kind)
    names = ("error_move", "error_plan", "optimum_bound", "true", "true_1e4", "true_1e6")
    values = (np.nan, np.nan, np.inf, 0.0, 0.0, 0.0)
    for name, value in zip(names, values, strict=True):
        evaluated.columns["evaluations"][first, EVALUATION.index(name)] = value
    return evaluated


def test_without_a_certificate_no_claim_is_false() -> None:
    _, run = _tables(_certified("none", 6, _log([CALM] * 3)))
    assert (run["uncertified"], run["undecided_steps"]) == (12, 0)
    assert (run["claimed_not_true"], run["true_not_claimed"], run["failed_steps"]) == (0, 0, 0)
    assert run["true_share"] == 1.0


@pytest.mark.parametrize("status", list(Status))
def test_a_step_undecided_at_rounding_is_charged_to_nobody(status: Status) -> None:
    log = _log([CALM] * 3, [status] * 6)
    log.z[:, :6] = np.nan
    evaluated = _certified("undecided", 6, log)
    _, run = _tables(evaluated)
    assert (run["uncertified"], run["undecided_steps"]) == (0, 12)
    assert (run["claimed_not_true"], run["true_not_claimed"], run["failed_steps"]) == (0, 0, 0)
    assert run["true_share"] == 1.0 and run["error_move_max"] == 0.0 and run["primal_max"] == 0.0
    worst = find_worst_step(evaluated, "error")
    assert worst is not None and worst.objective == 0.0


def test_nobody_fails_where_no_point_is_feasible_but_who_answers_all_the_same() -> None:
    log = _log([CALM] * 2, [Status.PRIMAL_INFEASIBLE, Status.SOLVED, Status.MAX_ITERATIONS])
    _, run = _tables(_certified("infeasible", 3, log))
    assert (run["infeasible_steps"], run["uncertified"]) == (3, 0)
    assert (run["failed_steps"], run["claimed_not_true"]) == (1, 1)


def test_an_answer_that_is_not_finite_fails_with_a_certificate_or_without() -> None:
    log = _log([CALM] * 2)
    log.z[:, [2, 10]] = np.nan
    _, run = _tables(_certified("none", 6, log))
    assert (run["failed_steps"], run["claimed_not_true"]) == (2, 1)


@pytest.mark.parametrize(("percent", "needed"), [(50, 20), (95, 200), (99, 1000), (99.9, 10_000)])
def test_a_percentile_needs_ten_samples_beyond_it(percent: float, needed: int) -> None:
    assert rules.has_enough_samples_for_percentile(
        needed, percent
    ) and not rules.has_enough_samples_for_percentile(needed - 1, percent)
    assert np.isfinite(rules.percentile_or_nan(np.arange(float(needed)), percent))
    assert np.isnan(rules.percentile_or_nan(np.arange(needed - 1.0), percent))


def test_a_limit_violated_by_rounding_is_charged_to_nobody() -> None:
    """0 ≥ z ≥ 1e-17 is decided by nobody."""
    sequence = _sequence()
    low = np.zeros((STEPS, N))
    low[:6], high = 1e-17, np.zeros(N)
    base = replace(sequence.base, lb=low[0], ub=high)
    sequence = replace(sequence, base=base, lb=low, ub=np.zeros((STEPS, N)))
    for status in (Status.SOLVED, Status.PRIMAL_INFEASIBLE):
        _, run = _tables(evaluate_replay_log(_log([CALM] * 3, [status] * 6), sequence, 0.3))
        assert (run["undecided_steps"], run["uncertified"], run["infeasible_steps"]) == (12, 0, 0)
        assert (run["claimed_not_true"], run["failed_steps"], run["true_share"]) == (0, 0, 1.0)
    exact = ExactWorkspace()
    exact.setup(sequence.problem(0))
    exact.solve()
    assert exact.read().status is Status.PRIMAL_INFEASIBLE
    assert exact.optima[-1].kind == "undecided"


def test_an_answer_is_unusable_by_its_status_or_its_numbers() -> None:
    steps = {
        "status": np.array(["ERROR", "SOLVED", "SOLVED", "MAX_ITERATIONS", "SOLVED"]),
        "error_plan": np.array([0.1, np.inf, np.nan, 0.3, np.nan]),
        "primal": np.array([0.1, 0.2, np.inf, 0.3, 0.0]),
    }
    assert rules.mask_unusable_steps(steps).tolist() == [True, True, True, False, False]


def test_the_error_of_a_cascade_is_the_larger_known_one() -> None:
    alone = {"error_move": np.array([0.1, 0.3, np.nan])}
    np.testing.assert_array_equal(rules.compute_first_move_errors(alone), [0.1, 0.3, np.nan])
    both = alone | {"allocation_error": np.array([0.2, np.nan, 0.4])}
    assert rules.compute_first_move_errors(both).tolist() == [0.2, 0.3, 0.4]


def test_medians_and_maxima_are_of_what_is_there() -> None:
    values = [np.nan, 3.0, 1.0, np.nan, 8.0]
    assert (rules.median_of_known(values), rules.maximum_of_known(values)) == (3.0, 8.0)
    assert rules.maximum_of_known([-2.0, -3.0]) == -2.0
    assert rules.median_of_known([7.0]) == rules.maximum_of_known([7.0]) == 7.0
    for nothing in ([], [np.nan]):
        assert np.isnan(rules.median_of_known(nothing)) and np.isnan(
            rules.maximum_of_known(nothing)
        )


# Certificate, status, claimed, true, fallback, unconverged; what the step then counts as.
FACTS = ("certificate", "status", "claimed", "true", "fallback", "unconverged")
CASES = {
    ("linear", "SOLVED", True, True, False, False): "",
    ("linear", "SOLVED", True, False, False, False): "claimed_not_true",
    ("linear", "INACCURATE", False, True, False, True): "failed true_not_claimed",
    ("gap", "MAX_ITERATIONS", False, False, True, False): "failed",
    ("rational", "PRIMAL_INFEASIBLE", False, False, True, False): "failed",
    ("infeasible", "PRIMAL_INFEASIBLE", False, True, True, False): "",
    ("infeasible", "SOLVED", True, False, False, False): "claimed_not_true",
    ("infeasible", "INACCURATE", False, False, False, True): "failed",
    ("none", "SOLVED", True, False, False, False): "unknown",
    ("none", "INACCURATE", False, True, False, True): "unknown failed",
    ("none", "ERROR", False, False, True, False): "unknown failed",
    ("undecided", "SOLVED", True, False, True, True): "unknown",
    ("undecided", "INACCURATE", False, True, True, True): "unknown",
}


@pytest.mark.parametrize("as_table", [False, True])
def test_each_kind_of_step_is_charged_as_the_method_states(as_table: bool) -> None:
    columns = {
        name: np.array([case[i] for case in CASES], dtype=object if i < 2 else bool)
        for i, name in enumerate(FACTS)
    }
    columns = {name: c.astype(str) if c.dtype == object else c for name, c in columns.items()}
    columns |= dict.fromkeys(("error_plan", "primal"), np.zeros(len(CASES)))
    steps = pd.DataFrame(columns) if as_table else columns
    found = {
        "unknown": ~rules.mask_decided_steps(steps),
        "failed": rules.mask_failed_steps(steps),
        "claimed_not_true": rules.mask_claimed_not_true(steps),
        "true_not_claimed": rules.mask_true_not_claimed(steps),
    }
    for i, (case, expected) in enumerate(CASES.items()):
        assert {name for name, flags in found.items() if flags[i]} == set(expected.split()), case
    of_no_use = [case[1] in ("PRIMAL_INFEASIBLE", "ERROR") for case in CASES]
    assert rules.mask_unusable_steps(steps).tolist() == of_no_use


@pytest.mark.parametrize(
    ("switches", "timed_share", "explained"),
    [
        (0.0, 0.5, 0),
        (100.0, 0.01, 10),  # 4 hits and three times 2
        (100.0, 0.0625, 40),  # 25 hits and three times 5
        (100.0, 0.5, 100),  # all may hit
        (7.0, float("nan"), 7),
    ],
)
def test_switches_explain_late_timings(switches: float, timed_share: float, explained: int) -> None:
    """A share of 1 % is hit by 4 % of the switches, plus three standard deviations."""
    assert rules.count_explained_late_timings(switches, timed_share) == explained
