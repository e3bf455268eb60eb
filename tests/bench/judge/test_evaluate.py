"""The referee's columns: what an answer is worth, whatever its solver says."""

from __future__ import annotations

import numpy as np
import pytest

from dpbench import condense, load_scenario
from dpbench.bench.judge.closed_loop import EVALUATION, StepEvaluator
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import QPStep
from dpbench.qp.solution import Solution, Status


def judged(builder: CondensedQP, step: QPStep, answer: Solution) -> dict[str, float]:
    base = builder.problem(step)
    evaluator = StepEvaluator(base, base, builder.scale)
    return evaluated(evaluator, step, step, answer)


def evaluated(
    evaluator: StepEvaluator, step: QPStep, own: QPStep, answer: Solution
) -> dict[str, float]:
    """What is said of the last answer that was added."""
    evaluator.add(step, own, answer, evaluator.certify(step))
    return dict(zip(EVALUATION, evaluator.evaluations()[-1], strict=True))


@pytest.fixture(scope="module")
def builder() -> CondensedQP:
    return condense(load_scenario("paper"))


@pytest.fixture(scope="module")
def step(builder: CondensedQP) -> QPStep:
    x = np.array([0, 0, 0, 0, 0, 0, 1.2, 1.3, 0.0])
    return builder.emit(x, np.zeros(3), np.zeros(3))


@pytest.fixture(scope="module")
def optimum(builder: CondensedQP, step: QPStep) -> Solution:
    base = builder.problem(step)
    found = StepEvaluator(base, base, builder.scale).certify(step)
    return Solution(Status.SOLVED, found.z, found.y, found.y_box)


def test_the_optimum_is_true_under_any_usable_status(
    builder: CondensedQP, step: QPStep, optimum: Solution
) -> None:
    """The truth of an answer does not depend on what its solver claims."""
    for status in (Status.SOLVED, Status.MAX_ITERATIONS, Status.UNKNOWN):
        answer = Solution(status, optimum.z, optimum.y, optimum.y_box)
        assert judged(builder, step, answer)["true_1e6"] == 1.0


def test_a_false_infeasible_is_not_true(
    builder: CondensedQP, step: QPStep, optimum: Solution
) -> None:
    """Claiming infeasibility of a feasible step is wrong even with the optimum in hand."""
    answer = Solution(Status.PRIMAL_INFEASIBLE, optimum.z, optimum.y, optimum.y_box)
    assert judged(builder, step, answer)["true"] == 0.0


def test_a_true_infeasible_is_true(builder: CondensedQP, step: QPStep) -> None:
    """A step whose amplitude limit cannot be reached is infeasible, and saying so is true."""
    impossible = QPStep(step.q, np.full(15, 3.0), np.full(15, 4.0))
    answer = Solution.missing(15, 15, Status.PRIMAL_INFEASIBLE)
    evaluations = judged(builder, impossible, answer)
    assert evaluations["true"] == 1.0
    assert np.isnan(evaluations["error_move"]), "there is no optimum to be away from"


def test_missing_multipliers_are_found_by_the_referee(
    builder: CondensedQP, step: QPStep, optimum: Solution
) -> None:
    """An exact plan without multipliers is judged by the best ones there are."""
    nan = np.full(15, np.nan)
    evaluations = judged(builder, step, Solution(Status.SOLVED, optimum.z, nan, nan))
    assert evaluations["true_1e6"] == 1.0


def test_error_move_looks_at_the_first_move_only(
    builder: CondensedQP, step: QPStep, optimum: Solution
) -> None:
    """A wrong last move is an error of the plan, not of the move that is applied."""
    z = optimum.z.copy()
    z[-1] += 0.5
    evaluations = judged(builder, step, Solution(Status.SOLVED, z, optimum.y, optimum.y_box))
    assert evaluations["error_move"] < 1e-12
    assert evaluations["error_plan"] == pytest.approx(0.5, abs=1e-12)
    assert evaluations["true"] == 0.0


def test_no_answer_is_infinitely_wrong(builder: CondensedQP, step: QPStep) -> None:
    """NaN in the iterate makes residuals and errors infinite, never small."""
    evaluations = judged(builder, step, Solution.missing(15, 15, Status.SOLVED))
    assert evaluations["error_move"] == evaluations["error_plan"] == np.inf
    assert evaluations["primal"] == evaluations["dual"] == np.inf
    assert evaluations["true"] == 0.0


def test_raw_units_are_judged_in_scaled_ones() -> None:
    """An exact answer in N and N·m has error_move in rate-limit steps, and residuals in both."""
    scenario = load_scenario("paper")
    scaled, si = condense(scenario), condense(scenario, units="si")
    x = np.array([0, 0, 0, 0, 0, 0, 1.2, 1.3, 0.0])
    theta = (x, np.zeros(3), np.zeros(3))
    step, step_si = scaled.emit(*theta), si.emit(*theta)
    evaluator = StepEvaluator(scaled.problem(step), si.problem(step_si), si.scale)
    best = evaluator.certify(step)
    scale = si.scale.z
    answer = Solution(Status.SOLVED, best.z * scale, best.y / scale, best.y_box / scale)
    evaluations = evaluated(evaluator, step, step_si, answer)
    assert evaluations["true_1e6"] == 1.0
    assert evaluations["error_move"] < 1e-14
    answer.z[0] += 0.01 * scale[0]
    evaluations = evaluated(evaluator, step, step_si, answer)
    assert evaluations["error_move"] == pytest.approx(0.01, rel=1e-9)


def test_many_answers_are_judged_as_each_by_itself(
    builder: CondensedQP, optimum: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, however many are judged at once; missing and false ones among them."""
    rng, cases = np.random.default_rng(1), list[tuple[QPStep, Solution]]()
    for i in range(23):
        x = np.append(np.zeros(6), rng.normal(size=3))
        made = Solution(Status.SOLVED, *(rng.normal(size=15) for _ in range(3)))
        if i % 5 == 1:
            made.y[:], made.y_box[:] = np.nan, np.nan
        if i % 5 == 2:
            made = Solution.missing(15, 15, Status.PRIMAL_INFEASIBLE)
        cases.append((builder.emit(x, np.zeros(3), np.zeros(3)), made if i % 5 else optimum))
    one_by_one = [[*judged(builder, step, answer).values()] for step, answer in cases]
    for most in (7, 128):
        monkeypatch.setattr("dpbench.bench.judge.closed_loop.AT_ONCE", most)
        base = builder.problem(cases[0][0])
        evaluator = StepEvaluator(base, base, builder.scale)
        for step, answer in cases:
            evaluator.add(step, step, answer, evaluator.certify(step))
        np.testing.assert_array_equal(evaluator.evaluations(), one_by_one)
