"""Search by differential evolution for a goal, which keeps the worst case.

The solver answers in a process of its own; one that crashes or hangs costs the sequence it failed
on. Every sequence is answered by a new workspace, a warm-up round first, as in a campaign, so that
a case replays to the same figures.
"""

from dataclasses import dataclass, replace
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.optimize import Bounds, differential_evolution
from scipy.stats import qmc

from dpbench.arrays import Floats
from dpbench.bench.judge.evaluation import (
    CERTIFICATES,
    EVALUATION,
    EvaluatedCell,
    evaluate_replay_log,
)
from dpbench.bench.judge.rules import INFEASIBLE, UNCERTIFIED, UNDECIDED, WARM_UP
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import Cell, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.exact_loop import record_sequence
from dpbench.bench.workers.child import ServingChild
from dpbench.bench.workers.worker import answer_sequences
from dpbench.bench.worst_case.space import SearchSpace
from dpbench.errors import CertificateError, InputError
from dpbench.qp.program import QPSequence
from dpbench.qp.solution import Status
from dpbench.scenario.scenario import Scenario

Goal = Literal["iterations", "error"]
GOALS: tuple[Goal, ...] = get_args(Goal)
DECLINED = 1e-2
"""Largest error that an answer without a claim counts: what is just true."""
_ROUNDING = 1e-18
"""Errors of zero have no logarithm; no certificate sees one below this."""
_LARGEST = 1e300
_NO_ANSWER_CLAIMS = [status for status in Status if status.claims_no_optimum_exists]
CASE_LIMIT_S = 5.0
"""Run time of one case; a solver that takes longer hangs."""
FIRST_STEPS = 5
"""Steps of the scenario that show whether a solver counts its iterations."""
BASELINE_LIMIT_S = 60.0
"""Run time of the scenario's own sequence; a slower solver answers part of it."""
_POPULATIONS = (8, 16, 32)
"""Points that evolve together: powers of two, for which a Sobol sample is balanced."""


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


class _BudgetError(Exception):
    """Raised within a worst-case search when its number of trials is used up."""


class SearchedSolver:
    """A solver in a worker process that solves sequences of QPs one after the other."""

    def __init__(self, context: ForkServerContext, folder: Path, cell: Cell) -> None:
        self._context, self._folder, self._cell = context, folder, cell
        self._start_process()

    @property
    def name(self) -> str:
        """Name of the solver."""
        return self._cell.solver

    def _start_process(self) -> None:
        """Start a worker process with the solver; InputError where it cannot run."""
        args = (self._cell.to_json(), self._folder, "searched")
        self._child = ServingChild(
            self._context, answer_sequences, args, self._folder, "searched", limit_s=None
        )
        ready = self._child.wait_until_ready()
        if isinstance(ready, InputError):
            raise ready
        if ready is not True:
            outcome = self._child.determine_outcome()
            where, detail = f"solver {self._cell.solver}", f"{outcome.outcome}: {outcome.detail}"
            raise InputError(where, "", detail, "a solver that starts in its own process")

    def answer(self, sequence: QPSequence, limit_s: float) -> tuple[Outcome, EvaluatedCell | None]:
        """Replay a sequence of QPs within `limit_s` [s]; return outcome and evaluated steps."""
        raw = self._child.raw_path
        raw.unlink(missing_ok=True)
        # How to make it in another form is not needed there, and large.
        self._child.send_order((replace(sequence, sparse_equivalent=None), limit_s))
        completed = self._child.wait_for_reply(limit_s)
        outcome = Outcome("finished", "")
        if completed is False:
            outcome = Outcome("timed_out", f"the sequence took more than {limit_s:g} s")
        elif completed is not True:
            outcome = self._child.dismiss()
            self._start_process()
        if not raw.exists():
            return outcome, None
        sample_s = float(sequence.meta.get("sample_s", float("nan")))
        return outcome, evaluate_replay_log(RawLog.open(raw), sequence, sample_s)

    def close(self) -> None:
        """End the worker process of the solver."""
        self._child.dismiss()


@dataclass(frozen=True, eq=False)
class Case:
    """A variant of a scenario, its QPs, the solver's outcome, and its worst step, if any."""

    scenario: Scenario
    sequence: QPSequence
    outcome: Outcome
    worst: WorstStep | None


class Search:
    """A search for the scenario variant with a solver's worst step, by differential evolution.

    Attributes
    ----------
    baseline, baseline_outcome : of the scenario itself, as in `Case`.
    best : the first of the worst cases so far; None where none had a figure.
    failures : by outcome of the process: how many cases, and the first of them.
    evaluations : cases tried; stopped : why the budget is not spent, "" where it is.
    """

    def __init__(
        self,
        solver_process: SearchedSolver,
        space: SearchSpace,
        goal: Goal,
        budget: int,
        progress: Progress,
    ) -> None:
        self._solver_process, self._space, self._goal = solver_process, space, goal
        self._budget, self._progress = budget, progress
        self.baseline: WorstStep | None = None
        self.baseline_outcome = Outcome("timed_out", "not tried")
        self.best: Case | None = None
        self.failures: dict[str, tuple[int, Case]] = {}
        self.evaluations = 0
        self.stopped = ""

    def run(self, base: Scenario, seed: int) -> None:
        """Replay the unchanged scenario, then variants until trials are used up; store the worst.

        InputError where the goal is iterations and the solver counts none, or a case cannot be
        made; CertificateError for the scenario itself.
        """
        # An impossible length is an error before anything runs.
        self._space.build_variant(np.zeros(self._space.dimensions))
        self._progress.start(self._budget)
        try:
            self._evaluate_baseline(base)
            self._evolve(np.random.default_rng(seed))
        except _BudgetError:
            return
        except KeyboardInterrupt:
            self.stopped = "interrupted"

    def _evaluate_baseline(self, base: Scenario) -> None:
        """Replay the unchanged scenario and set its outcome and worst step."""
        if self._goal == "iterations":
            self._refuse_solver_without_count(base.truncate(FIRST_STEPS))
        self._progress.advance(0, f"{base.name} itself, {base.steps} steps")
        outcome, evaluated = self._solver_process.answer(record_sequence(base), BASELINE_LIMIT_S)
        self.baseline_outcome = outcome
        self.baseline = None if evaluated is None else find_worst_step(evaluated, self._goal)

    def _refuse_solver_without_count(self, first: Scenario) -> None:
        """Raise InputError if the solver solves the first steps and reports no iterations."""
        _, evaluated = self._solver_process.answer(record_sequence(first), CASE_LIMIT_S)
        if evaluated is None or find_worst_step(evaluated, "iterations") is not None:
            return
        if (evaluated.columns["status"] == Status.SOLVED).any():
            where = f"solver {self._solver_process.name}"
            allowed = "a solver that counts its iterations on this route, or --goal error"
            raise InputError(where, "", "no number of iterations in its solutions", allowed)

    def _evolve(self, rng: np.random.Generator) -> None:
        """Search scenario variants for the worst step by differential evolution, until stopped."""
        d = self._space.dimensions
        size = max((s for s in _POPULATIONS if 8 * s <= self._budget), default=_POPULATIONS[0])
        # A population that has closed in on one point starts anew.
        while not self.stopped:
            first = qmc.Sobol(d, seed=rng).random(size)
            differential_evolution(
                self._compute_cost_at_point,
                Bounds(-np.ones(d), np.ones(d)),
                init=2.0 * first - 1.0,
                maxiter=self._budget,
                tol=1e-6,
                polish=False,
                seed=rng,
            )

    def _compute_cost_at_point(self, point: Floats) -> float:
        """Return the cost of a scenario variant: the worse its worst step, the lower; else inf."""
        if self.evaluations == self._budget:
            raise _BudgetError
        self.evaluations += 1
        worst = self._replay_variant_at_point(point)
        known = None if self.best is None else self.best.worst
        self._progress.advance(
            1, "nothing yet" if known is None else known.describe_figure(self._goal)
        )
        return np.inf if worst is None else -worst.score

    def _replay_variant_at_point(self, point: Floats) -> WorstStep | None:
        """Replay the scenario variant at a point, keep it if worst; return its worst step."""
        try:
            scenario = self._space.build_variant(point)
            sequence = record_sequence(scenario)
        except CertificateError:
            # Without a certified loop there is nothing to judge by.
            return None
        try:
            outcome, evaluated = self._solver_process.answer(sequence, CASE_LIMIT_S)
        except InputError as error:
            # The solver ran before, so the input is right; the best case so far is kept.
            self.stopped = f"stopped: {error}"
            raise _BudgetError from error
        if outcome.outcome == "lost":
            # No failure of the solver, and the next case would fare no better.
            self.stopped = f"stopped: {outcome.detail}"
            raise _BudgetError
        if outcome.outcome != "finished" or evaluated is None:
            case = Case(scenario, sequence, outcome, None)
            count, first = self.failures.get(outcome.outcome, (0, case))
            self.failures[outcome.outcome] = count + 1, first
            return None
        worst = find_worst_step(evaluated, self._goal)
        known = None if self.best is None else self.best.worst
        if worst is not None and (known is None or worst.objective > known.objective):
            self.best = Case(scenario, sequence, outcome, worst)
        return worst
