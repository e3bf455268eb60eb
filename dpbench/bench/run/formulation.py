"""Formulations of one and the same problem: what the solver gets, and its answer mapped back.

Whatever the solver is given, logs, fallback and referee go on with the condensed problem.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from dpbench.bench.record.cell import Formulation
from dpbench.bench.run.qp_builder import QPBuilder
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.qp.stacked import stack, stack_step, unstack

NO_MODEL = "the QPs of a scenario; recorded and random ones bring no model whose states to keep"


class Formulated(Protocol):
    """One formulation of a sequence of QPs.

    Attributes
    ----------
    base : the problem a workspace is set up with, in this formulation.
    """

    base: QuadraticProgram

    def step(self, step: QPStep) -> QPStep:
        """What the solver gets of an emitted step; a part of emitting it.

        New matrices become those of `base`, so that a later step without any is solved with the
        same ones. Of the arrays that go to the solver nobody else keeps any.
        """

    def solution(self, answer: Solution) -> Solution:
        """The answer to the condensed problem."""


class Box:
    """The condensed problem as it is emitted: nothing to do."""

    def __init__(self, base: QuadraticProgram) -> None:
        self.base = base

    def step(self, step: QPStep) -> QPStep:
        """The step itself."""
        # Asking the flag `refresh` takes half a microsecond, and this is a part of emitting.
        if not (step.P is None and step.A is None and step.lb is None and step.ub is None):
            self.base = self.base.at(step)
            return step.copy()
        return step

    def solution(self, answer: Solution) -> Solution:
        """The answer itself."""
        return answer


class Stacked(Box):
    """The paper's one-sided rows (eq. 23-25), made of each emitted step."""

    def __init__(self, base: QuadraticProgram) -> None:
        super().__init__(stack(base))
        self._m = base.m

    def step(self, step: QPStep) -> QPStep:
        """The step with all limits as one-sided rows."""
        return super().step(stack_step(step, self.base))

    def solution(self, answer: Solution) -> Solution:
        """The multipliers of both sides of a row joined."""
        return unstack(answer, self._m)


class Sparse(Box):
    """The stage-ordered problem: its steps are emitted as such, its answers are condensed.

    Parameters
    ----------
    base : a problem of the sequence; condensed : maps an answer (`StagedQP.condensed`).
    """

    def __init__(self, base: QuadraticProgram, condensed: Callable[[Solution], Solution]) -> None:
        super().__init__(base)
        self._condensed = condensed

    def solution(self, answer: Solution) -> Solution:
        """The moves and the multipliers of their limits."""
        return self._condensed(answer)


def in_loop(formulation: Formulation, builder: QPBuilder, base: QuadraticProgram) -> Formulated:
    """The formulation of a closed loop; `base` is a condensed problem of the builder.

    The steps of "sparse" are those of a builder that was told so.
    """
    if builder.staged is None:
        return _of_condensed(formulation, base)
    model = builder.staged.control.model
    at_rest = np.zeros(model.n_x), np.zeros(model.n_y), np.zeros(model.n_u)
    staged = builder.staged
    return Sparse(staged.problem(staged.emit(*at_rest)), staged.condensed)


def in_replay(formulation: Formulation, sequence: QPSequence) -> tuple[QPSequence, Formulated]:
    """The steps to replay and their formulation; those of "sparse" are all made here, once.

    Raises
    ------
    InputError : for "sparse", where nobody knows the model behind the QPs.
    """
    if formulation != "sparse":
        return sequence, _of_condensed(formulation, sequence.base)
    if sequence.sparse_equivalent is None:
        raise InputError(f"sequence {sequence.name}", "formulation", "'sparse'", NO_MODEL)
    sparse = sequence.sparse_equivalent()
    return sparse.sequence, Sparse(sparse.sequence.base, sparse.condensed)


def _of_condensed(formulation: Formulation, base: QuadraticProgram) -> Formulated:
    return Stacked(base) if formulation == "condensed_stacked" else Box(base)
