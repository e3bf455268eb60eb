"""The judged columns of a loop of five steps whose log is changed where it must be noticed."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench import load_scenario
from dpbench.bench.judge.evaluation import CERTIFICATES, EVALUATION, EvaluatedCell, StepEvaluator
from dpbench.bench.record.raw_log import RawLog
from dpbench.qp.program import QPStep, QuadraticProgram, Units
from dpbench.qp.solution import Solution, Status
from tests.bench.judge.known_runs import judged_loop

STEPS, SOLVE = 5, 3


def judged(
    change: Callable[[RawLog], Any], scenario: str = "paper", units: str = "scaled"
) -> tuple[EvaluatedCell, RawLog]:
    evaluated, log, _ = judged_loop(change, scenario, units, STEPS)
    return evaluated, log


def figure(evaluated: EvaluatedCell, name: str) -> Any:
    return evaluated.columns["evaluations"][:, EVALUATION.index(name)]


def test_each_column_is_that_of_the_log() -> None:
    def change(log: RawLog) -> None:
        log.flags[:] = 0
        log.flags[[0, 1, 2], [0, 1, 2]] = 1
        log.counters[0] = [1.5, 2.0, 3.0, 4.0, 5.0, 6.0]
        log.latency_ns[:] = np.arange(STEPS)

    found, log = judged(change)
    for i, name in enumerate(("fallback", "unconverged", "clipped")):
        assert np.flatnonzero(found.columns[name]).tolist() == [i]
    np.testing.assert_array_equal(found.columns["state"], log.state)
    for name in ("tau", "command", "latency_ns"):
        np.testing.assert_array_equal(found.columns[name], getattr(log, name))
    np.testing.assert_allclose(found.columns["t_s"], 0.3 * np.arange(STEPS), rtol=1e-15)
    assert found.columns["repeat"].tolist() == [0] * STEPS
    assert found.columns["k"].tolist() == list(range(STEPS))
    names = ("replay_s", "voluntary_switches", "involuntary_switches", "steal_s")
    assert [found.metrics[name] for name in names] == [1.5, 2.0, 3.0, 4.0]
    clock = [found.metrics[name] for name in ("sample_s", "first_sample", "every_sample")]
    assert clock == [0.3, 0.0, 1.0] and found.metrics["matrix_steps"] == 0.0


def test_the_steps_that_were_done_are_those_that_are_judged() -> None:
    found, _ = judged(lambda log: log.done.fill(3))
    assert len(found.columns["k"]) == len(found.columns["tau"]) == 3
    assert len(found.columns["state"]) == 4 and found.metrics
    found, _ = judged(lambda log: log.done.fill(0))
    assert len(found.columns["k"]) == 0 and found.metrics == {}


def test_a_step_that_was_not_asked_has_no_answer_to_judge() -> None:
    def change(log: RawLog) -> None:
        log.times[0, :, SOLVE] = [7, 0, -1, -2, 7]

    found, _ = judged(change)
    asked = [True, True, False, False, True]
    assert found.columns["asked"].tolist() == asked
    assert np.isfinite(figure(found, "error_move")).tolist() == asked
    kinds = [CERTIFICATES[i] for i in found.columns["certificate"]]
    assert [kind != "none" for kind in kinds] == asked


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_answers_of_a_backup_are_judged_where_it_was_asked(units: str) -> None:
    """The backup repeats the right answers of the solver; a solve of 0 ns is an answer too.

    It is given the condensed QP in the units of the solver, whose residuals are then small.
    """

    def change(log: RawLog) -> None:
        backup = log.backup
        assert backup is not None
        for name in ("status", "z", "y", "y_box"):
            getattr(backup, name)[:] = getattr(log, name)
        backup.times[0, :, SOLVE] = [0, 7, -1, 7, -2]
        backup.done[0] = STEPS

    found, _, _ = judged_loop(change, "paper", units, STEPS, backup="quadprog")
    asked = [True, True, False, True, False]
    assert found.columns["backup_asked"].tolist() == asked
    error = found.columns["backup_evaluations"][:, EVALUATION.index("error_plan")]
    assert np.isfinite(error).tolist() == asked
    assert error[asked].max() < (1e-6 if units == "scaled" else 0.05)


@pytest.mark.parametrize("scenario", ["paper", "thrusters_cascade"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_answers_are_right_in_any_units_until_they_are_changed(scenario: str, units: str) -> None:
    """The plan of step 2 is doubled, which is as far from the optimum as it is large.

    In N and N·m the answers of daqp are right to a few hundredths of the maximum increment.
    """
    sizes: list[float] = []

    def change(log: RawLog) -> None:
        sizes.append(float(np.abs(log.z[0, 2]).max()))
        log.z[0, 2] *= 2.0

    found, _ = judged(change, scenario, units)
    error, right = figure(found, "error_plan"), 1e-6 if units == "scaled" else 0.05
    assert error[[0, 1, 3, 4]].max() < right
    if units == "scaled":
        assert error[2] == pytest.approx(sizes[0], rel=1e-6)
    assert error[2] > right
    second = found.columns.get("allocation_evaluations")
    if second is not None:
        assert second[:, EVALUATION.index("error_move")].max() < right


def test_the_undelivered_force_is_a_share_of_the_largest_there_is() -> None:
    """At step 1 surge lacks half of the ship's limit, sway a quarter; step 4 lacks all of yaw."""
    ship = load_scenario("thrusters_cascade").vessel
    largest = np.maximum(ship.tau_max, -ship.tau_min)

    def change(log: RawLog) -> None:
        log.demand[:] = log.tau
        log.demand[1] += largest * [0.5, -0.25, 0.0]
        log.demand[4] -= largest * [0.0, 0.0, 1.0]

    found, _ = judged(change, "thrusters_cascade")
    np.testing.assert_allclose(
        found.columns["undelivered_share"], [0.0, 0.5, 0.0, 0.0, 1.0], atol=1e-12
    )
    assert found.metrics["undelivered_share"] == pytest.approx(1.0)


def test_residuals_of_an_allocation_in_its_own_units() -> None:
    """A surge slack 5 N too large breaks its equality by 5 N, or by 5 N over the rate limit."""

    def change(log: RawLog) -> None:
        assert log.allocation is not None
        log.allocation.z[0, 2, -3] += 5.0

    case = load_scenario("thrusters_cascade")
    found, _ = judged(change, "thrusters_cascade", "si")
    second = found.columns["allocation_evaluations"]
    own, scaled = (second[:, EVALUATION.index(name)] for name in ("primal_own", "primal"))
    assert own[2] == pytest.approx(5.0, rel=1e-6) and np.delete(own, 2).max() < 1e-3
    assert scaled[2] == pytest.approx(5.0 / case.force_step_max[0], rel=1e-6)


def problem(q: list[float], unit: float = 1.0) -> QuadraticProgram:
    """½‖z‖² + qᵀz with each variable within ±1 and free rows, in units of `unit`."""
    limits = -np.ones(2) / unit, np.ones(2) / unit
    free, eye = np.full(2, 9.0), unit * np.eye(2)
    return QuadraticProgram(unit * eye, unit * np.array(q), eye, -free, free, *limits, 1)


Case = tuple[QuadraticProgram, Solution]


def evaluations(cases: list[Case], own: QuadraticProgram | None = None) -> list[dict[str, float]]:
    """Return the figures of answers to QPs of the same matrices; `own` is a QP in units of 4."""
    base, scale = cases[0][0], 1.0 if own is None else 0.25
    evaluator = StepEvaluator(base, own or base, Units(np.full(2, scale), np.ones(2)))
    for qp, answer in cases:
        step, given = (QPStep(one.q, one.l, one.u) for one in (qp, own or qp))
        evaluator.queue_answer(step, given, answer, evaluator.certify(step))
    return [dict(zip(EVALUATION, row, strict=True)) for row in evaluator.stack_evaluations()]


def evaluation(qp: QuadraticProgram, z: Any, y_box: Any, status: Status = Status.SOLVED) -> Any:
    y = np.full(2, np.nan) if np.isnan(y_box).any() else np.zeros(2)
    (found,) = evaluations([(qp, Solution(status, np.array(z), y, np.array(y_box)))])
    return found


@pytest.mark.parametrize(
    ("q", "active"), [([0.5, -0.5], 0), ([3.0, -0.5], 1), ([-3.0, 2.0], 2), ([0.5, 1.0001], 1)]
)
@pytest.mark.parametrize("status", [Status.SOLVED, Status.MAX_ITERATIONS, Status.UNKNOWN])
def test_the_optimum_is_true_under_any_status(q: list[float], active: int, status: Status) -> None:
    found = evaluation(problem(q), -np.clip(q, -1.0, 1.0), np.clip(q, -1.0, 1.0) - q, status)
    assert found["n_active"] == active
    assert found["error_plan"] == 0.0 and found["true_1e6"] == 1.0 and found["dual"] == 0.0


def test_a_claim_of_infeasibility_is_true_where_no_point_is_feasible() -> None:
    qp = problem([-2.0, 0.0])
    infeasible = Status.PRIMAL_INFEASIBLE
    assert evaluation(qp, [1.0, 0.0], [1.0, 0.0], infeasible)["true"] == 0.0
    empty = replace(qp, l=np.full(2, 3.0), u=np.full(2, 4.0))
    (found,) = evaluations([(empty, Solution.without_point(2, 2, infeasible))])
    assert found["true"] == 1.0 and np.isnan(found["error_move"])


def test_a_wrong_last_move_is_an_error_of_the_plan_alone() -> None:
    found = evaluation(problem([-2.0, 0.0]), [1.0, 0.5], [1.0, 0.0])
    assert (found["error_move"], found["error_plan"], found["true"]) == (0.0, 0.5, 0.0)


def test_no_answer_is_infinitely_wrong() -> None:
    (found,) = evaluations([(problem([-2.0, 0.0]), Solution.without_point(2, 2, Status.SOLVED))])
    assert {found[name] for name in ("error_move", "error_plan", "primal", "dual")} == {np.inf}
    assert found["true"] == 0.0


def test_an_answer_in_other_units_has_residuals_in_both() -> None:
    """Own variables count 4 scaled ones: 0.25 stands for z = 1, a multiplier of 4 for 1.

    A z of (1.5, 0) for the optimum (1, 0) is 0.5 off and violates its limit by as much, by 0.125 in
    its own units.
    """
    scaled, own = problem([-2.0, 0.0]), problem([-2.0, 0.0], 4.0)
    answers = [
        Solution(Status.SOLVED, np.array([z, 0.0]), np.zeros(2), np.array([4.0, 0.0]))
        for z in (0.25, 0.375)
    ]
    right, wrong = evaluations([(scaled, answer) for answer in answers], own)
    assert (right["primal"], right["dual"], right["dual_own"], right["true_1e6"]) == (0, 0, 0, 1)
    assert (wrong["primal"], wrong["primal_own"]) == (0.5, 0.125)
    assert (wrong["dual"], wrong["dual_own"]) == (0.5, 2.0)
    assert (wrong["error_move"], wrong["true"]) == (0.5, 0.0)


@pytest.mark.parametrize(
    ("off", "true"),
    [(9e-6, [1, 1, 1]), (1.1e-5, [1, 1, 0]), (9e-4, [1, 1, 0]), (1.1e-3, [1, 0, 0])],
)
def test_an_answer_is_true_at_the_tolerances_it_satisfies(off: float, true: list[int]) -> None:
    """A plan may be ten tolerances of 1e-3, 1e-4, 1e-6 away; its residuals are zero here.

    The optimum is (1, 0) with a multiplier of 1, which grows by as much as z falls short.
    """
    found = evaluation(problem([-2.0, 0.0]), [1.0 - off, 0.0], [1.0 + off, 0.0])
    assert [found[name] for name in ("true", "true_1e4", "true_1e6")] == true


@pytest.mark.parametrize(("short", "dual"), [(1e-6, 0.0), (3e-6, 1.000003)])
def test_missing_multipliers_are_those_of_the_limits_met(short: float, dual: float) -> None:
    """A limit of 1 is met to within 1e-6·(1 + 1); its multiplier then balances z - 2."""
    found = evaluation(problem([-2.0, 0.0]), [1.0 - short, 0.0], [np.nan, np.nan])
    assert found["dual"] == pytest.approx(dual, rel=1e-9, abs=1e-12)


def test_many_answers_are_judged_as_each_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, cases = np.random.default_rng(1), list[Case]()
    for i in range(23):
        answer = Solution(Status.SOLVED, *(rng.normal(size=2) for _ in range(3)))
        if i % 5 == 1:
            answer.y[:], answer.y_box[:] = np.nan, np.nan
        if i % 5 == 2:
            answer = Solution.without_point(2, 2, Status.PRIMAL_INFEASIBLE)
        cases.append((problem(rng.normal(size=2).tolist()), answer))
    one_by_one = [[*evaluations([case])[0].values()] for case in cases]
    for most in (7, 128):
        monkeypatch.setattr("dpbench.bench.judge.evaluation.BATCH_SIZE", most)
        found = [[*figures.values()] for figures in evaluations(cases)]
        np.testing.assert_array_equal(found, one_by_one)
