"""The route through qpsolvers: policies, failures of a library, what it reports about itself."""

import time
import warnings

import numpy as np
import pytest
from qpsolvers import Problem, solve_problem

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.solution import Status
from dpbench.solvers.libraries import THROUGH_QPSOLVERS, qpsolvers_workspace as qpsolvers_route
from dpbench.solvers.one_sided import OneSidedForm
from dpbench.solvers.open import open_workspace
from dpbench.solvers.table import TABLE, find_solver_availability
from tests.solvers.conftest import Configuration, solve_qp

THROUGH = [name for name in THROUGH_QPSOLVERS if find_solver_availability(name).ok]


@pytest.mark.parametrize("solver", THROUGH)
def test_warm_is_offered_where_a_start_matters_and_only_there(solver, sequence):
    adapter = THROUGH_QPSOLVERS[solver]
    row = adapter.record
    name = adapter.qpsolvers_key
    form = OneSidedForm(sequence.base, row.form, adapter.box)
    form.write_step_vectors_as_one_sided(sequence.base.q, sequence.base.l, sequence.base.u)
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
    assert all(same) == ("warm" not in row.policies_by_route["qpsolvers"])


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


TIMED = {"clarabel", "ecos", "osqp", "qpalm", "scs", "qoco"}
ON_REQUEST = {name for name in TABLE if name.startswith(("piqp", "proxqp"))}
"""Libraries that time themselves, and those that do so with a setting."""


@pytest.mark.slow
def test_self_reported_time_is_in_nanoseconds(installed, sequence):
    workspace = open_workspace(
        installed, settings={"compute_timings": True} if installed in ON_REQUEST else {}
    )
    workspace.setup(sequence.base)
    started = time.perf_counter_ns()
    workspace.solve()
    elapsed = time.perf_counter_ns() - started
    reported = workspace.read().reported_ns
    if installed in TIMED | ON_REQUEST or reported != -1:
        # A unit a thousand times too large or too small falls out of this range for all of them.
        assert 1_000 <= reported <= elapsed


STATUS_DROPPED = {"daqp", "highs", "jaxopt", "pyqpmad", "qpax", "quadprog"}
"""Libraries whose status qpsolvers does not pass on."""


@pytest.mark.parametrize("solver", sorted({*THROUGH} - STATUS_DROPPED))
def test_iteration_limits_show_as_such(solver, sequence):
    key = Configuration(solver, "qpsolvers", "fresh").limit_key
    workspace = open_workspace(solver, settings={key: 1 if solver == "proxqp" else 2})
    answer = solve_qp(workspace, sequence.base)
    assert answer.status is Status.MAX_ITERATIONS
    assert np.isfinite(answer.z).all()
