"""The stages of an optimal control problem, found in the pattern of a QP.

A row with l = u and a last variable that no other such row ends in defines that variable, a state,
by the variables before it. It is a row of the dynamics

    x_{k+1} = A_k x_k + B_k u_k + b_k

if every variable has a stage k such that a row of the dynamics leads from one stage to the next and
all else (the cost, the other rows) stays within one. Each of these is an equation between the
stages of two variables, 0 or 1 apart; so the stages are the potentials of a graph, if it has any.
A variable that no row defines is an input of its stage. A QP that is not of this kind, or whose
variables are not in an order of time, is one stage: all variables are inputs, all rows constraints.

The data go to HPIPM in the order and the memory that its optimal control interface wants:

    minimise    Σ ½ [u; x]ᵀ [R S; Sᵀ Q] [u; x] + [r; q]ᵀ [u; x]               of each stage
    subject to  x_{k+1} = A_k x_k + B_k u_k + b_k
                lb ≤ [u; x] ≤ ub,  lg ≤ C x + D u ≤ ug

Vectors of all stages stand in one array each, so that a step gathers them at once, and only those
of the stages in which something has changed are handed over.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.solvers.libraries.hpipm.library import Structures, pointer

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


def find_stages(P: Matrix, A: Matrix, equal: Flags) -> list[Stage]:
    """Find the stages of a QP, in order; one stage if it has no others.

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


def _definitions(members: list[Indices], equal: Flags) -> dict[int, int]:
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
    """Find the stage of each variable, each connected part as early as can be.

    None if there is none.

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


def _walk(start: int, couplings: Couplings, stage_of: Indices, seen: Flags) -> Iterator[int]:
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


NOTHING: Indices = np.empty(0, dtype=np.intp)


def limited(A: Matrix, numbers: Indices) -> Matrix:
    """Those rows of [A; I]."""
    m, n = A.shape
    rows, own = np.zeros((numbers.size, n)), numbers >= m
    rows[~own] = A[numbers[~own]]
    rows[own, numbers[own] - m] = 1.0
    return rows


class StageLimits:
    """Which limits of [A; I] are bounds of a stage and which are general rows.

    A row that is one variable itself is a bound of it, if it has no other. A limit without any
    finite side is none; one infinite side is masked out, which this interface of HPIPM bears in
    bounds too.
    """

    def __init__(self, stage: Stage, A: Matrix, low: Vector, high: Vector) -> None:
        numbers = np.concatenate([stage.rows, A.shape[0] + stage.variables])
        numbers = numbers[~((low[numbers] == -np.inf) & (high[numbers] == np.inf))]
        rows = limited(A, numbers)
        single = (np.count_nonzero(rows, axis=1) == 1) & (rows.sum(axis=1) == 1.0)
        candidates = np.flatnonzero(single)[::-1]
        bound_of: dict[int, int] = {}
        # Bounds of the variables stand behind the rows and come first here.
        for variable, number in zip(
            rows[candidates].argmax(axis=1), numbers[candidates], strict=True
        ):
            bound_of.setdefault(int(variable), int(number))
        bounded = [i for i, v in enumerate(stage.variables.tolist()) if v in bound_of]
        self.positions = np.array(bounded, dtype=np.intc)
        self.bounds: Indices = np.array(
            [bound_of[v] for v in stage.variables[bounded].tolist()], dtype=np.intp
        )
        self.rows: Indices = np.setdiff1d(numbers, self.bounds)

    @property
    def sides(self) -> Indices:
        """Numbers in [A; I]: bounds before rows, as in HPIPM."""
        return np.concatenate([self.bounds, self.rows])

    def masks(self, low: Vector, high: Vector) -> dict[str, Vector]:
        """0 for each infinite side, 1 for the others, by the name of HPIPM's mask if it has a 0."""
        # A NaN is a limit like any other.
        masks = {
            f"{side}{kind}_mask": 1.0 - np.isinf(limit[numbers])
            for side, limit in (("l", low), ("u", high))
            for kind, numbers in (("b", self.bounds), ("g", self.rows))
        }
        return {name: mask for name, mask in masks.items() if not mask.all()}


class StageData:
    """The matrices of all stages, as HPIPM's setters take them, and the order of the vectors.

    Parameters
    ----------
    stages : as found; P : cost; A : rows; low, high : limits of [A; I].

    Attributes
    ----------
    order : the variables, dynamics : their defining rows, sides : the limits, stage by stage.
    pivots : what the variable that a row of `dynamics` defines is multiplied with.
    """

    def __init__(
        self, stages: list[Stage], P: Matrix, A: Matrix, low: Vector, high: Vector
    ) -> None:
        if len(stages) == 1:
            # HPIPM's recursion is wrong where there is no step from a stage to another.
            stages = [*stages, Stage(NOTHING, NOTHING, NOTHING, NOTHING)]
        self.stages = stages
        self.limits = [StageLimits(stage, A, low, high) for stage in stages]
        self.order = np.concatenate([stage.variables for stage in stages])
        self.dynamics = np.concatenate([stage.dynamics for stage in stages])
        self.sides = np.concatenate([limits.sides for limits in self.limits])
        states = np.concatenate([stage.states for stage in stages])
        self.pivots: Vector = A[self.dynamics, states]
        self.matrices = [self._stage(k, P, A) for k in range(len(stages))]

    def _stage(self, k: int, P: Matrix, A: Matrix) -> dict[str, NDArray[Any]]:
        stage, limits = self.stages[k], self.limits[k]
        u, x, general = stage.inputs, stage.states, limited(A, limits.rows)
        matrices: dict[str, NDArray[Any]] = {
            "R": P[np.ix_(u, u)],
            "Q": P[np.ix_(x, x)],
            "S": P[np.ix_(u, x)],
            "C": general[:, x],
            "D": general[:, u],
        }
        if k + 1 < len(self.stages):
            after = self.stages[k + 1]
            defining = A[after.dynamics]
            factor = -defining[np.arange(after.states.size), after.states][:, None]
            matrices |= {"A": defining[:, x] / factor, "B": defining[:, u] / factor}
        matrices = {name: np.asfortranarray(matrix) for name, matrix in matrices.items()}
        return matrices | {"idxb": limits.positions}

    @property
    def sizes(self) -> list[NDArray[np.intc]]:
        """nx, nu, nbx, nbu, ng, ns of each stage."""
        inputs = np.array([stage.inputs.size for stage in self.stages])
        on_inputs = [
            np.count_nonzero(limits.positions < n)
            for limits, n in zip(self.limits, inputs, strict=True)
        ]
        sizes = (
            [stage.states.size for stage in self.stages],
            inputs,
            [a.positions.size - n for a, n in zip(self.limits, on_inputs, strict=True)],
            on_inputs,
            [limits.rows.size for limits in self.limits],
            np.zeros(inputs.size),
        )
        return [np.array(size, dtype=np.intc) for size in sizes]


class Part:
    """One vector of all stages, sent by stage where it has changed.

    Parameters
    ----------
    calls : for each stage, the setters and how many entries of the vector each takes in turn.
    """

    def __init__(self, parts: Structures, calls: list[list[tuple[str, int]]]) -> None:
        sizes = [sum(size for _, size in stage) for stage in calls]
        self.values = np.zeros(sum(sizes))
        self._new = np.empty_like(self.values)
        self._changed = np.empty(self.values.shape, dtype=np.bool_)
        self._stage_of = np.repeat(np.arange(len(calls)), sizes)
        self._qp = parts.qp
        self._calls: list[list[tuple[Any, Any]]] = []
        at = 0
        for stage in calls:
            self._calls.append([])
            for name, size in stage:
                if size:
                    address = pointer(self.values[at : at + size])
                    self._calls[-1].append((parts.function(f"set_{name}"), address))
                at += size

    def gather(self, source: Vector, numbers: Indices) -> Vector:
        """Return the entries of a vector of the QP, in memory to be changed before `send`."""
        return source.take(numbers, out=self._new)

    def send(self, everything: bool = False) -> None:
        """Hand over what has been gathered."""
        changed = np.not_equal(self._new, self.values, out=self._changed)
        if not (everything or changed.any()):
            return
        self.values[:] = self._new
        for k in set(self._stage_of.tolist() if everything else self._stage_of[changed].tolist()):
            for function, address in self._calls[k]:
                function(k, address, self._qp)


def addresses(array: Vector, sizes: Iterable[int]) -> NDArray[np.uintp]:
    """Where pieces of those sizes begin in an array, as C reads it."""
    first = np.concatenate([[0], np.cumsum(list(sizes), dtype=np.intp)[:-1]])
    return (array.ctypes.data + array.itemsize * first).astype(np.uintp)
