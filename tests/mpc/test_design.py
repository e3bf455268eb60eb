"""Figures of a control design against the QPs and the loop they speak of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import design_figures

DESIGNS = {
    "paper": ({}, 0.94949),
    "robust": ({"N_p": 60, "N_c": 10, "robust": True}, 0.96726),
}


@pytest.mark.parametrize("terminal", ["none", "riccati"])
@pytest.mark.parametrize("name", DESIGNS)
def test_design_figures_are_those_of_the_builder_and_its_loop(
    ship: Any, name: str, terminal: str
) -> None:
    """Gains are the slopes of the first unconstrained move, condition numbers the eigenvalue ratios
    of P in both units, and eigenvalues those of the loop closed by these slopes."""
    options, radius = DESIGNS[name]
    problem = replace(ship("supply_fs99", **options), terminal=terminal)
    figures = design_figures(problem)
    scaled, si = CondensedQP(problem), CondensedQP(problem, units="si")

    def first_move(x: np.ndarray, y_ref: np.ndarray) -> np.ndarray:
        plan: np.ndarray = -np.linalg.solve(scaled.P, scaled.emit(x, y_ref, np.zeros(3)).q)
        return scaled.moves(plan)[0]

    K_mpc = -np.column_stack([first_move(e, np.zeros(3)) for e in np.eye(9)])
    K_y = np.column_stack([first_move(np.zeros(9), e) for e in np.eye(3)])
    for found, expected in ((figures.K_mpc, K_mpc), (figures.K_y, K_y)):
        size = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose(found / size, expected / size, rtol=0, atol=1e-9)
    loop = np.column_stack(
        [problem.model.A @ e + problem.model.B @ first_move(e, np.zeros(3)) for e in np.eye(9)]
    )
    roots = np.linalg.eigvals(loop)
    np.testing.assert_allclose(np.poly(figures.eigenvalues), np.poly(roots), rtol=0, atol=1e-8)
    assert figures.spectral_radius == pytest.approx(np.abs(roots).max(), abs=1e-8)
    assert figures.controllable == 9
    for condition, builder in ((figures.condition_scaled, scaled), (figures.condition_si, si)):
        values = np.linalg.eigvalsh(builder.P)
        assert condition == pytest.approx(values[-1] / values[0], rel=1e-6)
    if terminal == "none":
        # Known from the least-squares loop in the tests of the law.
        assert figures.spectral_radius == pytest.approx(radius, abs=5e-6)
    assert figures.spectral_radius < 1.0
    # Scaling by the rate limits is worth two decades.
    assert figures.condition_si > 50 * figures.condition_scaled
