"""Every certificate, given every active set of a small problem, is silent or right."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from dpbench.qp.referee.gap import gap_certificate
from dpbench.qp.referee.joint import ExactMatrices, JointQP
from dpbench.qp.referee.kkt import Geometry, KKTSystem, linear_certificate
from dpbench.qp.referee.rational import rational_certificate

ACTIVE_SETS = [np.array(signs, dtype=np.int8) for signs in product((-1, 0, 1), repeat=3)]


def _problem(q: tuple[float, float]) -> JointQP:
    """min ½‖z‖² + qᵀz, |z_i| ≤ 1, |z_1 + z_2| ≤ 1/2: its optimum is a projection."""
    C = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    U = np.array([0.5, 1.0, 1.0])
    return JointQP(np.eye(2), np.array(q), C, -U, U)


CASES = {
    # cost: optimum, the projection of −q on the feasible set
    (0.0, 0.0): (0.0, 0.0),
    (-0.125, -0.25): (0.125, 0.25),
    (-1.0, -1.0): (0.25, 0.25),
    (-2.0, 0.5): (1.0, -0.5),
    (-1.0, 0.5): (1.0, -0.5),
    (3.0, -3.0): (-1.0, 1.0),
    (-0.25, -0.25): (0.25, 0.25),
}


@pytest.mark.parametrize("q", CASES)
def test_linear_certificate(q: tuple[float, float]) -> None:
    """The linear certificate names the optimum or nothing, whichever rows are said to be active."""
    problem = _problem(q)
    for signs in ACTIVE_SETS:
        system = KKTSystem(problem.P, problem.C, signs)
        if system.proven:
            proof = linear_certificate(problem, Geometry(problem.C), system)
            assert proof is None or np.abs(proof.z - CASES[q]).max() <= proof.bound <= 1e-12


@pytest.mark.parametrize("q", CASES)
def test_gap_certificate(q: tuple[float, float]) -> None:
    """The bound of the gap certificate covers the optimum, however wrong the active rows are."""
    problem = _problem(q)
    exact = ExactMatrices.of(problem.P, problem.C)
    bounds = []
    for signs in ACTIVE_SETS:
        system = KKTSystem(problem.P, problem.C, signs)
        if system.proven:
            proof = gap_certificate(problem, exact, system, np.eye(2) * (1.0 + 1e-12))
            if proof is not None:
                assert np.abs(proof.z - CASES[q]).max() <= proof.bound
                bounds.append(proof.bound)
    assert min(bounds) <= 1e-12


@pytest.mark.parametrize("q", CASES)
def test_rational_certificate(q: tuple[float, float]) -> None:
    """The rational certificate finds the optimum to the last bit from any guess."""
    problem = _problem(q)
    exact = ExactMatrices.of(problem.P, problem.C)
    for signs in ACTIVE_SETS:
        proof = rational_certificate(problem, exact, signs)
        assert proof is not None
        # All coordinates of these optima are float64 numbers.
        assert tuple(proof.z) == CASES[q]
