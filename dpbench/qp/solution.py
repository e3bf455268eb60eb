"""Answers of solvers: a status, which is a claim, an iterate and its multipliers.

Sign convention: y > 0 at an upper limit, y < 0 at a lower one, so that stationarity reads
P z + q + Aᵀy + y_box = 0.
"""

import operator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np

from dpbench.arrays import Vector


class Status(IntEnum):
    """Status that a solver claims for its answer, in terms common to all solvers.

    Examples
    --------
    >>> Status.MAX_ITERATIONS.is_usable, Status.PRIMAL_INFEASIBLE.is_usable
    (True, False)
    """

    SOLVED = 0
    INACCURATE = 1
    MAX_ITERATIONS = 2
    TIME_LIMIT = 3
    PRIMAL_INFEASIBLE = 4
    DUAL_INFEASIBLE = 5
    NUMERICAL_ERROR = 6
    ERROR = 7
    UNKNOWN = 8

    @property
    def is_usable(self) -> bool:
        """Return whether a finite answer with this status is applied, as an unfinished one is.

        Examples
        --------
        >>> Status.TIME_LIMIT.is_usable, Status.NUMERICAL_ERROR.is_usable
        (True, False)
        """
        return self in _USABLE

    @property
    def is_applied_though_unfinished(self) -> bool:
        """Return whether an answer with this status is applied, but marked as not optimal.

        Examples
        --------
        >>> Status.TIME_LIMIT.is_applied_though_unfinished
        True
        """
        return self in _UNFINISHED

    @property
    def claims_no_optimum_exists(self) -> bool:
        """Return whether the status claims that no optimum exists: infeasible or unbounded.

        Examples
        --------
        >>> Status.DUAL_INFEASIBLE.claims_no_optimum_exists
        True
        """
        return self in (Status.PRIMAL_INFEASIBLE, Status.DUAL_INFEASIBLE)


_UNFINISHED = frozenset({Status.INACCURATE, Status.MAX_ITERATIONS, Status.TIME_LIMIT})
_USABLE = _UNFINISHED | {Status.SOLVED, Status.UNKNOWN}


@dataclass(slots=True, eq=False, repr=False)
class Solution:
    """Answer of a solver to one QP: status, primal point, multipliers and counters.

    Parameters
    ----------
    status : the solver's claim.
    z : (n,) iterate, y : (m,) row multipliers, y_box : (n,) bound multipliers; of float64.
    iterations : the solver's own count, -1 when it gives none.
    reported_ns : the solver's self-reported time, -1 when it gives none; never a substitute for
        the clock.
    detail : message of the library, for the record of a failure.

    Examples
    --------
    >>> import numpy as np
    >>> Solution(Status.SOLVED, z=np.ones(2), y=np.zeros(1), y_box=np.zeros(2), iterations=3)
    <Solution SOLVED: 2 variables, 3 iterations>
    """

    status: Status
    z: Vector
    y: Vector
    y_box: Vector
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""

    def __repr__(self) -> str:
        count = f", {self.iterations} iterations" if self.iterations >= 0 else ""
        detail = f", {self.detail}" if self.detail else ""
        return f"<Solution {self.status.name}: {len(self.z)} variables{count}{detail}>"

    @classmethod
    def without_point(
        cls, n: int, m: int, status: Status, detail: str = "", counters: tuple[int, int] = (-1, -1)
    ) -> "Solution":
        """Return an answer without a point, all arrays NaN; counters: iterations, time [ns].

        Examples
        --------
        >>> Solution.without_point(2, 1, Status.ERROR, "crashed")
        <Solution ERROR: 2 variables, crashed>
        """
        nan = np.nan
        return cls(status, np.full(n, nan), np.full(m, nan), np.full(n, nan), *counters, detail)

    def copy_with_other_vectors(self, z: Vector, y: Vector, y_box: Vector) -> "Solution":
        """Return a copy with other arrays z, y and y_box, and the same status and counters.

        Examples
        --------
        >>> import numpy as np
        >>> answer = Solution(Status.SOLVED, np.ones(1), np.zeros(0), np.zeros(1))
        >>> answer.copy_with_other_vectors(np.zeros(1), answer.y, answer.y_box).z
        array([0.])
        """
        return replace(self, z=z, y=y, y_box=y_box)

    @property
    def claimed(self) -> bool:
        """Return whether the solver claims to have solved the problem.

        Examples
        --------
        >>> Solution.without_point(1, 0, Status.SOLVED).claimed
        True
        """
        return self.status is Status.SOLVED

    @property
    def bytes_for_comparison(self) -> bytes:
        """Status and array bits as bytes, equal for answers that are judged alike.

        Examples
        --------
        >>> late = Solution.without_point(1, 0, Status.TIME_LIMIT)
        >>> failed = Solution.without_point(1, 0, Status.ERROR)
        >>> late.bytes_for_comparison == failed.bytes_for_comparison
        False
        """
        numbers = (self.z, self.y, self.y_box)
        return bytes([self.status]) + b"".join(array.tobytes() for array in numbers)


_FLOAT64 = np.dtype(np.float64)
_INTEGERS = frozenset((int, np.int64, np.int32))
_LARGEST = int(np.iinfo(np.int64).max)


def is_solution_of_plain_types(answer: Any, n: int, m: int) -> bool:
    """Return whether an answer is a `Solution` of plain types, read without a solver's code."""
    if type(answer) is not Solution:
        return False
    z, y, y_box = answer.z, answer.y, answer.y_box
    return (
        type(z) is type(y) is type(y_box) is np.ndarray
        and z.dtype == y.dtype == y_box.dtype == _FLOAT64
        and z.shape == y_box.shape == (n,)
        and y.shape == (m,)
        and type(answer.status) is Status
        and type(answer.iterations) in _INTEGERS
        and type(answer.reported_ns) in _INTEGERS
        and -_LARGEST <= answer.iterations <= _LARGEST
        and -_LARGEST <= answer.reported_ns <= _LARGEST
        and type(answer.detail) is str
    )


def copy_checked_answer(answer: Any, n: int, m: int) -> Solution:
    """Return a checked copy of a solver's answer; status ERROR and its fault if malformed."""
    try:
        return _copy_answer_or_raise_malformed(answer, n, m)
    except _MalformedError as error:
        return Solution.without_point(n, m, Status.ERROR, f"malformed answer: {error}")


class _MalformedError(Exception):
    """Error for a part of a solver's answer of the wrong type or shape."""


def _copy_answer_or_raise_malformed(answer: Any, n: int, m: int) -> Solution:
    """Return a checked copy of a solver's answer; _MalformedError for a wrong type or shape."""
    if not isinstance(answer, Solution):
        raise _MalformedError(f"{_name_type_of_value(answer)} in place of a Solution")
    status: Any = answer.status
    if type(status) is not Status:
        raise _MalformedError(f"status is {_name_type_of_value(status)}, not a Status")
    z, y = (
        _copy_array_or_raise_malformed("z", answer.z, n),
        _copy_array_or_raise_malformed("y", answer.y, m),
    )
    y_box = _copy_array_or_raise_malformed("y_box", answer.y_box, n)
    iterations = _read_counter_or_raise_malformed("iterations", answer.iterations)
    reported_ns = _read_counter_or_raise_malformed("reported_ns", answer.reported_ns)
    detail: Any = answer.detail
    if type(detail) is not str:
        raise _MalformedError(f"detail is {_name_type_of_value(detail)}, not text")
    return Solution(status, z, y, y_box, iterations, reported_ns, detail)


def _copy_array_or_raise_malformed(name: str, value: Any, size: int) -> Vector:
    """Return a copy of a float64 array of the given size; _MalformedError for anything else."""
    if not isinstance(value, np.ndarray):
        raise _MalformedError(f"{name} is {_name_type_of_value(value)}, not an array")
    # The numbers in memory, without any code of a subclass.
    array: Any = np.array(value, subok=False)
    if array.dtype != _FLOAT64 or array.shape != (size,):
        given = f"{array.dtype} of shape {array.shape}"
        raise _MalformedError(f"{name} is {given}, not float64 of shape ({size},)")
    return np.ascontiguousarray(array, dtype=np.float64)


def _read_counter_or_raise_malformed(name: str, value: Any) -> int:
    """Return a counter as an int; _MalformedError if it is no integer of 64 bits."""
    try:
        number = operator.index(value)
    except TypeError as error:
        raise _MalformedError(f"{name} is {_name_type_of_value(value)}, not an integer") from error
    if not -_LARGEST <= number <= _LARGEST:
        raise _MalformedError(f"{name} is beyond 64 bits")
    return number


def _name_type_of_value(value: Any) -> str:
    """Name the type of a value for an error message."""
    return "None" if value is None else f"of type {type(value).__name__}"
