"""Each scenario of the library shows what its paragraph says; the certified optimum steers."""

import copy
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, open_workspace, record_sequence, replay, run_closed_loop
from dpbench.bench.capability.frontier import CapabilityPlot
from dpbench.bench.judge.control_metrics import (
    compute_axis_limit_metrics,
    compute_control_metrics,
    compute_thruster_metrics,
)
from dpbench.bench.run.exact_loop import ExactLoop, rebuild_sequence, solve_loop_exactly
from dpbench.bench.run.formulation import QPBuilder
from dpbench.qp.referee.optimum import Optimum
from dpbench.scenario.controllers.controller import FIXED_MODEL
from dpbench.scenario.own_ship import DP_NUMBERS
from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.solvers.contract import Policy

pytestmark = pytest.mark.slow

NAMES = list_shipped_problem_names("scenarios")


@cache
def exact(name: str) -> ExactLoop:
    return solve_loop_exactly(load_scenario(name))


def measured(scenario: Scenario, loop: ExactLoop) -> dict[str, float]:
    builder = QPBuilder(scenario)
    u = scenario.controller.select_applied_commands(loop.tau, loop.thrust)
    of_ship = compute_control_metrics(scenario, loop.state, u, builder.reference, loop)
    if scenario.controller.commanded_thrusters is None:
        return of_ship | compute_axis_limit_metrics(scenario, loop.tau, builder.limits)
    return of_ship | compute_thruster_metrics(scenario, loop.thrust, builder.thruster_limits)


def metrics(name: str) -> dict[str, float]:
    return measured(load_scenario(name), exact(name))


def at_rate(found: dict[str, float]) -> float:
    """Share of the steps at a rate limit, the axis that has most of them."""
    return max(found[f"at_rate_{axis}"] for axis in ("surge", "sway", "yaw"))


def without_answer(loop: ExactLoop) -> int:
    return int(np.isnan(loop.z).any(axis=1).sum())


@pytest.mark.parametrize("name", NAMES)
def test_the_applied_force_obeys_the_limits_of_its_time(name: str) -> None:
    assert metrics(name)["limit_violations"] == 0


@pytest.mark.parametrize("name", [name for name in NAMES if name != "thruster_loss_hard"])
def test_every_step_has_a_certified_optimum(name: str) -> None:
    assert without_answer(exact(name)) == 0


@pytest.mark.parametrize(
    ("name", "share", "radius_m"),
    [("rough", (0.15, 0.30), (0.1, 0.3)), ("extreme", (0.4, 0.6), (1.5, 2.5))],
)
def test_sway_saturates(
    name: str, share: tuple[float, float], radius_m: tuple[float, float]
) -> None:
    """Sway is at its amplitude limit in a fifth (`rough`) or half (`extreme`) of the steps."""
    found = metrics(name)
    assert share[0] <= found["at_amplitude_sway"] <= share[1]
    assert radius_m[0] <= found["r_max_m"] <= radius_m[1]


def test_squall_meets_the_rate_then_the_amplitude_limit_and_the_ship_returns() -> None:
    """After 60 s sway moves at its rate limit, then it saturates; the drift is made good."""
    scenario, loop = load_scenario("squall"), exact("squall")
    tau = loop.tau[round(60.0 / scenario.sample_s) :, 1]
    rate = np.flatnonzero(np.abs(np.diff(tau)) >= scenario.problem.du_max[1] * (1 - 1e-9))
    full = np.flatnonzero(np.abs(tau) >= scenario.vessel.tau_max[1] * (1 - 1e-9))
    assert 0 < rate[0] < full[0]
    found = metrics("squall")
    assert found["r_max_m"] > 3.0
    assert np.hypot(*loop.state[-1, 3:5]) < 0.1


def test_move_arrives_after_rate_and_amplitude_limits_in_all_axes() -> None:
    """The ship ends within 5 cm and 0.1° of the new setpoint, 25 m and 30° away."""
    found, last = metrics("move"), exact("move").state[-1]
    assert min(found[f"at_rate_{axis}"] for axis in ("surge", "sway", "yaw")) > 0.02
    assert found["at_amplitude_sway"] > 0.02
    np.testing.assert_allclose(last[3:5], [20.0, 15.0], atol=0.05)
    np.testing.assert_allclose(np.degrees(last[5]), 30.0, atol=0.1)


def test_a_previewed_reference_filter_keeps_the_move_off_the_limits() -> None:
    """Filtered and previewed, the same move touches no limit and follows within 15 cm."""
    found, last = metrics("move_filtered"), exact("move_filtered").state[-1]
    assert at_rate(found) == 0
    assert found["r_max_m"] < 0.15
    np.testing.assert_allclose(last[3:5], [20.0, 15.0], atol=0.05)


def test_without_preview_the_ship_follows_later() -> None:
    scenario = replace(load_scenario("move_filtered"), preview=False)
    assert (
        measured(scenario, solve_loop_exactly(scenario))["r_rms_m"]
        > 2 * metrics("move_filtered")["r_rms_m"]
    )


def test_turn_needs_a_model_that_turns() -> None:
    """Re-linearised, the ship ends at 90° in its place; linearised once, it is lost."""
    loop, scenario = exact("turn"), load_scenario("turn")
    np.testing.assert_allclose(np.degrees(loop.state[-1, 5]), 90.0, atol=0.1)
    assert np.hypot(*loop.state[-1, 3:5]) < 0.1
    once = replace(scenario.controller, linearisation=FIXED_MODEL)
    fixed = solve_loop_exactly(replace(scenario, controller=once))
    assert np.hypot(fixed.state[-200:, 3], fixed.state[-200:, 4]).max() > 10.0


def test_the_cost_matrix_turns_with_the_ship_where_its_weights_are_unequal() -> None:
    """Every step of a turn brings P: the same one in `turn`, others in `turn_unequal`."""
    for name, same in (("turn", True), ("turn_unequal", False)):
        scenario = load_scenario(name)
        sequence = rebuild_sequence(scenario, exact(name), first=100, count=100)
        assert sequence.P is not None
        assert bool(np.ptp(sequence.P, axis=0).max() == 0) is same


@pytest.mark.parametrize(("policy", "taken_over"), [("fresh", 0), ("warm", 20)])
def test_matrix_updates_are_counted_by_who_takes_them_over(policy: Policy, taken_over: int) -> None:
    """A kept workspace takes over all 20 steps with new matrices, one set up anew none."""
    scenario = load_scenario("turn").truncate(20)
    workspace = open_workspace("daqp", route="native", policy=policy)
    found = run_closed_loop(scenario, workspace).summary
    assert found["matrix_steps"] == 20
    assert found["matrix_updates"] == taken_over


def test_wrap_takes_the_short_way() -> None:
    """From 175° to -175° the heading stays between 174° and 186°."""
    heading = np.degrees(exact("wrap").state[:, 5])
    assert heading.min() > 174.0
    assert heading.max() < 186.0
    np.testing.assert_allclose(heading[-1], 185.0, atol=0.1)


def test_a_lost_thruster_makes_hard_limits_infeasible_and_reachable_ones_not() -> None:
    lost = round(121.0 / 0.3)
    hard = np.isnan(exact("thruster_loss_hard").z).any(axis=1)
    assert hard.any()
    assert np.flatnonzero(hard)[0] == lost
    assert without_answer(exact("thruster_loss")) == 0
    assert without_answer(exact("thruster_loss_soft")) == 0


def test_after_the_loss_sway_stays_within_what_is_left() -> None:
    """Once the rate has brought it down, the sway force stays within 187.65 kN."""
    for name in ("thruster_loss", "thruster_loss_hard", "thruster_loss_soft"):
        tau = exact(name).tau[:, 1]
        assert np.abs(tau[: round(121.0 / 0.3)]).max() > 187.65e3
        assert np.abs(tau[-400:]).max() <= 187.65e3 * (1 + 1e-12)


def test_an_estimator_with_a_wave_filter_keeps_waves_out_of_the_limits() -> None:
    assert at_rate(metrics("waves")) < 0.02
    assert at_rate(metrics("waves_passive")) < 0.02
    assert at_rate(metrics("waves_unfiltered")) > 0.2
    for name in ("waves", "waves_passive", "waves_unfiltered"):
        assert metrics(name)["r_max_m"] < 1.0


def test_waves_in_a_controller_without_estimator_keep_the_rate_limits_active() -> None:
    scenario = load_scenario("waves")
    bare = replace(scenario, estimation=replace(scenario.estimation, waves=None))
    assert at_rate(measured(bare, solve_loop_exactly(bare))) > 0.6


def test_weather_is_held_within_a_quarter_of_a_metre() -> None:
    """Wind, current and drift of DP capability number 5 are within what the thrusters hold."""
    loop, found = exact("weather"), metrics("weather")
    assert found["r_max_m"] < 0.25
    # Against weather from the bow quarter the thrusters push ahead and to starboard.
    mean = loop.tau[1000:].mean(axis=0)
    assert mean[0] > 0
    assert mean[1] > 50e3


def test_a_ship_that_is_not_the_model_is_still_held() -> None:
    """With mass, damping, thrust and dead time off, the ship keeps within 15 cm."""
    assert metrics("mismatch")["r_max_m"] < 0.15
    matched = load_scenario("mismatch")
    matched = replace(matched, true_ship=matched.vessel, actuators=None)
    away = np.abs(solve_loop_exactly(matched).state - exact("mismatch").state)
    assert away[:, 3:5].max() > 1e-3


def test_three_forces_are_the_easier_problem_in_the_same_weather() -> None:
    """Ship, weather and horizons of `thrusters`; at most 13 active limits where that has 70."""
    forces, thrusters = (load_scenario(name) for name in ("three_forces", "thrusters"))
    assert forces.files["vessel"] == thrusters.files["vessel"]
    environments = [s.files["scenario"]["environment"] for s in (forces, thrusters)]
    assert environments[0] == environments[1]
    assert forces.problem.horizons_by_name == thrusters.problem.horizons_by_name
    most = [
        max(int((np.abs(np.r_[o.y, o.y_box]) > 1e-9).sum()) for o in exact(s.name).optima)
        for s in (forces, thrusters)
    ]
    assert most[0] <= 13 and most[1] >= 60
    assert 1.5 < metrics("three_forces")["r_max_m"] < 2.5


@pytest.mark.parametrize(("name", "number"), [("thrusters", 7), ("thrusters_loss", 6)])
def test_the_weather_on_thrusters_is_the_largest_that_level_1_holds(name: str, number: int) -> None:
    """After the loss of the scenario, if it has one; and the ship stays on station, within 5 m."""
    scenario = load_scenario(name)
    plot = CapabilityPlot(scenario.vessel)
    lost = [group for fault in scenario.files["scenario"]["faults"] for group in fault["lost"]]
    (case,) = (
        case for case in plot.intact_and_failure_cases if [case.name] == (lost or ["intact"])
    )
    tables = scenario.files["scenario"]["environment"]
    assert plot.find_wind_limit(case, np.radians(tables["wind"]["from_deg"])).number == number
    waves = tables["waves"]
    sea = (
        tables["wind"]["speed_mps"],
        waves["hs_m"],
        waves["tp_s"],
        tables["current"]["speed_mps"],
    )
    assert sea == DP_NUMBERS[number]
    assert metrics(name)["r_max_m"] < 5.0


def test_watch_circle_limits_the_speed_of_a_transfer() -> None:
    """Speed over ground stays near 0.15 m/s where it would be twice that without the bound."""
    scenario, loop = load_scenario("watch_circle"), exact("watch_circle")
    unbounded = replace(scenario.controller, outputs=None)
    free = solve_loop_exactly(replace(scenario, controller=unbounded))
    # Softened, and held at ten instants of the horizon only.
    assert top_speed(scenario, loop) < 0.17
    assert top_speed(scenario, free) > 0.3


def top_speed(scenario: Scenario, loop: ExactLoop) -> float:
    moved = np.diff(loop.state[:, 3:5], axis=0)
    return float(np.hypot(moved[:, 0], moved[:, 1]).max() / scenario.sample_s)


def test_no_answer_to_a_problem_that_has_none_is_no_failure() -> None:
    scenario = load_scenario("thruster_loss_hard").truncate(420)
    summary = run_closed_loop(scenario, open_workspace("daqp")).summary
    assert summary["infeasible_steps"] == summary["fallbacks"] == 3
    assert summary["failed_steps"] == 0
    assert summary["uncertified"] == 0
    assert summary["error_move_max"] < 1e-9


def test_a_cascade_holds_where_its_pseudo_inverse_does_not() -> None:
    scenario, loop = load_scenario("thrusters_cascade"), exact("thrusters_cascade")
    found = metrics("thrusters_cascade")
    assert 0.2 <= found["at_limit_thrusters"] <= 0.35
    assert loop.demand is not None
    missing = np.abs(loop.demand - loop.tau) / scenario.vessel.tau_max
    assert 0.07 <= (missing.max(axis=1) > 1e-3).mean() <= 0.15
    assert found["r_max_m"] < 0.3
    files = copy.deepcopy(scenario.files)
    files["scenario"]["controller"]["thrusters"]["allocation"] = "pseudo_inverse"
    clipped = build_scenario_from_documents(files)
    assert 5.0 < measured(clipped, solve_loop_exactly(clipped))["r_max_m"] < 7.0


def clipped(scenario: Scenario) -> pd.DataFrame:
    workspace = open_workspace("unconstrained_clipped")
    return run_closed_loop(scenario, workspace, formulation="none").steps


def radius(loop: ExactLoop) -> np.ndarray:
    return np.hypot(loop.state[:-1, 3], loop.state[:-1, 4])


@pytest.mark.parametrize(
    ("name", "late_s", "clipped_m"), [("paper", 55.0, 0.1), ("paper_tight", 150.0, 3.0)]
)
def test_the_constrained_law_beats_clipping(name: str, late_s: float, clipped_m: float) -> None:
    """The constrained law is within 0.1 m by 55 s; with R × 0.7 the clipped law leaves 3 m."""
    scenario, loop, baseline_law = load_scenario(name), exact(name), clipped(load_scenario(name))
    late = np.arange(scenario.steps) * scenario.sample_s >= late_s
    assert not scenario.reference.any() and radius(loop)[late].max() <= 0.1
    away = np.hypot(baseline_law["n_m"], baseline_law["e_m"]).to_numpy()
    assert away[late].max() > clipped_m
    assert -loop.state[:, 4].min() < -baseline_law["e_m"].min()


def test_calm_has_no_active_limit() -> None:
    """In `calm` both laws give the same force, because no limit is ever active."""
    scenario = load_scenario("calm")
    tau = clipped(scenario)[["tau_x_N", "tau_y_N", "tau_n_Nm"]].to_numpy()
    most = 1e-6 * scenario.problem.du_max.min()
    np.testing.assert_allclose(tau, exact("calm").tau, rtol=0, atol=most)


@pytest.mark.parametrize("solver", ["quadprog", "daqp", "paper_active_set"])
@pytest.mark.parametrize("name", ["paper", "rough"])
def test_exact_solvers_are_exact(solver: str, name: str) -> None:
    """quadprog, daqp and the paper's method keep error_move ≤ 1e-9 in scaled units, certified."""
    run = run_closed_loop(load_scenario(name), open_workspace(solver))
    assert (run.steps["optimum_bound"] <= 1e-9).all()
    assert (run.steps["error_move"] <= 1e-9).all()
    assert run.steps["claimed"].all() and run.steps["true_1e6"].all()
    assert run.summary["dev_position_max_m"] < 1e-6


SHORT, LONG = 7, 24
# Slow forces; gusts and waves; a Kalman filter and noise; an observer; a reference that moves; a
# model linearised, and thruster rows made, at each step; a second QP at each step.
KINDS = ["paper", "weather", "waves", "waves_passive", "move_filtered", "turn"]
KINDS += ["thrusters_turning", "thrusters_cascade"]


def assert_same(one: Optimum, other: Optimum) -> None:
    for part in fields(Optimum):
        np.testing.assert_array_equal(getattr(one, part.name), getattr(other, part.name))


@pytest.mark.parametrize("name", KINDS)
def test_a_shorter_exact_loop_is_the_beginning_of_a_longer_one(name: str) -> None:
    scenario = load_scenario(name)
    short, long = (solve_loop_exactly(scenario.truncate(steps)) for steps in (SHORT, LONG))
    states = len(short.state)
    assert (len(long.theta), len(short.theta), states) == (LONG, SHORT, SHORT + 1)
    np.testing.assert_array_equal(short.state, long.state[:states])
    for part in ("theta", "tau", "thrust", "z"):
        np.testing.assert_array_equal(getattr(short, part), getattr(long, part)[:SHORT])
    assert (short.demand is not None) == scenario.controller.allocates
    if short.demand is not None and long.demand is not None:
        np.testing.assert_array_equal(short.demand, long.demand[:SHORT])
    assert len(short.allocated) == (SHORT if long.allocated else 0)
    for optima, others in ((short.optima, long.optima), (short.allocated, long.allocated)):
        for one, other in zip(optima, others, strict=False):
            assert_same(one, other)


def test_the_first_step_of_a_loop_takes_the_iterations_of_its_replay() -> None:
    """Both set solvers up with q = 0; OSQP scales the cost by the q of its set-up."""
    scenario = load_scenario("paper").truncate(2)
    osqp = open_workspace("osqp", route="native", policy="reuse")
    loop = run_closed_loop(scenario, osqp)
    replayed = replay(record_sequence(scenario), osqp, repeats=1)
    first, again = (
        run.steps.loc[run.steps["k"] == 0, "iterations"].max() for run in (loop, replayed)
    )
    assert first == again > 1
