"""The paper's stacked form: rows in the paper's order, the same optimum, multipliers back."""

from __future__ import annotations

import daqp
import numpy as np
import pytest
import quadprog

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.qp.stacked import stack, stack_step, unstack
from dpbench.scenario.scenario import condense, load_scenario


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
    """The paper's problem: N_p 30, N_c 5, three axes, scaled."""
    return condense(load_scenario("paper"))


@pytest.fixture(scope="module")
def in_newtons() -> CondensedQP:
    """The same in N and N·m, as the paper writes it."""
    return condense(load_scenario("paper"), units="si")


def test_stacked_form_has_the_sixty_rows_of_the_paper_in_its_order(in_newtons: CondensedQP) -> None:
    """M = [−C2; C2; −I; I] and γ = [−U_min + C1 u; U_max − C1 u; −ΔU_min; ΔU_max] (eq. 23-25)."""
    u_min = np.array([-980000.0, -417000.0, -18000000.0])
    u_max = np.array([1240000.0, 417000.0, 18000000.0])
    du_max = np.array([32736.0, 11008.0, 475200.0])
    u = np.array([2e5, -1e5, 3e6])
    C2 = np.zeros((15, 15))
    for i in range(5):
        for j in range(i + 1):
            C2[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = np.eye(3)
    C1 = np.vstack([np.eye(3)] * 5)
    step = in_newtons.emit(state(1.2, 1.3, 0.0), np.zeros(3), u)
    found = stack(in_newtons.problem(step))
    assert (found.n, found.m) == (15, 60)
    np.testing.assert_array_equal(found.A, np.vstack([-C2, C2, -np.eye(15), np.eye(15)]))
    gamma = [
        -np.tile(u_min, 5) + C1 @ u,
        np.tile(u_max, 5) - C1 @ u,
        np.tile(du_max, 5),
        np.tile(du_max, 5),
    ]
    np.testing.assert_allclose(found.u, np.concatenate(gamma), rtol=1e-14)
    assert np.isneginf(found.l).all()
    assert np.isneginf(found.lb).all()
    assert np.isposinf(found.ub).all()
    np.testing.assert_array_equal(found.P, in_newtons.P)
    np.testing.assert_array_equal(found.q, step.q)


@pytest.mark.parametrize("name", STEPS)
def test_stacked_and_two_sided_forms_have_one_optimum(builder: CondensedQP, name: str) -> None:
    """quadprog on the stacked rows, mapped back, and daqp on the two-sided form agree in z, y and
    y_box."""
    x, u_prev, least_active = STEPS[name]
    qp = builder.problem(builder.emit(x, np.zeros(3), u_prev))
    z, _, flag, info = daqp.solve(
        qp.P.copy(),
        qp.q.copy(),
        qp.A.copy(),
        np.concatenate([qp.ub, qp.u]),
        np.concatenate([qp.lb, qp.l]),
        np.zeros(qp.n + qp.m, dtype=np.intc),
    )
    assert flag == 1
    lam = np.asarray(info["lam"])
    one_sided = stack(qp)
    raw = quadprog.solve_qp(
        one_sided.P.copy(), -one_sided.q, -one_sided.A.T.copy(), -one_sided.u, 0
    )
    answer = Solution(Status.SOLVED, raw[0], raw[4], np.zeros(qp.n), 3, 5, "words")
    back = unstack(answer, qp.m)
    # daqp's primal tolerance is 1e-6; on its final active set both solve one linear system.
    np.testing.assert_allclose(back.z, z, rtol=0, atol=1e-8)
    size = 1e-8 * (1.0 + np.abs(qp.q).max())
    np.testing.assert_allclose(back.y, lam[qp.n :], rtol=0, atol=size)
    np.testing.assert_allclose(back.y_box, lam[: qp.n], rtol=0, atol=size)
    slope = qp.P @ back.z + qp.q + qp.A.T @ back.y + back.y_box
    np.testing.assert_allclose(slope, 0.0, atol=size)
    active = np.count_nonzero(back.y) + np.count_nonzero(back.y_box)
    assert active >= least_active
    assert bool(active) == bool(least_active)
    assert (back.status, back.iterations, back.reported_ns, back.detail) == (
        Status.SOLVED,
        3,
        5,
        "words",
    )


def test_both_amplitude_signs_come_back_as_signed_multipliers() -> None:
    """λ of an upper row becomes y > 0, of a lower row y < 0, and the same for bounds."""
    lam = np.arange(1.0, 11.0)
    back = unstack(Solution(Status.SOLVED, np.zeros(3), lam, np.zeros(3)), 2)
    np.testing.assert_array_equal(back.y, [3.0 - 1.0, 4.0 - 2.0])
    np.testing.assert_array_equal(back.y_box, [8.0 - 5.0, 9.0 - 6.0, 10.0 - 7.0])


def test_a_missing_answer_stays_missing() -> None:
    """NaN in the stacked answer is NaN in the two-sided one, never a made-up multiplier."""
    back = unstack(Solution.missing(3, 10, Status.ERROR, "broke"), 2)
    assert np.isnan(np.concatenate([back.z, back.y, back.y_box])).all()
    assert (back.y.shape, back.y_box.shape) == ((2,), (3,))
    assert (back.status, back.detail) == (Status.ERROR, "broke")


def test_stacking_a_step_is_stacking_its_problem(builder: CondensedQP) -> None:
    """The stacked problem after a stacked step equals the stacked form of the problem after it."""
    first = builder.problem(builder.emit(state(0.01, -0.01, 0.0), np.zeros(3), np.zeros(3)))
    step = builder.emit(STEPS["amplitude"][0], np.zeros(3), STEPS["amplitude"][1])
    base = stack(first)
    kept = [a.copy() for a in (base.A, base.u, step.q, step.l, step.u)]
    moved = base.at(stack_step(step, base))
    expected = stack(first.at(step))
    for name in ("P", "q", "A", "l", "u", "lb", "ub"):
        np.testing.assert_array_equal(getattr(moved, name), getattr(expected, name))
    for now, then in zip((base.A, base.u, step.q, step.l, step.u), kept, strict=True):
        np.testing.assert_array_equal(now, then)


@pytest.mark.parametrize("changed", [(), ("A",), ("P", "A"), ("lb",), ("ub",), ("P", "lb", "ub")])
def test_a_chain_of_steps_stays_in_step_with_the_two_sided_form(changed: tuple[str, ...]) -> None:
    """Steps that change matrices or bounds, then vectors only, give stacked forms that agree as
    long as each is stacked against the problem it follows."""
    rng = np.random.default_rng(len(changed))
    n, m = 4, 3

    def fresh() -> dict[str, np.ndarray]:
        root = rng.normal(size=(n, n))
        return {
            "P": root @ root.T + np.eye(n),
            "q": rng.normal(size=n),
            "A": rng.normal(size=(m, n)),
            "l": -rng.uniform(1, 2, m),
            "u": rng.uniform(1, 2, m),
            "lb": -rng.uniform(1, 2, n),
            "ub": rng.uniform(1, 2, n),
        }

    two_sided = QuadraticProgram(**fresh())
    one_sided = stack(two_sided)
    for brought in (changed, (), changed):
        new = fresh()
        step = QPStep(new["q"], new["l"], new["u"], **{name: new[name] for name in brought})
        one_sided = one_sided.at(stack_step(step, one_sided))
        two_sided = two_sided.at(step)
        expected = stack(two_sided)
        for name in ("P", "q", "A", "l", "u", "lb", "ub"):
            np.testing.assert_array_equal(getattr(one_sided, name), getattr(expected, name))
