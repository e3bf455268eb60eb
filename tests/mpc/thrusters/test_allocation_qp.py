"""The allocation QP of a cascade, against other constructions."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import quadprog
from scipy.optimize import linprog

from dpbench.mpc.thruster_rows import RAMP_DOWN_SHARE, build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.allocation_qp import AllocationProblem, AllocationQP, StaticAllocation
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Thruster, ThrusterSet

SHIP = ThrusterSet(
    (
        Thruster("port", "azimuth", -32.0, -5.0, 1.9e5, 8.0),
        Thruster("starboard", "azimuth", -32.0, 5.0, 1.9e5, 8.0),
        Thruster("bow", "azimuth", 26.0, 0.0, 1.4e5, 6.0, sector_rad=(-1.2, 1.5)),
        Thruster("tunnel", "tunnel", 30.0, 0.0, 1.1e5, 5.0),
        Thruster("main", "main", -35.0, 0.0, 2.0e5, 10.0, 0.6),
    )
)
SAMPLE_S = 0.5
STEP_MAX = np.array([4e4, 2e4, 6e5])


def problem(
    ship: ThrusterSet = SHIP, *, thrust: float = 1.0, move: float = 0.01, slack: float = 100.0
) -> AllocationProblem:
    """Weights in multiples of 1/T², 1/Δf_max² and 1/Δτ_max²."""
    step = ship.largest_force_changes_per_sample(SAMPLE_S)
    return AllocationProblem(
        ship.T_e,
        build_limit_rows_of_thrusters(ship, 12),
        np.diag(thrust / ship.repeat_for_each_force_entry(ship.largest_thrusts_N) ** 2),
        np.diag(move / step**2),
        np.diag(slack / STEP_MAX**2),
        step,
        STEP_MAX,
    )


def situation(seed: int, reach: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """A demand some way off what the thrusters give now, and what they give: within all limits."""
    rng, rows = np.random.default_rng(seed), build_limit_rows_of_thrusters(SHIP, 12)
    f = rng.uniform(-1.0, 1.0, SHIP.n_f) * SHIP.repeat_for_each_force_entry(SHIP.largest_thrusts_N)
    f[4:6] = np.abs(f[4]) * np.array([1.0, 0.8])
    along, unlike = rows.G @ f, np.where(rows.low < 0.0, rows.low, -np.inf)
    over = np.maximum(along / rows.high, along / unlike)
    f /= max(1.0, float(over.max()) * 1.0001)
    assert (rows.G @ f >= rows.low).all()
    return SHIP.T_e @ f + reach * rng.uniform(-1.0, 1.0, 3) * STEP_MAX, f


def by_forces(case: AllocationProblem, tau: np.ndarray, f_prev: np.ndarray) -> np.ndarray:
    """f of the same problem, with f itself as the variables and τ_c − T_e f for the slack."""
    rows, eye, unit = (
        case.rows,
        np.eye(len(f_prev)),
        SHIP.repeat_for_each_force_entry(SHIP.largest_thrusts_N),
    )
    H = case.W + case.R + case.T_e.T @ case.slack @ case.T_e
    g = -case.R @ f_prev - case.T_e.T @ case.slack @ tau
    C = np.vstack((rows.G, -rows.G, eye, -eye)) * unit / 1e5
    b = np.concatenate((rows.high, -rows.low, f_prev + case.df_max, case.df_max - f_prev)) / 1e5
    share = quadprog.solve_qp(H * np.outer(unit, unit), -g * unit, -C.T, -b)[0]
    return np.asarray(share * unit)


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("seed", range(12))
def test_the_optimum_is_that_of_the_forces_themselves(units: Any, seed: int) -> None:
    case = problem()
    builder = AllocationQP(case, units=units)
    tau, f_prev = situation(seed)
    qp = AllocationQP(case).problem(AllocationQP(case).emit(tau, f_prev))
    optimum = certify(qp)
    assert optimum.bound < 1e-9
    z = optimum.z * builder.scale.z
    step = builder.emit(tau, f_prev)
    own = builder.problem(step)
    assert (own.n, own.m, own.block, own.moves) == (11, 3 + 6 + 6 + 8 + 1 + 1, 0, 8)
    assert own.objective(z) == pytest.approx(qp.objective(optimum.z), rel=1e-9)
    excess = np.concatenate((own.A @ z - step.u, step.l - own.A @ z))
    assert (excess / np.tile(builder.scale.row, 2)).max() < 1e-9
    f = f_prev + builder.moves(z)
    np.testing.assert_allclose(f, by_forces(case, tau, f_prev), atol=2.0)
    if units == "scaled":
        slack = z[builder.n_f :] * STEP_MAX
        np.testing.assert_allclose(slack, tau - SHIP.T_e @ f, atol=1e-4)


def least_slack(case: AllocationProblem, tau: np.ndarray, f_prev: np.ndarray) -> float:
    """The least max |s_i|/Δτ_max,i over all forces within the limits: a linear program."""
    rows, n_f = case.rows, len(f_prev)
    scaled = case.T_e * case.df_max / STEP_MAX[:, np.newaxis]
    short, before = (tau - case.T_e @ f_prev) / STEP_MAX, rows.G @ f_prev
    G, none, one = rows.G * case.df_max / 1e4, np.zeros((len(rows.G), 1)), np.ones((3, 1))
    A = np.block([[-scaled, -one], [scaled, -one], [G, none], [-G, none]])
    b = np.concatenate([-short, short, (rows.high - before) / 1e4, (before - rows.low) / 1e4])
    answer = linprog(np.eye(n_f + 1)[n_f], A, b, bounds=[(-1.0, 1.0)] * n_f + [(0.0, None)])
    assert answer.status == 0
    return float(answer.fun)


def slack_of(case: AllocationProblem, tau: np.ndarray, f_prev: np.ndarray) -> float:
    """The largest |s_i|/Δτ_max,i of the optimum."""
    builder = AllocationQP(case)
    z = certify(builder.problem(builder.emit(tau, f_prev))).z
    return float(np.abs(z[builder.n_f :]).max())


def test_the_slack_is_next_to_nothing_where_the_demand_is_attainable_and_only_there() -> None:
    """A linear program tells what is attainable; there the slack falls as 1/Ω."""
    attained = 0
    for seed in range(40):
        tau, f_prev = situation(seed, reach=1.6)
        least = least_slack(problem(), tau, f_prev)
        slack = slack_of(problem(), tau, f_prev)
        assert slack >= least - 1e-9
        if least > 1e-6:
            assert slack > 1e-6
            continue
        attained += 1
        assert slack < 1e-2
        assert slack_of(problem(slack=1e4), tau, f_prev) == pytest.approx(0.01 * slack, rel=0.05)
    assert 10 <= attained <= 30


def test_without_limits_it_becomes_the_pseudo_inverse() -> None:
    """β = 0, no limit in reach: the distance to the pseudo-inverse falls as 1/Ω."""
    tau = np.array([3e3, -2e3, 5e4])
    ship = replace(SHIP, thrusters=(*SHIP.thrusters[:2], SHIP.thrusters[3]))
    wanted = problem(ship).compute_weighted_pseudo_inverse() @ tau
    np.testing.assert_allclose(ship.T_e @ wanted, tau, rtol=1e-9)
    away = []
    for slack in (1e2, 1e4, 1e6):
        builder = AllocationQP(problem(ship, move=0.0, slack=slack))
        z = certify(builder.problem(builder.emit(tau, np.zeros(5)))).z
        assert np.abs(z[: builder.n_f]).max() < 0.9
        away.append(float(np.abs(builder.moves(z) - wanted).max()))
    assert away[0] < 0.01 * np.abs(wanted).max()
    assert away[1] == pytest.approx(0.01 * away[0], rel=0.05)
    assert away[2] == pytest.approx(0.0001 * away[0], rel=0.05)


def test_the_pseudo_inverse_without_lost_thrusters() -> None:
    case, tau = problem(), np.array([5e4, -3e4, 8e5])
    f = (
        case.compute_weighted_pseudo_inverse(case.rows.limits_after_loss_of_thrusters({1, 4}).lost)
        @ tau
    )
    assert (f[[2, 3, 7]] == 0.0).all()
    np.testing.assert_allclose(SHIP.T_e @ f, tau, rtol=1e-9)
    tunnel_alone = (
        case.compute_weighted_pseudo_inverse(
            case.rows.limits_after_loss_of_thrusters({0, 1, 2, 4}).lost
        )
        @ tau
    )
    scaled = SHIP.T_e[:, 6] / STEP_MAX
    assert tunnel_alone[6] == pytest.approx(scaled @ (tau / STEP_MAX) / (scaled @ scaled))


def test_the_mirrored_ship_does_the_mirrored_thing() -> None:
    ship = ThrusterSet((*SHIP.thrusters[:2], SHIP.thrusters[3]))
    builder = AllocationQP(problem(ship))
    rng = np.random.default_rng(5)
    mirror = np.zeros((5, 5))
    mirror[[0, 1, 2, 3, 4], [2, 3, 0, 1, 4]] = [1.0, -1.0, 1.0, -1.0, -1.0]
    for _ in range(10):
        f = (
            0.6
            * rng.uniform(-1.0, 1.0, 5)
            * ship.repeat_for_each_force_entry(ship.largest_thrusts_N)
        )
        tau = ship.T_e @ f + 2.0 * rng.uniform(-1.0, 1.0, 3) * STEP_MAX
        there = builder.moves(certify(builder.problem(builder.emit(tau, f))).z)
        tau_mirrored, f_mirrored = tau * [1.0, -1.0, -1.0], mirror @ f
        qp = builder.problem(builder.emit(tau_mirrored, f_mirrored))
        np.testing.assert_allclose(builder.moves(certify(qp).z), mirror @ there, atol=1e-3)


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_equalities_have_two_equal_sides(units: Any) -> None:
    builder = AllocationQP(problem(), units=units)
    rng = np.random.default_rng(0)
    for _ in range(200):
        step = builder.emit(1e6 * rng.normal(size=3), 1e5 * rng.normal(size=SHIP.n_f))
        np.testing.assert_array_equal(step.l[:3], step.u[:3])
        assert (step.l[3:] < step.u[3:]).all()


def test_a_lost_thruster_is_soon_at_nothing_and_every_step_has_an_answer() -> None:
    case, lost = problem(), {0, 3}
    builder, limits = AllocationQP(case), case.rows.limits_after_loss_of_thrusters(lost)
    for seed in range(4):
        tau, f = situation(seed)
        for _ in range(int(np.ceil(8.0 / SAMPLE_S / RAMP_DOWN_SHARE)) + 1):
            optimum = certify(builder.problem(builder.emit(tau, f, limits=limits)))
            assert np.isfinite(optimum.bound)
            f = f + builder.moves(optimum.z)
        assert np.abs(f[[0, 1, 6]]).max() < 1e-6
        assert np.abs(f[[2, 3, 4, 5, 7]]).max() > 1e4


WHOLE = (Piece(), Piece(), Piece())
NONE_LOST: frozenset[int] = frozenset()
FULL = np.ones(3)


@pytest.fixture
def thrusters() -> ThrusterSet:
    """Two stern azimuths of 100 kN, 5 m off the centre line, and a bow tunnel of 80 kN."""
    port = Thruster("port", "azimuth", -30.0, -5.0, 1e5, 10.0)
    starboard = Thruster("starboard", "azimuth", -30.0, 5.0, 1e5, 10.0)
    return ThrusterSet((port, starboard, Thruster("bow", "tunnel", 30.0, 0.0, 8e4, 8.0)))


def allocation(thrusters: ThrusterSet, *, room: bool = False, sides: int = 16) -> StaticAllocation:
    return StaticAllocation(thrusters, sides, [room, room, False], [3 * room, 3 * room, 0])


def forces(thrusters: ThrusterSet, qp: QuadraticProgram) -> np.ndarray:
    """The certified optimum in N."""
    optimum = certify(qp)
    assert optimum.kind != "infeasible"
    return optimum.z * thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N)


def test_the_optimum_balances_the_load_with_the_least_effort(thrusters: ThrusterSet) -> None:
    """T_e f = −load, and f is the weighted pseudo-inverse where no limit is met."""
    load = np.array([-4e4, 3e4, -2e5])
    f = forces(
        thrusters, allocation(thrusters).build_qp_for_static_load(load, FULL, WHOLE, NONE_LOST)
    )
    np.testing.assert_allclose(thrusters.T_e @ f, -load, rtol=1e-9, atol=1e-6)
    W_inverse, T_e = (
        np.diag(thrusters.repeat_for_each_force_entry(thrusters.largest_thrusts_N) ** 2),
        thrusters.T_e,
    )
    expected = W_inverse @ T_e.T @ np.linalg.solve(T_e @ W_inverse @ T_e.T, -load)
    np.testing.assert_allclose(f, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("sides", [8, 16, 36])
def test_the_most_ahead_is_full_thrust_times_its_share(thrusters: ThrusterSet, sides: int) -> None:
    """Corners lie ahead: 2 · 100 kN · β is held and no more."""
    shares = np.array([0.9, 0.9, 0.5])
    program = allocation(thrusters, sides=sides)
    for load_N, kind in ((1.8e5 * (1 - 1e-9), False), (1.8e5 * (1 + 1e-9), True)):
        qp = program.build_qp_for_static_load(
            np.array([-load_N, 0.0, 0.0]), shares, WHOLE, NONE_LOST
        )
        assert (certify(qp).kind == "infeasible") is kind


def test_what_is_lost_gives_nothing(thrusters: ThrusterSet) -> None:
    load = np.array([-4e4, 0.0, 0.0])
    f = forces(
        thrusters, allocation(thrusters).build_qp_for_static_load(load, FULL, WHOLE, frozenset({0}))
    )
    np.testing.assert_allclose(f[:2], 0.0, atol=1e-9)
    np.testing.assert_allclose(thrusters.T_e @ f, -load, rtol=1e-9, atol=1e-6)


def test_a_piece_keeps_a_force_in_its_sector_and_behind_its_chord(thrusters: ThrusterSet) -> None:
    """The port azimuth may push from 10° to 60° to port only, and there 40 % along a chord."""
    chord = np.array([[math.cos(-0.5), math.sin(-0.5), 0.4]])
    chosen = Piece((-1.0, -0.2), chord), Piece(), Piece()
    load = np.array([-1.2e5, 0.0, 0.0])
    f = forces(
        thrusters,
        allocation(thrusters, room=True).build_qp_for_static_load(load, FULL, chosen, NONE_LOST),
    )
    angle, size = math.atan2(f[1], f[0]), math.hypot(f[0], f[1])
    assert -1.0 - 1e-9 <= angle <= -0.2 + 1e-9
    assert size * math.cos(angle + 0.5) <= 0.4e5 * (1 + 1e-9)
    assert size > 1e4


def test_room_for_pieces_changes_the_shape_and_not_the_answer(thrusters: ThrusterSet) -> None:
    load = np.array([-1.5e5, 4e4, 1e6])
    builders = (allocation(thrusters, room=room) for room in (False, True))
    narrow, wide = (
        builder.build_qp_for_static_load(load, FULL, WHOLE, NONE_LOST) for builder in builders
    )
    assert wide.m == narrow.m + 2 * (2 + 3)
    np.testing.assert_allclose(certify(wide).z, certify(narrow).z, atol=1e-12)
