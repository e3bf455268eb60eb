"""The stage-ordered problem against the condensed one: the same optimum, proofs included."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpbench import open_workspace
from dpbench.errors import InputError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.farkas import farkas_valid
from dpbench.qp.referee.referee import certify
from dpbench.qp.residuals import residuals
from dpbench.qp.solution import Solution, Status

VESSELS = ("supply_fs99", "supply_mss", "supply_tmr", "osv", "cybership2")
ROUNDING = 1e-9
"""Of the sum of the sizes of all terms of an equation; optima are certified to 1e-10."""
SAME = 1e-8
"""The largest difference of plans called equal, in rate-limit steps."""


def both(problem: Any, units: UnitSystem = "scaled", **policy: Any) -> tuple[Any, Any]:
    """The condensed builder and the staged one."""
    return CondensedQP(problem, units=units, **policy), StagedQP(problem, units=units, **policy)


def rolled_out(
    problem: Any, unit: np.ndarray, theta: tuple[Any, ...], Y_d: np.ndarray, found: Solution
) -> Solution:
    """All variables and multipliers of the staged problem from a condensed answer, stage by stage.

    Forces and states by stepping the model, λ by summing multipliers backwards, μ by the costate
    recursion from the last state; `unit` (n_u,) of the moves, Y_d (N_p, n_y).
    """
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
    lam = -np.cumsum(y[::-1], axis=0)[::-1]
    z_parts, y_parts, box_parts = [], [], []
    for i in range(problem.N_p):
        box_parts.append(np.zeros(model.n_x))
        z_parts.append(states[i])
        y_parts.append(mu[i])
        if i < N_c:
            z_parts[-1:] = [moves[i], u[i], states[i]]
            y_parts[-1:] = [lam[i], mu[i], y[i]]
            bound = found.y_box.reshape(N_c, -1)[i]
            box_parts[-1:] = [bound, np.zeros(model.n_u), np.zeros(model.n_x)]
    whole = (np.concatenate(parts) for parts in (z_parts, y_parts, box_parts))
    return Solution(Status.SOLVED, *whole)


def assert_optimal(qp: QuadraticProgram, answer: Solution) -> None:
    """Every optimality condition, each to rounding of the terms it is the sum of."""
    z, y, y_box = answer.z, answer.y, answer.y_box
    slope = qp.P @ z + qp.q + qp.A.T @ y + y_box
    size = abs(qp.P) @ abs(z) + abs(qp.q) + abs(qp.A).T @ abs(y) + abs(y_box)
    assert (np.abs(slope) <= ROUNDING * (size + 1e-12 * size.max())).all()
    finite = [np.where(np.isfinite(limit), limit, 0.0) for limit in (qp.l, qp.u, qp.lb, qp.ub)]
    for value, low, high, multiplier, scale in (
        (qp.A @ z, qp.l, qp.u, y, abs(qp.A) @ abs(z) + abs(finite[0]) + abs(finite[1])),
        (z, qp.lb, qp.ub, y_box, abs(z) + abs(finite[3])),
    ):
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
    ship: Any,
    point: Any,
    name: str,
    psi0_rad: float,
    sizes: tuple[int, int],
    robust: bool,
    units: UnitSystem,
    seed: int,
) -> None:
    """States by simulation and costates by their recursion complete a certified condensed optimum
    to a point that satisfies every optimality condition of the staged problem, for any vessel,
    horizon and θ; `condensed` takes them away again."""
    problem = ship(name, psi0_rad=psi0_rad, N_p=sizes[0], N_c=sizes[1], robust=robust)
    case = point(problem, seed)
    scaled, builder = CondensedQP(problem), StagedQP(problem, units=units)
    optimum = certify(scaled.problem(scaled.emit(case.x, case.y_ref, case.u_prev)))
    assert optimum.bound < 1e-10
    unit = problem.du_max if units == "scaled" else np.ones(problem.model.n_u)
    own = np.tile(problem.du_max / unit, problem.N_c)
    found = Solution(Status.SOLVED, optimum.z * own, optimum.y / own, optimum.y_box / own)
    answer = rolled_out(problem, unit, (case.x, case.u_prev), case.held, found)
    qp = builder.problem(builder.emit(case.x, case.y_ref, case.u_prev))
    assert_optimal(qp, answer)
    back = builder.condensed(answer)
    for name_ in ("z", "y", "y_box"):
        np.testing.assert_array_equal(getattr(back, name_), getattr(found, name_))


ARMS: dict[str, Any] = {
    "piqp_multistage": dict.fromkeys(
        ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"), 1e-12
    ),
    "highs": "high",
}
"""Independent sparse solvers at tight settings: an interior point method, an active-set method."""


def distance(condensed: CondensedQP, staged: StagedQP, *theta: Any, **limits: Any) -> float:
    """How far the staged answer is from the certified condensed plan, in rate-limit steps.

    The nearer of two solvers: the interior point method comes to 1e-8 only where limits are weakly
    active, the active-set method breaks down on some problems.
    """
    optimum = certify(condensed.problem(condensed.emit(*theta, **limits)))
    assert optimum.bound < 1e-10
    qp = staged.problem(staged.emit(*theta, **limits))
    errors = []
    for solver, options in ARMS.items():
        workspace = open_workspace(solver, route="native", policy="reuse", settings=options)
        workspace.setup(qp)
        workspace.solve()
        found = workspace.read()
        if found.status is Status.SOLVED:
            errors.append(float(np.abs(staged.condensed(found).z - optimum.z).max()))
    return min(errors)


def test_an_independent_sparse_solver_finds_the_same_moves(case: Any) -> None:
    """Sparse solvers on the staged problem and the certified condensed optimum agree, with a
    reference that is held and with one that changes along the horizon."""
    builders = both(case.problem)
    for y_ref in (case.y_ref, case.preview()):
        assert distance(*builders, case.x, y_ref, case.u_prev) <= SAME


def lost(problem: Any) -> tuple[np.ndarray, Limits]:
    """A force near its limits, and limits that fall far below it at once."""
    u_prev = np.array([0.3, 1.0, -0.9]) * np.where([1, 1, 0], problem.u_max, -problem.u_min)
    return u_prev, Limits(0.4 * problem.u_min, 0.5 * problem.u_max)


@pytest.mark.parametrize("what", ["held", "preview", "limits", "terminal", "everything"])
def test_the_referee_certifies_the_same_moves(ship: Any, point: Any, what: str) -> None:
    """The certificate of the staged problem itself, whose cost is only semidefinite, against that
    of the condensed one; its multipliers satisfy the condensed problem's conditions."""
    problem = ship("supply_fs99", N_p=6, N_c=3, robust=True)
    if what in ("terminal", "everything"):
        problem = replace(problem, terminal="riccati")
    case = point(problem)
    y_ref = case.preview() if what in ("preview", "everything") else case.y_ref
    u_prev, limits = case.u_prev, None
    if what in ("limits", "everything"):
        # Half a rate-limit step below the force: it has to fall at once, and no move is forced to
        # its own limit, where the multipliers of a plan would not be unique.
        u_prev, _ = lost(problem)
        half = 0.5 * problem.du_max
        low = np.maximum(problem.u_min, -np.abs(u_prev) + half)
        limits = Limits(low, np.abs(u_prev) - half)
    condensed, staged = both(problem)
    qp = condensed.problem(condensed.emit(case.x, y_ref, u_prev, limits=limits))
    expected = certify(qp)
    found = certify(staged.problem(staged.emit(case.x, y_ref, u_prev, limits=limits)))
    assert expected.bound < 1e-10 and found.bound < SAME
    answer = Solution(Status.SOLVED, found.z, found.y, found.y_box)
    back = staged.condensed(answer)
    np.testing.assert_allclose(back.z, expected.z, rtol=0, atol=SAME)
    checked = residuals(qp, back)
    size = np.abs(qp.q).max()
    assert checked.primal < SAME and checked.dual < SAME * size
    assert checked.complementarity < SAME * size


@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("name", VESSELS)
def test_limits_that_fall_leave_a_feasible_step_and_the_same_plan(
    ship: Any, point: Any, name: str, units: UnitSystem
) -> None:
    """Under the policy `reachable` every move down is forced: solvers find that plan, and in exact
    arithmetic the amplitude rows leave room for it, by no more than rounding."""
    problem = ship(name, N_p=30, N_c=5, robust=True)
    case, (u_prev, limits) = point(problem), lost(problem)
    condensed, staged = both(problem)
    assert distance(condensed, staged, case.x, case.y_ref, u_prev, limits=limits) <= SAME
    own = StagedQP(problem, units=units)
    qp = own.problem(own.emit(case.x, case.y_ref, u_prev, limits=limits))
    unit = problem.du_max if units == "scaled" else np.ones(3)
    falling = -problem.du_max / unit
    for i in range(problem.N_c):
        # Exact: what the rows of the moves demand, and what the amplitude row allows.
        first = i * (2 * 3 + problem.model.n_x)
        high = qp.u[first + 3 + problem.model.n_x + 1]
        reached = Fraction(qp.l[1]) + (i + 1) * Fraction(falling[1])
        assert Fraction(high) >= reached
        assert float(high) - float(reached) <= 1e-14 * abs(float(qp.l[1]))


def test_with_a_terminal_cost_the_moves_are_the_same(ship: Any, point: Any) -> None:
    """At the paper's horizon, with preview and a cost at the end."""
    problem = replace(ship("supply_fs99", psi0_rad=0.4), terminal="riccati")
    case = point(problem)
    assert distance(*both(problem), case.x, case.preview(), case.u_prev) <= SAME


def test_a_proof_of_infeasibility_is_one_of_the_condensed_problem(ship: Any, point: Any) -> None:
    """Hard limits that no move reaches: the staged problem's Farkas vector, mapped, proves that the
    condensed one has no feasible point."""
    problem = ship("supply_fs99", N_p=6, N_c=3)
    case, (u_prev, limits) = point(problem), lost(problem)
    condensed, staged = both(problem, amplitude="hard")
    found = certify(staged.problem(staged.emit(case.x, case.y_ref, u_prev, limits=limits)))
    assert found.kind == "infeasible"
    answer = Solution(Status.PRIMAL_INFEASIBLE, found.z, found.y, found.y_box)
    back = staged.condensed(answer)
    qp = condensed.problem(condensed.emit(case.x, case.y_ref, u_prev, limits=limits))
    assert farkas_valid(qp, back.y, back.y_box)
    assert back.status is Status.PRIMAL_INFEASIBLE and np.isnan(back.z).all()


def test_a_missing_answer_stays_missing(ship: Any) -> None:
    """No number is made of NaN, and words and counts are handed on."""
    builder = StagedQP(ship("supply_fs99"))
    nothing = Solution.missing(builder.n, builder.m, Status.ERROR, "no factorisation")
    nothing.iterations, nothing.reported_ns = 7, 11
    back = builder.condensed(nothing)
    assert back.z.shape == back.y.shape == back.y_box.shape == (15,)
    assert np.isnan([back.z, back.y, back.y_box]).all()
    found = (back.status, back.iterations, back.reported_ns, back.detail)
    assert found == (Status.ERROR, 7, 11, "no factorisation")


def test_a_step_changes_vectors_only_and_keeps_them(ship: Any, point: Any) -> None:
    """Stages in order, 15 rows and variables with a move and 9 without; a step outlives the next
    one and leaves the vessel's limits in place."""
    problem = ship("supply_fs99")
    case, builder = point(problem), StagedQP(problem)
    assert builder.n == builder.m == 5 * 15 + 25 * 9
    rows, columns = np.nonzero(builder.A)
    # A row reaches back to the start of the stage before its own, and no further.
    assert (columns - rows).max() <= 15 and (rows - columns).max() <= 2 * 15
    first = builder.emit(case.x, case.y_ref, case.u_prev)
    kept = [array.copy() for array in (first.q, first.l, first.u)]
    assert first.P is first.A is first.lb is first.ub is None
    builder.emit(2 * case.x, case.preview(), -case.u_prev, limits=lost(problem)[1])
    again = builder.emit(case.x, case.y_ref, case.u_prev)
    for found, other, copy in zip(
        (first.q, first.l, first.u), (again.q, again.l, again.u), kept, strict=True
    ):
        np.testing.assert_array_equal(found, copy)
        np.testing.assert_array_equal(other, copy)
        assert not np.shares_memory(found, other)


@pytest.mark.parametrize(("key", "value"), [("units", "kN"), ("amplitude", "soft")])
def test_what_it_cannot_do_is_refused(ship: Any, key: str, value: str) -> None:
    """Units of another name, and a policy that needs slacks."""
    with pytest.raises(InputError, match=f"{key}.*{value}"):
        StagedQP(ship("supply_fs99"), **{key: value})
