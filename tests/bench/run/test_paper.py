"""What the paper claims, on the exactly solved loop and on its baseline law."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, open_workspace, run_closed_loop
from dpbench.bench.run.exact_loop import ExactLoop, solve_exactly
from dpbench.scenario.scenario import Scenario


def radius(scenario: Scenario, state: np.ndarray) -> np.ndarray:
    away = state[:, 3:5] - scenario.reference[:2]
    return np.hypot(away[:, 0], away[:, 1])


def clipped(scenario: Scenario) -> pd.DataFrame:
    return run_closed_loop(
        scenario, open_workspace("unconstrained_clipped"), formulation="none"
    ).steps


@pytest.fixture(scope="module")
def loops() -> dict[str, tuple[Scenario, ExactLoop]]:
    names = ("paper", "paper_tight", "calm", "rough")
    scenarios = {name: load_scenario(name) for name in names}
    return {name: (s, solve_exactly(s)) for name, s in scenarios.items()}


@pytest.mark.slow
def test_paper_constrained_settles_first_and_overshoots_less(
    loops: dict[str, tuple[Scenario, ExactLoop]],
) -> None:
    """In `paper` the constrained law is within 0.1 m by 55 s; the clipped law overshoots more."""
    scenario, exact = loops["paper"]
    r = radius(scenario, exact.state)
    t = np.arange(len(r)) * scenario.sample_s
    assert r[t >= 55.0].max() <= 0.1
    baseline_law = clipped(scenario)
    assert -exact.state[:, 4].min() < -baseline_law["e_m"].min()
    r_clipped = np.hypot(baseline_law["n_m"], baseline_law["e_m"]).to_numpy()
    assert r_clipped[t[:-1] >= 55.0].max() > 0.1


@pytest.mark.slow
def test_paper_tight_only_the_constrained_law_holds(
    loops: dict[str, tuple[Scenario, ExactLoop]],
) -> None:
    """With R × 0.7 the clipped law leaves 3 m after 150 s, the constrained one keeps 0.1 m."""
    scenario, exact = loops["paper_tight"]
    late = np.arange(scenario.steps) * scenario.sample_s > 150.0
    assert radius(scenario, exact.state)[:-1][late].max() <= 0.1
    baseline_law = clipped(scenario)
    assert np.hypot(baseline_law["n_m"], baseline_law["e_m"]).to_numpy()[late].max() > 3.0


@pytest.mark.slow
def test_calm_has_no_active_limit(loops: dict[str, tuple[Scenario, ExactLoop]]) -> None:
    """In `calm` both laws give the same force, because no limit is ever active."""
    scenario, exact = loops["calm"]
    baseline_law = clipped(scenario)
    tau = baseline_law[["tau_x_N", "tau_y_N", "tau_n_Nm"]].to_numpy()
    np.testing.assert_allclose(tau, exact.tau, rtol=0, atol=1e-6 * scenario.problem.du_max.min())


def test_rough_saturates_sway_and_stays_put(loops: dict[str, tuple[Scenario, ExactLoop]]) -> None:
    """In `rough` sway is at its amplitude limit in 15-30 % of the steps and r stays below 0.3 m."""
    scenario, exact = loops["rough"]
    at_limit = np.abs(exact.tau[:, 1]) >= scenario.vessel.tau_max[1] * (1 - 1e-9)
    assert 0.15 <= at_limit.mean() <= 0.30
    assert radius(scenario, exact.state).max() < 0.3


def test_no_force_violates_a_limit(loops: dict[str, tuple[Scenario, ExactLoop]]) -> None:
    """Amplitude and rate limits hold in every step of every exactly solved loop."""
    for scenario, exact in loops.values():
        ship = scenario.vessel
        assert (exact.tau <= ship.tau_max).all() and (exact.tau >= ship.tau_min).all()
        change = np.diff(exact.tau, axis=0, prepend=np.zeros((1, 3)))
        assert (np.abs(change) <= scenario.problem.du_max + np.spacing(ship.tau_max)).all()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["quadprog", "daqp", "paper_active_set"])
@pytest.mark.parametrize("name", ["paper", "rough"])
def test_exact_solvers_are_exact(
    loops: dict[str, tuple[Scenario, ExactLoop]], solver: str, name: str
) -> None:
    """quadprog, daqp and the paper's method keep error_move ≤ 1e-9 in scaled units, certified."""
    scenario, _ = loops[name]
    run = run_closed_loop(scenario, open_workspace(solver))
    assert (run.steps["optimum_bound"] <= 1e-9).all()
    assert (run.steps["error_move"] <= 1e-9).all()
    assert run.steps["claimed"].all() and run.steps["true_1e6"].all()
    assert run.summary["dev_position_max_m"] < 1e-6
