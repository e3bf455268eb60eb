"""Goal of a search, and the worst step of an evaluated replay by that measure."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from dpbench.arrays import Floats
from dpbench.bench.judge.closed_loop import CERTIFICATES, EVALUATION, EvaluatedCell
from dpbench.bench.judge.rules import INFEASIBLE, UNCERTIFIED, UNDECIDED, WARM_UP
from dpbench.qp.solution import Status

Goal = Literal["iterations", "error"]
GOALS: tuple[Goal, ...] = get_args(Goal)
DECLINED = 1e-2
"""Largest error that an answer without a claim counts: what is just true."""
_ROUNDING = 1e-18
"""Errors of zero have no logarithm; no certificate sees one below this."""
_LARGEST = 1e300
_NO_ANSWER_CLAIMS = [status for status in Status if status.claims_no_optimum_exists]


@dataclass(frozen=True)
class WorstStep:
    """The worst step of a replay: iterations (−1 if not counted), error, status, and how bad it is.

    `objective` is how bad by the goal; `score` is of the whole replay, which a search maximises:
    equal objectives may differ in it.
    """

    step: int
    iterations: int
    error_plan: float
    bound: float
    status: Status
    objective: float
    score: float

    def describe_figure(self, goal: Goal) -> str:
        """Format the worst step's iterations or error, whichever is searched for, as text."""
        if goal == "iterations":
            return f"{self.iterations} iterations ({self.status.name.lower()})"
        claim = "claimed" if self.status is Status.SOLVED else self.status.name.lower()
        if self.objective < self.error_plan:
            claim = f"{claim}, which counts as {self.objective:g}"
        near = f", known to {self.bound:.0e}" if self.bound > 0.01 * self.error_plan else ""
        return f"error_plan {self.error_plan:.2e} ({claim}{near})"


def find_worst_step(evaluated: EvaluatedCell, goal: Goal) -> WorstStep | None:
    """Return the worst step of a replay, by iterations or error; None if none can be rated.

    By "error" a claimed answer counts its `error_plan`; one that is declined counts at most
    `DECLINED`, because a controller can act on a refusal; a false "infeasible", and a "solved" of
    what has no feasible point, count as infinite.
    """
    columns = evaluated.columns
    counting = columns["repeat"] != WARM_UP
    iterations = columns["iterations"][counting]
    if goal == "iterations":
        if not (iterations >= 0).any():
            return None
        objective = iterations.astype(np.float64)
    else:
        objective = _rate_steps_by_error(evaluated)[counting]
    if not len(objective):
        return None
    at = int(objective.argmax())
    worst = float(objective[at])
    if goal == "iterations":
        # Counts tie often; of two equal ones the busier replay is nearer to a worse step.
        score = worst + float(np.maximum(objective, 0.0).mean()) / (1.0 + worst)
    else:
        score = float(np.log10(np.clip(worst, _ROUNDING, _LARGEST)))
    evaluations = columns["evaluations"][counting][at]
    return WorstStep(
        int(columns["k"][counting][at]),
        int(iterations[at]),
        float(evaluations[EVALUATION.index("error_plan")]),
        float(evaluations[EVALUATION.index("optimum_bound")]),
        Status(int(columns["status"][counting][at])),
        worst,
        score,
    )


def _rate_steps_by_error(evaluated: EvaluatedCell) -> Floats:
    """Return how bad each step's answer is by its error; inf for a false claim of the solver."""
    columns = evaluated.columns
    status = columns["status"]
    error, true = (columns["evaluations"][:, EVALUATION.index(x)] for x in ("error_plan", "true"))
    solved, empty = status == Status.SOLVED, np.isin(status, _NO_ANSWER_CLAIMS)
    certificate = np.array(CERTIFICATES)[columns["certificate"]]
    objective = np.where(solved, error, np.minimum(error, DECLINED))
    objective[(empty & (true != 1.0)) | (solved & (certificate == INFEASIBLE))] = np.inf
    objective[np.isin(certificate, (UNCERTIFIED, UNDECIDED))] = 0.0
    # No optimum to compare with, and nothing false about it.
    return np.nan_to_num(objective, nan=0.0, posinf=np.inf)
