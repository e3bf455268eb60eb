"""On a slow computer answers come late, at the samples and with the forces worked out by hand."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from dpbench import load_scenario, open_workspace, run_closed_loop
from dpbench.bench.judge.evaluation import EVALUATION, evaluate_loop_log
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import ClosedLoopTable, SuiteFile
from dpbench.bench.record.cell import SLOWEST, Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.backup import FALLBACKS
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.run.slow_computer import ComputationalDelay, SlowComputer
from dpbench.errors import InputError
from dpbench.mpc.law import compute_state_feedback_gains
from dpbench.qp.solution import Status
from dpbench.scenario.controllers.controller import stack_lower_and_upper_limits
from dpbench.scenario.scenario import Scenario
from tests.bench.run.loops import SAMPLE_NS, Planned, run_loop, surge_steps


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("paper").truncate(24)


def run(
    scenario: Scenario,
    workspace: Planned,
    slowdown: float = 1.0,
    budget: float = 1.0,
    fallback: str = "shifted_plan",
    **given: Any,
) -> RawLog:
    """A loop whose latencies are those of the workspace times the slowdown, in samples."""
    delay = ComputationalDelay(slowdown, round(budget * SAMPLE_NS), SAMPLE_NS)
    clock = workspace.clock
    log, complete = run_loop(scenario, workspace, fallback, clock=clock, delay=delay, **given)
    assert complete
    return log


def asked(log: RawLog) -> list[int]:
    return np.flatnonzero(log.times[0, :, 3] >= 0).tolist()


def test_a_plan_three_samples_late_enters_at_its_fourth_move(scenario: Scenario) -> None:
    """The first answer takes 2.5 samples: nothing for three steps, then its force no. 4, no. 5.

    From 0 the rate limit lets the force reach 1.0, then 1.5, where the plan ends and stays. The
    answer to step 3 arrives at step 12; planned from 0 too, it ends at the same force.
    """
    workspace = Planned(lambda i: (2.5, 9.0, 1e6)[i])
    log = run(scenario, workspace)
    assert asked(log) == [0, 3, 12]
    found = surge_steps(log, scenario)
    assert found[:12] == [0.0, 0.0, 0.0, 1.0, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5, 1.5]
    assert found[12:] == [1.5] * 12
    # Demanded at step 3: all four moves at once, which the rate limit then cuts.
    demanded = log.command[3, 0] / scenario.problem.du_max[0]
    assert demanded == pytest.approx(0.5 + 0.4 + 0.3 + 0.2)


def test_within_the_rate_limit_a_late_plan_is_followed_move_by_move(scenario: Scenario) -> None:
    """Two answers in time, then one of 1.5 samples: worked out step by step.

    Step 0: 0.5. Step 1: 1.0, plan of forces 1.0, 1.4, 1.7, 1.9, 2.0. Step 2 asks and is late: 1.4;
    its plan from 1.0 is 1.5, 1.9, 2.2, 2.4, 2.5. Step 3, busy: 1.7. Step 4: that plan arrives two
    samples late, with force no. 3: 2.2; step 4's own answer is three samples late. Step 5: 2.4;
    step 6: 2.5; step 7: the plan of step 4, from 1.7: 2.2, 2.6, 2.9, 3.1, 3.2; force no. 4: 3.1.
    """
    workspace = Planned(lambda i: (0.1, 1.0, 1.5, 3.0, 1e6)[i])
    log = run(scenario, workspace)
    assert asked(log) == [0, 1, 2, 4, 7]
    wanted = [0.5, 1.0, 1.4, 1.7, 2.2, 2.4, 2.5, 3.1, 3.2, 3.2]
    assert surge_steps(log, scenario)[:10] == wanted
    # The fallback steers where no answer is in time and none arrives: not in 0, 1, 4 and 7.
    assert np.flatnonzero(log.flags[:10, 0] == 0).tolist() == [0, 1, 4, 7]


def test_hold_waits_with_the_force_it_has(scenario: Scenario) -> None:
    """Fallback `hold`: the same latencies, but between arrivals the force stays.

    Step 1 is at 1.0 and stays until step 4: the plan of step 2, from 1.0, with 1.5, 1.9, 2.2 at
    force no. 3, which is 1.2 away: one maximum increment. Then 2.0 stays until step 7: the plan of
    step 4, from 1.0: force no. 4, 2.4.
    """
    workspace = Planned(lambda i: (0.1, 1.0, 1.5, 3.0, 1e6)[i])
    log = run(scenario, workspace, fallback="hold")
    wanted = [0.5, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.4, 2.4]
    assert surge_steps(log, scenario)[:9] == wanted


def test_clip_steers_by_the_unconstrained_law_meanwhile(scenario: Scenario) -> None:
    """Fallback `clip` demands K_y y_d − K_mpc x (eq. 33) in every step without an answer."""
    log = run(scenario, Planned(lambda i: 1e6), fallback="clip")
    law = compute_state_feedback_gains(scenario.problem)
    demanded = log.theta[:, 9:12] @ law.K_y.T - log.theta[:, :9] @ law.K_mpc.T
    np.testing.assert_allclose(
        log.command - log.theta[:, 12:15],
        demanded,
        rtol=0,
        atol=1e-6 * scenario.problem.du_max.max(),
    )


def test_an_answer_in_time_supersedes_the_late_one_that_arrives_with_it(scenario: Scenario) -> None:
    """Step 0 takes 1.5 samples and arrives at 2, where the own answer is in time: 0 + 0.5."""
    log = run(scenario, Planned(lambda i: (1.5, 0.5, 1e6)[i]))
    assert surge_steps(log, scenario)[:7] == [0.0, 0.0, 0.5, 0.9, 1.2, 1.4, 1.5]


@pytest.mark.parametrize(
    ("samples", "budget", "second"),
    [(1.0, 1.0, 1), (1.0, 0.5, 1), (1.01, 1.0, 2), (2.0, 1.0, 2), (0.5, 0.4, 1), (0.4, 0.4, 1)],
)
def test_arrival_instants(scenario: Scenario, samples: float, budget: float, second: int) -> None:
    log = run(scenario, Planned(lambda i: (samples, 1e6)[i]), budget=budget)
    assert asked(log) == [0, second]
    assert (surge_steps(log, scenario)[0] == 0.5) == (samples <= budget)


def test_nothing_arrives_and_the_fallback_steers_alone(scenario: Scenario) -> None:
    log = run(scenario, Planned(lambda i: 1.0), slowdown=SLOWEST)
    assert asked(log) == [0]
    assert not log.tau.any() and log.flags[:, 0].all()
    assert int(log.done[0]) == 24


def test_a_failed_solve_keeps_the_processor_and_brings_nothing(scenario: Scenario) -> None:
    workspace = Planned(lambda i: 2.0, Status.PRIMAL_INFEASIBLE)
    log = run(scenario, workspace)
    assert asked(log) == list(range(0, 24, 2))
    assert not log.tau.any() and log.flags[:, 0].all()
    assert workspace.resets == 12 + 1, "once after the warm-up, once per failure"


@settings(derandomize=True, max_examples=25, deadline=None)
@given(
    latencies=st.lists(st.floats(0.0, 8.0), min_size=24, max_size=24),
    moves=st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=5),
    fallback=st.sampled_from(sorted(FALLBACKS)),
)
def test_one_processor_and_no_limit_violated(
    scenario: Scenario, latencies: list[float], moves: list[float], fallback: str
) -> None:
    log = run(scenario, Planned(latencies.__getitem__, plan=moves), fallback=fallback)
    began = np.array(asked(log))
    took = np.maximum(1, np.ceil(np.round(np.array(latencies) * SAMPLE_NS) / SAMPLE_NS))
    np.testing.assert_array_equal(np.diff(began), took[: len(began) - 1])
    low, high = stack_lower_and_upper_limits(
        scenario.controller.list_planned_force_limits_by_sample(24)
    )
    change = np.diff(log.tau, axis=0, prepend=np.zeros((1, 3)))
    assert (np.abs(change) <= scenario.problem.du_max + np.spacing(scenario.vessel.tau_max)).all()
    assert (log.tau <= high).all() and (log.tau >= low).all()


@pytest.mark.slow
def test_fast_enough_is_the_ordinary_loop_bit_for_bit() -> None:
    scenario = load_scenario("thruster_loss_hard").truncate(450)
    plain = run_closed_loop(scenario, open_workspace("quadprog"))
    timed = {name for name in plain.steps if name.endswith("_ns")} | {"late"}
    # A budget of 0.3 s at a slowdown of 1: some 10 000 times what a step takes.
    slow = run_closed_loop(scenario, open_workspace("quadprog"), slowdown=1.0)
    same = [name for name in plain.steps if name not in timed]
    pd.testing.assert_frame_equal(plain.steps[same], slow.steps[same], check_exact=True)
    assert plain.steps["latency_ns"].isna().all()
    # What others took of the machine is no latency, and nothing else is left out of it.
    assert (slow.steps["latency_ns"] <= slow.steps["total_ns"]).all()
    shorter = (slow.steps["latency_ns"] < slow.steps["total_ns"]).sum()
    assert slow.summary["interrupted"] == shorter


def test_the_records_of_a_loop_on_a_hopeless_computer() -> None:
    scenario = load_scenario("paper").truncate(30)
    run = run_closed_loop(scenario, open_workspace("quadprog"), slowdown=SLOWEST)
    steps, summary = run.steps, run.summary
    assert steps["late"].all() and steps["fallback"].all()
    assert steps["total_ns"].notna().tolist() == [True] + [False] * 29
    assert steps["status"].tolist() == ["SOLVED"] + [""] * 29
    for name in ("emit_ns", "total_ns", "solve_ns", "latency_ns"):
        assert steps[name].iloc[1:].isna().all(), name
    assert (summary["deadline_misses"], summary["longest_miss_streak"]) == (30, 30)
    assert summary["computations"] == 1 and pd.isna(summary["miss_recover_steps_max"])
    assert summary["failed_steps"] == 0 and summary["true_share"] == 1.0
    assert summary["uncertified"] == 0 and summary["limit_violations"] == 0
    # The ship drifts without a force: the paper's disturbance moves it, at no change of force.
    assert not steps[["tau_x_N", "tau_y_N", "tau_n_Nm"]].to_numpy().any()
    assert summary["closed_loop_cost"] > summary["exact_cost"] > 0


def test_the_exact_loop_costs_what_the_exact_solver_pays() -> None:
    """`exact_cost` is the cost of a loop steered by answers that are right to 1e-12."""
    run = run_closed_loop(load_scenario("paper").truncate(60), open_workspace("quadprog"))
    assert run.summary["exact_cost"] == pytest.approx(run.summary["closed_loop_cost"], rel=1e-9)


@pytest.mark.parametrize(
    ("key", "value"),
    [("slowdown", 0.5), ("slowdown", -1.0), ("slowdown", 2 * SLOWEST), ("deadline_s", 0.4)],
)
def test_a_pace_that_cannot_be_is_refused_in_one_line(key: str, value: float) -> None:
    delay = {key: value}
    with pytest.raises(InputError, match=key):
        run_closed_loop(load_scenario("paper").truncate(3), open_workspace("quadprog"), **delay)


def test_slowdowns_are_an_axis_of_a_suite_and_leave_other_cells_alone() -> None:
    table = ClosedLoopTable(scenarios=["paper"], slowdowns=[0, 1, 100], deadline_s=0.1, steps=9)
    plain = ClosedLoopTable(scenarios=["paper"], steps=9)
    suite = SuiteFile(title="x", solvers=["daqp"], baseline_law=False, closed_loop=[table, plain])
    cells = [planned.cell for planned in plan_suite(suite)]
    assert [cell.slowdown for cell in cells] == [0.0, 1.0, 100.0, 0.0]
    assert [cell.deadline_s for cell in cells] == [0.1, 0.1, 0.1, 0.0]
    assert all(Cell.from_json(cell.to_json()) == cell for cell in cells)
    assert not {"slowdown", "deadline_s"} & set(cells[3].to_json().replace('"', " ").split())
    late = ClosedLoopTable(scenarios=["paper"], deadline_s=0.4)
    with pytest.raises(InputError, match="deadline_s"):
        plan_suite(SuiteFile(title="x", solvers=["daqp"], baseline_law=False, closed_loop=[late]))


def test_ordinary_loops_do_without_it(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SlowComputer, "__init__", None)
    assert not run_closed_loop(scenario, open_workspace("quadprog")).steps["late"].any()


def test_time_that_others_took_is_no_latency(scenario: Scenario) -> None:
    """A computation of 5 samples, interrupted, with 0.5 of processor time is in time.

    The next one, as long and not interrupted, is late whatever its processor time; the third is
    interrupted too, but its processor time is no less.
    """
    workspace = Planned(lambda i: 5.0)
    looks = iter([(0, 0.0), (1, 0.5), (1, 0.5), (1, 0.6), (1, 0.6), (2, 9.6), (2, 9.6), (2, 9.6)])

    def usage() -> tuple[int, int]:
        switches, used = next(looks)
        return switches, round(used * SAMPLE_NS)

    log = run(scenario.truncate(12), workspace, usage=usage)
    assert asked(log) == [0, 1, 6, 11]
    assert log.latency_ns[[0, 1, 6]].tolist() == [SAMPLE_NS // 2, 5 * SAMPLE_NS, 5 * SAMPLE_NS]
    assert (np.delete(log.latency_ns, [0, 1, 6, 11]) == -1).all()


def test_a_model_that_turns_is_judged_on_the_steps_that_were_computed() -> None:
    """Re-linearised QPs, every other one skipped: the referee rebuilds the same ones from θ.

    The answers are right, so an optimum of any other QP would show as an error.
    """
    scenario = load_scenario("turn").truncate(150)
    # Set-up, solve and read take half a sample each: an answer takes one and a half.
    ticks = iter(range(0, 10**12, SAMPLE_NS // 2))
    delay = ComputationalDelay(1.0, SAMPLE_NS, SAMPLE_NS)
    log, complete = run_loop(
        scenario, open_workspace("quadprog"), clock=lambda: next(ticks), delay=delay
    )
    assert complete
    began = asked(log)
    assert began == list(range(0, 150, 2))
    cell = Cell(
        "closed_loop", scenario.files, "quadprog", "qpsolvers", "fresh", "", 150, slowdown=1.0
    )
    evaluated = evaluate_loop_log(cell, log, solve_loop_exactly(scenario))
    move = evaluated.columns["evaluations"][:, EVALUATION.index("error_move")]
    assert (move[began] < 1e-9).all() and np.isnan(np.delete(move, began)).all()
    assert evaluated.metrics["matrix_steps"] > 1
