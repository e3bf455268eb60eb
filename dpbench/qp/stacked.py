"""The paper's stacked one-sided form (eq. 23-25) of a two-sided QP, and the conversion back.

    M z ≤ γ   with   M = [−A; A; −I; I],   γ = [−l; u; −lb; ub]
    rows                 0    m  2m  2m+n  2m+2n

For N_p 30, N_c 5 these are the paper's 60 rows: M1 = [−C2; C2], M2 = [−I; I]. The multipliers of
the two sides of one row combine to y = λ_upper − λ_lower.
"""

import numpy as np

from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution


def convert_qp_to_one_sided_rows(qp: QuadraticProgram) -> QuadraticProgram:
    """Convert a QP with two-sided rows and bounds to 2m + 2n one-sided rows M z ≤ γ."""
    identity = np.eye(qp.n)
    M = np.vstack([-qp.A, qp.A, -identity, identity])
    gamma = np.concatenate([-qp.l, qp.u, -qp.lb, qp.ub])
    free = np.full(qp.n, np.inf)
    none = np.full(len(gamma), -np.inf)
    return QuadraticProgram(qp.P, qp.q, M, none, gamma, -free, free, 0, qp.moves)


def convert_step_to_one_sided_rows(step: QPStep, stacked: QuadraticProgram) -> QPStep:
    """Convert a step of a QP to one of its one-sided form `stacked`, M from what it brings."""
    m = step.l.shape[0]
    gamma = stacked.u.copy()
    np.negative(step.l, out=gamma[:m])
    gamma[m : 2 * m] = step.u
    M = None
    if step.A is not None:
        M = stacked.A.copy()
        np.negative(step.A, out=M[:m])
        M[m : 2 * m] = step.A
    n = stacked.n
    if step.lb is not None:
        np.negative(step.lb, out=gamma[2 * m : 2 * m + n])
    if step.ub is not None:
        gamma[2 * m + n :] = step.ub
    return QPStep(step.q, stacked.l.copy(), gamma, P=step.P, A=M)


def convert_solution_to_two_sided_rows(solution: Solution, m: int) -> Solution:
    """Convert a solution of the one-sided QP back to one of the two-sided QP with m rows."""
    n = solution.z.shape[0]
    lam = solution.y
    y, y_box = lam[m : 2 * m] - lam[:m], lam[2 * m + n :] - lam[2 * m : 2 * m + n]
    return solution.copy_with_other_vectors(solution.z, y, y_box)
