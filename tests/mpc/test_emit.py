"""Steps of the condensed QP: the affine map, memory, limits and units; re-linearised steps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.errors import InputError
from dpbench.mpc.condense import build_rows_of_summed_increments
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.soft_limits import OutputBounds
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from tests.mpc.conftest import (
    assert_close,
    at_sea,
    naive_build,
    rolled_out_cost,
    ship_problem,
    solve_by_quadprog,
)


def pieces(step: QPStep) -> np.ndarray:
    return np.concatenate([step.q, step.l, step.u])


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("amplitude", ["reachable", "hard", "soft"])
@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("turning", [False, True])
def test_every_condensed_formulation_is_one_affine_map(
    units: Any, amplitude: Any, bounded: bool, turning: bool
) -> None:
    problem = ship_problem("supply_fs99", N_p=20, N_c=4)
    outputs = OutputBounds(0.3, 5.0, 0.15) if bounded else None
    form: dict[str, Any] = {"units": units, "amplitude": amplitude, "outputs": outputs}
    heading = {"psi0_rad": 0.0} if turning else {}
    builder = (RelinearisedQP if turning else CondensedQP)(problem, **heading, **form)
    rng = np.random.default_rng(3)
    theta = rng.normal(size=(3, 15)) * np.repeat([0.1, 1e5], [12, 3])
    theta[:, 8] = 0.4
    theta[2] = 0.37 * theta[0] + 0.63 * theta[1]
    steps = [builder.emit(row[:9], row[9:12], row[12:]) for row in theta]
    assert turning or all(step.refresh is Refresh.VECTORS for step in steps)
    parts = [pieces(step) for step in steps]
    finite = np.isfinite(builder.Z[:, -1])
    size = np.abs(builder.Z[finite]) @ np.append(np.abs(theta).max(axis=0), 1.0)
    for row, part in zip(theta, parts, strict=True):
        np.testing.assert_array_equal(part[~finite], builder.Z[~finite, -1])
        apart = np.abs(part[finite] - builder.Z[finite] @ np.append(row, 1.0))
        assert (apart <= 1e-14 * size).all()
    mixed = 0.37 * parts[0][finite] + 0.63 * parts[1][finite]
    assert (np.abs(mixed - parts[2][finite]) <= 1e-14 * size).all()


def test_a_step_stays_valid_and_leaves_its_inputs_alone(case: Any) -> None:
    builder = CondensedQP(case.problem)
    theta = (case.x.copy(), case.preview(), case.u_prev.copy())
    limits = Limits(0.5 * case.problem.u_min, 0.5 * case.problem.u_max)
    watched = [*theta, *limits, builder.P, builder.A, builder.lb, builder.ub, builder.Z]
    saved = [array.copy() for array in watched]
    first = builder.emit(*theta, limits=limits)
    before = pieces(first)
    builder.emit(0 * case.x, case.y_ref, 0 * case.u_prev)
    builder.emit(case.x + 1.0, case.preview(), 0.5 * case.u_prev, limits=limits)
    np.testing.assert_array_equal(pieces(first), before)
    for now, then in zip(watched, saved, strict=True):
        np.testing.assert_array_equal(now, then)
    first.q[:] = np.nan
    assert np.isfinite(pieces(builder.emit(*theta))).all()


def test_a_previewed_constant_reference_is_the_held_one(case: Any) -> None:
    builder = CondensedQP(case.problem)
    held = builder.emit(case.x, case.y_ref, case.u_prev)
    previewed = builder.emit(case.x, case.held, case.u_prev)
    np.testing.assert_array_equal(pieces(previewed), pieces(held))
    assert builder.constant_part_of_cost(case.x, case.held) == builder.constant_part_of_cost(
        case.x, case.y_ref
    )


def test_a_preview_of_another_length_is_refused() -> None:
    builder = CondensedQP(ship_problem("supply_fs99"))
    with pytest.raises(ValueError, match=r"mismatch|shapes|align"):
        builder.emit(np.zeros(9), np.zeros((29, 3)), np.zeros(3))


def test_moves_and_plan_are_inverse(case: Any) -> None:
    scaled, si = CondensedQP(case.problem), CondensedQP(case.problem, units="si")
    z = case.rng.normal(size=scaled.n)
    for builder in (scaled, si):
        np.testing.assert_allclose(
            builder.convert_increments_to_variables(builder.moves(z)), z, rtol=1e-15
        )
    expected = z.reshape(case.problem.N_c, -1) * case.problem.du_max
    np.testing.assert_allclose(scaled.moves(z), expected, rtol=1e-15)
    np.testing.assert_array_equal(si.moves(z), z.reshape(case.problem.N_c, -1))


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("factor", [1.0, 0.45])
def test_reachable_limits_follow_the_rate_row_by_row(case: Any, units: Any, factor: float) -> None:
    """Plan row i allows max(u_max, u_prev − iΔu_max) above and min(u_min, u_prev + iΔu_max) below.

    At factor 0.45 the limits have dropped below the force applied, the case of a lost thruster.
    """
    problem = case.problem
    u_min, u_max = factor * problem.u_min, factor * problem.u_max
    builder = CondensedQP(problem, units=units)
    step = builder.emit(case.x, case.y_ref, case.u_prev, limits=Limits(u_min, u_max))
    plain = builder.emit(case.x, case.y_ref, case.u_prev)
    np.testing.assert_array_equal(step.q, plain.q)
    # Compared as forces, so rounding is relative to the amplitude limit.
    size = 1e-12 * (problem.u_max - problem.u_min)
    for i, (low, high) in enumerate(zip(builder.moves(step.l), builder.moves(step.u), strict=True)):
        force, change = case.u_prev, (i + 1) * problem.du_max
        assert (np.abs(force + high - np.maximum(u_max, force - change)) <= size).all()
        assert (np.abs(force + low - np.minimum(u_min, force + change)) <= size).all()
    if factor == 1.0:
        np.testing.assert_allclose(pieces(step), pieces(plain), rtol=1e-12, atol=1e-9)


def test_reachable_limits_always_leave_a_feasible_plan(case: Any) -> None:
    problem = case.problem
    limits = Limits(0.3 * problem.u_min, 0.3 * problem.u_max)
    builder = CondensedQP(problem)
    step = builder.emit(case.x, case.y_ref, case.u_prev, limits=limits)
    force, moves = case.u_prev, []
    for _ in range(problem.N_c):
        target = np.clip(force, limits.low, limits.high)
        moves.append(np.clip(target - force, -problem.du_max, problem.du_max))
        force = force + moves[-1]
    rows = builder.A @ builder.convert_increments_to_variables(np.array(moves))
    assert (rows <= step.u + 1e-9).all() and (rows >= step.l - 1e-9).all()


def test_scaled_and_si_problems_have_one_answer(case: Any) -> None:
    scaled, si = CondensedQP(case.problem), CondensedQP(case.problem, units="si")
    theta = (case.x, case.y_ref, case.u_prev)
    problem, raw = scaled.problem(scaled.emit(*theta)), si.problem(si.emit(*theta))
    z, y, y_box = solve_by_quadprog(problem)
    unit, own = si.scale.z, z * si.scale.z
    # Stationarity of the mapped answer in the SI problem, each row in its own unit.
    slope = raw.P @ own + raw.q + raw.A.T @ (y / si.scale.row) + y_box / unit
    size = 1.0 + np.abs(problem.q).max()
    np.testing.assert_allclose(slope * unit, 0.0, atol=1e-10 * size)
    assert raw.objective(own) == pytest.approx(problem.objective(z), rel=1e-9)
    np.testing.assert_allclose(si.moves(own), scaled.moves(z), rtol=1e-14)
    # Solved on its own in SI units, where P has a condition of up to 1e5, the plan is the same.
    alone = si.moves(solve_by_quadprog(raw)[0]) / case.problem.du_max
    np.testing.assert_allclose(alone, scaled.moves(z) / case.problem.du_max, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["supply_fs99", "supply_tmr"])
def test_amplitude_rows_beyond_the_control_horizon_change_nothing(name: str) -> None:
    """Rows for u(k+N_c) … u(k+N_p−1) are redundant, because the plan stands still there."""
    here = at_sea(ship_problem(name, psi0_rad=0.4, N_p=30, N_c=5))
    builder = CondensedQP(here.problem)
    qp = builder.problem(builder.emit(here.x, here.y_ref, here.u_prev))
    # One row per axis and instant up to N_p, each the sum of all moves made so far.
    sums = np.array([[float(j <= i) for j in range(5)] for i in range(30)])
    limits = [np.tile(side[:3], 30) for side in (qp.l, qp.u)]
    longer = QuadraticProgram(qp.P, qp.q, np.kron(sums, np.eye(3)), *limits, qp.lb, qp.ub)
    z, y, _ = solve_by_quadprog(qp)
    assert np.abs(y).max() > 0.0
    np.testing.assert_allclose(solve_by_quadprog(longer)[0], z, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(longer.A[:15], build_rows_of_summed_increments(5, np.eye(3)))


UNLIKE = np.array([[1.0, 0.3, 2.0], [0.3, 4.0, 0.0], [2.0, 0.0, 300.0]])
"""A weight that tells north from east, and couples both with heading."""
OPTIONS: list[dict[str, Any]] = [
    {},
    {"amplitude": "soft"},
    {"outputs": OutputBounds(0.3, 5.0, 0.2)},
    {"amplitude": "soft", "outputs": OutputBounds(0.3, 5.0)},
]


def state_at(psi_rad: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, a preview (30, 3) and u_prev of a ship under way at a heading."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([0.05 * rng.normal(size=6), rng.normal(size=2), [psi_rad]])
    preview = x[6:] + 0.1 * np.cumsum(rng.normal(size=(30, 3)), axis=0)
    return x, preview, np.array([2e5, -3e5, 4e6]) * rng.uniform(-1, 1, 3)


@pytest.mark.slow
@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    psi0_rad=st.floats(-4, 4),
    psi_rad=st.floats(-7, 7),
    options=st.sampled_from(OPTIONS),
    units=st.sampled_from(["scaled", "si"]),
    unlike=st.booleans(),
)
def test_a_relinearised_step_is_the_step_condensed_anew_at_its_heading(
    psi0_rad: float, psi_rad: float, options: Any, units: Any, unlike: bool
) -> None:
    change = {"Q": UNLIKE} if unlike else {}
    here, there = (
        replace(ship_problem("supply_mss", psi0_rad=a), **change) for a in (psi0_rad, psi_rad)
    )
    builder = RelinearisedQP(here, psi0_rad=psi0_rad, units=units, **options)
    fresh = CondensedQP(there, units=units, penalty=builder.penalty, **options)
    x, preview, u_prev = state_at(psi_rad)
    limits = Limits(0.4 * here.u_min, 0.5 * here.u_max)
    for y_ref in (preview[0], preview):
        for of_now in (None, limits):
            found = builder.problem(builder.emit(x, y_ref, u_prev, limits=of_now))
            expected = fresh.problem(fresh.emit(x, y_ref, u_prev, limits=of_now))
            for name in ("P", "A", "q", "l", "u", "lb", "ub"):
                assert_close(getattr(found, name), getattr(expected, name))
            assert (found.block, found.moves) == (expected.block, expected.moves)


@pytest.mark.parametrize("psi_rad", [0.0, np.pi / 2, -2.9, 9.0])
def test_a_relinearised_step_agrees_with_the_naive_construction(psi_rad: float) -> None:
    builder = RelinearisedQP(replace(ship_problem("supply_fs99"), Q=UNLIKE), psi0_rad=0.0)
    x, preview, u_prev = state_at(psi_rad)
    step = builder.emit(x, preview, u_prev)
    there = replace(ship_problem("supply_fs99", psi0_rad=psi_rad), Q=UNLIKE)
    expected = naive_build(there, x, preview, u_prev)
    assert step.P is not None
    assert_close(step.P, expected.move[:, None] * expected.E * expected.move)
    assert_close(step.q, expected.move * expected.F_k)


@pytest.mark.parametrize("unlike", [False, True], ids=["round Q", "Q unlike"])
def test_the_cost_matrix_turns_only_with_a_weight_that_tells_north_from_east(unlike: bool) -> None:
    """RᵀQR = Q keeps P to the last bit at all headings."""
    problem = ship_problem("supply_fs99", N_p=60, N_c=10, robust=True)
    problem = replace(problem, Q=UNLIKE) if unlike else problem
    for always in (True, False):
        builder = RelinearisedQP(problem, psi0_rad=0.0, always=always)
        x, preview, u_prev = state_at(1.3)
        step = builder.emit(x, preview[0], u_prev)
        sent = always or unlike
        assert step.refresh == (Refresh.VECTORS | Refresh.MATRICES if sent else Refresh.VECTORS)
        assert step.A is None
        same = np.array_equal(builder.problem(step).P, CondensedQP(problem).P)
        assert same is not unlike


def test_steps_stay_valid_after_the_ship_has_turned() -> None:
    problem = replace(ship_problem("supply_fs99"), Q=UNLIKE)
    builder = RelinearisedQP(problem, psi0_rad=0.0, outputs=OutputBounds(0.3, 5.0))
    x, preview, u_prev = state_at(0.4)
    step = builder.emit(x, preview, u_prev)
    kept = {name: getattr(step, name).copy() for name in ("P", "A", "q", "l", "u")}
    for psi_rad in (0.5, 2.0):
        builder.emit(state_at(psi_rad)[0], preview, u_prev)
    for name, then in kept.items():
        np.testing.assert_array_equal(getattr(step, name), then)


@pytest.mark.parametrize(
    ("threshold_deg", "expected"),
    # Headings of the steps below are 0, 0, 3, 5, 9, 9, 3.5, 400 degrees.
    [(0.0, [1, 2, 3, 4, 5, 6, 7, 8]), (4.0, [0, 0, 0, 1, 2, 2, 3, 4])],
)
def test_the_model_follows_the_heading_beyond_a_threshold(
    threshold_deg: float, expected: list[int]
) -> None:
    """Threshold 0 re-linearises each step."""
    threshold = np.radians(threshold_deg)
    builder, before = (
        RelinearisedQP(ship_problem("supply_fs99"), psi0_rad=0.0, threshold_rad=threshold),
        0,
    )
    for heading_deg, count in zip([0, 0, 3, 5, 9, 9, 3.5, 400], expected, strict=True):
        x, preview, u_prev = state_at(np.radians(heading_deg))
        step = builder.emit(x, preview[0], u_prev)
        assert (Refresh.MATRICES in step.refresh) is (count > before)
        fresh = CondensedQP(ship_problem("supply_fs99", psi0_rad=builder.heading_rad))
        assert_close(step.q, fresh.emit(x, preview[0], u_prev).q)
        before = count


def test_constant_cost_and_matrices_are_those_of_the_heading() -> None:
    """½zᵀPz + qᵀz + J0 is the cost by stepping the model of the step's heading."""
    here = replace(ship_problem("supply_fs99", psi0_rad=0.2), Q=UNLIKE)
    builder = RelinearisedQP(here, psi0_rad=0.2)
    x, preview, u_prev = state_at(1.9)
    step = builder.emit(x, preview, u_prev)
    there = replace(ship_problem("supply_fs99", psi0_rad=1.9), Q=UNLIKE)
    moves = np.random.default_rng(1).uniform(-1, 1, (5, 3)) * there.du_max
    cost = builder.problem(step).objective(
        builder.convert_increments_to_variables(moves)
    ) + builder.constant_part_of_cost(x, preview)
    assert cost == pytest.approx(rolled_out_cost(there, x, preview, moves), rel=1e-11)


def test_a_round_terminal_cost_turns_with_the_ship_and_no_other_is_taken() -> None:
    here = replace(ship_problem("supply_tmr", psi0_rad=0.3), terminal="riccati")
    builder = RelinearisedQP(here, psi0_rad=0.3)
    x, preview, u_prev = state_at(-2.0)
    found = builder.problem(builder.emit(x, preview, u_prev))
    fresh = CondensedQP(replace(ship_problem("supply_tmr", psi0_rad=-2.0), terminal="riccati"))
    expected = fresh.problem(fresh.emit(x, preview, u_prev))
    for name in ("P", "q"):
        assert_close(getattr(found, name), getattr(expected, name))
    with pytest.raises(InputError, match="terminal cost"):
        RelinearisedQP(replace(here, Q=UNLIKE), psi0_rad=0.3)
    with pytest.raises(InputError, match="threshold_rad"):
        RelinearisedQP(here, psi0_rad=0.3, threshold_rad=-0.1)
