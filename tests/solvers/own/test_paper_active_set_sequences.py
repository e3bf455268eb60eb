"""The paper's method from step to step: sequences of QPs, starts, odd arrays, size."""

import subprocess
import sys
from inspect import getclosurevars

import numpy as np
import pytest
import quadprog

from dpbench import load_scenario, run_closed_loop
from dpbench.bench.run.exact_loop import sequence_of, solve_exactly
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.active_set import factor as active_set_factor
from dpbench.solvers.own.active_set import layout as active_set_layout
from dpbench.solvers.own.active_set.kernel import _entry_points, mark_spans
from dpbench.solvers.own.hildreth import hildreth_step
from tests.solvers.conftest import solve_next, solve_qp

INF = np.inf


def workspace(policy="warm"):
    return open_workspace("paper_active_set", policy=policy)


@pytest.mark.slow
def test_in_newtons_every_step_is_claimed_too():
    """In SI units, where a plan is 1e5 and its rounding 1e-11 of that, no claim is lost."""
    scenario = load_scenario("paper").first(100)
    for policy in ("fresh", "warm"):
        solver = workspace(policy)
        steps = run_closed_loop(scenario, solver, units="si").steps
        assert (steps["status"] == "SOLVED").all()
        assert steps["error_plan"].max() <= 1e-9


@pytest.mark.parametrize("name", ["paper", "paper_tight", "calm", "rough"])
def test_every_step_of_a_scenario_is_the_certified_optimum(name):
    """Along the exactly solved loop every answer is the optimum to 1e-9 of a rate-limit step."""
    scenario = load_scenario(name)
    exact = solve_exactly(scenario)
    sequence = sequence_of(scenario, exact)
    iterations = {}
    for policy in ("reuse", "warm"):
        solver = workspace(policy)
        solver.setup(sequence.base)
        iterations[policy] = 0
        for k in range(len(sequence)):
            answer = solve_next(solver, sequence.step(k))
            assert answer.status is Status.SOLVED
            assert np.abs(answer.z - exact.z[k]).max() <= 1e-9
            iterations[policy] += answer.iterations
    # What a start is for: the set changes in few steps, by few rows.
    assert iterations["warm"] <= 0.15 * iterations["reuse"]


def chain(block):
    """Six moves of one variable each, of which the third wants beyond its bound."""
    six = np.ones(6)
    q = np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    return QuadraticProgram(np.eye(6), q, np.zeros((0, 6)), [], [], -six, six, block)


@pytest.mark.parametrize(("block", "iterations"), [(1, 0), (2, 2), (0, 2)])
def test_the_kept_set_moves_on_by_one_move(block, iterations):
    """A set one move nearer needs no change; moved otherwise it costs a drop and an add."""
    qp = chain(block)
    solver = workspace()
    assert solve_qp(solver, qp).iterations == 1
    answer = solve_next(solver, QPStep(np.roll(qp.q, -1), qp.l, qp.u))
    np.testing.assert_allclose(answer.z, [0, 1, 0, 0, 0, 0], rtol=0, atol=1e-15)
    assert answer.iterations == iterations


def test_the_same_set_costs_no_iteration():
    """A set that is still optimal is kept as it is, whatever the block."""
    qp = chain(1)
    solver = workspace()
    solver.setup(qp)
    solver.solve()
    assert solve_next(solver, QPStep(1.1 * qp.q, qp.l, qp.u)).iterations == 0
    solver.reset()
    solver.solve()
    assert solver.read().iterations == 1


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 1e-8])
def test_nearly_parallel_rows_are_told_apart(angle):
    """Two rows at a small angle meet in one point, which is the optimum."""
    A = np.array([[1.0, 0.0], [1.0, angle]])
    # z0 ≤ 1 and z0 + angle·z1 ≤ 1 − angle meet in (1, −1); the cost pulls between the two rows.
    high = np.array([1.0, 1.0 - angle])
    z, y = np.array([1.0, -1.0]), np.array([2.0, 3.0])
    qp = QuadraticProgram(
        np.eye(2), -(z + A.T @ y), A, [-INF, -INF], high, [-INF, -INF], [INF, INF]
    )
    solver = workspace()
    answer = solve_qp(solver, qp)
    assert answer.status is Status.SOLVED
    # The rounding of `high` alone moves the point by 1e-16 over the angle.
    np.testing.assert_allclose(answer.z, z, rtol=0, atol=1e-15 / angle)


def odd(array, kind):
    """The same numbers in another kind of array."""
    if kind == "strided":
        return np.repeat(array, 2)[::2]
    if kind == "read-only":
        array = array.copy()
        array.flags.writeable = False
        return array
    return array.astype(kind)


@pytest.mark.parametrize("kind", ["strided", "read-only", ">f8", "float32"])
def test_other_kinds_of_arrays_are_taken_over_all_the_same(sequence, kind):
    """The compiled copy is for contiguous float64 arrays; others give the same answers."""
    expected, found = workspace(), workspace()
    for solver in (expected, found):
        solver.setup(sequence.base)
    for step in sequence.steps:
        q, low, high = (a.astype(np.float32).astype(float) for a in (step.q, step.l, step.u))
        expected.update(QPStep(q, low, high))
        found.update(QPStep(odd(q, kind), odd(low, kind), odd(high, kind)))
        expected.solve()
        found.solve()
        np.testing.assert_array_equal(found.read().z, expected.read().z)


def test_three_hundred_variables_and_six_hundred_rows():
    """With a box, 600 rows and some 200 of them active it agrees with quadprog."""
    rng = np.random.default_rng(0)
    n, m = 300, 600
    B = rng.normal(size=(n, n))
    P, A = B @ B.T / n + 0.1 * np.eye(n), rng.normal(size=(m, n)) / np.sqrt(n)
    q, two, one = 10 * rng.normal(size=n), 2 * np.ones(m), np.ones(n)
    solver = workspace()
    solver.setup(QuadraticProgram(P, q, A, -two, two, -one, one))
    C = np.vstack([A, -A, np.eye(n), -np.eye(n)]).T
    limit = -np.concatenate([two, two, one, one])
    for _ in range(2):
        solver.solve()
        answer = solver.read()
        assert answer.status is Status.SOLVED
        np.testing.assert_allclose(
            answer.z, quadprog.solve_qp(P, -q, C, limit)[0], rtol=0, atol=1e-10
        )
        assert np.count_nonzero(answer.y) + np.count_nonzero(answer.y_box) > 150
        q = q + 0.1 * rng.normal(size=n)
        solver.update(QPStep(q, -two, two))


def test_compiled_code_on_disk_is_not_used_after_a_change(monkeypatch):
    """The mark of the compiled code changes with a constant that some function of it names."""
    before = active_set_layout.stamp(_entry_points)
    assert active_set_layout.stamp(_entry_points) == before
    monkeypatch.setattr(active_set_factor, "CLOSE", 1e-7)
    assert active_set_layout.stamp(_entry_points) != before


@pytest.mark.slow
@pytest.mark.parametrize("first", ["hildreth", "active_set.factor", "active_set.check"])
def test_compiled_code_on_disk_is_used_whatever_was_imported_before(first):
    """Its mark tells nothing of the order of imports, nor of kernels that it does not call."""
    program = f"""
import dpbench.solvers.own.{first}
from inspect import getclosurevars
from dpbench.solvers.own import hildreth
from dpbench.solvers.own.active_set.kernel import mark_spans
for function in (mark_spans, hildreth.hildreth_step):
    print(getclosurevars(function.py_func).nonlocals["version"])
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    here = (stamp_of(mark_spans), stamp_of(hildreth_step))
    assert done.stdout.split() == [str(stamp) for stamp in here]


def stamp_of(function):
    """What stands in the closure of a compiled function."""
    return getclosurevars(function.py_func).nonlocals["version"]
