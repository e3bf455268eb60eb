"""Counts of one solver's C along a sequence, in memory."""

from dataclasses import dataclass

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.embedded.recipe import Settings

COUNTED = ("instructions", "loads", "stores", "stack", "iterations", "active", "status")
"""Columns of each step: executed, bytes of stack, then what the solver reports."""


@dataclass(frozen=True, eq=False)
class StepCounts:
    """Counts of a solver's C along a sequence of K QPs.

    Parameters
    ----------
    solver, target, sequence : names.
    single : whether in single precision.
    settings : of the solver.
    steps : (K,) of each of `COUNTED`; −1 where not counted or reported.
    z : (K, n) answers, in the units of the sequence.
    error_move, error_plan : (K,) distance to the certified optimum, of first move and whole plan.
    sizes : bytes of code, constants, static data and heap.
    """

    solver: str
    target: str
    sequence: str
    single: bool
    settings: Settings
    steps: dict[str, Ints]
    z: Matrix
    error_move: Vector
    error_plan: Vector
    sizes: dict[str, int]
