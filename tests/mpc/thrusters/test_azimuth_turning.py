"""Azimuths that turn at a limited rate: the rows of a step, what is cut, a run that keeps to it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.bench.run.exact_loop import solve_exactly
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning, TurningQP
from dpbench.qp.referee.referee import certify
from dpbench.scenario.scenario import Scenario, condense, load_scenario

part = st.floats(-1.0, 1.0)


@pytest.fixture(scope="module")
def case() -> Scenario:
    return load_scenario("thrusters_turning").first(60)


def arcs(case: Scenario, f: np.ndarray, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What each azimuth moves along and across its direction, in what it may (a,)."""
    assert case.controller.commanded is not None
    thrusters = case.controller.commanded.thrusters
    along, across = [], []
    for thruster, at in zip(thrusters.thrusters, thrusters.places, strict=True):
        if thruster.kind != "azimuth":
            continue
        size = float(np.hypot(*f[at]))
        n = f[at] / size if size > 5e-11 * thruster.thrust_N else np.array([1.0, 0.0])
        most = max(size, 0.05 * thruster.thrust_N) * np.radians(12.0) * case.sample_s
        along.append(abs(n @ move[at]) / case.problem.du_max[at.start])
        across.append(abs(n[0] * move[at][1] - n[1] * move[at][0]) / most)
    return np.array(along), np.array(across)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_the_rows_of_a_step_are_arc_and_rate_of_its_directions(case: Scenario, units: str) -> None:
    """Behind the polygons' rows, which stay as they are; A is the step's own."""
    builder = condense(case, units=units)  # type: ignore[arg-type] # one of the two
    assert isinstance(builder, TurningQP)
    rng = np.random.default_rng(2)
    f = 1e5 * rng.uniform(-0.5, 0.5, 8)
    f[4:6] = 0.0
    step = builder.emit(rng.normal(size=9), np.zeros(3), f)
    qp = builder.problem(step)
    plain = CondensedQP(case.problem, units=units)  # type: ignore[arg-type] # one of the two
    shape = case.problem.N_c, qp.m // case.problem.N_c
    polygons = qp.A.reshape(*shape, -1)[:, :-6].reshape(plain.A.shape)
    np.testing.assert_allclose(polygons, plain.A, rtol=0, atol=1e-15)
    assert shape[1] == plain.m // case.problem.N_c + 6
    seen = set()
    for _ in range(100):
        plan = 1.5 * rng.uniform(-1, 1, (case.problem.N_c, 8)) * case.problem.du_max
        rows = qp.A @ builder.plan(plan)
        kept = ((rows <= qp.u) & (rows >= qp.l)).reshape(shape)[:, -6:]
        for i in range(case.problem.N_c):
            along, across = arcs(case, f, plan[i])
            expected = np.stack((along <= 1.0, across <= 1.0), axis=-1).reshape(-1)
            np.testing.assert_array_equal(kept[i], expected)
            seen |= set(expected.tolist())
    assert seen == {True, False}


def test_both_units_have_one_optimum(case: Scenario) -> None:
    """Of a step that turns its azimuths as far as they go."""
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
    """Rate of each entry, rate along the direction, arc across it."""
    case = load_scenario("thrusters_turning")
    assert case.controller.commanded is not None
    f, move = 1e5 * np.array(share), 2.0 * np.array(moves) * case.problem.du_max
    turning = AzimuthTurning.of(case.controller.commanded.thrusters, case.sample_s)
    kept = turning.kept(
        f, np.clip(move, -case.problem.du_max, case.problem.du_max), case.problem.du_max
    )
    assert (np.abs(kept) <= case.problem.du_max * (1 + 1e-12)).all()
    along, across = arcs(case, f, kept)
    assert (along <= 1 + 1e-9).all() and (across <= 1 + 1e-9).all()
    np.testing.assert_allclose(
        turning.kept(f, kept, case.problem.du_max), kept, atol=1e-9 * case.problem.du_max.max()
    )


def test_a_run_keeps_to_the_turning_rate_and_uses_it(case: Scenario) -> None:
    """Of the exactly solved loop: no azimuth turns faster, some as fast as they may."""
    thrust = solve_exactly(case).thrust
    most = np.array([arcs(case, before, now - before)[1] for before, now in pairwise(thrust)])
    assert most.max() <= 1 + 1e-6
    assert most.max() >= 1 - 1e-6
