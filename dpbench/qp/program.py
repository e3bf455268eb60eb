"""The types all packages share: a quadratic program, one step of it, a recorded sequence.

    minimise ½ zᵀP z + qᵀz   subject to   l ≤ A z ≤ u,   lb ≤ z ≤ ub

Arrays are float64 and C-contiguous. Nothing here checks values beyond shape and type: a NaN is
data that the solvers must face and the referee must find.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Flag, auto
from typing import TYPE_CHECKING, Any

import numpy as np

from dpbench.arrays import Floats, Matrix, Vector
from dpbench.errors import ShapeError

if TYPE_CHECKING:
    from dpbench.qp.solution import Solution

CONSTANT = ("P", "A", "lb", "ub")
"""What of a problem stays the same along most sequences."""


class Refresh(Flag):
    """What a step changes in the problem a workspace was set up with."""

    VECTORS = auto()
    MATRICES = auto()


def in_blocks(n: int, m: int, block: int) -> bool:
    """Whether n variables and m rows fall into moves of `block` variables and equally many rows."""
    return block == 0 or (n % block == 0 and m % (n // block) == 0)


def rows_per_block(n: int, m: int, block: int) -> int:
    """How many of m rows belong to each move of `block` of n variables; 0 where block is."""
    return m * block // n


def shaped(where: str, name: str, value: object, shape: tuple[int, ...]) -> Floats:
    """`value` as a contiguous float64 array; ShapeError naming where and name unless of `shape`."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError.of(where, name, array.shape, f"shape {shape}")
    return array


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """A convex QP in two-sided form.

    Parameters
    ----------
    P : (n, n) symmetric positive semidefinite cost matrix.
    q : (n,) linear cost.
    A : (m, n) rows; m may be 0.
    l, u : (m,) row limits, ±inf allowed.
    lb, ub : (n,) bounds, ±inf allowed.
    block : variables per move, so that a workspace can shift a warm start by one move without
        knowing ships; the rows belong to the n/block moves alike. 0 keeps a start as it is.
    moves : how many variables of a block, its first ones, are moves of an actuator; the rest are
        slacks, which no error of a move or of a plan counts. 0 = all.
    stages : (states, inputs) of each stage of an optimal control problem whose variables are in
        this order, for a solver that factorises stage by stage; () where there are none.

    Raises
    ------
    ShapeError : if the shapes do not fit each other.
    """

    P: Matrix
    q: Vector
    A: Matrix
    l: Vector  # noqa: E741 - the name of the lower row limit in OSQP's and the paper's notation
    u: Vector
    lb: Vector
    ub: Vector
    block: int = 0
    moves: int = 0
    stages: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        n = np.shape(self.q)[0] if np.ndim(self.q) == 1 else -1
        if n < 1:
            raise ShapeError.of("QuadraticProgram", "q", np.shape(self.q), "shape (n,) with n ≥ 1")
        m = np.shape(self.A)[0] if np.ndim(self.A) == 2 else -1
        if m < 0:
            raise ShapeError.of("QuadraticProgram", "A", np.shape(self.A), f"shape (m, {n})")
        shapes = {"P": (n, n), "q": (n,), "A": (m, n), "l": (m,), "u": (m,), "lb": (n,), "ub": (n,)}
        for name, shape in shapes.items():
            array = shaped("QuadraticProgram", name, getattr(self, name), shape)
            object.__setattr__(self, name, array)
        if not in_blocks(n, m, self.block):
            allowed = f"0, or a divisor of n={n} into moves that share m={m} rows alike"
            raise ShapeError.of("QuadraticProgram", "block", (self.block,), allowed)
        most = self.block or n
        if not 0 <= self.moves <= most:
            raise ShapeError.of("QuadraticProgram", "moves", (self.moves,), f"0 to {most}")

    @property
    def n(self) -> int:
        """Number of variables."""
        return int(self.q.shape[0])

    @property
    def m(self) -> int:
        """Number of rows."""
        return int(self.A.shape[0])

    def limits(self) -> tuple[Vector, Vector]:
        """[l; lb] and [u; ub], the lower and upper limits of the rows of [A; I]: (m + n,) each."""
        return np.concatenate((self.l, self.lb)), np.concatenate((self.u, self.ub))

    def objective(self, z: Vector) -> float:
        """½ zᵀPz + qᵀz."""
        return float(0.5 * z @ self.P @ z + self.q @ z)

    def copy(self) -> QuadraticProgram:
        """Copy the problem into memory that nobody else holds."""
        P, q, A, l, u, lb, ub = (  # noqa: E741 - the name in OSQP's notation, as `l` above
            array.copy() for array in (self.P, self.q, self.A, self.l, self.u, self.lb, self.ub)
        )
        return QuadraticProgram(P, q, A, l, u, lb, ub, self.block, self.moves, self.stages)

    def changed_by(self, step: QPStep) -> bool:
        """Whether a step has to be solved with other matrices than those of this problem."""
        if step.P is step.A is step.lb is step.ub is None:
            return False
        for name in CONSTANT:
            matrix, known = getattr(step, name), getattr(self, name)
            if matrix is not None and matrix is not known and not np.array_equal(matrix, known):
                return True
        return False

    def at(self, step: QPStep) -> QuadraticProgram:
        """Return the problem after `step`: its vectors, and its matrices where it brings any."""
        return QuadraticProgram(
            self.P if step.P is None else step.P,
            step.q,
            self.A if step.A is None else step.A,
            step.l,
            step.u,
            self.lb if step.lb is None else step.lb,
            self.ub if step.ub is None else step.ub,
            self.block,
            self.moves,
            self.stages,
        )


@dataclass(slots=True, eq=False)
class QPStep:
    """What changes from one step to the next; the vectors live in memory of the step's own.

    `P, A, lb, ub` are None unless they changed.
    """

    q: Vector
    l: Vector  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    u: Vector
    P: Matrix | None = None
    A: Matrix | None = None
    lb: Vector | None = None
    ub: Vector | None = None

    @property
    def refresh(self) -> Refresh:
        """`VECTORS`, or `VECTORS | MATRICES` when P, A, lb or ub changed."""
        if self.P is None and self.A is None and self.lb is None and self.ub is None:
            return Refresh.VECTORS
        return Refresh.VECTORS | Refresh.MATRICES

    def copy(self) -> QPStep:
        """Copy the step into memory that nobody else holds."""
        P, A, lb, ub = (a if a is None else a.copy() for a in (self.P, self.A, self.lb, self.ub))
        return QPStep(self.q.copy(), self.l.copy(), self.u.copy(), P, A, lb, ub)


@dataclass(frozen=True, eq=False)
class Units:
    """Diagonal change of units between a problem as solved and its scaled form.

    z_own = z * z_scaled and (A z)_own = row * (A z)_scaled; the objective is the same number in
    both, so multipliers transform by y_scaled = row * y_own and y_box_scaled = z * y_box_own.
    """

    z: Vector
    row: Vector


@dataclass(frozen=True, eq=False)
class QPSequence:
    """QPs recorded along one run: constant matrices in `base`, the rest per step.

    Parameters
    ----------
    name : what it was recorded from.
    base : the problem of step 0 (all its arrays are those of step 0).
    q, l, u : (K, n), (K, m), (K, m) vectors of each step.
    P, A : (K, n, n), (K, m, n) matrices of each step; None where they are those of `base`.
    lb, ub : (K, n) bounds of each step; None where they are those of `base`.
    units : how the variables of these QPs relate to the scaled ones; None means scaled.
    scaled : the same sequence in scaled units, what the referee judges in; None when this is it.
    meta : where it comes from: scenario, sample time [s], first step, versions.
    sparse_equivalent : makes the same problems in sparse form with the states kept; None where
        nobody can.
    """

    name: str
    base: QuadraticProgram
    q: Matrix
    l: Matrix  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    u: Matrix
    units: Units | None = None
    scaled: QPSequence | None = None
    meta: dict[str, str | float | int] = field(default_factory=dict)
    P: Floats | None = None
    A: Floats | None = None
    lb: Matrix | None = None
    ub: Matrix | None = None
    sparse_equivalent: Callable[[], SparseEquivalent] | None = None

    def __post_init__(self) -> None:
        K, n, m = np.shape(self.q)[0], self.base.n, self.base.m
        shapes: dict[str, tuple[int, ...]] = {"q": (K, n), "l": (K, m), "u": (K, m)}
        shapes |= {"P": (K, n, n), "A": (K, m, n), "lb": (K, n), "ub": (K, n)}
        for name, shape in shapes.items():
            if getattr(self, name) is None and name in CONSTANT:
                continue
            array = shaped("QPSequence", name, getattr(self, name), shape)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return int(self.q.shape[0])

    def step(self, k: int) -> QPStep:
        """Step k in memory of its own: whatever is written there, the sequence stays as it is."""
        step = QPStep(self.q[k].copy(), self.l[k].copy(), self.u[k].copy())
        if not (self.P is None and self.A is None and self.lb is None and self.ub is None):
            for name in CONSTANT:
                array = getattr(self, name)
                if array is not None:
                    setattr(step, name, array[k].copy())
        return step

    def problem(self, k: int) -> QuadraticProgram:
        """Return the whole problem of step k."""
        return self.base.at(self.step(k))


def in_own_units(scaled: QPSequence, units: Units) -> QPSequence:
    """Convert QPs to the units `units` stands for, with `scaled` as their scaled form.

        P_own = U⁻¹ P U⁻¹,  q_own = U⁻¹ q,  A_own = W A U⁻¹,  l_own = W l,  lb_own = U lb

    with U = diag(units.z) and W = diag(units.row).

    Parameters
    ----------
    scaled : a sequence in scaled units.
    units : z (n,) and row (m,), what 1 of a variable and of a row is in the other units.

    Raises
    ------
    ShapeError : for units of another size than the QPs.
    """
    base = scaled.base
    for name, factors, size in (("z", units.z, base.n), ("row", units.row, base.m)):
        if factors.shape != (size,):
            raise ShapeError.of("Units", name, factors.shape, f"shape {(size,)}")
    z, row = units.z, units.row
    factor: dict[str, Any] = {
        "P": 1.0 / np.outer(z, z),
        "q": 1.0 / z,
        "A": np.outer(row, 1.0 / z),
        "l": row,
        "u": row,
        "lb": z,
        "ub": z,
    }
    own = {name: getattr(base, name) * by for name, by in factor.items()}
    problem = replace(base, **own)
    # The same factors for all steps: they are those of the last axes.
    steps = {name: getattr(scaled, name) * factor[name] for name in ("q", "l", "u")}
    for name in CONSTANT:
        matrices = getattr(scaled, name)
        steps[name] = None if matrices is None else matrices * factor[name]
    return replace(
        scaled, base=problem, units=units, scaled=scaled, sparse_equivalent=None, **steps
    )


@dataclass(frozen=True, eq=False)
class SparseEquivalent:
    """The problems of a sequence in sparse form, and the way back from their answers.

    `condensed` maps an answer to a problem of `sequence` to one of the sequence it is the
    sparse_equivalent of.
    """

    sequence: QPSequence
    condensed: Callable[[Solution], Solution]
