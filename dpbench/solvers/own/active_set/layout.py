"""The array S on which the compiled active-set method works, and how its functions are compiled.

S is one array so that a step is one call with one argument, which is what a call costs most for.
Its first rows hold vectors; the rows of K, [P Aᵀ], H, Jᵀ, A and L follow, in this order: see
`active_set_constants.py` for their contents.
"""

from __future__ import annotations

import marshal
import zlib
from collections.abc import Callable
from types import FunctionType
from typing import TypeVar, cast

from numba import njit

# Rows of vectors. X, E, R and STEP are scratch.
HEAD, CHECK, Q, LOW, HIGH, UNIT, SUM, V0, V = range(9)
LAM, SIDE, ACTIVE, INVERSE, R, STEP, X, E, Z, BEFORE = range(9, 19)
VECTORS = 19
# Slots of row HEAD, and of row CHECK; there is room for sixteen in a row.
N, N_PAD, M, COUNT, ASIDE, ITERATIONS, LIMIT, KEEP, STALE, BLOCK, STAMP = range(11)
SIZE, MOST, LARGEST, LENGTH, WORST, PINNED = range(6)
MASK = 0xFFFFFF
"""An integer is taken with it so that the compiler knows that an index is not negative."""

# What a compiled solve answers when it is not the number of iterations.
NOT_FINITE, CROSSED, INFEASIBLE, UNDECIDED, DOUBTFUL = -1, -2, -3, -4, -5

F = TypeVar("F", bound=Callable[..., object])

# Sums may be reordered, so that they vectorise; NaN and infinities keep their meaning.
REORDER = {"reassoc", "contract", "nsz"}
_compiled: list[FunctionType] = []


def compiled(function: F) -> F:
    """A function that other compiled functions call."""
    assert isinstance(function, FunctionType)
    _compiled.append(function)
    return cast(F, njit(fastmath=REORDER, error_model="numpy")(function))


def stamp() -> int:
    """A number that changes with any compiled function and with the constants it names.

    Numba's cache looks at the file of the function it holds, not at what that function calls; a
    stamp in its closure makes it look at both.
    """
    parts = []
    for function in _compiled:
        code, known = function.__code__, function.__globals__
        numbers = [known[n] for n in code.co_names if isinstance(known.get(n), (int, float))]
        parts.append((code, numbers))
    return zlib.crc32(marshal.dumps(parts))
