"""A constant disturbance leaves no steady error in the exactly solved loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import discretise, linearise, rotation
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.qp.referee.referee import Referee
from dpbench.scenario.scenario import load_vessel

PSI0 = 0.4
DISTURBANCE = np.array([-120e3, 150e3, 1.5e6])
"""b in the north-east frame [N, N, N·m]."""
STEPS = 700
"""The slowest mode of the paper's tuning is 0.9495 a step: 1e-15 of it is left."""

VARIANTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "riccati": {"terminal": "riccati"},
    "soft": {"amplitude": "soft"},
    "outputs": {"outputs": OutputBounds(0.3, 5.0, 0.5)},
    "relinearised": {"relinearised": True},
}


def builder_of(problem: Any, options: dict[str, Any]) -> CondensedQP:
    """The controller of a variant."""
    options = dict(options)
    if "terminal" in options:
        return CondensedQP(replace(problem, terminal=options["terminal"]))
    if options.pop("relinearised", False):
        return RelinearisedQP(problem, psi0_rad=PSI0, always=False)
    return CondensedQP(problem, **options)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_constant_disturbance_leaves_no_steady_error(ship: Any, variant: str) -> None:
    """Model plus constant b, every step solved with a certified optimum: after a transient with
    active limits the output is the reference and the force is −Rᵀb, both to rounding."""
    vessel = load_vessel("supply_fs99")
    problem = ship("supply_fs99", psi0_rad=PSI0)
    builder = builder_of(problem, VARIANTS[variant])
    referee = Referee(builder.P, builder.A, builder.lb, builder.ub)
    plant = discretise(linearise(vessel.M, vessel.D, PSI0), 0.3)
    push = rotation(PSI0).T @ DISTURBANCE
    state = np.array([0.0, 0.0, 0.0, 0.5, -0.4, PSI0])
    y_ref = np.array([0.2, 0.1, PSI0 + 0.02])
    before, u, limited = state, np.zeros(3), 0
    for _ in range(STEPS):
        x = np.concatenate([state - before, state[3:]])
        step = builder.emit(x, y_ref, u)
        best = referee.certify(step.q, step.l, step.u)
        assert best.bound < 1e-10
        limited += bool((np.abs(best.y_box) > 1e-9).any())
        u = u + builder.moves(best.z)[0]
        before, state = state, plant.A @ state + plant.B @ (u + push)
    assert limited > 3
    np.testing.assert_allclose(state[3:], y_ref, rtol=0, atol=1e-10)
    np.testing.assert_allclose(state[:3], 0.0, atol=1e-10)
    np.testing.assert_allclose(u / problem.du_max, -push / problem.du_max, rtol=0, atol=1e-8)
