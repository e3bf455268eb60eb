"""Whether a solver's claim that there is no answer is true: a false one is as wrong as a false
"solved"."""

from __future__ import annotations

from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.feasibility.farkas import certify_unbounded, farkas_valid, unbounded_valid
from dpbench.qp.referee.referee import Optimum
from dpbench.qp.solution import Solution, Status


def judge_claim(qp: QuadraticProgram, solution: Solution, optimum: Optimum) -> bool:
    """Whether the status PRIMAL_INFEASIBLE or DUAL_INFEASIBLE of `solution` is proven true.

    The solver's own certificate in (y, y_box), or direction in z, is accepted if it is valid;
    otherwise the referee's verdict on the same problem decides. Any other status claims nothing of
    the kind and gives False.
    """
    if solution.status is Status.PRIMAL_INFEASIBLE:
        return optimum.kind == "infeasible" or farkas_valid(qp, solution.y, solution.y_box)
    if solution.status is Status.DUAL_INFEASIBLE:
        if optimum.kind not in ("none", "infeasible"):
            return False
        return unbounded_valid(qp, solution.z) or certify_unbounded(qp) is not None
    return False
