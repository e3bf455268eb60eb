"""What a solver answers: a status that is a claim, an iterate, its multipliers.

Sign convention of multipliers: y > 0 at an upper limit, y < 0 at a lower one, so that
stationarity reads P z + q + Aᵀy + y_box = 0.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from dpbench.arrays import Vector


class Status(IntEnum):
    """What the solver claims. The text of each is a sentence with the likely cause."""

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
    def sentence(self) -> str:
        """A sentence for a reader of the report."""
        return _SENTENCES[self]

    @property
    def usable(self) -> bool:
        """Whether a finite iterate under this status is applied to the ship.

        Infeasible, error and time-limit claims come with no plan worth following; an inaccurate
        or unfinished iterate is applied and marked.
        """
        return self in _USABLE

    @property
    def is_unfinished(self) -> bool:
        """Whether a usable iterate under this status is applied and marked."""
        return self in _UNFINISHED

    @property
    def denies_optimum(self) -> bool:
        """Whether it is the claim that there is no optimum."""
        return self in (Status.PRIMAL_INFEASIBLE, Status.DUAL_INFEASIBLE)


_SENTENCES = {
    Status.SOLVED: "The solver claims an optimum within its tolerances.",
    Status.INACCURATE: "The solver stopped near an optimum, outside its tolerances; "
    "tighter scaling or looser tolerances are the usual remedy.",
    Status.MAX_ITERATIONS: "The iteration limit was reached; raise it or loosen the tolerances.",
    Status.TIME_LIMIT: "The solver's own time limit was reached.",
    Status.PRIMAL_INFEASIBLE: "The solver claims that no point satisfies the constraints.",
    Status.DUAL_INFEASIBLE: "The solver claims that the problem is unbounded.",
    Status.NUMERICAL_ERROR: "A factorisation or line search broke down; bad scaling is the "
    "usual cause.",
    Status.ERROR: "The library raised an exception or refused the problem.",
    Status.UNKNOWN: "The library's answer has no documented meaning, or makes no claim.",
}
_UNFINISHED = frozenset({Status.INACCURATE, Status.MAX_ITERATIONS})
_USABLE = _UNFINISHED | {Status.SOLVED, Status.UNKNOWN}


@dataclass(slots=True, eq=False)
class Solution:
    """The answer to one QP; arrays are the solution's own memory and NaN where there is none.

    `received` turns an answer that is not so into one that says what is wrong with it.

    Parameters
    ----------
    status : the solver's claim.
    z : (n,) iterate, y : (m,) row multipliers, y_box : (n,) bound multipliers; of float64.
    iterations : the solver's own count, -1 when it gives none.
    reported_ns : the solver's self-reported time, -1 when it gives none; a second opinion, never
        a substitute for the clock.
    detail : the library's own words, for the record of a failure.
    """

    status: Status
    z: Vector
    y: Vector
    y_box: Vector
    iterations: int = -1
    reported_ns: int = -1
    detail: str = ""

    @classmethod
    def missing(cls, n: int, m: int, status: Status, detail: str = "") -> Solution:
        """No answer: NaN-filled arrays."""
        nan = np.nan
        return cls(status, np.full(n, nan), np.full(m, nan), np.full(n, nan), detail=detail)

    def with_iterate(self, z: Vector, y: Vector, y_box: Vector) -> Solution:
        """Return the same claim, count, time and words with other numbers, which are not copied."""
        told = self.iterations, self.reported_ns, self.detail
        return Solution(self.status, z, y, y_box, *told)

    @property
    def claimed(self) -> bool:
        """Whether the solver claims to have solved the problem."""
        return self.status is Status.SOLVED

    @property
    def identity(self) -> bytes:
        """Equal for answers that are judged alike: the claim and the bits of all numbers."""
        numbers = (self.z, self.y, self.y_box)
        return bytes([self.status]) + b"".join(array.tobytes() for array in numbers)


_FLOAT64 = np.dtype(np.float64)
_INTEGERS = frozenset((int, np.int64, np.int32))
_LARGEST = int(np.iinfo(np.int64).max)


def is_plain(answer: Any, n: int, m: int) -> bool:
    """Whether an answer is as `Solution` says, and of nothing but types that cannot compute.

    What is taken from such an answer later is what was there, and taking it is no solver's work.
    """
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


def received(answer: Any, n: int, m: int) -> Solution:
    """`answer` with everything in it taken out, so that nothing of it is computed later.

    Parameters
    ----------
    answer : what a solver gave; n, m : variables and rows of its QP.

    Returns
    -------
    A plain `Solution`. Of an answer that is malformed: no answer, with the status ERROR and what is
    wrong in words.
    """
    try:
        return _taken(answer, n, m)
    except _MalformedError as error:
        return Solution.missing(n, m, Status.ERROR, f"malformed answer: {error}")


class _MalformedError(Exception):
    """What of an answer is not as the contract says."""


def _taken(answer: Any, n: int, m: int) -> Solution:
    if not isinstance(answer, Solution):
        raise _MalformedError(f"{_kind(answer)} in place of a Solution")
    status: Any = answer.status
    if type(status) is not Status:
        raise _MalformedError(f"status is {_kind(status)}, not a Status")
    z = _array("z", answer.z, n)
    y, y_box = _array("y", answer.y, m), _array("y_box", answer.y_box, n)
    iterations = _integer("iterations", answer.iterations)
    reported_ns = _integer("reported_ns", answer.reported_ns)
    detail: Any = answer.detail
    if type(detail) is not str:
        raise _MalformedError(f"detail is {_kind(detail)}, not text")
    return Solution(status, z, y, y_box, iterations, reported_ns, detail)


def _array(name: str, value: Any, size: int) -> Vector:
    """Return a float64 array as it lies in memory; whatever else could be made one is none."""
    if not isinstance(value, np.ndarray):
        raise _MalformedError(f"{name} is {_kind(value)}, not an array")
    # Of a subclass the numbers in its memory, and nothing it would do when asked for them.
    array: Any = np.array(value, subok=False)
    if array.dtype != _FLOAT64 or array.shape != (size,):
        given = f"{array.dtype} of shape {array.shape}"
        raise _MalformedError(f"{name} is {given}, not float64 of shape ({size},)")
    return np.ascontiguousarray(array, dtype=np.float64)


def _integer(name: str, value: Any) -> int:
    try:
        number = operator.index(value)
    except TypeError as error:
        raise _MalformedError(f"{name} is {_kind(value)}, not an integer") from error
    if not -_LARGEST <= number <= _LARGEST:
        raise _MalformedError(f"{name} is beyond 64 bits")
    return number


def _kind(value: Any) -> str:
    """Return the type of a value in words."""
    return "None" if value is None else f"of type {type(value).__name__}"
