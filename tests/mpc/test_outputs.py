"""Bounds on predicted position and speed against stepping the model and against hard rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.soft_limits import Penalty
from dpbench.qp.referee.referee import certify

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
    """How far points (…, 2) lie outside each side of the regular polygon inscribed in a circle
    whose first side faces north."""
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
    ship: Any,
) -> None:
    """For any plan, what a row lacks is how far the stepped model is outside that side at that
    instant, less the slack; in m and m/s in SI, round the held reference."""
    if radius_m is None and speed_mps is None:
        speed_mps = 0.1
    problem = ship("supply_mss", psi0_rad=0.6, N_c=N_c)
    bounds = OutputBounds(SAMPLE_S, radius_m, speed_mps, sides)
    amplitude: Any = "soft" if soft else "reachable"
    builder = CondensedQP(problem, units="si", outputs=bounds, amplitude=amplitude)
    x, u_prev = under_way(seed)
    y_ref = np.array([0.3, 0.9, 0.1])
    step = builder.emit(x, y_ref, u_prev)
    rng = np.random.default_rng(seed)
    moves = rng.uniform(-1, 1, (N_c, 3)) * problem.du_max
    plan = builder.plan(moves).reshape(N_c, -1)
    number = sides * ((radius_m is not None) + (speed_mps is not None))
    slack = rng.uniform(0, 1, (N_c, number))
    plan[:, -number:] = slack
    lacking = (builder.A @ plan.reshape(-1) - step.u).reshape(N_c, -1)[:, -number:]
    position, speed = stepped(problem, x, moves)
    at = np.array([(j * 30) // N_c for j in range(1, N_c + 1)]) - 1
    expected = []
    if radius_m is not None:
        expected.append(excess(position[at] - y_ref[:2], radius_m, sides))
    if speed_mps is not None:
        expected.append(excess(speed[at], speed_mps, sides))
    np.testing.assert_allclose(
        lacking, np.concatenate(expected, axis=1) - slack, rtol=0, atol=1e-11
    )
    assert np.isneginf(step.l.reshape(N_c, -1)[:, -number:]).all()
    assert builder.problem(step).block == 3 * (2 if soft else 1) + number


def test_the_circle_moves_with_a_previewed_reference(ship: Any) -> None:
    """With a preview the sides stand round the reference of their instant."""
    problem = ship("supply_fs99", psi0_rad=0.2)
    rng = np.random.default_rng(2)
    x, u_prev = under_way(5)
    preview = np.cumsum(0.1 * rng.normal(size=(30, 3)), axis=0)
    moves = rng.uniform(-1, 1, (5, 3)) * problem.du_max
    position, speed = stepped(problem, x, moves)
    expected = np.concatenate(
        [excess((position - preview[:, :2])[5::6], 2.0, 8), excess(speed[5::6], 0.2, 8)], axis=1
    )
    bounds = OutputBounds(SAMPLE_S, 2.0, 0.2)
    for amplitude in ("reachable", "soft"):
        for units in ("scaled", "si"):
            builder = CondensedQP(problem, units=units, outputs=bounds, amplitude=amplitude)  # type: ignore[arg-type] # names from a loop
            lacking = builder.A @ builder.plan(moves) - builder.emit(x, preview, u_prev).u
            si = CondensedQP(problem, units="si", outputs=bounds, amplitude=amplitude)  # type: ignore[arg-type] # the same
            unit = 1.0 if units == "si" else si.scale.row
            found = (lacking * unit).reshape(5, -1)[:, -16:]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(6))
def test_where_the_bounds_can_be_kept_the_soft_plan_is_that_of_hard_rows(
    ship: Any, by_quadprog: Any, seed: int
) -> None:
    """With the default penalty the moves are those of the rows without slacks, solved by another
    library, wherever those have a solution; the bounds matter in every case."""
    problem = ship("supply_fs99", psi0_rad=0.4)
    x, u_prev = under_way(seed)
    soft = CondensedQP(problem, outputs=OutputBounds(SAMPLE_S, 8.0, 0.12))
    qp = soft.problem(soft.emit(x, np.zeros(3), u_prev))
    moves = np.arange(soft.n).reshape(5, -1)[:, :3].reshape(-1)
    hard = type(qp)(
        qp.P[np.ix_(moves, moves)],
        qp.q[moves],
        qp.A[:, moves],
        np.maximum(qp.l, -1e3),
        qp.u,
        qp.lb[moves],
        qp.ub[moves],
    )
    z, y, _ = by_quadprog(hard)
    assert np.abs(y.reshape(5, -1)[:, 3:]).max() > 1e-3
    found = certify(qp)
    assert found.bound < 1e-10
    # quadprog works in double precision on a condition of about 1e3.
    np.testing.assert_allclose(found.z[moves], z, rtol=0, atol=1e-9)
    slacks = np.delete(found.z, moves)
    np.testing.assert_allclose(slacks, 0.0, atol=1e-9)


def test_where_the_bounds_cannot_be_kept_their_excess_is_paid(ship: Any) -> None:
    """A ship outside its circle has a plan all the same; every slack is how far the plan stays
    outside that side, and a higher penalty buys no smaller total."""
    problem = ship("supply_fs99")
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
