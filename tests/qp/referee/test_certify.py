"""The referee against independent solvers, at its limits, and on what it must not certify."""

from dataclasses import fields
from fractions import Fraction
from functools import partial
from itertools import product

import numpy as np
import pytest
import quadprog

from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import ARRAYS, QPStep, QuadraticProgram
from dpbench.qp.referee import guesses
from dpbench.qp.referee.dyadic import Dyadic, is_integer_matrix_semidefinite
from dpbench.qp.referee.gap import prove_optimum_by_duality_gap
from dpbench.qp.referee.kkt import (
    Geometry,
    KKTSystem,
    is_proven_positive_definite,
    prove_optimum_by_kkt_error_bounds,
)
from dpbench.qp.referee.optimum import ExactMatrices, JointQP, Optimum
from dpbench.qp.referee.rational import prove_optimum_in_exact_arithmetic
from dpbench.qp.referee.referee import (
    Referee,
    certify,
    get_shared_referee,
    measure_first_move_and_plan_errors_of_many,
)
from dpbench.qp.residuals import are_answers_correct, residuals
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import condense, load_scenario
from tests.qp.referee.test_kernels import solve_exactly

INF = np.inf


def _random(n: int, m: int, seed: int, condition: float = 1e4) -> QuadraticProgram:
    """A random problem with unit rows and a P of the given condition; z = 0 is feasible."""
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.logspace(0.0, -np.log10(condition), n)) @ Q.T
    A = rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.3)
    A[np.arange(m), np.arange(m) % n] += 1.0
    A /= np.linalg.norm(A, axis=1)[:, np.newaxis]
    limits = -rng.random(m), rng.random(m), -np.ones(n), np.ones(n)
    return QuadraticProgram(0.5 * (P + P.T), rng.normal(size=n), A, *limits)


@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_quadprog(seed: int) -> None:
    qp = _random(12, 10, seed)
    eye = np.eye(qp.n)
    C = np.vstack((qp.A, eye, -qp.A, -eye))
    b = np.concatenate((qp.l, qp.lb, -qp.u, -qp.ub))
    z = quadprog.solve_qp(qp.P, -qp.q, C.T, b)[0]
    # cond(P) = 1e4 times the rounding of some 12 eliminations.
    assert np.abs(z - certify(qp).z).max() <= 1e-10


@pytest.mark.parametrize("n", [15, 30])
@pytest.mark.parametrize("condition", [1e4, 1e8])
def test_strict_problems_are_bounded_far_below_what_is_judged(n: int, condition: float) -> None:
    for seed in range(10):
        assert certify(_random(n, n, seed, condition)).bound <= 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_missing_and_false_guesses_do_not_move_the_optimum(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    qp = _random(6, 5, seed)
    known, lie = certify(qp), np.random.default_rng(seed).integers(-1, 2, 11).astype(np.int8)
    for guessers in ((), (lambda problem: lie,) * 2):
        monkeypatch.setattr(guesses, "GUESSERS", guessers)
        found = certify(qp)
        assert np.abs(found.z - known.z).max() <= found.bound + known.bound <= 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_bounds_of_the_inverse_hold(seed: int) -> None:
    qp = _random(5, 3, seed, condition=1e7)
    signs = np.array([1, -1, 0, 0, 0, 1, 0, 0], dtype=np.int8)
    system = KKTSystem(qp.P, np.vstack((qp.A, np.eye(5))), signs)
    assert system.is_proven_nonsingular
    inverse = system.bound_inverse_entrywise()
    for j in range(8):
        pairs = zip(solve_exactly(system.K, np.eye(8)[j]), inverse[:, j].tolist(), strict=True)
        assert all(abs(value) <= Fraction(bound) for value, bound in pairs)


def test_singular_matrix_is_not_proven_definite() -> None:
    assert is_proven_positive_definite(np.diag([1.0, 1e-8]))
    for smallest in (0.0, -1e-18, -1e-8):
        assert not is_proven_positive_definite(np.diag([1.0, smallest]))
    v = np.array([[1.0], [0.1]])
    assert not is_proven_positive_definite(v @ v.T)


def test_definiteness_survives_rounding() -> None:
    indefinite = 0
    for seed in range(100):
        B = np.random.default_rng(seed).normal(size=(2, 3))
        P = 0.5 * (B.T @ B + (B.T @ B).T)
        if not is_integer_matrix_semidefinite(Dyadic.from_floats(P).whole):
            indefinite += 1
            assert not is_proven_positive_definite(P)
    assert indefinite > 10


BOX = [-1.0] * 2, [1.0] * 2


def test_semidefinite_cost_with_a_unique_optimum() -> None:
    qp = QuadraticProgram(np.diag([2.0, 0.0]), [-1.0, 1.0], np.zeros((0, 2)), [], [], *BOX)
    optimum = certify(qp)
    assert optimum.kind == "linear"
    assert np.abs(optimum.z - [0.5, -1.0]).max() <= optimum.bound <= 1e-12


@pytest.mark.parametrize(
    ("last", "q"),
    [
        (0.0, [1.0, 0.0]),
        (-1.0, [0.5, 0.5]),
        (-1e-18, [0.5, 0.5]),
        (np.nan, [0.5, 0.5]),
        (1.0, [0.5, np.nan]),
        (1.0, [0.5, np.inf]),
    ],
    ids=["many optima", "saddle", "tiny saddle", "NaN in P", "NaN in q", "inf in q"],
)
def test_nothing_is_claimed_without_a_unique_optimum(last: float, q: list[float]) -> None:
    optimum = certify(QuadraticProgram(np.diag([1.0, last]), q, np.zeros((0, 2)), [], [], *BOX))
    assert (optimum.kind, optimum.bound) == ("none", INF)
    assert np.isnan(optimum.z).all()
    assert np.isnan(
        measure_first_move_and_plan_errors_of_many(np.zeros((1, 2)), [optimum], 0)
    ).all()


@pytest.mark.parametrize(
    ("P", "q", "upper", "reason"),
    [
        (-1.0, 0.0, 1.0, "P is not proven positive semidefinite"),
        (1.0, np.nan, 1.0, "q"),
        (np.nan, 0.0, 1.0, "P"),
        (1.0, 0.0, np.nan, "limits are NaN"),
    ],
)
def test_data_that_forbid_a_certificate_are_named(
    P: float, q: float, upper: float, reason: str
) -> None:
    rows = np.zeros((0, 2)), [], []
    qp = QuadraticProgram(P * np.eye(2), np.full(2, q), *rows, -np.ones(2), np.full(2, upper))
    optimum = certify(qp)
    assert optimum.kind == "none" and reason in optimum.reason
    assert optimum.reason in repr(optimum)


def test_inputs_are_copied_and_left_alone() -> None:
    qp = _random(6, 5, 3)
    given = qp.copy()
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    first = referee.certify_vectors(qp.q, qp.l, qp.u)
    assert all((getattr(qp, name) == getattr(given, name)).all() for name in ARRAYS)
    kept = first.z.copy()
    qp.P[:], qp.A[:], qp.lb[:], qp.ub[:] = 0.0, 0.0, 0.0, 0.0
    again = referee.certify_vectors(given.q, given.l, given.u)
    assert (again.z == kept).all() and (first.z == kept).all()


ACTIVE_SETS = [np.array(signs, dtype=np.int8) for signs in product((-1, 0, 1), repeat=3)]


def _problem(q: tuple[float, float]) -> JointQP:
    """min ½‖z‖² + qᵀz, |z_i| ≤ 1, |z_1 + z_2| ≤ 1/2: its optimum is a projection."""
    C = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    U = np.array([0.5, 1.0, 1.0])
    return JointQP(np.eye(2), np.array(q), C, -U, U)


CASES = {
    # cost: optimum, the projection of −q on the feasible set
    (0.0, 0.0): (0.0, 0.0),
    (-0.125, -0.25): (0.125, 0.25),
    (-1.0, -1.0): (0.25, 0.25),
    (-2.0, 0.5): (1.0, -0.5),
    (-1.0, 0.5): (1.0, -0.5),
    (3.0, -3.0): (-1.0, 1.0),
    (-0.25, -0.25): (0.25, 0.25),
}


@pytest.mark.parametrize("q", CASES)
def test_linear_certificate(q: tuple[float, float]) -> None:
    problem = _problem(q)
    for signs in ACTIVE_SETS:
        system = KKTSystem(problem.P, problem.C, signs)
        if system.is_proven_nonsingular:
            proof = prove_optimum_by_kkt_error_bounds(problem, Geometry(problem.C), system)
            assert proof is None or np.abs(proof.z - CASES[q]).max() <= proof.bound <= 1e-12


@pytest.mark.parametrize("q", CASES)
def test_gap_certificate(q: tuple[float, float]) -> None:
    problem = _problem(q)
    exact = ExactMatrices.from_float_matrices(problem.P, problem.C)
    systems, bounds = partial(KKTSystem, problem.P, problem.C), []
    for signs in ACTIVE_SETS:
        proof = prove_optimum_by_duality_gap(
            problem, exact, systems, signs, np.eye(2) * (1.0 + 1e-12)
        )
        if proof is not None:
            assert np.abs(proof.z - CASES[q]).max() <= proof.bound
            bounds.append(proof.bound)
    assert min(bounds) <= 1e-12


@pytest.mark.parametrize("q", CASES)
def test_rational_certificate(q: tuple[float, float]) -> None:
    problem = _problem(q)
    exact = ExactMatrices.from_float_matrices(problem.P, problem.C)
    for signs in ACTIVE_SETS:
        proof = prove_optimum_in_exact_arithmetic(problem, exact, signs)
        assert proof is not None
        # All coordinates of these optima are float64 numbers.
        assert tuple(proof.z) == CASES[q]


@pytest.mark.parametrize("name", ["paper", "rough"])
@pytest.mark.parametrize("drop", [False, True])
def test_steps_of_a_scenario(name: str, drop: bool) -> None:
    builder = condense(load_scenario(name))
    control = builder.control
    referee = Referee(builder.P, builder.A, builder.lb, builder.ub)
    rng = np.random.default_rng(0)
    eye = np.eye(builder.n)
    C = np.vstack((builder.A, eye, -builder.A, -eye)).T.copy()
    for _ in range(20):
        x = 1e-3 * rng.normal(size=control.model.n_x)
        y_ref = rng.normal(size=3) * [3.0, 3.0, 0.1]
        u_prev = control.u_max * rng.uniform(0.7, 1.0, 3)
        limits = Limits(0.4 * control.u_min, 0.4 * control.u_max) if drop else None
        step = builder.emit(x, y_ref, u_prev, limits=limits)
        qp = builder.problem(step)
        optimum = referee.certify_vectors(step.q, step.l, step.u)
        assert optimum.kind == "linear"
        assert optimum.bound <= 1e-12
        answer = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
        assert are_answers_correct(qp.q[np.newaxis], residuals(qp, answer), 0.0, 1e-6)
        # quadprog wants some interior: limits a part in 1e9 wider move z by no more than
        # 1e-9 times the Lipschitz constant of the optimum, which cond(P) < 1e3 bounds.
        wider = np.concatenate((step.l, qp.lb, -step.u, -qp.ub)) - 1e-9
        z = quadprog.solve_qp(qp.P, -step.q, C, wider)[0]
        assert np.abs(z - optimum.z).max() <= 1e-6


def test_what_is_known_of_the_matrices_changes_no_answer() -> None:
    builder = condense(load_scenario("rough"))
    matrices = builder.P, builder.A, builder.lb, builder.ub
    rng = np.random.default_rng(3)
    runs: list[list[QPStep]] = [[], []]
    for run in (*[runs[0]] * 30, *[runs[1]] * 30):
        x, y_ref = 1e-3 * rng.normal(size=9), rng.normal(size=3) * [9.0, 9.0, 0.3]
        run.append(builder.emit(x, y_ref, builder.control.u_max * rng.uniform(-1.0, 1.0, 3)))

    def certified(referee: Referee, run: int) -> list[Optimum]:
        return [referee.certify_vectors(step.q, step.l, step.u) for step in runs[run]]

    alone = [certified(Referee(*matrices), run) for run in range(2)]
    for run in (0, 1, 1, 0):
        for found, wanted in zip(
            certified(get_shared_referee(*matrices), run), alone[run], strict=True
        ):
            for part in fields(Optimum):
                np.testing.assert_array_equal(getattr(found, part.name), getattr(wanted, part.name))
