"""The figures by which a control design is judged before any simulation (paper section III.E).

λ of A − B K_mpc (eq. 35);   K_mpc, K_y (eq. 33);   cond₂(E) in SI and of z = ΔU/Δu_max
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix
from dpbench.mpc.condense import ControlProblem, condense_matrices
from dpbench.mpc.law import closed_loop_eigenvalues, controllable_rank, gains


@dataclass(frozen=True, eq=False)
class DesignFigures:
    """What the unconstrained loop and the cost matrix of a control problem look like.

    Parameters
    ----------
    eigenvalues : (n_x,) of the closed loop, by falling modulus; inside the unit circle it is
        stable as long as no limit is active.
    spectral_radius : modulus of the first.
    K_mpc, K_y : (n_u, n_x), (n_u, n_y) gains [N, N, N·m per m/s, rad/s, m, rad].
    controllable : dimension of the controllable subspace of (A, B); n_x is all of it.
    condition_scaled, condition_si : 2-norm condition numbers of P in the two systems of units.
    """

    eigenvalues: NDArray[np.complex128]
    spectral_radius: float
    K_mpc: Matrix
    K_y: Matrix
    controllable: int
    condition_scaled: float
    condition_si: float


def design_figures(problem: ControlProblem) -> DesignFigures:
    """The figures of a control problem, terminal cost included; limits play no part."""
    matrices = condense_matrices(problem)
    law = gains(problem, matrices)
    roots = closed_loop_eigenvalues(problem.model, law).astype(np.complex128)
    du = np.tile(problem.du_max, problem.N_c)
    return DesignFigures(
        eigenvalues=roots,
        spectral_radius=float(np.abs(roots[0])),
        K_mpc=law.K_mpc,
        K_y=law.K_y,
        controllable=controllable_rank(problem.model),
        condition_scaled=float(np.linalg.cond(matrices.E * np.outer(du, du))),
        condition_si=float(np.linalg.cond(matrices.E)),
    )
