"""The referee against independent solvers, at its limits, and on what it must not certify."""

from __future__ import annotations

from fractions import Fraction

import clarabel
import numpy as np
import pytest
import quadprog
from scipy import sparse

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee import oracle
from dpbench.qp.referee.dyadic import Dyadic, is_semidefinite
from dpbench.qp.referee.joint import ExactMatrices, JointQP
from dpbench.qp.referee.kkt import KKTSystem, positive_definite
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.rational import rational_certificate
from dpbench.qp.referee.referee import Referee, certify, error_of
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
    l, u = -rng.random(m), rng.random(m)  # noqa: E741 - as in QuadraticProgram
    ones = np.ones(n)
    return QuadraticProgram(0.5 * (P + P.T), rng.normal(size=n), A, l, u, -ones, ones)


@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_quadprog(seed: int) -> None:
    """The certified optimum is that of the Goldfarb-Idnani solver."""
    qp = _random(12, 10, seed)
    eye = np.eye(qp.n)
    C = np.vstack((qp.A, eye, -qp.A, -eye))
    b = np.concatenate((qp.l, qp.lb, -qp.u, -qp.ub))
    z = quadprog.solve_qp(qp.P, -qp.q, C.T, b)[0]
    # cond(P) = 1e4 times the rounding of some 12 eliminations.
    assert np.abs(z - certify(qp).z).max() <= 1e-10


@pytest.mark.parametrize("seed", range(10))
def test_agrees_with_clarabel(seed: int) -> None:
    """The certified optimum is that of an interior-point solver, to its tolerance."""
    qp = _random(12, 10, seed, condition=100.0)
    eye = np.eye(qp.n)
    C = sparse.csc_matrix(np.vstack((qp.A, eye, -qp.A, -eye)))
    b = np.concatenate((qp.u, qp.ub, -qp.l, -qp.lb))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-13
    P = sparse.csc_matrix(np.triu(qp.P))
    cones = [clarabel.NonnegativeConeT(len(b))]
    answer = clarabel.DefaultSolver(P, qp.q, C, b, cones, settings).solve()
    # A gap of 1e-13 at the smallest eigenvalue 1e-2 leaves √(2·1e-13/1e-2) = 4.5e-6.
    assert np.abs(np.array(answer.x) - certify(qp).z).max() <= 1e-5


@pytest.mark.parametrize("n", [15, 30])
@pytest.mark.parametrize("condition", [1e4, 1e8])
def test_strict_problems_are_bounded_far_below_what_is_judged(n: int, condition: float) -> None:
    """Random problems with unit rows are certified to 1e-9 up to a condition of 1e8."""
    for seed in range(10):
        assert certify(_random(n, n, seed, condition)).bound <= 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_kinds_of_certificate_agree(seed: int) -> None:
    """The linear and the rational certificate enclose the same point."""
    qp = _random(8, 6, seed, condition=1e6)
    joint = JointQP.of(qp)
    guess = np.zeros(14, dtype=np.int8)
    exact = rational_certificate(joint, ExactMatrices.of(joint.P, joint.C), guess)
    assert exact is not None
    linear = certify(qp)
    assert linear.kind == "linear"
    assert np.abs(linear.z - exact.z).max() <= linear.bound + exact.bound


def test_nobody_to_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any guess the referee certifies the same optima."""
    with_guesses = [certify(_random(6, 5, seed)) for seed in range(4)]
    monkeypatch.setattr(oracle, "GUESSERS", ())
    for seed, known in enumerate(with_guesses):
        alone = certify(_random(6, 5, seed))
        assert np.abs(alone.z - known.z).max() <= alone.bound + known.bound <= 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_lying_guessers(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Who names the wrong active set cannot move the certified optimum."""
    rng = np.random.default_rng(seed)
    qp = _random(6, 5, seed)
    known = certify(qp)
    lie = rng.integers(-1, 2, qp.n + qp.m).astype(np.int8)
    monkeypatch.setattr(oracle, "GUESSERS", (lambda problem: lie,) * 2)
    found = certify(qp)
    assert np.abs(found.z - known.z).max() <= found.bound + known.bound <= 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_bounds_of_the_inverse_hold(seed: int) -> None:
    """The entrywise bounds contain the inverse in exact rational arithmetic."""
    qp = _random(5, 3, seed, condition=1e7)
    signs = np.array([1, -1, 0, 0, 0, 1, 0, 0], dtype=np.int8)
    system = KKTSystem(qp.P, np.vstack((qp.A, np.eye(5))), signs)
    assert system.proven
    inverse = system.inverse_bounds()
    for j in range(8):
        column = solve_exactly(system.K, np.eye(8)[j])
        assert all(
            abs(v) <= Fraction(b) for v, b in zip(column, inverse[:, j].tolist(), strict=True)
        )


def test_singular_matrix_is_not_proven_definite() -> None:
    """A singular, an indefinite and a barely indefinite matrix are not called definite."""
    assert positive_definite(np.diag([1.0, 1e-8]))
    for smallest in (0.0, -1e-18, -1e-8):
        assert not positive_definite(np.diag([1.0, smallest]))
    v = np.array([[1.0], [0.1]])
    assert not positive_definite(v @ v.T)


def test_definiteness_survives_rounding() -> None:
    """A matrix that rounding made exactly indefinite is never called definite.

    Products of rank two with rounded entries are indefinite by some 1e-16 about half the time,
    and a plain Cholesky factorisation does not always notice.
    """
    indefinite = 0
    for seed in range(100):
        B = np.random.default_rng(seed).normal(size=(2, 3))
        P = B.T @ B
        P = 0.5 * (P + P.T)
        if not is_semidefinite(Dyadic.of(P).whole):
            indefinite += 1
            assert not positive_definite(P)
    assert indefinite > 10


def test_semidefinite_cost_with_a_unique_optimum() -> None:
    """With semidefinite P a strictly active, regular optimum is certified: it is the only one."""
    P = np.diag([2.0, 0.0])
    qp = QuadraticProgram(P, [-1.0, 1.0], np.eye(2), [-INF] * 2, [INF] * 2, [-1.0] * 2, [1.0] * 2)
    optimum = certify(qp)
    assert optimum.kind == "linear"
    assert np.abs(optimum.z - [0.5, -1.0]).max() <= optimum.bound <= 1e-12


@pytest.mark.parametrize(
    ("P", "q"),
    [
        ([[1.0, 0.0], [0.0, 0.0]], [1.0, 0.0]),
        ([[1.0, 0.0], [0.0, -1.0]], [0.5, 0.5]),
        ([[1.0, 0.0], [0.0, -1e-18]], [0.5, 0.5]),
        ([[1.0, 0.0], [0.0, np.nan]], [0.5, 0.5]),
        ([[1.0, 0.0], [0.0, 1.0]], [0.5, np.nan]),
        ([[1.0, 0.0], [0.0, 1.0]], [0.5, np.inf]),
    ],
    ids=["many optima", "saddle", "tiny saddle", "NaN in P", "NaN in q", "inf in q"],
)
def test_nothing_is_claimed_without_a_unique_optimum(P: object, q: object) -> None:
    """Where no unique optimum exists, or the data are no numbers, nothing is certified."""
    qp = QuadraticProgram(P, q, np.zeros((0, 2)), [], [], [-1.0] * 2, [1.0] * 2)  # type: ignore[arg-type]  # lists become arrays
    optimum = certify(qp)
    assert (optimum.kind, optimum.bound) == ("none", INF)
    assert np.isnan(optimum.z).all()
    assert np.isnan(error_of(np.zeros(2), optimum, 0)).all()


def test_inputs_are_copied_and_left_alone() -> None:
    """A referee neither writes to what it is given nor follows later changes of it."""
    qp = _random(6, 5, 3)
    arrays = {name: getattr(qp, name).copy() for name in ("P", "A", "lb", "ub", "q", "l", "u")}
    referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
    first: Optimum = referee.certify(qp.q, qp.l, qp.u)
    assert all((getattr(qp, name) == array).all() for name, array in arrays.items())
    kept = first.z.copy()
    qp.P[:], qp.A[:], qp.lb[:], qp.ub[:] = 0.0, 0.0, 0.0, 0.0
    again = referee.certify(arrays["q"], arrays["l"], arrays["u"])
    assert (again.z == kept).all()
    assert (first.z == kept).all()
