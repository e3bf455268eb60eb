"""Types that all packages share: a quadratic program, one step of it, a recorded sequence.

    minimise ½ zᵀP z + qᵀz   subject to   l ≤ A z ≤ u,   lb ≤ z ≤ ub

Arrays are float64 and C-contiguous. Shape, type and the symmetry of P are checked, values are not:
solvers and the referee have to face NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Flag, auto
from typing import TYPE_CHECKING, Any

import numpy as np

from dpbench.arrays import Floats, Matrix, Vector
from dpbench.errors import InputError, ShapeError, require_type

if TYPE_CHECKING:
    from dpbench.qp.solution import Solution

CONSTANT = ("P", "A", "lb", "ub")  # along most sequences
ARRAYS = ("P", "q", "A", "l", "u", "lb", "ub")
ABSENT: Any = None  # The default of an array that may be left out
SYMMETRIC = 1e-10
"""Asymmetry of P, relative to its largest entry, that counts as rounding; more is refused, as some
solvers read one triangle and some the whole."""


class Refresh(Flag):
    """Parts of a QP that a step changes in a solver's workspace: vectors, or also matrices.

    Examples
    --------
    >>> import numpy as np
    >>> QPStep(q=np.array([-1.0]), l=np.zeros(1), u=np.ones(1)).refresh
    <Refresh.VECTORS: 1>
    """

    VECTORS = auto()
    MATRICES = auto()


def has_equal_blocks(n: int, m: int, block: int) -> bool:
    """Return whether n variables and m rows divide into equal moves of `block` variables."""
    return block == 0 or (n % block == 0 and m % (n // block) == 0)


def count_rows_per_block(n: int, m: int, block: int) -> int:
    """Return the number of constraint rows per control move of `block` variables."""
    return m * block // n


def require_shapes_and_make_contiguous(
    owner: object, shapes: Mapping[str, tuple[int, ...]]
) -> None:
    """Check the shapes of a frozen dataclass's arrays and make them contiguous float64.

    ShapeError for other shapes; TypeError for what is no dense array of numbers.
    """
    for name, shape in shapes.items():
        given = getattr(owner, name)
        try:
            array = np.ascontiguousarray(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            where, found = f"{type(owner).__name__}: {name}", f"a {type(given).__name__}"
            allowed = f"a dense array of numbers, shape {shape}"
            raise TypeError(f"{where}: found {found}; allowed: {allowed}") from error
        if array.shape != shape:
            raise ShapeError.from_shapes(type(owner).__name__, name, array.shape, f"shape {shape}")
        object.__setattr__(owner, name, array)


def require_or_make_symmetric(P: Floats, where: str) -> Floats:
    """Return P (…, n, n) if it is symmetric, else its symmetric part.

    Matrices that are not finite are returned as they are. InputError, naming the entry, where the
    asymmetry exceeds `SYMMETRIC`.
    """
    mirrored = P.swapaxes(-1, -2)
    if (mirrored == P).all() or not np.isfinite(P).all():
        return P
    with np.errstate(over="ignore"):
        gap = np.abs(P - mirrored)
    if gap.max() > SYMMETRIC * np.abs(P).max():
        at = tuple(int(x) for x in np.unravel_index(int(gap.argmax()), gap.shape))
        mirror = [*at[:-2], at[-1], at[-2]]
        found = f"{P[at]:g}, and {mirrored[at]:g} at P{mirror}"
        raise InputError(where, f"P{list(at)}", found, "a symmetric matrix, such as (P + P.T) / 2")
    return 0.5 * P + 0.5 * mirrored


def describe_qp_size(n: int, m: int) -> str:
    """Return the size of a QP as text: its variables and rows."""
    return f"{n} variable{'s' * (n != 1)}, {m} row{'s' * (m != 1)}"


@dataclass(frozen=True, eq=False, repr=False)
class QuadraticProgram:
    """Convex quadratic program (QP) with two-sided rows and bounds.

    Parameters
    ----------
    P : (n, n) symmetric positive semidefinite cost matrix.
    q : (n,) linear cost.
    A : (m, n) rows; m may be 0. No rows by default.
    l, u : (m,) row limits, ±inf allowed. By default there is no limit.
    lb, ub : (n,) bounds, ±inf allowed. By default there is no bound.
    block : variables per move, n by default (0). Errors of the first move are judged on the first
        `block` variables, and a warm start is shifted by as many (0: not shifted). Every move has
        equally many rows.
    moves : number of variables at the start of a block that are moves of an actuator; the others
        are slacks, which no error of a move or of a plan counts. 0 = all.
    stages : (states, inputs) of each stage of an optimal control problem whose variables are in
        this order, for a solver that factorises stage by stage; () where there are none.

    Raises
    ------
    ShapeError : naming the array whose shape does not fit the others.
    InputError : P is not symmetric; a difference by rounding is averaged.

    Examples
    --------
    >>> qp = QuadraticProgram([[1, 0], [0, 1]], [-3, -3], [[1, 1]], [-9], [2], [0, 0], [1, 1])
    >>> qp
    <QuadraticProgram: 2 variables, 1 row>
    >>> qp.objective(qp.ub)
    -5.0
    >>> QuadraticProgram([[1, 0], [0, 1]], [-3.0, -3.0], lb=[0.0, 0.0], ub=[9.0, 9.0])
    <QuadraticProgram: 2 variables, 0 rows>
    """

    P: Matrix
    q: Vector
    A: Matrix = ABSENT
    l: Vector = ABSENT  # noqa: E741 - OSQP's and the paper's name of the lower row limit
    u: Vector = ABSENT
    lb: Vector = ABSENT
    ub: Vector = ABSENT
    block: int = 0
    moves: int = 0
    stages: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        n = np.shape(self.q)[0] if np.ndim(self.q) == 1 else -1
        if n < 1:
            raise ShapeError.from_shapes(
                "QuadraticProgram", "q", np.shape(self.q), "shape (n,) with n ≥ 1"
            )
        self._fill_missing_array("A", (0, n), 0.0)
        m = np.shape(self.A)[0] if np.ndim(self.A) == 2 else -1
        if m < 0:
            raise ShapeError.from_shapes(
                "QuadraticProgram", "A", np.shape(self.A), f"shape (m, {n})"
            )
        for name, size, limit in (("l", m, -np.inf), ("u", m, np.inf), ("lb", n, -np.inf)):
            self._fill_missing_array(name, (size,), limit)
        self._fill_missing_array("ub", (n,), np.inf)
        shapes = {"P": (n, n), "q": (n,), "A": (m, n), "l": (m,), "u": (m,), "lb": (n,), "ub": (n,)}
        require_shapes_and_make_contiguous(self, shapes)
        object.__setattr__(self, "P", require_or_make_symmetric(self.P, "QuadraticProgram"))
        if not has_equal_blocks(n, m, self.block):
            allowed = f"0, or a divisor of n = {n} such that n / block divides m = {m}"
            raise ShapeError("QuadraticProgram", "block", self.block, allowed)
        most = self.block or n
        if not 0 <= self.moves <= most:
            raise ShapeError("QuadraticProgram", "moves", self.moves, f"0 to {most}")

    def _fill_missing_array(self, name: str, shape: tuple[int, ...], value: float) -> None:
        """Set an array that was left out, such as a bound, to one value throughout."""
        if getattr(self, name) is ABSENT:
            object.__setattr__(self, name, np.full(shape, value))

    def __repr__(self) -> str:
        return f"<QuadraticProgram: {describe_qp_size(self.n, self.m)}>"

    @property
    def n(self) -> int:
        """Number n of the QP's variables.

        Examples
        --------
        >>> QuadraticProgram([[1, 0], [0, 1]], [-3.0, -3.0]).n
        2
        """
        return int(self.q.shape[0])

    @property
    def m(self) -> int:
        """Number m of the QP's constraint rows, without bounds.

        Examples
        --------
        >>> QuadraticProgram([[1, 0], [0, 1]], [-3.0, -3.0], [[1, 1]], [-9], [2]).m
        1
        """
        return int(self.A.shape[0])

    def stack_row_and_bound_limits(self) -> tuple[Vector, Vector]:
        """Return lower and upper limits (m + n,) of rows and bounds together.

        Examples
        --------
        >>> qp = QuadraticProgram([[1, 0], [0, 1]], [-3, -3], [[1, 1]], [-9], [2], [0, 0], [9, 9])
        >>> qp.stack_row_and_bound_limits()
        (array([-9.,  0.,  0.]), array([2., 9., 9.]))
        """
        return np.concatenate((self.l, self.lb)), np.concatenate((self.u, self.ub))

    def objective(self, z: Vector) -> float:
        """Return the objective value ½ zᵀPz + qᵀz at z.

        Examples
        --------
        >>> import numpy as np
        >>> QuadraticProgram([[1, 0], [0, 1]], [-3.0, -3.0]).objective(np.ones(2))
        -5.0
        """
        return float(0.5 * z @ self.P @ z + self.q @ z)

    def copy(self) -> QuadraticProgram:
        """Copy the QP with all its arrays.

        Examples
        --------
        >>> qp = QuadraticProgram([[1, 0], [0, 1]], [-3.0, -3.0])
        >>> qp.copy().P is qp.P
        False
        """
        return self._copy_with_replaced_arrays(
            {name: getattr(self, name).copy() for name in ARRAYS}
        )

    def changed_by(self, step: QPStep) -> bool:
        """Return whether a step brings matrices or bounds that differ from this problem's.

        Examples
        --------
        >>> qp = QuadraticProgram([[1]], [-3.0], lb=[0.0])
        >>> qp.changed_by(QPStep(qp.q, qp.l, qp.u, lb=qp.lb + 1))
        True
        """
        if step.P is step.A is step.lb is step.ub is None:
            return False
        pairs = ((getattr(step, name), getattr(self, name)) for name in CONSTANT)
        changed = ((new, old) for new, old in pairs if new is not None and new is not old)
        return any(not np.array_equal(new, old) for new, old in changed)

    def at(self, step: QPStep) -> QuadraticProgram:
        """Return this QP with a step's vectors q, l and u, and its matrices if the step has any.

        Examples
        --------
        >>> qp = QuadraticProgram([[1]], [-3.0])
        >>> qp.at(QPStep(qp.q + 4, qp.l, qp.u)).q
        array([1.])
        """
        given = {name: getattr(step, name) for name in ARRAYS}
        parts = {name: part for name, part in given.items() if part is not None}
        changed = self._copy_with_replaced_arrays(parts)
        require_shapes_and_make_contiguous(
            changed, {name: getattr(self, name).shape for name in parts}
        )
        return changed

    def for_setup(self) -> QuadraticProgram:
        """Return this QP with q = 0, as solvers are set up before the first state is measured.

        OSQP, SCS and Clarabel scale the cost by the q of their set-up, so that their iterations and
        the effect of OSQP's ρ depend on it.

        Examples
        --------
        >>> QuadraticProgram([[1]], [-3.0]).for_setup().q
        array([0.])
        """
        return self._copy_with_replaced_arrays({"q": np.zeros(self.n)})

    def _copy_with_replaced_arrays(self, parts: dict[str, Floats]) -> QuadraticProgram:
        """Return this QP with other arrays, unchecked, as that would count as a solver's time."""
        # A fifth of the time of `copy.copy`, in every step that brings matrices.
        changed = object.__new__(type(self))
        changed.__dict__.update(self.__dict__ | parts)
        return changed


@dataclass(slots=True, eq=False, repr=False)
class QPStep:
    """Data of a QP that change from one step to the next.

    Examples
    --------
    >>> import numpy as np
    >>> step = QPStep(q=np.array([-1.0]), l=np.zeros(1), u=np.ones(1))
    >>> step
    <QPStep: 1 variable, 1 row, vectors>
    """

    q: Vector
    l: Vector  # noqa: E741 - l ≤ Az ≤ u, the name of the field
    u: Vector
    P: Matrix | None = None
    A: Matrix | None = None
    lb: Vector | None = None
    ub: Vector | None = None

    def __repr__(self) -> str:
        parts = "vectors" if self.refresh is Refresh.VECTORS else "vectors and matrices"
        return f"<QPStep: {describe_qp_size(len(self.q), len(self.l))}, {parts}>"

    if not TYPE_CHECKING:  # A type checker still finds names that do not exist.

        def __getattr__(self, name: str) -> Any:
            """Raise AttributeError that names what has the complete QP, as for `setup(step)`."""
            allowed = "a QuadraticProgram has the complete QP, such as `condensed.problem(step)`"
            raise AttributeError(f"QPStep has no {name!r}; {allowed}")

    @property
    def refresh(self) -> Refresh:
        """Parts of the QP that this step changes: vectors alone, or matrices and bounds too.

        Examples
        --------
        >>> import numpy as np
        >>> QPStep(q=np.array([-1.0]), l=np.zeros(1), u=np.ones(1), lb=np.zeros(1)).refresh
        <Refresh.VECTORS|MATRICES: 3>
        """
        if self.P is self.A is self.lb is self.ub is None:
            return Refresh.VECTORS
        return Refresh.VECTORS | Refresh.MATRICES

    def copy(self) -> QPStep:
        """Copy a step's QP data with all its arrays.

        Examples
        --------
        >>> import numpy as np
        >>> step = QPStep(q=np.array([-1.0]), l=np.zeros(1), u=np.ones(1))
        >>> step.copy().q is step.q
        False
        """
        P, A, lb, ub = (a if a is None else a.copy() for a in (self.P, self.A, self.lb, self.ub))
        return QPStep(self.q.copy(), self.l.copy(), self.u.copy(), P, A, lb, ub)


@dataclass(frozen=True, eq=False)
class Units:
    """Diagonal scaling between a problem in its own units and its scaled form.

    z_own = z * z_scaled and (A z)_own = row * (A z)_scaled; the objective is equal in both, so
    y_scaled = row * y_own and y_box_scaled = z * y_box_own.

    Examples
    --------
    >>> import numpy as np
    >>> Units(z=np.array([250.0, 250.0]), row=np.ones(1)).z
    array([250., 250.])
    """

    z: Vector
    row: Vector


def require_units(where: str, units: object, n: int, m: int) -> None:
    """Raise TypeError for what is no `Units`, ShapeError for units of other sizes than n and m."""
    require_type(f"{where}: units", units, Units, "Units(z=<n numbers>, row=<m numbers>), or None")
    require_shapes_and_make_contiguous(units, {"z": (n,), "row": (m,)})


@dataclass(frozen=True, eq=False, repr=False)
class QPSequence:
    """Sequence of QPs recorded along one run, with constant or varying matrices.

    Errors are judged in units of z. Scale z so that 1 is its largest change in one step, or the
    scale that matters: with U = diag(u), give U P U, U q, A U, lb/u and ub/u.

    Parameters
    ----------
    name : what it was recorded from.
    base : the problem of step 0.
    q, l, u : (K, n), (K, m), (K, m) vectors of each step.
    P, A, lb, ub : (K, …) matrices and bounds of each step; None where they are constant, then they
        are in `base`. `problem(k)` returns the complete QP in both cases.
    units : `Units` with what 1 of a variable and of a row is in SI; None where nothing is known.
        Files keep them (`unit_z`, `unit_row`); neither they nor judging scale the arrays by them.
    scaled : the same sequence in scaled units, in which answers are judged; None when this is it.
    meta : origin: scenario, sample time [s], first step, horizons, versions.
    sparse_equivalent : makes the sparse form with the states kept; None where there is none.
    documents : of the scenario (`Scenario.files`), or the capability plot; empty for others.

    Examples
    --------
    >>> qp = QuadraticProgram([[1]], [-1.0], [[1]], [0.0], [1.0], [-9.0], [9.0])
    >>> sequence = QPSequence("two", qp, q=[[-1.0], [2.0]], l=[[0.0], [0.0]], u=[[1.0], [1.0]])
    >>> sequence
    <QPSequence two: 2 QPs of 1 variable, 1 row, constant matrices>
    >>> sequence.problem(1).q
    array([2.])
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
    documents: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        K, n, m = np.shape(self.q)[0], self.base.n, self.base.m
        shapes: dict[str, tuple[int, ...]] = {"q": (K, n), "l": (K, m), "u": (K, m)}
        shapes |= {"P": (K, n, n), "A": (K, m, n), "lb": (K, n), "ub": (K, n)}
        given = {name: shape for name, shape in shapes.items() if getattr(self, name) is not None}
        require_shapes_and_make_contiguous(self, given)
        if self.P is not None:
            object.__setattr__(self, "P", require_or_make_symmetric(self.P, "QPSequence"))
        if self.units is not None:
            require_units("QPSequence", self.units, n, m)

    def __len__(self) -> int:
        return int(self.q.shape[0])

    def __repr__(self) -> str:
        varies = any(getattr(self, name) is not None for name in CONSTANT)
        matrices = "matrices of each step" if varies else "constant matrices"
        size = describe_qp_size(self.base.n, self.base.m)
        return f"<QPSequence {self.name}: {len(self)} QPs of {size}, {matrices}>"

    def step(self, k: int) -> QPStep:
        """Return a copy of the QP data of step k that change along the sequence.

        IndexError for a step that the sequence does not have.

        Examples
        --------
        >>> qp = QuadraticProgram([[1]], [-1.0])
        >>> two = QPSequence("two", qp, q=[[-1.0], [2.0]], l=[[], []], u=[[], []])
        >>> two.step(1).q
        array([2.])
        """
        try:
            step = QPStep(self.q[k].copy(), self.l[k].copy(), self.u[k].copy())
        except IndexError:
            raise IndexError(f"step: found {k}; allowed: 0 to {len(self) - 1}") from None
        for name in CONSTANT:
            if (array := getattr(self, name)) is not None:
                setattr(step, name, array[k].copy())
        return step

    def problem(self, k: int) -> QuadraticProgram:
        """Return the complete QP of step k; IndexError as for `step`.

        Examples
        --------
        >>> qp = QuadraticProgram([[1]], [-1.0])
        >>> two = QPSequence("two", qp, q=[[-1.0], [2.0]], l=[[], []], u=[[], []])
        >>> two.problem(1)
        <QuadraticProgram: 1 variable, 0 rows>
        """
        return self.base.at(self.step(k))


def convert_sequence_to_units(scaled: QPSequence, units: Units) -> QPSequence:
    """Convert a scaled QP sequence to other units; the scaled one stays attached to it.

        P_own = U⁻¹ P U⁻¹,  q_own = U⁻¹ q,  A_own = W A U⁻¹,  l_own = W l,  lb_own = U lb

    with U = diag(units.z) (n,) and W = diag(units.row) (m,); ShapeError for units of another size.
    """
    base = scaled.base
    require_units("convert_sequence_to_units", units, base.n, base.m)
    z, row = units.z, units.row
    factor: dict[str, Any] = {"l": row, "u": row, "lb": z, "ub": z, "q": 1.0 / z}
    factor |= {"P": 1.0 / np.outer(z, z), "A": np.outer(row, 1.0 / z)}
    own = {name: getattr(base, name) * by for name, by in factor.items()}
    problem = replace(base, **own)
    # The same factors for all steps: they are those of the last axes.
    parts = {name: getattr(scaled, name) for name in ARRAYS}
    steps: dict[str, Any]
    steps = {name: part if part is None else part * factor[name] for name, part in parts.items()}
    steps |= {"units": units, "scaled": scaled, "sparse_equivalent": None}
    return replace(scaled, base=problem, **steps)


@dataclass(frozen=True, eq=False)
class SparseEquivalent:
    """Sparse form of a condensed QP sequence, and the map of its solutions to condensed ones."""

    sequence: QPSequence
    condensed: Callable[[Solution], Solution]
