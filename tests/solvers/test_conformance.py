"""What every solver of the table has to keep, whatever its library does."""

from __future__ import annotations

import gc
import time

import numpy as np
import psutil
import pytest

from dpbench.bench.run.formulation import Box
from dpbench.bench.run.timed_solver import StepTimeLimitError, TimedSolver, is_usable
from dpbench.errors import ShapeError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Status
from dpbench.solvers.table import TABLE

INF = np.inf
CYCLES, WINDOWS = 70, 5
PAGES = 64 * 4096  # what an allocator may take at once
TWO = 2.0 * np.eye(2)


def problem(P, q, A, l, u, lb, ub):  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    """A problem from nested lists."""
    rows = np.reshape(np.asarray(A, dtype=float), (-1, len(q)))
    return QuadraticProgram(P, q, rows, l, u, lb, ub)


# name: problem, z, y, y_box; each derived by hand from P z + q + Aᵀy + y_box = 0.
KNOWN = {
    # Unconstrained optimum (3, −3) cut to (1, −1); 2z + q = (−4, 4).
    "row 0 at its upper limit, row 1 at its lower one": (
        problem(TWO, [-6, 6], np.eye(2), [-9, -1], [1, 9], [-9, -9], [9, 9]),
        [1, -1],
        [4, -4],
        [0, 0],
    ),
    # The same with bounds, and without any row.
    "variable 0 at its upper bound, variable 1 at its lower one": (
        problem(TWO, [-6, 6], [], [], [], [-9, -1], [1, 9]),
        [1, -1],
        [],
        [4, -4],
    ),
    # By symmetry z = (½, ½) on z0 + z1 = 1; P z + q = −5/2 in both.
    "a coupled cost on one row": (
        problem([[2, 1], [1, 2]], [-4, -4], [[1, 1]], [-1], [1], [-9, -9], [9, 9]),
        [0.5, 0.5],
        [2.5],
        [0, 0],
    ),
    # z0 = ½ at its bound, z0 − z1 = −1 at its lower limit; 2z + q = (−1, −3).
    "one side of each limit infinite": (
        problem(TWO, [-2, -6], [[1, 1], [1, -1]], [-INF, -1], [INF, INF], [-INF, -5], [0.5, INF]),
        [0.5, 1.5],
        [0, -3],
        [4, 0],
    ),
    # Projection of (1, 3) on z0 + z1 = 1.
    "an equality row": (
        problem(TWO, [-2, -6], [[1, 1]], [1], [1], [-9, -9], [9, 9]),
        [-0.5, 1.5],
        [3],
        [0, 0],
    ),
    "a fixed variable": (
        problem(TWO, [-2, -6], [[1, 1]], [-9], [9], [-9, 0.5], [9, 0.5]),
        [1, 0.5],
        [0],
        [0, 5],
    ),
    "nothing active": (
        problem(TWO, [-2, -6], [[1, 1]], [-9], [9], [-9, -9], [9, 9]),
        [1, 3],
        [0],
        [0, 0],
    ),
    "nothing limited": (
        problem(TWO, [-2, -6], [[1, 1]], [-INF], [INF], [-INF, -INF], [INF, INF]),
        [1, 3],
        [0],
        [0, 0],
    ),
}


def patience(configuration):
    """Settings under which an infeasible or undefined problem is given up soon.

    On a NaN, and natively on an infeasible problem, ProxQP runs to its iteration limits, which
    takes it half a minute by default; so does SCS natively on a NaN.
    """
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


@pytest.mark.parametrize("name", KNOWN)
def test_known_optimum(configuration, name, solve_at_once):
    """Every solver finds the optimum and the signed multipliers of a problem solved by hand."""
    qp, z, y, y_box = KNOWN[name]
    answer = solve_at_once(configuration.open(), qp)
    assert answer.status is Status.SOLVED
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=configuration.tolerance)
    np.testing.assert_allclose(answer.y, y, rtol=0, atol=10 * configuration.tolerance)
    np.testing.assert_allclose(answer.y_box, y_box, rtol=0, atol=10 * configuration.tolerance)


def test_answers_satisfy_the_optimality_conditions(configuration, sequence):
    """Along a sequence every answer fulfils the KKT conditions to the accuracy of its class."""
    workspace = configuration.open()
    workspace.setup(sequence.base)
    for step in sequence.steps:
        workspace.update(step)
        workspace.solve()
        qp, answer = sequence.base.at(step), workspace.read()
        assert answer.status is Status.SOLVED
        assert kkt_residual(qp, answer) <= 10 * configuration.tolerance


def test_update_equals_a_new_setup(configuration, sequence, solve_at_once):
    """An updated workspace gives bit for bit what a new one gives; with a memory, to tolerance.

    Scalings, penalties and factors kept from an earlier step are such a memory, and so is a start.
    """
    workspace = configuration.open()
    workspace.setup(sequence.base)
    for step in sequence.steps:
        workspace.update(step)
        workspace.solve()
        answer = workspace.read()
        fresh = solve_at_once(configuration.open(), sequence.base.at(step))
        atol = 0.0 if configuration.exact_again else 2 * configuration.tolerance
        np.testing.assert_allclose(answer.z, fresh.z, rtol=0, atol=atol)


def test_limits_may_become_infinite_equal_and_finite_again(configuration, sequence, solve_at_once):
    """A step may change which limits are infinite or equal."""
    workspace = configuration.open()
    workspace.setup(sequence.base)
    first, second, third = sequence.steps[:3]
    low, high = second.l.copy(), second.u.copy()
    low[0], high[1], low[2:4], high[2] = -INF, INF, (0.25, -INF), 0.25
    for step in (first, QPStep(second.q, low, high), third):
        workspace.update(step)
        workspace.solve()
        qp = sequence.base.at(step)
        exact = certify(qp)
        np.testing.assert_allclose(
            workspace.read().z, exact.z, rtol=0, atol=configuration.tolerance
        )


def test_matrices_may_change(configuration, sequence, solve_at_once):
    """A step that brings matrices and bounds is solved with them, and so are those after it."""
    workspace = configuration.open()
    base, step = sequence.base, sequence.steps[0]
    workspace.setup(base)
    workspace.update(
        QPStep(step.q, step.l, step.u, 2.0 * base.P, -base.A, 0.5 * base.lb, 0.25 * base.ub)
    )
    later = sequence.steps[1]
    workspace.update(later)
    assert workspace.matrix_updates == 1
    workspace.solve()
    qp = QuadraticProgram(
        2.0 * base.P, later.q, -base.A, later.l, later.u, 0.5 * base.lb, 0.25 * base.ub
    )
    exact = certify(qp)
    np.testing.assert_allclose(workspace.read().z, exact.z, rtol=0, atol=configuration.tolerance)


def test_inputs_stay_as_they_are_and_are_not_kept(configuration, sequence, solve_at_once):
    """No solver writes to the caller's arrays, and none sees what the caller writes later."""
    base, step = sequence.base, sequence.steps[0]
    names = ("P", "q", "A", "l", "u", "lb", "ub")
    before = {name: getattr(base, name).copy() for name in names}
    vectors = [step.q.copy(), step.l.copy(), step.u.copy()]
    workspace = configuration.open()
    solve_at_once(workspace, base)
    workspace.update(step)
    workspace.solve()
    expected = workspace.read().z
    for name in names:
        np.testing.assert_array_equal(getattr(base, name), before[name])
    for handed_over, kept in zip((step.q, step.l, step.u), vectors, strict=True):
        np.testing.assert_array_equal(handed_over, kept)
    again = configuration.open()
    again.setup(base)
    again.solve()
    again.read()
    again.update(step)
    for array in (*(getattr(base, name) for name in names), step.q, step.l, step.u):
        array.fill(np.nan)
    again.solve()
    np.testing.assert_array_equal(again.read().z, expected)


def test_a_rebuild_uses_the_workspaces_own_matrices(configuration, sequence, solve_at_once):
    """What the caller writes after setup is not seen by a step that changes the pattern either."""
    base, step = sequence.base, sequence.steps[0]
    low = step.l.copy()
    low[1] = -INF
    last = QPStep(step.q, low, step.u)
    exact = certify(base.at(last))
    workspace = configuration.open()
    workspace.setup(base)
    for array in (base.P, base.q, base.A, base.l, base.u, base.lb, base.ub):
        array.fill(np.nan)
    workspace.update(last)
    workspace.solve()
    np.testing.assert_allclose(workspace.read().z, exact.z, rtol=0, atol=configuration.tolerance)


def test_an_answer_is_the_callers_own(configuration, sequence):
    """Neither the next solve nor a second read changes an answer, nor does writing to it."""
    workspace = configuration.open()
    workspace.setup(sequence.base)
    workspace.solve()
    first, second = workspace.read(), workspace.read()
    kept = first.z.copy(), first.y.copy(), first.y_box.copy()
    for array in (second.z, second.y, second.y_box):
        array.fill(7.0)
    workspace.update(sequence.steps[0])
    workspace.solve()
    workspace.read()
    for answered, before in zip((first.z, first.y, first.y_box), kept, strict=True):
        np.testing.assert_array_equal(answered, before)


@pytest.mark.parametrize("name", ["q", "l", "u", "P", "A", "lb", "ub"])
def test_wrong_shapes_are_refused(configuration, sequence, name):
    """An array of another shape is refused by name instead of being half taken over."""
    workspace = configuration.open()
    workspace.setup(sequence.base)
    step = sequence.steps[0]
    setattr(step, name, np.zeros((5, 5) if name in "PA" else 5))
    with pytest.raises(ShapeError, match=f"QPStep: {name}"):
        workspace.update(step)


def test_infeasible_problems_are_not_claimed_solved(configuration, solve_at_once):
    """An infeasible problem is reported as such where the table says so, and never as solved."""
    answer = solve_at_once(configuration.open("default"), INFEASIBLE)
    if configuration.record.detects_infeasibility:
        assert answer.status is Status.PRIMAL_INFEASIBLE
    else:
        assert answer.status not in (Status.SOLVED, Status.PRIMAL_INFEASIBLE)
    if answer.status is Status.UNKNOWN:
        # Without a reason for the failure there is no iterate either, which a ship could follow.
        assert np.isnan(answer.z).all()


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
@pytest.mark.parametrize("reset", [True, False], ids=["reset", "no reset"])
@pytest.mark.parametrize("fault", ["infeasible", "nan in q", "nan in u"])
def test_recovery(configuration, sequence, fault, reset, solve_at_once):
    """After a step that cannot be solved the next one is solved, with a reset and without."""
    workspace = configuration.open(**patience(configuration))
    workspace.setup(sequence.base)
    workspace.solve()
    workspace.read()
    bad, after = sequence.steps[:2]
    workspace.update(spoil(bad, fault))
    workspace.solve()
    if reset:
        workspace.read()
        workspace.reset()
    workspace.update(after)
    workspace.solve()
    answer = workspace.read()
    qp = sequence.base.at(after)
    assert answer.status is Status.SOLVED
    assert kkt_residual(qp, answer) <= 10 * configuration.tolerance
    if configuration.exact_again:
        expected = solve_at_once(configuration.open(**patience(configuration)), qp)
        np.testing.assert_array_equal(answer.z, expected.z)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("fault", ["infeasible", "nan in q", "nan in u", "interrupted"])
def test_no_state_of_a_failed_step_survives(configuration, sequence, fault, monkeypatch):
    """Driven as in a loop, the answers after a failed step are those the referee certifies.

    A solve that is interrupted has changed whatever it changes, and its answer is lost.
    """
    workspace = configuration.open(**patience(configuration))
    solver = TimedSolver(workspace, Box(sequence.base), time.perf_counter_ns)
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
        exact = certify(sequence.base.at(step))
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(answer.z, exact.z, rtol=0, atol=configuration.tolerance)


def interrupted(solver):
    """What reading an answer comes to after an alarm."""

    def read():
        solver.interrupted = "interrupted"
        raise StepTimeLimitError(solver.interrupted)

    return read


# Multipliers may come back infinite.
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("fault", ["nan in q", "nan in u"])
def test_a_nan_is_not_claimed_solved(configuration, sequence, fault):
    """Nobody claims to have solved a problem with a NaN in it, but for the faults in the table."""
    workspace = configuration.open(**patience(configuration))
    workspace.setup(sequence.base)
    workspace.update(spoil(sequence.steps[0], fault))
    workspace.solve()
    assert workspace.read().claimed == (f"solved despite a {fault}" in configuration.record.faults)


def test_recovery_from_an_iteration_limit(limited_configuration, sequence, solve_at_once):
    """After a step that was stopped by the iteration limit, one within the limit is solved."""
    configuration, base = limited_configuration, sequence.base
    hard = QPStep(40.0 * sequence.steps[0].q, base.l, base.u)
    easy = QPStep(0.0 * hard.q, base.l - 5.0, base.u + 5.0)
    few, many = (
        solve_at_once(configuration.open(), base.at(step)).iterations for step in (easy, hard)
    )
    assert few < many, "the problems do not tell the limits apart"
    limit = 1 if configuration.solver.startswith("proxqp") else (few + many) // 2
    workspace = configuration.open(**{configuration.limit_key: limit})
    workspace.setup(base.at(easy))
    workspace.update(hard)
    workspace.solve()
    assert workspace.read().status in (Status.MAX_ITERATIONS, Status.INACCURATE)
    if configuration.policy == "warm":
        # From a start that is far away the easy step may need more than the limit, too.
        workspace.reset()
    workspace.update(easy)
    workspace.solve()
    answer = workspace.read()
    assert answer.status is Status.SOLVED
    assert kkt_residual(base.at(easy), answer) <= 10 * configuration.tolerance


def test_two_workspaces_do_not_disturb_each_other(configuration, sequence):
    """Workspaces that take turns give bit for bit what each gives alone."""
    base = sequence.base
    other = QuadraticProgram(2.0 * base.P, base.q, -base.A, -base.u, -base.l, base.lb, base.ub)
    problems = base, other

    def opened():
        workspaces = [configuration.open() for _ in problems]
        for workspace, qp in zip(workspaces, problems, strict=True):
            workspace.setup(qp)
        return workspaces

    def answer(workspace, step):
        workspace.update(step)
        workspace.solve()
        return workspace.read().z

    alone = [[answer(w, step) for step in sequence.steps[:4]] for w in opened()]
    together = opened()
    for k, step in enumerate(sequence.steps[:4]):
        for workspace in together:
            workspace.update(step)
        for workspace in together:
            workspace.solve()
        for workspace, expected in zip(together, alone, strict=True):
            np.testing.assert_array_equal(workspace.read().z, expected[k])


def resident_bytes():
    """Memory of this process that is in use."""
    gc.collect()
    return psutil.Process().memory_info().rss


@pytest.mark.slow
def test_workspaces_do_not_leak(configuration):
    """Workspaces that are made, used and dropped leave no memory behind."""
    n = 40
    rng = np.random.default_rng(5)
    P, A = np.eye(n) + np.ones((n, n)) / n, rng.normal(size=(n, n))
    one = np.ones(n)
    qp = QuadraticProgram(P, rng.normal(size=n), A, -9 * one, 9 * one, -one, one)

    def cycles(count):
        for _ in range(count):
            workspace = configuration.open("default")
            workspace.setup(qp)
            workspace.solve()
            workspace.read()

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


def test_a_cost_that_is_not_convex_enough(configuration, solve_at_once):
    """Where the table asks for strict convexity, a semidefinite cost is refused, not mis-solved."""
    qp = problem([[2, 0], [0, 0]], [-2, -1], [[1, 1]], [-9], [1], [-1, -1], [1, 0.5])
    answer = solve_at_once(configuration.open(), qp)
    if TABLE[configuration.solver].needs_strict_convexity:
        assert not answer.claimed
    else:
        # z = (½, ½) with the row active: 2·½ − 2 + 1 = 0 and −1 + 1 = 0.
        assert answer.claimed
        np.testing.assert_allclose(answer.z, [0.5, 0.5], rtol=0, atol=configuration.tolerance)


def test_read_before_solve_is_no_answer(configuration, sequence):
    """A workspace that has not solved says so."""
    workspace = configuration.open()
    workspace.setup(sequence.base)
    answer = workspace.read()
    assert answer.status is Status.ERROR
    assert answer.detail == "read before solve"
    assert np.isnan(answer.z).all()
