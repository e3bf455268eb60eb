"""Bounds on predicted position and speed against stepping the model and against hard rows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.errors import ShapeError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import (
    build_rotation_matrix,
    discretise_zero_order_hold,
    linearise_ship_at_heading,
)
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.soft_limits import OutputBounds, Penalty
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import Referee, certify
from dpbench.scenario.scenario import load_vessel
from tests.mpc.conftest import random_problem, ship_problem, solve_by_quadprog

SAMPLE_S = 0.3


def stepped(problem: Any, x: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """North and east (N_p, 2) and speed over ground (N_p, 2) by stepping the model."""
    state, outputs = x, [problem.model.C @ x]
    for i in range(problem.N_p):
        du = moves[i] if i < problem.N_c else np.zeros(3)
        state = problem.model.A @ state + problem.model.B @ du
        outputs.append(problem.model.C @ state)
    track = np.array(outputs)[:, :2]
    return track[1:], np.diff(track, axis=0) / SAMPLE_S


def excess(points: np.ndarray, radius: float, sides: int) -> np.ndarray:
    half = np.pi / sides
    corners = radius * np.exp(1j * (2 * half * np.arange(sides) - half))
    along = np.roll(corners, -1) - corners
    # Distance from the line through a corner along a side, positive on the outside.
    offset = (points[..., 0] + 1j * points[..., 1])[..., np.newaxis] - corners
    return (np.conj(along) * offset).imag / -np.abs(along)


def under_way(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A ship near the edge of a watch circle of 5 m, drifting, and the force applied."""
    rng = np.random.default_rng(seed)
    x = np.zeros(9)
    x[3:5] = SAMPLE_S * rng.uniform(-0.1, 0.1, 2)
    x[6:8] = rng.uniform(-4, 4, 2)
    return x, rng.uniform(-1, 1, 3) * [3e5, 1e5, 3e6]


@settings(max_examples=40, derandomize=True, deadline=None)
@given(
    seed=st.integers(0, 1000),
    sides=st.integers(3, 12),
    radius_m=st.none() | st.floats(0.5, 20.0),
    speed_mps=st.none() | st.floats(0.02, 1.0),
    soft=st.booleans(),
    N_c=st.sampled_from([1, 5, 7, 30]),
)
def test_output_rows_are_the_sides_of_the_polygons_of_the_stepped_model(
    seed: int,
    sides: int,
    radius_m: float | None,
    speed_mps: float | None,
    soft: bool,
    N_c: int,
) -> None:
    if radius_m is None and speed_mps is None:
        speed_mps = 0.1
    problem = ship_problem("supply_mss", psi0_rad=0.6, N_c=N_c)
    bounds = OutputBounds(SAMPLE_S, radius_m, speed_mps, sides)
    amplitude: Any = "soft" if soft else "reachable"
    builder = CondensedQP(problem, units="si", outputs=bounds, amplitude=amplitude)
    x, u_prev = under_way(seed)
    y_ref = np.array([0.3, 0.9, 0.1])
    step = builder.emit(x, y_ref, u_prev)
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1, 1, (N_c, 3)) * problem.du_max
    plan = builder.convert_increments_to_variables(moves).reshape(N_c, -1)
    number = sides * ((radius_m is not None) + (speed_mps is not None))
    slack = rng.uniform(0, 1, (N_c, number))
    plan[:, -number:] = slack
    lacking = (builder.A @ plan.reshape(-1) - step.u).reshape(N_c, -1)[:, -number:]
    position, speed = stepped(problem, x, moves)
    at = np.array([(j * 30) // N_c for j in range(1, N_c + 1)]) - 1
    bounded = ((position[at] - y_ref[:2], radius_m), (speed[at], speed_mps))
    expected = [excess(points, most, sides) for points, most in bounded if most is not None]
    found = lacking + slack
    np.testing.assert_allclose(found, np.concatenate(expected, axis=1), rtol=0, atol=1e-11)
    assert np.isneginf(step.l.reshape(N_c, -1)[:, -number:]).all()
    assert builder.problem(step).block == 3 * (2 if soft else 1) + number


@pytest.mark.parametrize("amplitude", ["reachable", "soft"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_the_circle_moves_with_a_previewed_reference(amplitude: Any, units: Any) -> None:
    problem = ship_problem("supply_fs99", psi0_rad=0.2)
    rng = np.random.default_rng(2)
    x, u_prev = under_way(5)
    preview = np.cumsum(0.1 * rng.normal(size=(30, 3)), axis=0)
    moves = rng.uniform(-1, 1, (5, 3)) * problem.du_max
    position, speed = stepped(problem, x, moves)
    expected = np.concatenate(
        [excess((position - preview[:, :2])[5::6], 2.0, 8), excess(speed[5::6], 0.2, 8)], axis=1
    )
    bounds = OutputBounds(SAMPLE_S, 2.0, 0.2)
    builder = CondensedQP(problem, units=units, outputs=bounds, amplitude=amplitude)
    lacking = (
        builder.A @ builder.convert_increments_to_variables(moves)
        - builder.emit(x, preview, u_prev).u
    )
    si = CondensedQP(problem, units="si", outputs=bounds, amplitude=amplitude)
    found = (lacking * (1.0 if units == "si" else si.scale.row)).reshape(5, -1)[:, -16:]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_where_the_bounds_can_be_kept_the_soft_plan_is_that_of_hard_rows(seed: int) -> None:
    problem = ship_problem("supply_fs99", psi0_rad=0.4)
    x, u_prev = under_way(seed)
    soft = CondensedQP(problem, outputs=OutputBounds(SAMPLE_S, 8.0, 0.12))
    qp = soft.problem(soft.emit(x, np.zeros(3), u_prev))
    moves = np.arange(soft.n).reshape(5, -1)[:, :3].reshape(-1)
    limits = np.maximum(qp.l, -1e3), qp.u, qp.lb[moves], qp.ub[moves]
    hard = QuadraticProgram(qp.P[np.ix_(moves, moves)], qp.q[moves], qp.A[:, moves], *limits)
    z, y, _ = solve_by_quadprog(hard)
    assert np.abs(y.reshape(5, -1)[:, 3:]).max() > 1e-3
    found = certify(qp)
    assert found.bound < 1e-10
    # quadprog works in double precision on a condition of about 1e3.
    np.testing.assert_allclose(found.z[moves], z, rtol=0, atol=1e-9)
    slacks = np.delete(found.z, moves)
    np.testing.assert_allclose(slacks, 0.0, atol=1e-9)


def test_where_the_bounds_cannot_be_kept_their_excess_is_paid() -> None:
    problem = ship_problem("supply_fs99")
    x = np.zeros(9)
    x[6:8] = [6.0, 1.0]
    totals = []
    for factor in (1.0, 100.0):
        bounds = OutputBounds(SAMPLE_S, radius_m=5.0)
        plain = CondensedQP(problem, outputs=bounds).penalty
        assert plain is not None
        penalty = Penalty(plain.amplitude, factor * plain.outputs, plain.curvature)
        scaled = CondensedQP(problem, outputs=bounds, penalty=penalty)
        best = certify(scaled.problem(scaled.emit(x, np.zeros(3), np.zeros(3))))
        assert best.bound < 1e-10
        position, _ = stepped(problem, x, scaled.moves(best.z))
        outside = np.maximum(excess(position[5::6], 5.0, 8), 0.0)
        unit = CondensedQP(problem, units="si", outputs=bounds).scale.z.reshape(5, -1)[:, 3:]
        slacks = best.z.reshape(5, -1)[:, 3:] * unit
        np.testing.assert_allclose(slacks, outside, rtol=0, atol=1e-9)
        totals.append(outside.sum())
    assert totals[0] > 3.0
    assert totals[0] == pytest.approx(totals[1], rel=1e-9)


@pytest.mark.parametrize("amplitude", ["reachable", "hard"])
@pytest.mark.parametrize("units", ["scaled", "si"])
def test_output_bounds_leave_cost_and_amplitude_rows_of_the_moves_alone(
    amplitude: Any, units: Any
) -> None:
    problem = ship_problem("supply_fs99", psi0_rad=0.3)
    bounds = OutputBounds(SAMPLE_S, 5.0, 0.2)
    plain = CondensedQP(problem, units=units, amplitude=amplitude)
    builder = CondensedQP(problem, units=units, amplitude=amplitude, outputs=bounds)
    x = np.array([0.01, 0.02, 0.0, 0.02, -0.01, 0.0, 3.0, -2.0, 0.1])
    theta = (x, np.zeros(3), 0.9 * problem.u_max)
    limits = Limits(0.4 * problem.u_min, 0.4 * problem.u_max)
    place = np.arange(builder.n).reshape(5, -1)
    moves, sides = place[:, :3].reshape(-1), place[:, 3:].reshape(-1)
    free = builder.problem(builder.emit(*theta))
    for limited in (None, limits):
        found = builder.problem(builder.emit(*theta, limits=limited))
        expected = plain.problem(plain.emit(*theta, limits=limited))
        # SI matrices pass through scaled ones, which costs a rounding or two.
        np.testing.assert_allclose(found.P[np.ix_(moves, moves)], expected.P, rtol=1e-14)
        np.testing.assert_array_equal(found.A[np.ix_(moves, moves)], expected.A)
        assert not found.A[np.ix_(moves, sides)].any()
        for name in ("q", "l", "u", "lb", "ub"):
            part = getattr(found, name)[moves]
            np.testing.assert_allclose(part, getattr(expected, name), rtol=1e-12)
        np.testing.assert_array_equal(found.u[sides], free.u[sides])
        assert np.isneginf(found.l[sides]).all()


def test_bounds_are_for_ships() -> None:
    with pytest.raises(ShapeError, match="3 rows, one for each output of a ship"):
        CondensedQP(random_problem(1, 2, 2, 9, 3), outputs=OutputBounds(SAMPLE_S, 5.0))


PSI0 = 0.4
DISTURBANCE = np.array([-120e3, 150e3, 1.5e6])
"""b in the north-east frame [N, N, N·m]."""
STEPS = 700
"""The slowest mode of the paper's tuning is 0.9495 a step: 1e-15 of it is left."""

VARIANTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "riccati": {"terminal": "riccati"},
    "soft": {"amplitude": "soft"},
    "outputs": {"outputs": OutputBounds(0.3, 5.0, 0.5)},
    "relinearised": {"relinearised": True},
}


def builder_of(problem: Any, options: dict[str, Any]) -> CondensedQP:
    options = dict(options)
    if "terminal" in options:
        return CondensedQP(replace(problem, terminal=options["terminal"]))
    if options.pop("relinearised", False):
        return RelinearisedQP(problem, psi0_rad=PSI0, always=False)
    return CondensedQP(problem, **options)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_constant_disturbance_leaves_no_steady_error(variant: str) -> None:
    vessel = load_vessel("supply_fs99")
    problem = ship_problem("supply_fs99", psi0_rad=PSI0)
    builder = builder_of(problem, VARIANTS[variant])
    referee = Referee(builder.P, builder.A, builder.lb, builder.ub)
    plant = discretise_zero_order_hold(linearise_ship_at_heading(vessel.M, vessel.D, PSI0), 0.3)
    push = build_rotation_matrix(PSI0).T @ DISTURBANCE
    state = np.array([0.0, 0.0, 0.0, 0.5, -0.4, PSI0])
    y_ref = np.array([0.2, 0.1, PSI0 + 0.02])
    before, u, limited = state, np.zeros(3), 0
    for _ in range(STEPS):
        x = np.concatenate([state - before, state[3:]])
        step = builder.emit(x, y_ref, u)
        best = referee.certify_vectors(step.q, step.l, step.u)
        assert best.bound < 1e-10
        limited += bool((np.abs(best.y_box) > 1e-9).any())
        u = u + builder.moves(best.z)[0]
        before, state = state, plant.A @ state + plant.B @ (u + push)
    assert limited > 3
    np.testing.assert_allclose(state[3:], y_ref, rtol=0, atol=1e-10)
    np.testing.assert_allclose(state[:3], 0.0, atol=1e-10)
    np.testing.assert_allclose(u / problem.du_max, -push / problem.du_max, rtol=0, atol=1e-8)
