"""The stage-ordered problem against the condensed one: the same optimum, proofs included."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench import open_workspace
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.referee.referee import certify
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Solution, Status
from tests.mpc.conftest import VESSELS, at_sea, ship_problem

ROUNDING = 1e-9
"""Rounding error, relative to the sum of the sizes of all terms of an equation; optima are
certified to 1e-10."""
SAME = 1e-8
"""The largest difference of plans called equal, in maximum increments."""


def both(problem: Any, units: UnitSystem = "scaled", **policy: Any) -> tuple[Any, Any]:
    return CondensedQP(problem, units=units, **policy), StagedQP(problem, units=units, **policy)


def rolled_out(
    problem: Any, unit: np.ndarray, theta: tuple[Any, ...], Y_d: np.ndarray, found: Solution
) -> Solution:
    x, u_prev = theta
    model, Q, N_c = problem.model, problem.Q, problem.N_c
    moves, y = found.z.reshape(N_c, -1), found.y.reshape(N_c, -1)
    u = u_prev / unit + np.cumsum(moves, axis=0)
    states = []
    for i in range(problem.N_p):
        x = model.A @ x + (model.B @ (unit * moves[i]) if i < N_c else 0.0)
        states.append(x)
    mu = np.zeros((problem.N_p, model.n_x))
    costate = np.zeros(model.n_x)
    for i in range(problem.N_p - 1, -1, -1):
        costate = model.A.T @ costate - model.C.T @ Q @ (model.C @ states[i] - Y_d[i])
        mu[i] = costate
    lam, bounds = -np.cumsum(y[::-1], axis=0)[::-1], found.y_box.reshape(N_c, -1)
    none, zero = np.zeros((N_c, model.n_u)), np.zeros(model.n_x)
    parts = moves, u, states[:N_c], lam, mu[:N_c], y, bounds, none, [zero] * N_c
    stages = list(zip(*parts, strict=True))
    z = [part for stage in stages for part in stage[:3]] + states[N_c:]
    multipliers = [part for stage in stages for part in stage[3:6]] + list(mu[N_c:])
    box = [part for stage in stages for part in stage[6:]] + [zero] * (problem.N_p - N_c)
    return Solution(Status.SOLVED, *(np.concatenate(parts) for parts in (z, multipliers, box)))


def assert_optimal(qp: QuadraticProgram, answer: Solution) -> None:
    """Every optimality condition, each to rounding of the terms it is the sum of."""
    z, y, y_box = answer.z, answer.y, answer.y_box
    slope = qp.P @ z + qp.q + qp.A.T @ y + y_box
    size = abs(qp.P) @ abs(z) + abs(qp.q) + abs(qp.A).T @ abs(y) + abs(y_box)
    assert (np.abs(slope) <= ROUNDING * (size + 1e-12 * size.max())).all()
    l, u, ub = (np.abs(np.nan_to_num(side, posinf=0.0)) for side in (qp.l, qp.u, qp.ub))  # noqa: E741
    rows = qp.A @ z, qp.l, qp.u, y, abs(qp.A) @ abs(z) + l + u
    for value, low, high, multiplier, scale in (rows, (z, qp.lb, qp.ub, y_box, abs(z) + ub)):
        slack = ROUNDING * (scale + 1e-12 * scale.max())
        assert (value <= high + slack).all() and (value >= low - slack).all()
        pushed = np.abs(multiplier) > 1e-9 * np.abs(multiplier).max(initial=0.0)
        at = np.where(multiplier > 0, high, low)
        assert (np.abs(value - at)[pushed] <= slack[pushed]).all()


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(VESSELS),
    psi0_rad=st.floats(-3.0, 3.0),
    sizes=st.sampled_from([(1, 1), (6, 1), (6, 6), (30, 5), (60, 10)]),
    robust=st.booleans(),
    units=st.sampled_from(["scaled", "si"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_condensed_optimum_rolled_out_is_optimal_in_stages(
    name: str,
    psi0_rad: float,
    sizes: tuple[int, int],
    robust: bool,
    units: UnitSystem,
    seed: int,
) -> None:
    problem = ship_problem(name, psi0_rad=psi0_rad, N_p=sizes[0], N_c=sizes[1], robust=robust)
    case = at_sea(problem, seed)
    scaled, builder = CondensedQP(problem), StagedQP(problem, units=units)
    optimum = certify(scaled.problem(scaled.emit(case.x, case.y_ref, case.u_prev)))
    assert optimum.bound < 1e-10
    unit = problem.du_max if units == "scaled" else np.ones(problem.model.n_u)
    own = np.tile(problem.du_max / unit, problem.N_c)
    found = Solution(Status.SOLVED, optimum.z * own, optimum.y / own, optimum.y_box / own)
    answer = rolled_out(problem, unit, (case.x, case.u_prev), case.held, found)
    qp = builder.problem(builder.emit(case.x, case.y_ref, case.u_prev))
    assert_optimal(qp, answer)
    back = builder.convert_solution_to_condensed(answer)
    for name_ in ("z", "y", "y_box"):
        np.testing.assert_array_equal(getattr(back, name_), getattr(found, name_))


# Independent sparse solvers at tight settings: an interior point method, an active-set method.
TOLERANCES = "eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"
SOLVERS: dict[str, Any] = {"piqp_multistage": dict.fromkeys(TOLERANCES, 1e-12), "highs": "high"}


def distance(condensed: CondensedQP, staged: StagedQP, *theta: Any, **limits: Any) -> float:
    """Return the distance of the staged answer from the certified condensed plan, in maximum
    increments."""
    optimum = certify(condensed.problem(condensed.emit(*theta, **limits)))
    assert optimum.bound < 1e-10
    qp = staged.problem(staged.emit(*theta, **limits))
    errors = []
    for solver, options in SOLVERS.items():
        workspace = open_workspace(solver, route="native", policy="reuse", settings=options)
        workspace.setup(qp)
        workspace.solve()
        found = workspace.read()
        if found.status is Status.SOLVED:
            errors.append(
                float(np.abs(staged.convert_solution_to_condensed(found).z - optimum.z).max())
            )
    return min(errors)


def test_an_independent_sparse_solver_finds_the_same_moves(case: Any) -> None:
    builders = both(case.problem)
    for y_ref in (case.y_ref, case.preview()):
        assert distance(*builders, case.x, y_ref, case.u_prev) <= SAME


def lost(problem: Any) -> tuple[np.ndarray, Limits]:
    """A force near its limits, and limits that fall far below it at once."""
    u_prev = np.array([0.3, 1.0, -0.9]) * np.where([1, 1, 0], problem.u_max, -problem.u_min)
    return u_prev, Limits(0.4 * problem.u_min, 0.5 * problem.u_max)


@pytest.mark.parametrize("what", ["held", "preview", "limits", "terminal", "everything"])
def test_the_referee_certifies_the_same_moves(what: str) -> None:
    problem = ship_problem("supply_fs99", N_p=6, N_c=3, robust=True)
    problem = replace(problem, terminal="riccati" if what in ("terminal", "everything") else "none")
    case = at_sea(problem)
    y_ref = case.preview() if what in ("preview", "everything") else case.y_ref
    u_prev, limits = case.u_prev, None
    if what in ("limits", "everything"):
        # Half a maximum increment below the force: it has to fall at once, and no move is forced to
        # its own limit, where the multipliers of a plan would not be unique.
        u_prev, half = lost(problem)[0], 0.5 * problem.du_max
        low = np.maximum(problem.u_min, half - np.abs(u_prev))
        limits = Limits(low, np.abs(u_prev) - half)
    condensed, staged = both(problem)
    qp = condensed.problem(condensed.emit(case.x, y_ref, u_prev, limits=limits))
    expected = certify(qp)
    found = certify(staged.problem(staged.emit(case.x, y_ref, u_prev, limits=limits)))
    assert expected.bound < 1e-10 and found.bound < SAME
    back = staged.convert_solution_to_condensed(
        Solution(Status.SOLVED, found.z, found.y, found.y_box)
    )
    np.testing.assert_allclose(back.z, expected.z, rtol=0, atol=SAME)
    error, size = residuals(qp, back), np.abs(qp.q).max()
    assert error.primal < SAME and max(error.dual, error.complementarity) < SAME * size


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("name", VESSELS)
def test_limits_that_fall_leave_a_feasible_step_and_the_same_plan(
    name: str, units: UnitSystem
) -> None:
    problem = ship_problem(name, N_p=30, N_c=5, robust=True)
    case, (u_prev, limits) = at_sea(problem), lost(problem)
    condensed, staged = both(problem)
    assert distance(condensed, staged, case.x, case.y_ref, u_prev, limits=limits) <= SAME
    own = StagedQP(problem, units=units)
    qp = own.problem(own.emit(case.x, case.y_ref, u_prev, limits=limits))
    step = Fraction(1.0 if units == "scaled" else problem.du_max[1])
    for i in range(problem.N_c):
        # Exact: what the rows of the moves demand, and what the amplitude row allows.
        high, reached = qp.u[i * 15 + 3 + 9 + 1], Fraction(qp.l[1]) - (i + 1) * step
        assert Fraction(high) >= reached
        assert float(high) - float(reached) <= 1e-14 * abs(float(qp.l[1]))


def test_a_proof_of_infeasibility_is_one_of_the_condensed_problem() -> None:
    problem = ship_problem("supply_fs99", N_p=6, N_c=3)
    case, (u_prev, limits) = at_sea(problem), lost(problem)
    condensed, staged = both(problem, amplitude="hard")
    found = certify(staged.problem(staged.emit(case.x, case.y_ref, u_prev, limits=limits)))
    assert found.kind == "infeasible"
    answer = Solution(Status.PRIMAL_INFEASIBLE, found.z, found.y, found.y_box)
    back = staged.convert_solution_to_condensed(answer)
    qp = condensed.problem(condensed.emit(case.x, case.y_ref, u_prev, limits=limits))
    assert is_farkas_vector_proof(qp, back.y, back.y_box)
    assert back.status is Status.PRIMAL_INFEASIBLE and np.isnan(back.z).all()


def test_a_step_changes_vectors_only_and_keeps_them() -> None:
    """Stages in order, 15 rows and variables with a move and 9 without."""
    problem = ship_problem("supply_fs99")
    case, builder = at_sea(problem), StagedQP(problem)
    assert builder.n == builder.m == 5 * 15 + 25 * 9
    rows, columns = np.nonzero(builder.A)
    # A row reaches back to the start of the stage before its own, and no further.
    assert (columns - rows).max() <= 15 and (rows - columns).max() <= 2 * 15
    first = builder.emit(case.x, case.y_ref, case.u_prev)
    kept = [array.copy() for array in (first.q, first.l, first.u)]
    assert first.P is first.A is first.lb is first.ub is None
    builder.emit(2 * case.x, case.preview(), -case.u_prev, limits=lost(problem)[1])
    again = builder.emit(case.x, case.y_ref, case.u_prev)
    for name, then in zip("qlu", kept, strict=True):
        found, other = getattr(first, name), getattr(again, name)
        np.testing.assert_array_equal(found, then)
        np.testing.assert_array_equal(other, then)
        assert not np.shares_memory(found, other)


@pytest.mark.parametrize(("key", "value"), [("units", "kN"), ("amplitude", "soft")])
def test_what_it_cannot_do_is_refused(key: str, value: str) -> None:
    with pytest.raises(InputError, match=f"{key}.*{value}"):
        StagedQP(ship_problem("supply_fs99"), **{key: value})
