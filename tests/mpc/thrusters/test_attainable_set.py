"""The attainable set against linear programs over the thrusters themselves, and in a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from dpbench.bench.judge.control_metrics import joint_limit_metrics
from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.bench.run.formulation import QPBuilder
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.thruster_rows import thruster_rows
from dpbench.mpc.thrusters.attainable_set import attainable_set
from dpbench.scenario.scenario import Scenario, load_scenario, load_vessel, scenario_of
from dpbench.ship.thrusters import ThrusterSet


def reach_by_linprog(thrusters: ThrusterSet, sides: int, tau: np.ndarray, lost: set[int]) -> float:
    """The largest s for which the thrusters make s τ, by a linear program over f."""
    rows = thruster_rows(thrusters, sides)
    gone = np.isin(rows.entry, sorted(lost))
    kN = 1e-3
    A_eq = np.hstack([thrusters.T_e, -tau[:, np.newaxis] * kN * 1e3])
    A_ub = np.hstack([np.vstack([rows.G, -rows.G]), np.zeros((2 * len(rows.low), 1))])
    b_ub = np.concatenate([rows.high, -rows.low]) * kN
    bounds = [(0.0, 0.0) if out else (None, None) for out in gone] + [(0.0, None)]
    cost = np.zeros(thrusters.n_f + 1)
    cost[-1] = -1.0
    scale = np.array([1.0, 1.0, 1.0 / 40.0])[:, np.newaxis]
    # f in kN, s such that s τ is in N: A_eq f = s τ kN.
    A_eq[:, -1] = -tau * kN
    found = linprog(cost, A_ub, b_ub, scale * A_eq, np.zeros(3), bounds)
    assert found.status == 0
    return float(found.x[-1])


@pytest.mark.parametrize("name", ["osv", "ratownik"])
@pytest.mark.parametrize("lost", [set(), {0}, {1, 2}], ids=str)
@pytest.mark.parametrize("sides", [4, 8])
def test_the_edge_of_the_set_is_where_no_thrust_is_left(
    name: str, lost: set[int], sides: int
) -> None:
    """In 60 random directions: how far the rows let a force grow, and how far linprog does."""
    thrusters = load_vessel(name).thrusters
    assert thrusters is not None
    found = attainable_set(thrusters, sides)
    low, high, _ = found.limits(lost)
    rng = np.random.default_rng(sides)
    for _ in range(60):
        tau = rng.normal(size=3) * [1e5, 1e5, 4e6]
        along = found.normals @ tau
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(along > 0.0, high / along, low / along)
        expected = reach_by_linprog(thrusters, sides, tau, lost)
        assert np.nanmin(reach) == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_no_row_is_there_twice() -> None:
    """Pairs of edges of one azimuth share a plane, two tunnels a line: one normal each."""
    thrusters = load_vessel("ratownik").thrusters
    assert thrusters is not None
    normals = attainable_set(thrusters, 8).normals
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    close = np.abs(unit @ unit.T) > 1 - 1e-12
    assert close.sum() == len(unit)
    assert 50 <= len(unit) <= 91


def case(steps: int, **controller: object) -> Scenario:
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
    return scenario_of(files | {"scenario": own | {"controller": table | controller}})


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_a_force_on_a_facet_leaves_no_slack_in_its_row(units: UnitSystem) -> None:
    """One move from rest to h(n)·n/|n|² is on the facet of n after it, and at every later move."""
    problem = case(3).problem
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
    """Every force of the exactly solved loop can be made by the thrusters, some just so."""
    scenario = case(150)
    exact = solve_exactly(scenario)
    thrusters = scenario.vessel.thrusters
    assert thrusters is not None
    reach = [reach_by_linprog(thrusters, 4, tau, set()) for tau in exact.tau[60::10]]
    assert min(reach) >= 1 - 1e-7
    builder = QPBuilder(scenario)
    metrics = joint_limit_metrics(scenario, exact.tau, builder.limits)
    assert metrics["limit_violations"] == 0.0
    assert (metrics["at_limit_thrusters"] > 0.0) == (min(reach) < 1 + 1e-6)
    assert "at_amplitude_surge" not in metrics


def test_what_cannot_be_is_said_in_one_line() -> None:
    """A vessel without thrusters, and limits of a controller that has its own."""
    files = load_scenario("rough").files
    table = files["scenario"]["controller"] | {"limits": "attainable"}
    with pytest.raises(InputError, match=r'controller.limits: found "attainable"; allowed: "box"'):
        scenario_of(files | {"scenario": files["scenario"] | {"controller": table}})
    thrusters = load_vessel("osv").thrusters
    assert thrusters is not None
    turned = replace(thrusters.thrusters[2], sector_rad=(0.0, 1.0))
    with pytest.raises(InputError, match="sector_deg"):
        attainable_set(ThrusterSet((*thrusters.thrusters[:2], turned, thrusters.thrusters[3])), 8)
