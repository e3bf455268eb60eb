"""The stages of an optimal control problem, found in the pattern of a QP.

A row with l = u and a last variable that no other such row ends in defines that variable, a state,
by the variables before it. It is a row of the dynamics

    x_{k+1} = A_k x_k + B_k u_k + b_k

if every variable has a stage k such that a row of the dynamics leads from one stage to the next and
all else (the cost, the other rows) stays within one. Each of these is an equation between the
stages of two variables, 0 or 1 apart; so the stages are the potentials of a graph, if it has any.
A variable that no row defines is an input of its stage. A QP that is not of this kind, or whose
variables are not in an order of time, is one stage: all variables are inputs, all rows constraints.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Matrix

Indices = NDArray[np.intp]
Couplings = list[list[tuple[int, int]]]
"""For each variable: the variables it is coupled with, and how many stages behind it they are."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One stage of a QP, all by number.

    Parameters
    ----------
    inputs, states : its variables.
    dynamics : for each state, the row that defines it; none in stage 0.
    rows : the other rows, which have variables of this stage only.
    """

    inputs: Indices
    states: Indices
    dynamics: Indices
    rows: Indices

    @property
    def variables(self) -> Indices:
        """Inputs, then states."""
        return np.concatenate([self.inputs, self.states])


def find_stages(P: Matrix, A: Matrix, equal: NDArray[np.bool_]) -> list[Stage]:
    """The stages of a QP, in order; one stage if it has no others.

    Parameters
    ----------
    P : (n, n) symmetric cost; A : (m, n) rows; equal : (m,) which rows have l = u.
    """
    row, column = np.nonzero(A)
    members = np.split(column, np.searchsorted(row, np.arange(1, A.shape[0])))[: A.shape[0]]
    defines = _definitions(members, equal)
    stage_of = _potentials(_couplings(P, members, defines), set(defines.values()))
    if stage_of is None:
        defines, stage_of = {}, np.zeros(P.shape[0], dtype=np.intp)
    return _collected(members, defines, stage_of)


def _definitions(members: list[Indices], equal: NDArray[np.bool_]) -> dict[int, int]:
    """Which variable a row may define: {row: variable}, no variable twice."""
    last = {int(row): int(members[row].max()) for row in np.flatnonzero(equal) if members[row].size}
    taken: set[int] = set()
    defines = {}
    for row, variable in last.items():
        if variable not in taken:
            taken.add(variable)
            defines[row] = variable
    return defines


def _couplings(P: Matrix, members: list[Indices], defines: dict[int, int]) -> Couplings:
    couplings: Couplings = [[] for _ in range(P.shape[0])]

    def couple(i: int, j: int, apart: int) -> None:
        couplings[i].append((j, apart))
        couplings[j].append((i, -apart))

    for i, j in zip(*(index.tolist() for index in np.nonzero(np.triu(P, 1))), strict=True):
        couple(i, j, 0)
    for row, variables in enumerate(members):
        if row in defines:
            for j in variables.tolist():
                if j != defines[row]:
                    couple(defines[row], j, -1)
        else:
            for i, j in zip(variables[:-1].tolist(), variables[1:].tolist(), strict=True):
                couple(i, j, 0)
    return couplings


def _potentials(couplings: Couplings, states: set[int]) -> Indices | None:
    """The stage of each variable, each connected part as early as can be; None if there is none.

    A state is never in stage 0, from where nothing could lead to it.
    """
    n = len(couplings)
    stage_of, seen = np.zeros(n, dtype=np.intp), np.zeros(n, dtype=np.bool_)
    for start in range(n):
        if seen[start]:
            continue
        part = list(_walk(start, couplings, stage_of, seen))
        first = min(int(stage_of[i]) - (i in states) for i in part)
        stage_of[part] -= first
    consistent = all(
        stage_of[j] == stage_of[i] + apart for i in range(n) for j, apart in couplings[i]
    )
    return stage_of if consistent else None


def _walk(
    start: int, couplings: Couplings, stage_of: Indices, seen: NDArray[np.bool_]
) -> Iterator[int]:
    """All variables connected with one, each given a stage on the way."""
    seen[start] = True
    waiting = deque([start])
    while waiting:
        i = waiting.popleft()
        yield i
        for j, apart in couplings[i]:
            if not seen[j]:
                seen[j] = True
                stage_of[j] = stage_of[i] + apart
                waiting.append(j)


def _collected(members: list[Indices], defines: dict[int, int], stage_of: Indices) -> list[Stage]:
    n, last = stage_of.size, int(stage_of.max())
    defining = np.full(n, -1, dtype=np.intp)
    for row, variable in defines.items():
        defining[variable] = row
    # A row without any variable limits nothing but 0, in whichever stage it stands.
    of_row = np.array([stage_of[v[0]] if v.size else 0 for v in members], dtype=np.intp)
    of_row[list(defines)] = -1
    stages = []
    for k in range(last + 1):
        here = np.flatnonzero(stage_of == k)
        states = here[defining[here] >= 0]
        inputs = here[defining[here] < 0]
        stages.append(Stage(inputs, states, defining[states], np.flatnonzero(of_row == k)))
    return stages
