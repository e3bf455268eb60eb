"""Workspaces of libraries: what a start is, what is kept, what is said about their failures."""

import gc
import time
from dataclasses import replace
from math import isnan

import numpy as np
import pytest

from dpbench.bench.run.footprint import heap_bytes_in_use
from dpbench.errors import DpbenchError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.libraries import NATIVE
from dpbench.solvers.libraries.native_workspace import WarmStart
from dpbench.solvers.open import open_workspace
from dpbench.solvers.settings import find_options_of_preset
from dpbench.solvers.table import TABLE, find_solver_availability
from tests.solvers.conftest import Sequence, solve_next, solve_qp

HERE = [name for name in NATIVE if find_solver_availability(name).ok]
WARM = [name for name in HERE if "warm" in TABLE[name].get_route_record("native").policies]


def opened(solver, policy="", settings="default"):
    """A workspace that keeps something from step to step."""
    policy = policy or TABLE[solver].get_route_record("native").policies[1]
    return open_workspace(solver, route="native", policy=policy, settings=settings)


def answers(workspace, base, steps):
    return Sequence(base, steps).answers(workspace)


@pytest.mark.parametrize("solver", WARM)
def test_a_warm_start_makes_a_difference(solver, sequence):
    base = replace(sequence.base, block=0)
    steps = [step for step in sequence.steps[:3] for _ in range(2)]
    counts = {
        policy: sum(a.iterations for a in answers(opened(solver, policy, "high"), base, steps))
        for policy in ("fresh", "warm")
    }
    assert counts["warm"] != counts["fresh"]
    assert counts["warm"] < counts["fresh"] or solver.startswith("hpipm")


def test_a_start_is_the_previous_answer_one_move_later():
    """Moves and multipliers shift by a block of two variables and one row; block 0 keeps all."""
    z, y, y_box = np.arange(1.0, 7.0), np.arange(10.0, 13.0), np.arange(20.0, 26.0)
    for block, expected in (
        (2, ([3, 4, 5, 6, 0, 0], [11, 12, 0], [22, 23, 24, 25, 0, 0])),
        (0, (z, y, y_box)),
    ):
        start = WarmStart(6, 3, block)
        assert not start.shift_stored_answer_if_any()
        start.store_copy_of_answer(Solution(Status.SOLVED, z, y, y_box))
        assert start.shift_stored_answer_if_any()
        for shifted, wanted in zip((start.z, start.y, start.y_box), expected, strict=True):
            np.testing.assert_array_equal(shifted, wanted)
        np.testing.assert_array_equal(start.dual, np.concatenate([start.y, start.y_box]))


STATELESS = {
    "clarabel": {"equilibrate_enable": False},
    "osqp": {"adaptive_rho": 0, "scaling": 0},
    "scs": {"adaptive_scale": False, "normalize": False, "acceleration_lookback": 0},
}
"""Settings that switch off what `RouteRecord.keeps` names."""


@pytest.mark.parametrize("solver", sorted(STATELESS))
def test_what_a_kept_workspace_carries_on_is_what_the_table_says(solver, sequence):
    assert TABLE[solver].get_route_record("native").keeps
    for settings, same in ((STATELESS[solver], True), ("default", False)):
        kept = answers(opened(solver, "reuse", settings), sequence.base, sequence.steps)
        problems = map(sequence.base.at, sequence.steps)
        new = [solve_qp(opened(solver, "fresh", settings), qp) for qp in problems]
        assert all(np.array_equal(a.z, b.z) for a, b in zip(kept, new, strict=True)) is same


@pytest.mark.parametrize("solver", HERE)
def test_limits_that_cross_are_never_solved(solver, sequence):
    blind = "solved despite limits that cross" in TABLE[solver].get_route_record("native").faults
    base, step = sequence.base, sequence.steps[0]
    low = step.l.copy()
    low[0] = step.u[0] + 1.0
    crossed = QPStep(step.q, low, step.u)
    limit = {"max_iter": 50, "max_iter_in": 50} if solver.startswith("proxqp") else "default"
    workspace = opened(solver, settings=limit)
    for qp in (base, base.at(crossed)):
        solutions = answers(workspace, qp, [crossed, step])
        assert solutions[0].claimed == (blind and qp is base)
        assert solutions[1].claimed


@pytest.mark.parametrize("solver", HERE)
def test_limits_that_cross_alone_are_never_solved(solver):
    """A single row, 2 ≤ z ≤ 1."""
    faults = TABLE[solver].get_route_record("native").faults
    qp = QuadraticProgram([[1.0]], [0.0], [[1.0]], [2.0], [1.0], [-9.0], [9.0])
    limit = {"max_iter": 50, "max_iter_in": 50} if solver.startswith("proxqp") else "default"
    answer = solve_qp(opened(solver, settings=limit), qp)
    assert answer.claimed == ("solved despite limits that cross alone" in faults)


class Panic(BaseException):
    """As raised by Rust libraries, which do not derive theirs from Exception."""


CALLS = [
    ("native", method)
    for method in ("_create_library_solver", "_send_step_vectors_to_library", "_call_library_solve")
]
CALLS.append(("qpsolvers", "_call_library_solve"))
"""Methods that call the library, on each route."""


@pytest.mark.parametrize(("route", "method"), CALLS)
@pytest.mark.parametrize("error", [KeyError("x"), ValueError("y"), Panic("z"), KeyboardInterrupt()])
def test_what_a_library_raises_is_an_answer(monkeypatch, sequence, route, method, error):
    workspace = open_workspace("osqp", route=route, policy="warm")
    workspace.setup(sequence.base)

    def fail(*arguments):
        raise error

    def run():
        if method == "_create_library_solver":
            return solve_qp(workspace, sequence.base)
        return solve_next(workspace, sequence.steps[0])

    with monkeypatch.context() as patch:
        patch.setattr(workspace, method, fail)
        if isinstance(error, KeyboardInterrupt):
            with pytest.raises(KeyboardInterrupt):
                run()
            return
        answer = run()
        assert answer.status is Status.ERROR
        assert answer.detail == f"{type(error).__name__}: {error}"
        assert np.isnan(answer.z).all()
    assert solve_next(workspace, sequence.steps[1]).claimed


@pytest.mark.parametrize(
    ("solver", "route"), [*((name, "native") for name in HERE), ("daqp", "qpsolvers")]
)
def test_use_before_setup_is_a_persons_mistake(solver, route, sequence):
    workspace = open_workspace(solver, route=route)
    with pytest.raises(DpbenchError, match="call setup"):
        workspace.update(sequence.steps[0])
    with pytest.raises(DpbenchError, match="call setup"):
        workspace.read()


@pytest.mark.parametrize("solver", HERE)
def test_a_workspace_may_be_set_up_for_another_size(solver, sequence):
    workspace = opened(solver, settings="high")
    answers(workspace, sequence.base, sequence.steps[:2])
    eye = np.eye(2)
    qp = QuadraticProgram(eye, [-3, 0], eye, [-1, -1], [1, 1], [-2, -2], [2, 2])
    # An interior point ends at a gap of 1e-9, which allows 4.5e-5 for P = I.
    np.testing.assert_allclose(solve_qp(workspace, qp).z, [1.0, 0.0], rtol=0, atol=1e-4)


@pytest.mark.parametrize("solver", ["piqp", "piqp_multistage", "piqp_sparse"])
def test_rows_that_become_equalities_are_solved_as_such(solver):
    """Rows with l = u, which have no interior, are equalities; multipliers keep their places."""
    rng = np.random.default_rng(3)
    n, m = 6, 4
    A, q, free = rng.normal(size=(m, n)), rng.normal(size=n), np.full(n, 2.0)
    middle = A @ rng.uniform(-0.5, 0.5, size=n)
    base = QuadraticProgram(np.eye(n), q, A, middle - 1, middle + 1, -free, free)
    steps = []
    for equal in ([], [0], [1, 3], [0, 1, 2, 3], []):
        low, high = middle - 0.1, middle + 0.1
        low[equal] = high[equal] = middle[equal]
        steps.append(QPStep(q, low, high))
    found = answers(opened(solver, "reuse", "high"), base, steps)
    for step, answer in zip(steps, found, strict=True):
        expected = certify(base.at(step))
        assert answer.status is Status.SOLVED and answer.iterations < 30
        for name, atol in (("z", 1e-7), ("y", 1e-6), ("y_box", 1e-6)):
            np.testing.assert_allclose(getattr(answer, name), getattr(expected, name), atol=atol)


def test_arrays_given_before_are_known_and_new_ones_are_taken(sequence):
    workspace = open_workspace("piqp", route="native", policy="fresh", settings="high")
    base, other = sequence.base, replace(sequence.base, P=2.0 * sequence.base.P)
    step = QPStep(base.q, base.l, base.u, P=other.P)
    for qp in (base, base, other, base):
        np.testing.assert_allclose(solve_qp(workspace, qp).z, certify(qp).z, atol=1e-6)
    np.testing.assert_allclose(solve_next(workspace, step).z, certify(other).z, atol=1e-6)
    np.testing.assert_allclose(solve_qp(workspace, base).z, certify(base).z, atol=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(isnan(heap_bytes_in_use()), reason="only glibc 2.33 and later shows its heap")
@pytest.mark.parametrize("solver", ["osqp", "qoco"])
def test_a_step_leaves_no_memory_behind(solver, sequence):
    """Not even the 32 B of an answer that the interface of a library makes and forgets."""
    workspace, steps = opened(solver, "reuse"), 30 * sequence.steps[:10]
    growth = []
    # A leak grows in each window, what is allocated once in some.
    for _ in range(5):
        before = heap_bytes_in_use()
        answers(workspace, sequence.base, steps)
        gc.collect()
        growth.append(heap_bytes_in_use() - before)
    assert min(growth) < 8 * len(steps), growth


LIMITED = [
    (name, route, policy)
    for name, row in TABLE.items()
    if row.time_limit and find_solver_availability(name).ok
    for route, policies in row.policies_by_route.items()
    for policy in policies
]
"""Configurations of libraries that end a solve after a time by themselves."""


@pytest.mark.parametrize(("solver", "route", "policy"), LIMITED)
def test_a_time_limit_that_is_not_met_changes_no_bit(solver, route, policy, sequence):
    found = (
        sequence.answers(open_workspace(solver, route=route, policy=policy, step_limit_s=limit))
        for limit in (60.0, None)
    )
    for one, other in zip(*found, strict=True):
        assert (one.status, one.iterations) == (other.status, other.iterations)
        np.testing.assert_array_equal(one.z, other.z)


TIMED = sorted({name for name, route, _ in LIMITED if route == "native"})


@pytest.mark.parametrize("solver", TIMED)
def test_a_time_limit_of_no_time_gives_an_iterate(solver, sequence):
    """An iterate that is not solved at the first reading of the clock is an unfinished one."""
    options = {**find_options_of_preset("high", solver), TABLE[solver].time_limit: 1e-7}
    workspace = open_workspace(solver, route="native", settings=options)
    for step in sequence.steps[:3]:
        workspace.setup(sequence.base.at(step))
        workspace.solve()
        answer = workspace.read()
        assert answer.claimed or answer.status.is_applied_though_unfinished
        assert np.isfinite(answer.z).all()


@pytest.mark.slow
@pytest.mark.parametrize("solver", TIMED)
def test_a_time_limit_is_one_of_each_solve(solver, sequence):
    limit_s, policy = 0.2, opened(solver).policy
    workspace = open_workspace(solver, route="native", policy=policy, step_limit_s=limit_s)
    workspace.setup(sequence.base)
    until = time.monotonic() + 1.5 * limit_s
    while time.monotonic() < until:
        assert solve_next(workspace, sequence.steps[0]).status is Status.SOLVED
