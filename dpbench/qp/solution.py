"""What a solver answers: a status that is a claim, an iterate, its multipliers.

Sign convention of multipliers: y > 0 at an upper limit, y < 0 at a lower one, so that
stationarity reads P z + q + Aᵀy + y_box = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from dpbench.qp.program import Vector


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
_USABLE = frozenset({Status.SOLVED, Status.INACCURATE, Status.MAX_ITERATIONS, Status.UNKNOWN})


@dataclass(slots=True, eq=False)
class Solution:
    """The answer to one QP; arrays are the solution's own memory and NaN where there is none.

    Parameters
    ----------
    status : the solver's claim.
    z : (n,) iterate, y : (m,) row multipliers, y_box : (n,) bound multipliers.
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

    @property
    def claimed(self) -> bool:
        """Whether the solver claims to have solved the problem."""
        return self.status is Status.SOLVED

    @property
    def identity(self) -> bytes:
        """Equal for answers that are judged alike: the claim and the bits of all numbers."""
        numbers = (self.z, self.y, self.y_box)
        return bytes([self.status]) + b"".join(array.tobytes() for array in numbers)
