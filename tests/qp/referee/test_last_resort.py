"""Optima that only the last resort certifies."""

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee import guesses
from dpbench.qp.referee.implied import (
    remove_limits_of_zero_rows,
    turn_always_met_limits_into_equalities,
)
from dpbench.qp.referee.kkt import KKTSystem
from dpbench.qp.referee.last_resort import LastResort, enclose_all_optima
from dpbench.qp.referee.optimum import (
    ExactMatrices,
    JointQP,
    Optimum,
    Proof,
    Scales,
    is_exact_after_power_of_two_scaling,
)
from dpbench.qp.referee.rational import prove_optimum_in_exact_arithmetic
from dpbench.qp.referee.referee import Referee, certify
from dpbench.qp.residuals import are_answers_correct, residuals
from dpbench.qp.solution import Solution, Status

INF = np.inf
BOUND = 1e-9


@dataclass(frozen=True)
class Planted:
    """A problem, its optimum, and the unit each variable is in."""

    qp: QuadraticProgram
    z: NDArray[np.float64]
    unit: NDArray[np.float64]


def plant(
    seed: int,
    n: int,
    *,
    equal: int,
    strict: int,
    weak: int,
    bounds: int = 0,
    rank: int | None = None,
    spread: int = 0,
    density: float = 1.0,
) -> Planted:
    """A problem with so many equality, strictly and weakly active rows and strictly active bounds.

    As many inactive rows again and no bound on the other variables; P has the given rank, and is
    definite without one; `spread` scales variables and rows by powers of two up to 2^±spread.
    """
    rng = np.random.default_rng(seed)
    m = 2 * (equal + strict + weak)
    B = rng.integers(-2, 3, (n if rank is None else rank, n)) * (rng.random(n) < density)
    P = B.T @ B + (np.eye(n) if rank is None else 0.0)
    A = (rng.integers(-3, 4, (m, n)) * (rng.random((m, n)) < density)).astype(float)
    z = rng.integers(-16, 17, n) / 8
    value, side = A @ z, rng.choice([-1.0, 1.0], m)
    size = rng.integers(1, 16, m) / 8
    kind = np.repeat(["equal", "strict", "weak", "free"], [equal, strict, weak, m // 2])
    y = np.where(np.isin(kind, ["equal", "strict"]), side * size, 0.0)
    room, both = np.where(kind == "free", size, 0.0), np.isin(kind, ["free", "equal"])
    u = np.where((side > 0) | both, value + room, INF)
    l = np.where((side < 0) | both, value - room, -INF)  # noqa: E741 - l as in QP
    lb, ub, y_box = np.full(n, -INF), np.full(n, INF), np.zeros(n)
    held = rng.permutation(n)[:bounds]
    lb[held], y_box[held] = z[held], -rng.integers(1, 16, bounds) / 8
    q = -(P @ z + A.T @ y + y_box)
    D, R = (2.0 ** rng.integers(-spread, spread + 1, count) for count in (n, m))
    scaled = P / np.outer(D, D), q / D, R[:, None] * A / D, R * l, R * u, lb * D, ub * D
    return Planted(QuadraticProgram(*scaled), z * D, D)


def _certified(known: Planted) -> Optimum:
    optimum = certify(known.qp)
    assert optimum.kind in ("linear", "gap", "rational")
    assert np.abs(optimum.z - known.z).max() <= optimum.bound <= BOUND * known.unit.max()
    return optimum


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("spread", [0, 10])
def test_weak_rows_beside_equalities(seed: int, spread: int) -> None:
    known = plant(seed, 60, equal=15, strict=10, weak=10, spread=spread)
    optimum = _certified(known)
    answer = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
    if not spread:
        assert are_answers_correct(known.qp.q[np.newaxis], residuals(known.qp, answer), 0.0, 1e-6)


def test_definite_in_other_units() -> None:
    for seed in range(3):
        _certified(plant(seed, 120, equal=20, strict=10, weak=10, density=0.2, spread=25))


@pytest.mark.slow
@pytest.mark.parametrize("n", [150, 300])
def test_sparse_and_large(n: int) -> None:
    _certified(plant(n, n, equal=n // 3, strict=n // 10, weak=n // 10, density=0.1, spread=6))


@settings(max_examples=80, derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 12),
    st.integers(0, 4),
    st.integers(0, 4),
    st.integers(0, 4),
    st.integers(0, 20),
)
def test_bound_holds_on_its_own(
    seed: int, n: int, equal: int, strict: int, weak: int, spread: int
) -> None:
    known = plant(seed, n, equal=equal, strict=strict, weak=weak, spread=spread)
    proof = _resort(known.qp)
    if proof is not None:
        assert np.abs(proof.z - known.z).max() <= proof.bound
    if equal + strict + weak <= n // 2:
        assert proof is not None
        assert proof.bound <= BOUND * known.unit.max()


def _resort(qp: QuadraticProgram) -> Proof | None:
    joint = JointQP.from_qp(qp)
    return LastResort(joint.P, joint.C, convex=True).prove_optimum(joint)


@pytest.mark.slow
@settings(max_examples=40, derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(2, 12),
    st.integers(0, 3),
    st.integers(0, 4),
    st.integers(0, 6),
    st.integers(0, 8),
)
def test_singular_cost(
    seed: int, n: int, equal: int, strict: int, bounds: int, spread: int
) -> None:
    sizes = {"bounds": min(bounds, n), "rank": seed % n, "spread": spread}
    known = plant(seed, n, equal=equal, strict=strict, weak=1, **sizes)
    optimum = certify(known.qp)
    assert optimum.kind != "infeasible"
    if np.isfinite(optimum.bound):
        assert np.abs(optimum.z - known.z).max() <= optimum.bound
        assert optimum.bound <= 1e-6 * max(1.0, np.abs(known.z).max())


@pytest.mark.parametrize("seed", range(5))
def test_degenerate_vertex_of_a_linear_program(seed: int) -> None:
    _certified(plant(seed, 45, equal=5, strict=60, weak=0, rank=0))


def test_many_minimisers_have_no_certificate() -> None:
    ones = np.ones(2)
    for q in ([1.0, 0.0], [0.0, 0.0], [1.0, 1.0]):
        qp = QuadraticProgram(np.zeros((2, 2)), q, [[1.0, 1.0]], [0.5], [0.5], -ones, ones)
        assert (certify(qp).bound < INF) is (q == [1.0, 0.0])


@pytest.mark.parametrize(("row", "certified"), [([0.0, 1.0], True), ([1.0, 0.0], False)])
def test_cost_convex_where_equalities_leave_room(row: list[float], certified: bool) -> None:
    P, free = np.diag([1.0, -1.0]), np.full(2, INF)
    qp = QuadraticProgram(P, [-1.0, 0.0], [row], [0.25], [0.25], -free, free)
    optimum = certify(qp)
    assert (optimum.bound < 1e-12) is certified
    if certified:
        assert np.abs(optimum.z - [1.0, 0.25]).max() <= optimum.bound


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_exact_arithmetic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    B, A, u = rng.normal(size=(9, 9)), rng.normal(size=(6, 9)), rng.normal(size=6)
    limits = np.where(np.arange(6) < 3, u, -INF), u, [-5.0] * 9, [5.0] * 9
    P = 0.5 * (B.T @ B + (B.T @ B).T)
    qp = QuadraticProgram(P, rng.normal(size=9), A, *limits)
    joint = JointQP.from_qp(qp)
    start = np.zeros(15, dtype=np.int8)
    exact = prove_optimum_in_exact_arithmetic(
        joint, ExactMatrices.from_float_matrices(joint.P, joint.C), start
    )
    proof = _resort(qp)
    assert exact is not None and (proof is None) is (exact.kind == "infeasible")
    if proof is None:
        return
    assert np.abs(proof.z - exact.z).max() <= proof.bound + exact.bound
    assert proof.bound <= BOUND


@pytest.mark.parametrize("rank", [0, 1, 2])
@pytest.mark.parametrize("q", [(-2.0, 0.5), (-0.25, -0.25), (3.0, -3.0), (0.125, 0.5), (0.0, 0.0)])
def test_every_active_set(q: tuple[float, float], rank: int) -> None:
    """Given any active set the enclosure is silent or covers a minimiser of z_1 + z_2 = 1/4."""
    P = np.diag([1.0, 1.0]) if rank == 2 else np.diag([float(rank), 0.0])
    C = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    U = np.array([0.25, 1.0, 1.0])
    problem = JointQP(P, np.array(q), C, np.array([0.25, -1.0, -1.0]), U)
    slope, curvature = q[0] - q[1] - 0.25 * P[1, 1], P[0, 0] + P[1, 1]
    best = None
    if curvature or slope:
        free = -slope / curvature if curvature else -INF * slope
        best = float(np.clip(free, -0.75, 1.0))
    bounds = []
    for rest in product((-1, 0, 1), repeat=2):
        system = KKTSystem(P, C, np.array([1, *rest], dtype=np.int8))
        if not system.is_proven_nonsingular:
            continue
        inward = np.array([0.0] + [1.0] * (len(system.rows) - 1))
        exact = ExactMatrices.from_float_matrices(P, C)
        found = enclose_all_optima(problem, exact, system, inward, convex=True)
        if found is not None:
            assert best is not None and (np.abs(found.z - [best, 0.25 - best]) <= found.bound).all()
            bounds.append(found.bound.max())
    assert best is None or min(bounds) <= 1e-12


def _cycle(change: float = 0.0) -> JointQP:
    """Rows z_1 ≥ z_2 ≥ … ≥ z_5 ≥ z_1 (all equal), an equality row twice, and an empty row."""
    eye, ones, free = np.eye(5), np.ones(5), np.full(5, INF)
    A = np.vstack((eye - np.roll(eye, 1, axis=1), ones, 3.0 * ones, 0.0 * ones))
    limits = [0.0] * 4 + [-change, 2.0, 6.0, -1.0], [INF] * 5 + [2.0, 6.0, 1.0]
    return JointQP.from_qp(QuadraticProgram(eye, np.arange(5), A, *limits, -free, free))


def test_implied_equalities_are_found_exactly() -> None:
    problem = remove_limits_of_zero_rows(_cycle())
    assert np.isinf(problem.L[7])
    touched = np.array([-1] * 5 + [1, 1] + [0] * 6, dtype=np.int8)
    found = turn_always_met_limits_into_equalities(problem, touched)
    assert found is not None
    equal = found.L == found.U
    assert equal.sum() == 5
    assert np.linalg.matrix_rank(found.C[equal]) == 5
    assert (
        turn_always_met_limits_into_equalities(
            remove_limits_of_zero_rows(_cycle(2.0**-60)), touched
        )
        is None
    )


def test_circle_of_rows_is_certified(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = _cycle()
    proof = LastResort(problem.P, problem.C, convex=True).prove_optimum(problem)
    assert proof is not None
    # The bound is less than what 0.4 is off from two fifths.
    assert max(abs(Fraction(z) - Fraction(2, 5)) for z in proof.z.tolist()) <= proof.bound <= 1e-12
    assert np.isnan(proof.y).all()
    # With nobody to guess it is silent.
    monkeypatch.setattr(guesses, "GUESSERS", ())
    assert LastResort(problem.P, problem.C, convex=True).prove_optimum(problem) is None


@pytest.mark.parametrize("seed", range(5))
def test_other_units_are_the_same_problem_to_the_last_bit(seed: int) -> None:
    known = plant(seed, 8, equal=2, strict=2, weak=2, bounds=2, spread=25)
    joint = JointQP.from_qp(known.qp)
    scales = Scales.compute_ruiz_scales(joint.P, joint.C)
    P, C = scales.scale_cost_matrix(joint.P), scales.scale_constraint_rows(joint.C)
    scaled = scales.scale_problem(joint, P, C)
    D, R = scales.D, scales.R
    assert (P / scales.cost / np.outer(D, D) == joint.P).all()
    assert (C / np.outer(R, D) == joint.C).all()
    assert (C[-8:] == np.eye(8)).all()
    assert (scaled.q / D / scales.cost == joint.q).all()
    assert (scaled.U / R == joint.U).all()
    sizes = np.abs(C[:-8]).max(axis=1)
    assert sizes[sizes > 0.0].max() <= 8.0 * sizes[sizes > 0.0].min()


def test_numbers_out_of_range_are_left_alone() -> None:
    """Numbers that scaling could push out of float64 are refused, infinite limits are not."""
    assert is_exact_after_power_of_two_scaling(np.array([1.0, 0.0, INF]))
    assert not is_exact_after_power_of_two_scaling(np.array([1e300]))
    assert not is_exact_after_power_of_two_scaling(np.array([1.0, 1e-300]))


def test_referee_keeps_its_last_resort() -> None:
    known = plant(3, 50, equal=12, strict=6, weak=6)
    qp = known.qp
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    for q in (qp.q, qp.q + 1.0, qp.q):
        one, two = referee.certify_vectors(q, qp.l, qp.u), certify(replace(qp, q=q))
        assert np.abs(one.z - two.z).max() <= one.bound + two.bound <= BOUND
