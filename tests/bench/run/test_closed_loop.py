"""The closed loop does what docs/method.md says of control, whatever the solver does."""

import copy
import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench import load_scenario
from dpbench.bench.record.cell import DEFAULT_FALLBACK
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.backup import FALLBACKS
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.run.timed_solver import RunDelay
from dpbench.errors import CertificateError
from dpbench.mpc.law import UnconstrainedLaw, compute_state_feedback_gains
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import Referee
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, condense
from dpbench.solvers.contract import Workspace
from tests.bench.run.loops import run_loop

Answer = Callable[[int, QPStep], Solution]


class Scripted(Workspace):
    def __init__(self, answer: Answer) -> None:
        super().__init__("scripted", "native", "reuse")
        self.answer, self.k, self.resets = answer, -1, 0
        self.step: QPStep | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        self.k = -1

    def update(self, step: QPStep) -> None:
        self.k, self.step = self.k + 1, step

    def solve(self) -> None:
        pass

    def read(self) -> Solution:
        assert self.step is not None
        return self.answer(self.k, self.step)

    def reset(self) -> None:
        self.resets += 1


def run(
    scenario: Scenario, answer: Answer, fallback: str = "shifted_plan", limit_ns: int = 2**62
) -> tuple[RawLog, Scripted, bool]:
    workspace = Scripted(answer)
    log, complete = run_loop(scenario, workspace, fallback, limit_ns=limit_ns)
    return log, workspace, complete


def constant(value: float) -> Answer:
    return lambda k, step: Solution(Status.SOLVED, np.full(15, value), np.zeros(15), np.zeros(15))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("paper").truncate(40)


def test_first_step_sees_no_motion_and_no_force(scenario: Scenario) -> None:
    """At k = 0 the increments Δx_m and the force u(−1) are zero and y is the start."""
    log, _, _ = run(scenario, constant(0.0))
    np.testing.assert_array_equal(log.theta[0, :6], 0.0)
    np.testing.assert_array_equal(log.theta[0, 6:9], [1.2, 1.3, 0.0])
    np.testing.assert_array_equal(log.theta[0, 12:15], 0.0)


def test_a_ship_under_way_is_carried_on(scenario: Scenario) -> None:
    velocity = np.array([0.8, 0.0, 0.0])
    still = replace(scenario.environment, amplitude=np.zeros(3))
    moving = replace(scenario, velocity=velocity, environment=still)
    log, _, _ = run(moving, constant(0.0))
    ship = moving.vessel
    t_s, rate = 0.3 * np.arange(41), ship.D[0, 0] / ship.M[0, 0]
    np.testing.assert_allclose(log.state[:, 0], 0.8 * np.exp(-rate * t_s), rtol=1e-9)
    ahead = 1.2 + 0.8 * (1.0 - np.exp(-rate * t_s)) / rate
    np.testing.assert_allclose(log.state[:, 3], ahead, rtol=1e-9)
    np.testing.assert_array_equal(log.state[:, [1, 2, 5]], 0.0)
    np.testing.assert_array_equal(log.theta[0, :6], 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["measured", "kalman", "passive"])
def test_an_estimator_knows_how_the_ship_starts(scenario: Scenario, kind: str) -> None:
    files = copy.deepcopy(scenario.files)
    files["scenario"]["start"] |= {"surge_mps": 0.8, "sway_mps": -0.3, "yaw_degps": 0.5}
    files["scenario"]["estimator"] |= {"kind": kind, "peak_period_s": 8.0}
    moving = build_scenario_from_documents(files)
    truth = np.array([0.8, -0.3, np.radians(0.5), 1.2, 1.3, 0.0])
    np.testing.assert_allclose(
        moving.estimator().update_and_return_state(truth, np.zeros(3)), truth, atol=1e-12
    )


def test_increments_are_differences_of_the_measured_state(scenario: Scenario) -> None:
    """Δx_m(k) is x_m(k) − x_m(k−1) and y is the pose at t_k."""
    log, _, _ = run(scenario, constant(0.3))
    np.testing.assert_array_equal(log.theta[1:, :6], np.diff(log.state[:40], axis=0))
    np.testing.assert_array_equal(log.theta[:, 6:9], log.state[:40, 3:])


def test_u_prev_is_the_force_applied_after_clipping(scenario: Scenario) -> None:
    log, _, _ = run(scenario, constant(7.0))
    np.testing.assert_array_equal(log.theta[1:, 12:15], log.tau[:-1])
    assert log.flags[:, 2].all(), "every step was clipped"
    np.testing.assert_allclose(
        np.diff(log.tau[:20], axis=0)[0], scenario.problem.du_max, rtol=1e-12
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, -5.0])
def test_no_answer_violates_a_limit(scenario: Scenario, bad: float) -> None:
    rng = np.random.default_rng(1)

    def answer(k: int, step: QPStep) -> Solution:
        z = rng.normal(scale=50.0, size=15)
        z[k % 15] = bad
        return Solution(Status.SOLVED, z, np.zeros(15), np.zeros(15))

    log, _, _ = run(scenario, answer)
    ship = scenario.vessel
    assert (log.tau <= ship.tau_max).all() and (log.tau >= ship.tau_min).all()
    change = np.diff(log.tau, axis=0, prepend=np.zeros((1, 3)))
    assert (np.abs(change) <= scenario.problem.du_max + np.spacing(ship.tau_max)).all()
    assert np.isfinite(log.state).all()


def failing_from(first: int, status: Status = Status.PRIMAL_INFEASIBLE) -> Answer:
    """A falling plan up to step `first`, no answer from there on."""
    plan = np.repeat([0.5, 0.4, 0.3, 0.2, 0.1], 3)

    def answer(k: int, step: QPStep) -> Solution:
        if k < first:
            return Solution(Status.SOLVED, plan, np.zeros(15), np.zeros(15))
        return Solution.without_point(15, 15, status)

    return answer


def test_shifted_plan_follows_the_last_plan_then_holds(scenario: Scenario) -> None:
    log, workspace, _ = run(scenario, failing_from(3))
    moves = np.diff(log.tau, axis=0, prepend=np.zeros((1, 3))) / scenario.problem.du_max
    np.testing.assert_allclose(moves[2:9, 0], [0.5, 0.4, 0.3, 0.2, 0.1, 0.0, 0.0], atol=1e-9)
    assert log.flags[:, 0].tolist() == [0] * 3 + [1] * 37
    assert workspace.resets == 37, "the workspace is reset after every unusable answer"


def test_a_step_without_certificate(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop has its table although a step has no certificate; its QPs are not published."""
    certify, count = Referee.certify_vectors, itertools.count()

    def fail_at_five(referee: Referee, *vectors: Any) -> Optimum:
        optimum = certify(referee, *vectors)
        if next(count) != 5:
            return optimum
        n, m = len(optimum.z), len(optimum.y)
        return Optimum(*(np.full(size, np.nan) for size in (n, m, n)), np.inf, "none", "no proof")

    monkeypatch.setattr(Referee, "certify_vectors", fail_at_five)
    exact = solve_loop_exactly(scenario.truncate(8))
    assert [optimum.kind == "none" for optimum in exact.optima] == [k == 5 for k in range(8)]
    du_max = scenario.problem.du_max
    np.testing.assert_allclose(
        (exact.tau[5] - exact.tau[4]) / du_max, exact.optima[4].z[3:6], atol=1e-12
    )
    with pytest.raises(CertificateError, match="step 5 has no certified optimum: no proof"):
        exact.require_certificates(scenario.name)


def test_hold_keeps_the_force(scenario: Scenario) -> None:
    log, _, _ = run(scenario, failing_from(3), "hold")
    np.testing.assert_array_equal(log.tau[3:], np.tile(log.tau[2], (37, 1)))


def test_clip_is_the_unconstrained_law(scenario: Scenario) -> None:
    """Fallback `clip` demands K_y y_d − K_mpc x (eq. 33) and the loop clips it."""
    log, _, _ = run(scenario, failing_from(0), "clip")
    law = compute_state_feedback_gains(scenario.problem)
    demanded = log.theta[:, 9:12] @ law.K_y.T - log.theta[:, :9] @ law.K_mpc.T
    np.testing.assert_allclose(
        log.command - log.theta[:, 12:15],
        demanded,
        rtol=0,
        atol=1e-6 * scenario.problem.du_max.max(),
    )


@pytest.mark.parametrize(
    ("status", "is_applied"),
    [
        *((status, True) for status in (Status.MAX_ITERATIONS, Status.INACCURATE)),
        (Status.TIME_LIMIT, True),
        *((status, False) for status in (Status.PRIMAL_INFEASIBLE, Status.DUAL_INFEASIBLE)),
        (Status.ERROR, False),
    ],
)
def test_which_answers_are_applied(scenario: Scenario, status: Status, is_applied: bool) -> None:
    """The first moves the ship and is `unconverged`; instead of the second the fallback acts."""
    answer = Solution(status, np.full(15, 0.25), np.zeros(15), np.zeros(15))
    log, _, _ = run(scenario, lambda k, step: answer)
    assert (log.flags[:, 1] == is_applied).all() and (log.flags[:, 0] != is_applied).all()
    first = 0.25 * scenario.problem.du_max if is_applied else np.zeros(3)
    np.testing.assert_allclose(log.tau[0], first, rtol=1e-12)
    assert is_applied or not log.tau.any()


def test_an_adapter_that_raises_is_a_row(scenario: Scenario) -> None:
    def answer(k: int, step: QPStep) -> Solution:
        if k % 2:
            raise ArithmeticError("the library blew up")
        return Solution(Status.SOLVED, np.zeros(15), np.zeros(15), np.zeros(15))

    log, _, complete = run(scenario, answer)
    assert complete and int(log.done[0]) == 40
    assert log.status[0].tolist() == [Status.SOLVED, Status.ERROR] * 20
    assert np.isnan(log.z[0, 1]).all()


def test_the_time_limit_keeps_the_steps(scenario: Scenario) -> None:
    def slow(k: int, step: QPStep) -> Solution:
        time.sleep(0.01)
        return Solution(Status.SOLVED, np.zeros(15), np.zeros(15), np.zeros(15))

    log, _, complete = run(scenario, slow, limit_ns=50_000_000)
    assert not complete
    assert 1 <= int(log.done[0]) < 40


@pytest.mark.slow
def test_waits_for_the_core_end_no_run(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    def slow(k: int, step: QPStep) -> Solution:
        time.sleep(0.01)
        return Solution(Status.SOLVED, np.zeros(15), np.zeros(15), np.zeros(15))

    def waited_ns(self: RunDelay) -> int:
        return round(0.99 * time.perf_counter_ns())

    # As if nearly all of that were a wait.
    monkeypatch.setattr(RunDelay, "read_total_ns", waited_ns)
    assert run(scenario, slow, limit_ns=50_000_000)[2]


def test_fallback_without_a_plan_holds(scenario: Scenario) -> None:
    law = FALLBACKS[DEFAULT_FALLBACK](15, 3, UnconstrainedLaw(condense(scenario)))
    np.testing.assert_array_equal(law.move(np.zeros(9), np.zeros(3), np.zeros(3)), np.zeros(3))
