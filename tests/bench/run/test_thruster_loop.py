"""Closed loops that steer thrusters: against a loop written out here, limits of what is applied,
lost thrusters, and what slow thrusters give."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from qpsolvers import solve_qp

from dpbench.bench.record.cell import Formulation
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.backup import FALLBACKS
from dpbench.bench.run.exact_loop import ExactLoop, solve_loop_exactly
from dpbench.mpc.thruster_rows import RAMP_DOWN_SHARE
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, load_scenario
from dpbench.ship.actuators import Actuators, CommandedThrusters
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from dpbench.solvers.open import open_workspace
from tests.bench.run.loops import limit_violations, run_loop

AFT = {"kind": "azimuth", "x_m": -32.0, "thrust_kN": 190.0, "rise_s": 8.0}
THRUSTERS: list[dict[str, Any]] = [
    AFT | {"name": "port", "y_m": -5.0},
    AFT | {"name": "starb", "y_m": 5.0},
    {"name": "bow", "kind": "azimuth", "x_m": 26.0, "thrust_kN": 140.0, "rise_s": 6.0},
    {"name": "tunnel", "kind": "tunnel", "x_m": 30.0, "thrust_kN": 110.0, "rise_s": 5.0},
]


def scenario(steps: int = 60, **changes: Any) -> Scenario:
    """The paper's ship with four thrusters, thrown 2 m and 5° off in a sea; tables changed."""
    plain = load_scenario("rough").files
    vessel = plain["vessel"] | {"thrusters": THRUSTERS}
    own = plain["scenario"] | {"duration_s": 0.3 * steps}
    own["start"] = {"north_m": 2.0, "east_m": -1.0, "heading_deg": 5.0}
    own["controller"] = {
        "tuning": "thrusters",
        "kind": "thrusters",
        "prediction_horizon": 30,
        "control_horizon": 3,
        "output_weight": [1.0, 1.0, 3000.0],
        "thrusters": {
            "polygon_sides": 8,
            "thrust_weight_relative": 1e-3,
            "move_weight_relative": 0.1,
        },
    } | changes.pop("controller", {})
    return build_scenario_from_documents(
        plain | {"scenario": own | changes, "vessel": vessel, "name": "thrusters"}
    )


def steered_by(solver: str, case: Scenario, formulation: Formulation = "condensed_box") -> RawLog:
    """The log of a closed loop with a solver, without an answer the plan before."""
    policy = "warm" if solver in ("daqp", "paper_active_set") else "reuse"
    workspace = open_workspace(solver, route="native", policy=policy, settings="high")
    log, complete = run_loop(case, workspace, formulation=formulation)
    assert complete
    return log


@pytest.fixture(scope="module")
def case() -> Scenario:
    return scenario()


@pytest.fixture(scope="module")
def exact(case: Scenario) -> ExactLoop:
    return solve_loop_exactly(case)


def test_the_loop_is_the_one_written_out_here(case: Scenario, exact: ExactLoop) -> None:
    control, plain = case.problem, load_scenario("rough")
    assert case.controller.commanded_thrusters is not None
    T_e, G = (
        case.controller.commanded_thrusters.thrusters.T_e,
        case.controller.commanded_thrusters.rows.G,
    )
    model, du, n_f, N_c = control.model, control.du_max, 7, 3
    plant = ShipPlant(case.true_ship, case.first_state, case.sample_s)
    sea = plain.environment.build_weather_table_at_stages(case.steps, case.sample_s, SUBSTEPS)
    f, previous = np.zeros(n_f), case.first_state
    for k in range(12):
        x = np.concatenate([plant.state - previous, plant.state[3:]])
        previous = plant.state.copy()
        H, g = np.zeros((N_c * n_f, N_c * n_f)), np.zeros(N_c * n_f)
        for i in range(1, control.N_p + 1):
            effect = np.hstack(
                [
                    model.C @ np.linalg.matrix_power(model.A, i - 1 - j) @ model.B * du
                    if j < i
                    else np.zeros((3, n_f))
                    for j in range(N_c)
                ]
            )
            free = model.C @ np.linalg.matrix_power(model.A, i) @ x - case.reference
            H += effect.T @ case.problem.Q @ effect
            g += effect.T @ case.problem.Q @ free
        sums = np.kron(np.tri(N_c), np.eye(n_f)) * np.tile(du, N_c)
        W = np.kron(np.eye(N_c), case.controller.commanded_thrusters.W)
        H += np.diag(np.tile(np.diag(case.problem.R) * du**2, N_c)) + sums.T @ W @ sums
        g += sums.T @ W @ np.tile(f, N_c)
        rows, base = np.kron(np.eye(N_c), G) @ sums / 1e3, np.tile(G @ f, N_c) / 1e3
        high, low = (np.tile(side, N_c) / 1e3 - base for side in (control.u_max, control.u_min))
        one = np.ones(N_c * n_f)
        z = solve_qp(
            H, g, np.vstack([rows, -rows]), np.r_[high, -low], lb=-one, ub=one, solver="quadprog"
        )
        f = f + z[:n_f] * du
        np.testing.assert_allclose(exact.thrust[k], f, atol=1e-4)
        np.testing.assert_allclose(exact.tau[k], T_e @ f, atol=1e-2)
        plant.advance_by_one_sample(T_e @ f, sea[k])
        np.testing.assert_allclose(exact.state[k + 1], plant.state, atol=1e-10)


@pytest.mark.parametrize(
    ("solver", "formulation"),
    [
        ("daqp", "condensed_box"),
        ("paper_active_set", "condensed_box"),
        ("quadprog", "condensed_stacked"),
        pytest.param("piqp", "sparse", marks=pytest.mark.slow),
    ],
)
def test_every_form_steers_as_the_exact_loop_does(
    case: Scenario, exact: ExactLoop, solver: str, formulation: Formulation
) -> None:
    log = steered_by(solver, case, formulation)
    away = np.abs(log.state - exact.state).max(axis=0)
    assert (away <= [1e-6, 1e-6, 1e-8, 1e-5, 1e-5, 1e-7]).all(), away
    assert limit_violations(case, log) == 0.0
    np.testing.assert_allclose(
        log.tau, case.controller.convert_commands_to_ship_force(log.thrust), rtol=1e-12
    )


def test_a_lost_group_gives_nothing_as_soon_as_its_rate_allows(case: Scenario) -> None:
    """Port azimuth and tunnel lost at 6 s."""
    lost = scenario(80, faults=[{"at_s": 6.0, "lost": ["port", "tunnel"]}])
    log = steered_by("daqp", lost)
    assert not log.flags.any()
    assert limit_violations(lost, log) == 0.0
    gone = 20 + math.ceil(8.0 / 0.3 / RAMP_DOWN_SHARE) + 1
    assert np.abs(log.thrust[gone:, [0, 1, 6]]).max() < 1e-6
    assert np.abs(log.thrust[19, [0, 1]]).max() > 1e4
    assert np.abs(log.thrust[gone:, 2:6]).max() > 1e4


def test_a_tripped_group_gives_nothing_at_once(case: Scenario) -> None:
    """Port azimuth and tunnel trip at 6 s: their force and what the QP starts from are zero."""
    fault = {"at_s": 6.0, "lost": ["port", "tunnel"]}
    tripped = scenario(40, faults=[fault | {"loss": "trip"}])
    log = steered_by("daqp", tripped)
    assert not log.flags.any()
    assert limit_violations(tripped, log) == 0.0
    ramped = steered_by("daqp", scenario(40, faults=[fault]))
    np.testing.assert_array_equal(log.state[:21], ramped.state[:21])
    np.testing.assert_allclose(log.thrust[20:, [0, 1, 6]], 0.0, atol=1e-6)
    u_prev = tripped.problem.model.theta.u_prev
    np.testing.assert_array_equal(log.theta[20, u_prev][[0, 1, 6]], 0.0)
    np.testing.assert_array_equal(log.theta[20, u_prev][2:6], log.thrust[19, 2:6])
    # What the hull feels in that sample is the force of the other thrusters alone.
    assert tripped.controller.commanded_thrusters is not None
    T_e = tripped.controller.commanded_thrusters.thrusters.T_e
    np.testing.assert_allclose(log.tau[20], T_e[:, 2:6] @ log.thrust[20, 2:6], atol=1e-3)
    away = [np.abs(run.state[21:, 3:5]).max() for run in (log, ramped)]
    assert away[0] != away[1]


def test_a_tripped_thruster_loses_what_is_under_way() -> None:
    """Neither commands delayed by two samples nor the lag's remainder reach the hull any more."""
    trips = ((4, SHIP.find_force_entries_of_thrusters({0, 3})),)
    plain, tripping = (
        CommandedThrusters(
            SHIP, 0.5, 2.0, Actuators(delay_samples=2), trips=given
        ).make_state_at_rest()
        for given in ((), trips)
    )
    goal = np.array([3e3, 4e3, 1e3, 0.0, 5e3, 0.0, 2e3])
    for k in range(8):
        whole, tau = (
            plain.force_on_hull_for_command(goal).copy(),
            tripping.force_on_hull_for_command(goal),
        )
        if k < 4:
            np.testing.assert_array_equal(tau, whole)
            continue
        assert not tripping.f[[0, 1, 6]].any()
        np.testing.assert_array_equal(tripping.f[2:6], plain.f[2:6])
        lost = SHIP.T_e[:, [0, 1, 6]]
        assert np.abs(tau - whole).max() > 0.1 * np.abs(lost @ plain.f[[0, 1, 6]]).max()


@pytest.mark.parametrize("fallback", FALLBACKS)
def test_without_answers_the_fallback_keeps_to_all_limits(fallback: str) -> None:
    case = scenario(30)
    tight = {"iter_limit": 1, "primal_tol": 1e-9}
    workspace = open_workspace("daqp", route="native", policy="warm", settings=tight)
    log, complete = run_loop(case, workspace, fallback)
    assert complete
    assert log.flags[:, 0].any() or log.flags[:, 1].any()
    assert limit_violations(case, log) == 0.0


COMMANDED = scenario().controller.commanded_thrusters
assert COMMANDED is not None
SHIP, ROWS = COMMANDED.thrusters, COMMANDED.rows
STEP = SHIP.largest_force_changes_per_sample(0.3)
LIMIT = scenario().controller.make_increment_limiter()


@pytest.mark.slow
@settings(derandomize=True, max_examples=200)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7),
    st.lists(st.floats(-5.0, 5.0), min_size=7, max_size=7),
    st.sets(st.integers(0, 3)),
)
def test_applied_forces_keep_limits(share: list[float], moves: list[float], lost: set[int]) -> None:
    f = np.array(share) * SHIP.repeat_for_each_force_entry(SHIP.largest_thrusts_N)
    f /= max(1.0, float((np.abs(ROWS.G @ f) / ROWS.high).max()))
    limits = low, high, _ = ROWS.limits_after_loss_of_thrusters(lost)
    df, applied = np.array(moves) * STEP, np.empty(7)
    clipped = LIMIT(f, df, limits, applied)
    assert (np.abs(applied - f) <= STEP * (1 + 1e-9)).all()
    before, after = ROWS.G @ f, ROWS.G @ applied
    # The polygon of a lost thruster never grows again: the share of it that holds the force.
    gauge = np.array([(np.abs(before) / ROWS.high)[ROWS.thruster == i].max() for i in range(4)])
    assert (after <= np.maximum(high, gauge[ROWS.thruster] * ROWS.high) + 1e-4).all()
    assert (after >= np.minimum(low, gauge[ROWS.thruster] * ROWS.low) - 1e-4).all()
    wanted = ROWS.G @ (f + df)
    good = (np.abs(df) <= STEP).all() and (wanted <= high).all() and (wanted >= low).all()
    if good:
        assert not clipped
        np.testing.assert_allclose(applied, f + df, atol=1e-6)


def test_slow_thrusters_follow_with_their_lag_and_never_leave_their_circles() -> None:
    lag_s, sample_s = 2.0, 0.5
    thrusters = CommandedThrusters(SHIP, sample_s, lag_s, Actuators()).make_state_at_rest()
    goal = np.array([3e3, 4e3, 0.0, 0.0, 0.0, 0.0, 2e3])
    for k in range(1, 9):
        tau = thrusters.force_on_hull_for_command(goal)
        t = k * sample_s
        np.testing.assert_allclose(thrusters.f, goal * (1 - math.exp(-t / lag_s)), rtol=1e-12)
        decay = lag_s / sample_s * (math.exp(sample_s / lag_s) - 1) * math.exp(-t / lag_s)
        np.testing.assert_allclose(tau, SHIP.T_e @ (goal * (1 - decay)), rtol=1e-9, atol=1e-6)
    for _ in range(100):
        thrusters.force_on_hull_for_command(np.full(7, 1e6))
    assert (
        SHIP.thruster_force_magnitudes(thrusters.f)[:3] <= SHIP.largest_thrusts_N[:3] * (1 + 1e-12)
    ).all()
    assert SHIP.thruster_force_magnitudes(thrusters.f)[0] > 0.99 * SHIP.largest_thrusts_N[0]


def test_a_lag_makes_a_thruster_late_and_not_slower() -> None:
    """Towards full thrust it runs one lag behind the ramp of its rise time.

    A staircase of steps Δf stays ahead of its lag by Δf/(exp(Δt/T) − 1) · (1 − exp(−t/T)), the sum
    of a geometric series.
    """
    lag_s, sample_s = 2.0, 0.5
    thrusters = CommandedThrusters(SHIP, sample_s, lag_s, Actuators()).make_state_at_rest()
    step, full = SHIP.largest_force_changes_per_sample(sample_s)[-1], np.zeros(7)
    full[-1] = SHIP.largest_thrusts_N[-1]
    assert full[-1] / step == pytest.approx(5.0 / sample_s)
    for k in range(1, 11):
        thrusters.force_on_hull_for_command(full)
        behind = step / math.expm1(sample_s / lag_s) * -math.expm1(-k * sample_s / lag_s)
        assert thrusters.f[-1] == pytest.approx(k * step - behind, rel=1e-9)
