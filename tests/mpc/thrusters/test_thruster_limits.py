"""Azimuths that turn at a limited rate: the rows of a step, what is cut, a run that keeps to it."""

import copy
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from dpbench.bench.judge.control_metrics import compute_joint_limit_metrics
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.run.formulation import QPBuilder
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.thruster_rows import build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP
from dpbench.qp.referee.referee import certify
from dpbench.scenario.scenario import (
    Scenario,
    build_scenario_from_documents,
    condense,
    load_scenario,
    load_vessel,
)
from dpbench.ship.thrusters import ThrusterSet

part = st.floats(-1.0, 1.0)


@pytest.fixture(scope="module")
def case() -> Scenario:
    return load_scenario("thrusters_turning").truncate(60)


def arcs(case: Scenario, f: np.ndarray, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the change of each azimuth along and across its direction, in shares of its limits
    (a,)."""
    assert case.controller.commanded_thrusters is not None
    thrusters = case.controller.commanded_thrusters.thrusters
    along, across = [], []
    for thruster, at in zip(thrusters.thrusters, thrusters.slices_in_force_vector, strict=True):
        if thruster.kind != "azimuth":
            continue
        size = float(np.hypot(*f[at]))
        n = f[at] / size if size > 5e-11 * thruster.thrust_N else np.array([1.0, 0.0])
        most = max(size, 0.05 * thruster.thrust_N) * np.radians(12.0) * case.sample_s
        along.append(abs(n @ move[at]) / case.problem.du_max[at.start])
        across.append(abs(n[0] * move[at][1] - n[1] * move[at][0]) / most)
    return np.array(along), np.array(across)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_the_rows_of_a_step_are_arc_and_rate_of_its_directions(case: Scenario, units: Any) -> None:
    builder = condense(case, units=units)
    assert isinstance(builder, TurningQP)
    rng = np.random.default_rng(2)
    f = 1e5 * rng.uniform(-0.5, 0.5, 8) * np.repeat([1.0, 0.0, 1.0], [4, 2, 2])
    qp = builder.problem(builder.emit(rng.normal(size=9), np.zeros(3), f))
    plain = CondensedQP(case.problem, units=units)
    shape = case.problem.N_c, qp.m // case.problem.N_c
    polygons = qp.A.reshape(*shape, -1)[:, :-6].reshape(plain.A.shape)
    np.testing.assert_allclose(polygons, plain.A, rtol=0, atol=1e-15)
    assert shape[1] == plain.m // case.problem.N_c + 6
    seen = set()
    for _ in range(100):
        plan = 1.5 * rng.uniform(-1, 1, (case.problem.N_c, 8)) * case.problem.du_max
        rows = qp.A @ builder.convert_increments_to_variables(plan)
        kept = ((rows <= qp.u) & (rows >= qp.l)).reshape(shape)[:, -6:]
        for found, move in zip(kept, plan, strict=True):
            expected = (np.array(arcs(case, f, move)) <= 1.0).T.reshape(-1)
            np.testing.assert_array_equal(found, expected)
            seen |= set(expected.tolist())
    assert seen == {True, False}


def test_both_units_have_one_optimum(case: Scenario) -> None:
    rng = np.random.default_rng(5)
    x, f = np.concatenate([np.zeros(6), [2.0, -1.0, 0.1]]), 1e5 * rng.uniform(-0.5, 0.5, 8)
    scaled, si = condense(case), condense(case, units="si")
    exact = certify(scaled.problem(scaled.emit(x, np.zeros(3), f)))
    other = certify(si.problem(si.emit(x, np.zeros(3), f)))
    assert exact.bound < 1e-9
    np.testing.assert_allclose(other.z / si.scale.z, exact.z, atol=1e-7)
    assert arcs(case, f, scaled.moves(exact.z)[0])[1].max() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
@settings(derandomize=True, max_examples=200)
@given(st.lists(part, min_size=8, max_size=8), st.lists(part, min_size=8, max_size=8))
def test_what_is_cut_keeps_to_everything_and_what_keeps_to_it_is_not_cut(
    share: list[float], moves: list[float]
) -> None:
    case = load_scenario("thrusters_turning")
    assert case.controller.commanded_thrusters is not None
    du_max = case.problem.du_max
    f, move = 1e5 * np.array(share), 2.0 * np.array(moves) * du_max
    turning = AzimuthTurning.select_from_thrusters(
        case.controller.commanded_thrusters.thrusters, case.sample_s
    )
    cut = turning.clip_force_changes_to_rates(f, np.clip(move, -du_max, du_max), du_max)
    assert (np.abs(cut) <= du_max * (1 + 1e-12)).all()
    assert (np.array(arcs(case, f, cut)) <= 1 + 1e-9).all()
    np.testing.assert_allclose(
        turning.clip_force_changes_to_rates(f, cut, du_max), cut, atol=1e-9 * du_max.max()
    )


def test_a_run_keeps_to_the_turning_rate_and_uses_it(case: Scenario) -> None:
    thrust = solve_loop_exactly(case).thrust
    most = np.array([arcs(case, before, now - before)[1] for before, now in pairwise(thrust)])
    assert most.max() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("sector_deg", [[-60.0, 60.0], [-90.0, 90.0], [90.0, 250.0]])
@pytest.mark.parametrize("lost", [["stern port"], ["stern port", "stern starboard"]])
def test_every_step_around_the_loss_of_an_azimuth_with_a_sector_is_certified(
    sector_deg: list[float], lost: list[str]
) -> None:
    files = copy.deepcopy(load_scenario("thrusters_loss").files)
    files["vessel"]["thrusters"][0]["sector_deg"] = sector_deg
    files["scenario"]["faults"] = [{"at_s": 6.0, "lost": lost}]
    exact = solve_loop_exactly(build_scenario_from_documents(files).truncate(50))
    assert {optimum.kind for optimum in exact.optima} <= {"linear", "gap"}
    np.testing.assert_allclose(exact.thrust[-1, :2], 0.0, atol=1e-9)


def thrusters_of(name: str) -> ThrusterSet:
    thrusters = load_vessel(name).thrusters
    assert thrusters is not None
    return thrusters


def reach_by_linprog(thrusters: ThrusterSet, sides: int, tau: np.ndarray, lost: set[int]) -> float:
    """The largest s for which the thrusters make s τ, by a linear program over f."""
    rows, kN = build_limit_rows_of_thrusters(thrusters, sides), 1e-3
    gone = np.isin(rows.entry, sorted(lost))
    # f in kN, s such that s τ is in N: T_e f = s τ kN.
    scale = np.array([1.0, 1.0, 1.0 / 40.0])[:, np.newaxis]
    A_eq = scale * np.column_stack([thrusters.T_e, -tau * kN])
    A_ub = np.column_stack([np.vstack([rows.G, -rows.G]), np.zeros(2 * len(rows.low))])
    b_ub = np.concatenate([rows.high, -rows.low]) * kN
    bounds = [(0.0, 0.0) if out else (None, None) for out in gone] + [(0.0, None)]
    cost = -np.eye(thrusters.n_f + 1)[-1]
    found = linprog(cost, A_ub, b_ub, A_eq, np.zeros(3), bounds)
    assert found.status == 0
    return float(found.x[-1])


@pytest.mark.parametrize("name", ["osv", "ratownik"])
@pytest.mark.parametrize("lost", [set(), {0}, {1, 2}], ids=str)
@pytest.mark.parametrize("sides", [4, 8])
def test_the_edge_of_the_set_is_where_no_thrust_is_left(
    name: str, lost: set[int], sides: int
) -> None:
    """In 20 random directions: how far the rows let a force grow, and how far linprog does."""
    thrusters = thrusters_of(name)
    found = build_attainable_force_polytope(thrusters, sides)
    low, high, _ = found.facet_limits_after_loss(lost)
    rng = np.random.default_rng(sides)
    for _ in range(20):
        tau = rng.normal(size=3) * [1e5, 1e5, 4e6]
        along = found.normals @ tau
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(along > 0.0, high / along, low / along)
        expected = reach_by_linprog(thrusters, sides, tau, lost)
        assert np.nanmin(reach) == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_no_row_is_there_twice() -> None:
    normals = build_attainable_force_polytope(thrusters_of("ratownik"), 8).normals
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    close = np.abs(unit @ unit.T) > 1 - 1e-12
    assert close.sum() == len(unit)
    assert 50 <= len(unit) <= 91


def force_case(steps: int) -> Scenario:
    """The controller of forces on ratownik in heavy weather, limited as a whole."""
    files = load_scenario("thrusters").files
    own = files["scenario"] | {"duration_s": 0.3 * steps}
    table = {
        "tuning": "forces",
        "prediction_horizon": 30,
        "control_horizon": 3,
        "output_weight": [1.0, 1.0, 3000.0],
        "move_weight_relative": [0.1, 0.1, 0.1],
        "limits": "attainable",
        "attainable_sides": 4,
    }
    return build_scenario_from_documents(files | {"scenario": own | {"controller": table}})


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_a_force_on_a_facet_leaves_no_slack_in_its_row(units: UnitSystem) -> None:
    """One move from rest to h(n)·n/|n|² is on the facet of n after it, and at every later move."""
    problem = force_case(3).problem
    qp = CondensedQP(problem, units=units)
    rest = np.zeros(problem.model.n_x), np.zeros(3), np.zeros(3)
    step = qp.emit(*rest)
    for i, (normal, reach) in enumerate(zip(problem.G, problem.u_max, strict=True)):
        moves = np.zeros((problem.N_c, 3))
        moves[0] = reach * normal / (normal @ normal)
        z = (moves / (problem.du_max if units == "scaled" else 1.0)).reshape(-1)
        rows = slice(i, None, len(problem.G))
        np.testing.assert_allclose((qp.A @ z)[rows], step.u[rows], rtol=1e-9)


def test_a_run_uses_what_there_is_and_no_more() -> None:
    scenario = force_case(150)
    tau = solve_loop_exactly(scenario).tau
    thrusters = thrusters_of("ratownik")
    reach = [reach_by_linprog(thrusters, 4, force, set()) for force in tau[60::10]]
    assert min(reach) >= 1 - 1e-7
    metrics = compute_joint_limit_metrics(scenario, tau, QPBuilder(scenario).limits)
    assert metrics["limit_violations"] == 0.0
    assert (metrics["at_limit_thrusters"] > 0.0) == (min(reach) < 1 + 1e-6)
    assert "at_amplitude_surge" not in metrics


def test_what_cannot_be_is_said_in_one_line() -> None:
    files = load_scenario("rough").files
    table = files["scenario"]["controller"] | {"limits": "attainable"}
    with pytest.raises(InputError, match=r'controller.limits: found "attainable"; allowed: "box"'):
        build_scenario_from_documents(
            files | {"scenario": files["scenario"] | {"controller": table}}
        )
    first, *others = thrusters_of("osv").thrusters[::-1]
    others[0] = replace(others[0], sector_rad=(0.0, 1.0))
    with pytest.raises(InputError, match="sector_deg"):
        build_attainable_force_polytope(ThrusterSet((first, *others)), 8)
