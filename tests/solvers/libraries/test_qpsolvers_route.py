"""The route through qpsolvers: policies, failures of a library, what it reports about itself."""

from __future__ import annotations

import time
import warnings

import numpy as np
import pytest
from qpsolvers import Problem, solve_problem

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.libraries import THROUGH_QPSOLVERS
from dpbench.solvers.libraries import qpsolvers_workspace as qpsolvers_route
from dpbench.solvers.one_sided import OneSidedForm
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import TABLE, available

THROUGH = [name for name in THROUGH_QPSOLVERS if available(name).ok]
WARM = [name for name in THROUGH if "warm" in TABLE[name].policies["qpsolvers"]]


@pytest.mark.parametrize("solver", THROUGH)
def test_warm_is_offered_where_a_start_matters_and_only_there(solver, sequence):
    """A start changes something if and only if the table offers the policy `warm`."""
    adapter = THROUGH_QPSOLVERS[solver]
    row = adapter.record
    name = adapter.qpsolvers_key
    form = OneSidedForm(sequence.base, row.form, adapter.box)
    form.fill(sequence.base.q, sequence.base.l, sequence.base.u)
    qp = Problem(form.P, form.q, form.G, form.h, form.A, form.b, form.lb, form.ub)
    rng = np.random.default_rng(3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        without = np.array(solve_problem(qp, name, **adapter.fixed).x)
        starts = [without, *rng.uniform(-1, 1, size=(5, without.size))]
        same = [
            np.array_equal(solve_problem(qp, name, initvals=x, **adapter.fixed).x, without)
            for x in starts
        ]
    assert all(same) == ("warm" not in row.policies["qpsolvers"])


@pytest.mark.parametrize("block", [0, 2])
def test_a_warm_start_is_the_previous_answer_one_move_later(monkeypatch, sequence, block):
    """The start is the last answer shifted by a block, its last move zero; as it is for block 0."""
    starts = []
    inner = qpsolvers_route.solve_problem

    def spy(*arguments, initvals, **options):
        starts.append(None if initvals is None else initvals.copy())
        return inner(*arguments, initvals=initvals, **options)

    monkeypatch.setattr(qpsolvers_route, "solve_problem", spy)
    b = sequence.base
    base = QuadraticProgram(b.P, b.q, b.A, b.l, b.u, b.lb, b.ub, block)
    answers = sequence._replace(base=base).answers(open_workspace("daqp", policy="warm"))
    assert starts[0] is None
    for start, previous in zip(starts[1:], answers, strict=False):
        expected = previous.z
        if block:
            expected = np.concatenate([previous.z[block:], np.zeros(block)])
        np.testing.assert_array_equal(start, expected)


@pytest.mark.parametrize("solver", WARM)
def test_reset_forgets_the_start(solver, sequence):
    """After a reset a warm workspace solves the next step as a fresh one does."""
    workspace = open_workspace(solver, policy="warm")
    sequence.answers(workspace)
    workspace.reset()
    step = sequence.steps[3]
    workspace.update(step)
    workspace.solve()
    fresh = open_workspace(solver)
    fresh.setup(sequence.base.at(step))
    fresh.solve()
    np.testing.assert_array_equal(workspace.read().z, fresh.read().z)


TIMED = {
    "clarabel": {},
    "ecos": {},
    "osqp": {},
    "piqp": {"compute_timings": True},
    "proxqp": {"compute_timings": True},
    "qpalm": {},
    "scs": {},
    "piqp_multistage": {"compute_timings": True},
    "piqp_sparse": {"compute_timings": True},
    "proxqp_sparse": {"compute_timings": True},
    "qoco": {},
}


@pytest.mark.slow
def test_self_reported_time_is_in_nanoseconds(installed, sequence):
    """A library's own time lies within the clock's and is no less than a microsecond."""
    workspace = open_workspace(installed, settings=TIMED.get(installed, {}))
    workspace.setup(sequence.base)
    started = time.perf_counter_ns()
    workspace.solve()
    elapsed = time.perf_counter_ns() - started
    reported = workspace.read().reported_ns
    if installed in TIMED or reported != -1:
        # A unit a thousand times too large or too small falls out of this range for all of them.
        assert 1_000 <= reported <= elapsed


# qpsolvers passes no status on for the solvers that are missing here.
LIMITS = {
    "clarabel": {"max_iter": 2},
    "cvxopt": {"maxiters": 2},
    "ecos": {"max_iters": 2},
    "kvxopt": {"maxiters": 2},
    "osqp": {"max_iter": 2},
    "piqp": {"max_iter": 2},
    "proxqp": {"max_iter": 1},
    "qpalm": {"max_iter": 2},
    "qtqp": {"max_iter": 2},
    "scs": {"max_iters": 2},
    "sip": {"max_iterations": 2},
}


@pytest.mark.parametrize("solver", [name for name in THROUGH if name in LIMITS])
def test_iteration_limits_show_as_such(solver, sequence):
    """A library stopped by its iteration limit says so, and its iterate is passed on."""
    workspace = open_workspace(solver, settings=LIMITS[solver])
    workspace.setup(sequence.base)
    workspace.solve()
    answer = workspace.read()
    assert answer.status is Status.MAX_ITERATIONS
    assert np.isfinite(answer.z).all()
