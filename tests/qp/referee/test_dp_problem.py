"""The referee on the problem it is for: the condensed QP of a dynamically positioned ship."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import quadprog

from dpbench.mpc.thruster_rows import Limits
from dpbench.qp.referee.optimum import Optimum
from dpbench.qp.referee.referee import Referee, referee_of
from dpbench.qp.residuals import is_true, residuals
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import condense, load_scenario


@pytest.mark.parametrize("name", ["paper", "rough"])
@pytest.mark.parametrize("drop", [False, True])
def test_steps_of_a_scenario(name: str, drop: bool) -> None:
    """Every step has a linear certificate below 1e-12, also while a limit has dropped.

    Far from the reference, with forces near their limits; the optimum is that of quadprog.
    """
    builder = condense(load_scenario(name))
    control = builder.control
    referee = Referee(builder.P, builder.A, builder.lb, builder.ub)
    rng = np.random.default_rng(0)
    eye = np.eye(builder.n)
    C = np.vstack((builder.A, eye, -builder.A, -eye)).T.copy()
    for _ in range(20):
        x = 1e-3 * rng.normal(size=control.model.n_x)
        y_ref = rng.normal(size=3) * [3.0, 3.0, 0.1]
        u_prev = control.u_max * rng.uniform(0.7, 1.0, 3)
        limits = Limits(0.4 * control.u_min, 0.4 * control.u_max) if drop else None
        step = builder.emit(x, y_ref, u_prev, limits=limits)
        qp = builder.problem(step)
        optimum = referee.certify(step.q, step.l, step.u)
        assert optimum.kind == "linear"
        assert optimum.bound <= 1e-12
        answer = Solution(Status.UNKNOWN, optimum.z, optimum.y, optimum.y_box)
        assert is_true(qp, residuals(qp, answer), 0.0, 1e-6)
        # quadprog wants some interior: limits a part in 1e9 wider move z by no more than
        # 1e-9 times the Lipschitz constant of the optimum, which cond(P) < 1e3 bounds.
        wider = np.concatenate((step.l, qp.lb, -step.u, -qp.ub)) - 1e-9
        z = quadprog.solve_qp(qp.P, -step.q, C, wider)[0]
        assert np.abs(z - optimum.z).max() <= 1e-6


def test_what_is_known_of_the_matrices_changes_no_answer() -> None:
    """Two runs of one controller, in either order: each certified as if there were no other."""
    builder = condense(load_scenario("rough"))
    matrices = builder.P, builder.A, builder.lb, builder.ub
    rng = np.random.default_rng(3)
    runs = [
        [
            builder.emit(
                1e-3 * rng.normal(size=9),
                rng.normal(size=3) * [9.0, 9.0, 0.3],
                builder.control.u_max * rng.uniform(-1.0, 1.0, 3),
            )
            for _ in range(30)
        ]
        for _ in range(2)
    ]

    def certified(referee: Referee, run: int) -> list[Optimum]:
        return [referee.certify(step.q, step.l, step.u) for step in runs[run]]

    alone = [certified(Referee(*matrices), run) for run in range(2)]
    for run in (0, 1, 1, 0):
        for found, wanted in zip(certified(referee_of(*matrices), run), alone[run], strict=True):
            for part in fields(Optimum):
                np.testing.assert_array_equal(getattr(found, part.name), getattr(wanted, part.name))
