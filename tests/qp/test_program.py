"""Steps and sequences of QPs, moves of their variables, and the paper's stacked form."""

from dataclasses import replace
from typing import Any

import daqp
import numpy as np
import pytest
import quadprog
import scipy

from dpbench.bench.run.formulation import (
    convert_qp_to_one_sided_rows,
    convert_solution_to_two_sided_rows,
    convert_step_to_one_sided_rows,
)
from dpbench.errors import InputError, ShapeError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram, Refresh
from dpbench.qp.referee.referee import certify
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import condense, load_scenario

K, N, M = 4, 6, 4


def program(seed: int, **more: Any) -> QuadraticProgram:
    rng = np.random.default_rng(seed)
    root, q, A = rng.normal(size=(N, N)), rng.normal(size=N), rng.normal(size=(M, N))
    l, u, lb, ub = (sign * rng.uniform(1, 2, k) for k in (M, N) for sign in (-1, 1))  # noqa: E741
    return QuadraticProgram(root @ root.T, q, A, l, u, lb, ub, **more)


def sequence(problems: list[QuadraticProgram], *matrices: str) -> QPSequence:
    names = "q", "l", "u", *matrices
    stacked = {name: np.array([getattr(p, name) for p in problems]) for name in names}
    return QPSequence(name="random", base=problems[0], **stacked)


def test_a_step_that_a_sequence_does_not_have_is_named() -> None:
    with pytest.raises(IndexError, match=r"^step: found 4; allowed: 0 to 3$"):
        sequence([program(k) for k in range(K)]).problem(K)


@pytest.mark.parametrize("matrices", [(), ("P",), ("A",), ("P", "A")], ids="".join)
def test_a_sequence_replays_the_problem_of_every_step(matrices: tuple[str, ...]) -> None:
    problems = [program(k) for k in range(K)]
    recorded = sequence(problems, *matrices)
    for k in (2, 0, 3, 1):
        step, found = recorded.step(k), recorded.problem(k)
        changed = Refresh.VECTORS | (Refresh.MATRICES if matrices else Refresh.VECTORS)
        assert step.refresh == changed
        for name in ("q", "l", "u", *matrices):
            np.testing.assert_array_equal(getattr(found, name), getattr(problems[k], name))
        for name in {"P", "A", "lb", "ub"} - set(matrices):
            np.testing.assert_array_equal(getattr(found, name), getattr(problems[0], name))


@pytest.mark.parametrize(("name", "shape"), [("P", (K, N, M)), ("A", (K, N, N)), ("P", (K, N))])
def test_a_sequence_names_the_matrices_that_do_not_fit(name: str, shape: tuple[int, ...]) -> None:
    base = program(0)
    vectors = {"q": np.zeros((K, N)), "l": np.zeros((K, M)), "u": np.zeros((K, M))}
    with pytest.raises(ShapeError) as caught:
        QPSequence(name="bad", base=base, **vectors, **{name: np.zeros(shape)})
    assert caught.value.key == name


def test_an_asymmetric_cost_is_refused_and_rounding_averaged() -> None:
    """Solvers that read one triangle would else solve another problem."""
    qp = program(0)
    apart = qp.P.copy()
    apart[1, 4] += 0.5
    with pytest.raises(InputError) as caught:
        replace(qp, P=apart)
    assert str(caught.value).startswith("QuadraticProgram: P[1, 4]: found ")
    steps = {"P": np.array([qp.P, apart])}
    with pytest.raises(InputError, match=r"QPSequence: P\[1, 1, 4\]: found "):
        QPSequence("two", qp, np.zeros((2, N)), np.zeros((2, M)), np.ones((2, M)), **steps)
    rounded = qp.P.copy()
    rounded[1, 4] *= 1.0 + 1e-14
    P = replace(qp, P=rounded).P
    np.testing.assert_array_equal(P, P.T)
    np.testing.assert_allclose(P, qp.P, rtol=1e-14)


def test_rows_and_limits_may_be_left_out() -> None:
    qp = program(0)
    boxed = QuadraticProgram(qp.P, qp.q, lb=qp.lb, ub=qp.ub)
    assert (boxed.n, boxed.m) == (N, 0)
    np.testing.assert_array_equal(boxed.ub, qp.ub)
    above = QuadraticProgram(qp.P, qp.q, qp.A, u=qp.u)
    low, high = above.stack_row_and_bound_limits()
    assert (low == -np.inf).all() and (high[M:] == np.inf).all()
    np.testing.assert_array_equal(high[:M], qp.u)


@pytest.mark.parametrize("P", [scipy.sparse.eye_array(N), "P", [[1.0], [1.0, 2.0]]])
def test_what_is_no_dense_array_is_a_type_error(P: Any) -> None:
    with pytest.raises(TypeError, match=r"^QuadraticProgram: P: found a \w+; allowed: a dense"):
        replace(program(0), P=P)
    with pytest.raises(
        TypeError, match=r"^qp: found an object of type tuple; allowed: a QuadraticProgram"
    ):
        certify((P,))  # type: ignore[arg-type] # the mistake that is tested


def test_a_cost_matrix_with_nan_is_kept() -> None:
    qp = program(0)
    broken = qp.P.copy()
    broken[1, 4] = np.nan
    np.testing.assert_array_equal(replace(qp, P=broken).P, broken)


def test_the_number_of_moves_survives_steps_and_stacking() -> None:
    qp = program(0, block=3, moves=2)
    step = QPStep(2.0 * qp.q, qp.l, qp.u, P=3.0 * qp.P)
    assert (qp.at(step).block, qp.at(step).moves) == (3, 2)
    assert convert_qp_to_one_sided_rows(qp).moves == 2
    assert program(0, block=3).moves == 0


@pytest.mark.parametrize(("block", "moves"), [(3, 4), (3, -1), (0, N + 1)])
def test_more_moves_than_variables_of_a_block_are_refused(block: int, moves: int) -> None:
    with pytest.raises(ShapeError) as caught:
        program(0, block=block, moves=moves)
    assert caught.value.key == "moves"


def state(north_m: float, east_m: float, heading_rad: float) -> np.ndarray:
    """An augmented state at rest at a pose."""
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, north_m, east_m, heading_rad])


# Nothing active; rate limits active; rate and amplitude limits active (sway at its limit).
STEPS = {
    "inside": (state(0.01, -0.01, 0.0), np.zeros(3), 0),
    "rate": (state(1.2, 1.3, 0.02), np.zeros(3), 3),
    "amplitude": (state(1.2, 1.3, 0.05), np.array([-970e3, -415e3, 1e6]), 5),
}


@pytest.fixture(scope="module")
def builder() -> CondensedQP:
    return condense(load_scenario("paper"))


def test_stacked_form_has_the_sixty_rows_of_the_paper_in_its_order() -> None:
    """M = [−C2; C2; −I; I] and γ = [−U_min + C1 u; U_max − C1 u; −ΔU_min; ΔU_max] (eq. 23-25)."""
    in_newtons = condense(load_scenario("paper"), units="si")
    u_min = np.array([-980000.0, -417000.0, -18000000.0])
    u_max = np.array([1240000.0, 417000.0, 18000000.0])
    du_max = np.array([32736.0, 11008.0, 475200.0])
    u, C2, eye = np.array([2e5, -1e5, 3e6]), np.kron(np.tri(5), np.eye(3)), np.eye(15)
    step = in_newtons.emit(state(1.2, 1.3, 0.0), np.zeros(3), u)
    found = convert_qp_to_one_sided_rows(in_newtons.problem(step))
    assert (found.n, found.m) == (15, 60)
    np.testing.assert_array_equal(found.A, np.vstack([-C2, C2, -eye, eye]))
    gamma = [np.tile(part, 5) for part in (-u_min + u, u_max - u, du_max, du_max)]
    np.testing.assert_allclose(found.u, np.concatenate(gamma), rtol=1e-14)
    assert all(np.isneginf(limit).all() for limit in (found.l, found.lb, -found.ub))
    np.testing.assert_array_equal(found.P, in_newtons.P)
    np.testing.assert_array_equal(found.q, step.q)


@pytest.mark.parametrize("name", STEPS)
def test_stacked_and_two_sided_forms_have_one_optimum(builder: CondensedQP, name: str) -> None:
    x, u_prev, least_active = STEPS[name]
    qp = builder.problem(builder.emit(x, np.zeros(3), u_prev))
    limits = (np.concatenate(pair) for pair in ((qp.ub, qp.u), (qp.lb, qp.l)))
    sense = np.zeros(qp.n + qp.m, dtype=np.intc)
    z, _, flag, info = daqp.solve(qp.P.copy(), qp.q.copy(), qp.A.copy(), *limits, sense)
    assert flag == 1
    lam, stacked = np.asarray(info["lam"]), convert_qp_to_one_sided_rows(qp)
    raw = quadprog.solve_qp(stacked.P.copy(), -stacked.q, -stacked.A.T.copy(), -stacked.u, 0)
    back = convert_solution_to_two_sided_rows(
        Solution(Status.SOLVED, raw[0], raw[4], np.zeros(qp.n), 3, 5, "words"), qp.m
    )
    # daqp's primal tolerance is 1e-6; on its final active set both solve one linear system.
    np.testing.assert_allclose(back.z, z, rtol=0, atol=1e-8)
    size = 1e-8 * (1.0 + np.abs(qp.q).max())
    np.testing.assert_allclose(back.y, lam[qp.n :], rtol=0, atol=size)
    np.testing.assert_allclose(back.y_box, lam[: qp.n], rtol=0, atol=size)
    slope = qp.P @ back.z + qp.q + qp.A.T @ back.y + back.y_box
    np.testing.assert_allclose(slope, 0.0, atol=size)
    active = np.count_nonzero(back.y) + np.count_nonzero(back.y_box)
    assert active >= least_active and bool(active) == bool(least_active)
    found = back.status, back.iterations, back.reported_ns, back.detail
    assert found == (Status.SOLVED, 3, 5, "words")


def test_both_amplitude_signs_come_back_as_signed_multipliers() -> None:
    """λ of an upper row becomes y > 0, of a lower row y < 0, and the same for bounds."""
    lam = np.arange(1.0, 11.0)
    back = convert_solution_to_two_sided_rows(
        Solution(Status.SOLVED, np.zeros(3), lam, np.zeros(3)), 2
    )
    np.testing.assert_array_equal(back.y, [3.0 - 1.0, 4.0 - 2.0])
    np.testing.assert_array_equal(back.y_box, [8.0 - 5.0, 9.0 - 6.0, 10.0 - 7.0])


def test_a_missing_answer_stays_missing() -> None:
    back = convert_solution_to_two_sided_rows(
        Solution.without_point(3, 10, Status.ERROR, "broke"), 2
    )
    assert np.isnan(np.concatenate([back.z, back.y, back.y_box])).all()
    assert (back.y.shape, back.y_box.shape) == ((2,), (3,))
    assert (back.status, back.detail) == (Status.ERROR, "broke")


def test_stacking_a_step_is_stacking_its_problem(builder: CondensedQP) -> None:
    first = builder.problem(builder.emit(state(0.01, -0.01, 0.0), np.zeros(3), np.zeros(3)))
    step = builder.emit(STEPS["amplitude"][0], np.zeros(3), STEPS["amplitude"][1])
    base = convert_qp_to_one_sided_rows(first)
    kept = [a.copy() for a in (base.A, base.u, step.q, step.l, step.u)]
    moved = base.at(convert_step_to_one_sided_rows(step, base))
    expected = convert_qp_to_one_sided_rows(first.at(step))
    for name in ("P", "q", "A", "l", "u", "lb", "ub"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(expected, name))
    for now, then in zip((base.A, base.u, step.q, step.l, step.u), kept, strict=True):
        np.testing.assert_array_equal(now, then)


@pytest.mark.parametrize("changed", [(), ("A",), ("P", "A"), ("lb",), ("ub",), ("P", "lb", "ub")])
def test_a_chain_of_steps_stays_in_step_with_the_two_sided_form(changed: tuple[str, ...]) -> None:
    two_sided = program(0)
    one_sided = convert_qp_to_one_sided_rows(two_sided)
    for seed, brought in enumerate((changed, (), changed), 1):
        new = program(seed)
        step = QPStep(new.q, new.l, new.u, **{name: getattr(new, name) for name in brought})
        one_sided = one_sided.at(convert_step_to_one_sided_rows(step, one_sided))
        two_sided = two_sided.at(step)
        expected = convert_qp_to_one_sided_rows(two_sided)
        for name in ("P", "q", "A", "l", "u", "lb", "ub"):
            np.testing.assert_array_equal(getattr(one_sided, name), getattr(expected, name))
