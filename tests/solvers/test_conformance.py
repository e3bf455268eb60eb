"""Conformance of every solver of the table to the contract, whatever its library does."""

import gc
import time
from math import isfinite

import numpy as np
import psutil
import pytest
from packaging.version import Version

from dpbench.bench.run.formulation import BoxFormulation
from dpbench.bench.run.timed_solver import StepTimeLimitError, TimedSolver, is_usable
from dpbench.errors import ShapeError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Status
from dpbench.solvers.contract import INFEASIBLE_CALLED_ERROR
from dpbench.solvers.table import TABLE, find_solver_availability

LAST_BITS = 1e-14
"""Rounding of kernels that begin where memory is aligned, as in ProxQP; a trace of an earlier solve
is of the size of its tolerance."""
INF = np.inf
CYCLES, WINDOWS = 70, 5
PAGES = 64 * 4096  # what an allocator may take at once
TWO = 2.0 * np.eye(2)


def problem(P, q, A, l, u, lb, ub):  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    rows = np.reshape(np.asarray(A, dtype=float), (-1, len(q)))
    return QuadraticProgram(P, q, rows, l, u, lb, ub)


# name: problem, then z, y and y_box; each derived by hand from P z + q + Aᵀy + y_box = 0.
KNOWN = {
    # Unconstrained optimum (3, −3) cut to (1, −1); 2z + q = (−4, 4).
    "row 0 at its upper limit, row 1 at its lower one": (
        problem(TWO, [-6, 6], np.eye(2), [-9, -1], [1, 9], [-9, -9], [9, 9]),
        ([1, -1], [4, -4], [0, 0]),
    ),
    # With bounds, and without any row.
    "variable 0 at its upper bound, variable 1 at its lower one": (
        problem(TWO, [-6, 6], [], [], [], [-9, -1], [1, 9]),
        ([1, -1], [], [4, -4]),
    ),
    # By symmetry z = (½, ½) on z0 + z1 = 1; P z + q = −5/2 in both.
    "a coupled cost on one row": (
        problem([[2, 1], [1, 2]], [-4, -4], [[1, 1]], [-1], [1], [-9, -9], [9, 9]),
        ([0.5, 0.5], [2.5], [0, 0]),
    ),
    # z0 = ½ at its bound, z0 − z1 = −1 at its lower limit; 2z + q = (−1, −3).
    "one side of each limit infinite": (
        problem(TWO, [-2, -6], [[1, 1], [1, -1]], [-INF, -1], [INF, INF], [-INF, -5], [0.5, INF]),
        ([0.5, 1.5], [0, -3], [4, 0]),
    ),
    # Projection of (1, 3) on z0 + z1 = 1.
    "an equality row": (
        problem(TWO, [-2, -6], [[1, 1]], [1], [1], [-9, -9], [9, 9]),
        ([-0.5, 1.5], [3], [0, 0]),
    ),
    "a fixed variable": (
        problem(TWO, [-2, -6], [[1, 1]], [-9], [9], [-9, 0.5], [9, 0.5]),
        ([1, 0.5], [0], [0, 5]),
    ),
    "nothing active": (
        problem(TWO, [-2, -6], [[1, 1]], [-9], [9], [-9, -9], [9, 9]),
        ([1, 3], [0], [0, 0]),
    ),
    "nothing limited": (
        problem(TWO, [-2, -6], [[1, 1]], [-INF], [INF], [-INF, -INF], [INF, INF]),
        ([1, 3], [0], [0, 0]),
    ),
}


def patience(configuration):
    """Settings under which an infeasible or undefined problem is given up soon."""
    if configuration.solver == "scs":
        return {"max_iters": 2000}
    if not configuration.solver.startswith("proxqp"):
        return {}
    return {"max_iter": 50, **({"max_iter_in": 50} if configuration.route == "native" else {})}


INFEASIBLE = problem(TWO, [-2, -6], [[1, 1]], [3], [4], [-1, -1], [1, 1])


def kkt_residual(qp, s):
    """Stationarity, feasibility and complementarity with the signs of `Solution`."""
    worst = [np.abs(qp.P @ s.z + qp.q + qp.A.T @ s.y + s.y_box).max()]
    for w, low, high, y in ((qp.A @ s.z, qp.l, qp.u, s.y), (s.z, qp.lb, qp.ub, s.y_box)):
        worst += [(w - high).max(initial=0.0), (low - w).max(initial=0.0)]
        worst += [(np.maximum(y, 0.0) * (high - w)).max(), (np.maximum(-y, 0.0) * (w - low)).max()]
    return max(worst)


def assert_certified(configuration, answer, qp):
    np.testing.assert_allclose(answer.z, certify(qp).z, rtol=0, atol=configuration.tolerance)


@pytest.mark.parametrize("name", KNOWN)
def test_known_optimum(configuration, name, solve_qp):
    qp, expected = KNOWN[name]
    answer = solve_qp(configuration.open(), qp)
    # With some kernels of OpenBLAS the residuals of superADMM stay above 1e-9 at the optimum.
    stalled = configuration.solver == "superadmm" and answer.status is Status.MAX_ITERATIONS
    assert answer.status is Status.SOLVED or stalled
    for part, known, factor in zip(parts(answer), expected, (1, 10, 10), strict=True):
        np.testing.assert_allclose(part, known, rtol=0, atol=factor * configuration.tolerance)


def parts(answer):
    return answer.z, answer.y, answer.y_box


def test_updated_answers_are_those_of_a_new_setup_and_optimal(configuration, sequence, solve_qp):
    atol = LAST_BITS if configuration.exact_again else 2 * configuration.tolerance
    answers = sequence.answers(configuration.open())
    for step, answer in zip(sequence.steps, answers, strict=True):
        qp = sequence.base.at(step)
        assert answer.status is Status.SOLVED
        assert kkt_residual(qp, answer) <= 10 * configuration.tolerance
        new = solve_qp(configuration.open(), qp)
        np.testing.assert_allclose(answer.z, new.z, rtol=0, atol=atol)


def test_limits_may_become_infinite_equal_and_finite_again(configuration, sequence):
    first, second, third = sequence.steps[:3]
    low, high = second.l.copy(), second.u.copy()
    low[0], high[1], low[2:4], high[2] = -INF, INF, (0.25, -INF), 0.25
    steps = [first, QPStep(second.q, low, high), third]
    answers = sequence._replace(steps=steps).answers(configuration.open())
    for step, answer in zip(steps, answers, strict=True):
        assert_certified(configuration, answer, sequence.base.at(step))


def test_matrices_may_change(configuration, sequence, solve_next):
    workspace = configuration.open()
    base, (step, later) = sequence.base, sequence.steps[:2]
    matrices = 2.0 * base.P, -base.A, 0.5 * base.lb, 0.25 * base.ub
    changed = QPStep(step.q, step.l, step.u, *matrices)
    workspace.setup(base)
    workspace.update(changed)
    answer = solve_next(workspace, later)
    assert workspace.matrix_updates == 1
    assert_certified(configuration, answer, base.at(changed).at(later))


@pytest.mark.parametrize("rebuilt", [False, True])
def test_inputs_stay_unchanged_and_are_not_shared(
    configuration, sequence, rebuilt, solve_qp, solve_next
):
    base, step = sequence.base, sequence.steps[0]
    if rebuilt:
        step.l[1] = -INF
    vectors = [step.q, step.l, step.u]
    arrays = [base.P, base.q, base.A, base.l, base.u, base.lb, base.ub, *vectors]
    copies, qp = [array.copy() for array in arrays], base.at(step).copy()
    workspace, again = configuration.open(), configuration.open()
    solve_qp(workspace, base)
    expected = solve_next(workspace, step).z
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    solve_qp(again, base)
    for array in arrays[: -len(vectors)]:
        array.fill(np.nan)
    again.update(step)
    for array in vectors:
        array.fill(np.nan)
    again.solve()
    np.testing.assert_array_equal(again.read().z, expected)
    assert_certified(configuration, again.read(), qp)


def test_an_answer_is_the_callers_own(configuration, sequence, solve_qp, solve_next):
    workspace = configuration.open()
    first = solve_qp(workspace, sequence.base)
    before = [array.copy() for array in parts(first)]
    for array in parts(workspace.read()):
        array.fill(7.0)
    solve_next(workspace, sequence.steps[0])
    for array, copy in zip(parts(first), before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_reset_forgets_the_start(warm_configuration, sequence, solve_qp, solve_next):
    configuration, step = warm_configuration, sequence.steps[0]
    workspace, new = configuration.open("default"), configuration.open("default")
    first = sequence.answers(workspace)[0]
    workspace.reset()
    again = solve_next(workspace, step)
    if configuration.route == "qpsolvers":
        first = solve_qp(new, sequence.base.at(step))
    np.testing.assert_array_equal(again.z, first.z)
    assert again.iterations == first.iterations


@pytest.mark.parametrize("name", ["q", "l", "u", "P", "A", "lb", "ub"])
def test_wrong_shapes_are_refused(configuration, sequence, name):
    workspace = configuration.open()
    workspace.setup(sequence.base)
    step = sequence.steps[0]
    setattr(step, name, np.zeros((5, 5) if name in "PA" else 5))
    with pytest.raises(ShapeError, match=f"QPStep: {name}"):
        workspace.update(step)


def test_infeasible_problems_are_not_claimed_solved(configuration, solve_qp):
    answer = solve_qp(configuration.open("default"), INFEASIBLE)
    if configuration.record.detects_infeasibility:
        assert answer.status is Status.PRIMAL_INFEASIBLE
    else:
        assert answer.status not in (Status.SOLVED, Status.PRIMAL_INFEASIBLE)
    if answer.status is Status.UNKNOWN:
        # Without a reason for the failure there is no iterate either, which a ship could follow.
        assert np.isnan(answer.z).all()


def test_known_failures_are_those_of_the_library(configuration, solve_qp):
    """Infeasible QPs by 1, and by less than the tolerance on limits."""
    known = TABLE[configuration.solver].known_failures
    wide = solve_qp(configuration.open("default"), INFEASIBLE)
    if known.get(Status.NUMERICAL_ERROR) == INFEASIBLE_CALLED_ERROR:
        assert wide.status is Status.NUMERICAL_ERROR
    if Status.SOLVED in known:
        narrow = problem(TWO, [-6, -6], [[1, 1]], [2 + 5e-7], [3], [-1, -1], [1, 1])
        assert solve_qp(configuration.open("default"), narrow).claimed
        assert not isfinite(certify(narrow).bound)


def spoil(step, fault):
    """The step with a fault that leaves nothing to solve."""
    q, low, high = step.q.copy(), step.l.copy(), step.u.copy()
    if fault == "infeasible":
        low, high = low + 20.0, high + 20.0
    elif fault == "nan in q":
        q[0] = np.nan
    else:
        high[0] = np.nan
    return QPStep(q, low, high)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["infeasible", "nan in q", "nan in u"])
def test_recovery_without_a_reset(configuration, sequence, fault, solve_qp, solve_next):
    workspace = configuration.open(**patience(configuration))
    solve_qp(workspace, sequence.base)
    bad, after = sequence.steps[:2]
    workspace.update(spoil(bad, fault))
    workspace.solve()
    answer, qp = solve_next(workspace, after), sequence.base.at(after)
    assert answer.status is Status.SOLVED
    assert kkt_residual(qp, answer) <= 10 * configuration.tolerance
    if configuration.exact_again:
        expected = solve_qp(configuration.open(**patience(configuration)), qp)
        np.testing.assert_allclose(answer.z, expected.z, rtol=0, atol=LAST_BITS)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("fault", ["infeasible", "nan in q", "nan in u", "interrupted"])
def test_no_state_of_a_failed_step_survives(configuration, sequence, fault, monkeypatch):
    workspace = configuration.open(**patience(configuration))
    solver = TimedSolver(workspace, BoxFormulation(sequence.base), time.perf_counter_ns)
    solver.prepare()
    first, bad, *after = sequence.steps[:5]
    assert solver.answer(solver.formulate(first)).status is Status.SOLVED
    with monkeypatch.context() as patch:
        if fault == "interrupted":
            patch.setattr(workspace, "read", interrupted(solver))
        answer = solver.answer(bad if fault == "interrupted" else spoil(bad, fault))
    known = f"solved despite a {fault}" in configuration.record.faults
    assert known or answer.status is not Status.SOLVED
    if not is_usable(answer):
        solver.reset()
    for step in after:
        answer = solver.answer(solver.formulate(step))
        assert answer.status is Status.SOLVED
        assert_certified(configuration, answer, sequence.base.at(step))


def interrupted(solver):
    def read():
        solver.interrupted = "interrupted"
        raise StepTimeLimitError(solver.interrupted)

    return read


MENDED = {("highs", "qpsolvers"): "1.16"}
"""Releases without the recorded fault of a NaN, which the lowest version declared still has."""


# Multipliers may come back infinite.
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("fault", ["nan in q", "nan in u"])
def test_a_nan_is_not_claimed_solved(configuration, sequence, fault, solve_next):
    workspace = configuration.open(**patience(configuration))
    workspace.setup(sequence.base)
    mended = MENDED.get((configuration.solver, configuration.route))
    version = find_solver_availability(configuration.solver).version
    has_fault = f"solved despite a {fault}" in configuration.record.faults and (
        mended is None or Version(version) < Version(mended)
    )
    assert solve_next(workspace, spoil(sequence.steps[0], fault)).claimed == has_fault


def test_recovery_from_an_iteration_limit(recovering_configuration, sequence, solve_qp, solve_next):
    configuration, base = recovering_configuration, sequence.base
    hard = QPStep(40.0 * sequence.steps[0].q, base.l, base.u)
    easy = QPStep(0.0 * hard.q, base.l - 5.0, base.u + 5.0)
    few, many = (solve_qp(configuration.open(), base.at(step)).iterations for step in (easy, hard))
    assert few < many, "the problems do not tell the limits apart"
    limit = 1 if configuration.solver.startswith("proxqp") else (few + many) // 2
    workspace = configuration.open(**{configuration.limit_key: limit})
    workspace.setup(base.at(easy))
    assert solve_next(workspace, hard).status in (Status.MAX_ITERATIONS, Status.INACCURATE)
    if configuration.policy == "warm":
        # From a start that is far away the easy step may need more than the limit, too.
        workspace.reset()
    answer = solve_next(workspace, easy)
    assert answer.status is Status.SOLVED
    assert kkt_residual(base.at(easy), answer) <= 10 * configuration.tolerance


# HiGHS 1.15 reports an even number of iterations, one more than an odd limit.
MORE = {"highs": 1}


@pytest.mark.parametrize("limit", [1, 3])
def test_an_iteration_limit_is_kept(limited_configuration, sequence, solve_qp, limit):
    """A solve that takes more iterations without a limit ends at it, with an iterate."""
    configuration, base = limited_configuration, sequence.base
    hard = base.at(QPStep(40.0 * sequence.steps[0].q, base.l, base.u))
    takes = solve_qp(configuration.open(), hard).iterations
    answer = solve_qp(configuration.open(**{configuration.limit_key: limit}), hard)
    assert np.isfinite(answer.z).all()
    if TABLE[configuration.solver].limits_outer_iterations:
        # It reports the inner ones.
        assert answer.iterations <= takes
        return
    assert answer.iterations <= limit + MORE.get(configuration.solver, 0)
    assert answer.status is (Status.MAX_ITERATIONS if takes > limit else Status.SOLVED)


def test_two_workspaces_do_not_disturb_each_other(configuration, sequence):
    base, steps = sequence.base, sequence.steps[:4]
    other = QuadraticProgram(2.0 * base.P, base.q, -base.A, -base.u, -base.l, base.lb, base.ub)
    cases = [sequence._replace(base=qp, steps=steps) for qp in (base, other)]
    alone = [case.answers(configuration.open()) for case in cases]
    together = [configuration.open() for _ in cases]
    for workspace, case in zip(together, cases, strict=True):
        workspace.setup(case.base)
    for k, step in enumerate(steps):
        for workspace in together:
            workspace.update(step)
        for workspace in together:
            workspace.solve()
        for workspace, answers in zip(together, alone, strict=True):
            np.testing.assert_array_equal(workspace.read().z, answers[k].z)


def resident_bytes():
    gc.collect()
    return psutil.Process().memory_info().rss


@pytest.mark.slow
def test_workspaces_do_not_leak(configuration, solve_qp):
    n = 40
    rng = np.random.default_rng(5)
    P, A = np.eye(n) + np.ones((n, n)) / n, rng.normal(size=(n, n))
    one = np.ones(n)
    qp = QuadraticProgram(P, rng.normal(size=n), A, -9 * one, 9 * one, -one, one)

    def cycles(count):
        for _ in range(count):
            workspace = configuration.open("default")
            solve_qp(workspace, qp)

    # A leak grows in each window, an allocator's pool in some: one window without growth is enough.
    # Whoever forgets P and A alone loses some four times this much.
    bound = 0.1 * CYCLES * (P.nbytes + A.nbytes) + PAGES
    cycles(20)
    growth = []
    while len(growth) < WINDOWS and min(growth, default=INF) > bound:
        before = resident_bytes()
        cycles(CYCLES)
        growth.append(resident_bytes() - before)
    assert min(growth) <= bound


def test_a_cost_that_is_not_convex_enough(configuration, solve_qp):
    qp = problem([[2, 0], [0, 0]], [-2, -1], [[1, 1]], [-9], [1], [-1, -1], [1, 0.5])
    answer = solve_qp(configuration.open(), qp)
    if TABLE[configuration.solver].needs_strict_convexity:
        assert not answer.claimed
    else:
        # z = (½, ½) with the row active: 2·½ − 2 + 1 = 0 and −1 + 1 = 0.
        assert answer.claimed
        np.testing.assert_allclose(answer.z, [0.5, 0.5], rtol=0, atol=configuration.tolerance)


def test_read_before_solve_is_no_answer(configuration, sequence):
    workspace = configuration.open()
    workspace.setup(sequence.base)
    answer = workspace.read()
    assert answer.status is Status.ERROR
    assert answer.detail == "read before solve"
    assert np.isnan(answer.z).all()
