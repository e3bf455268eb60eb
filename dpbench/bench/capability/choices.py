"""The best choice of one convex piece for each thruster, by branch and bound.

The number of choices is the product of the pieces: eight azimuths near each other have 11 664.
The convex hulls of the pieces bound the use of all choices from below. A balance has three rows
only, so few thrusters of an optimum lie between pieces (Shapley-Folkman): a few bounds are enough.
"""

import heapq
from collections.abc import Callable, Sequence
from itertools import count

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.capability.utilisation import Choices, Combination

GAP = 1e-9
"""Difference of uses that are the same, relative and of full thrust."""
Relax = Callable[[Choices], tuple[float, list[Vector]]]
"""Least use in the convex hulls of pieces, and the use of each piece."""


def find_least_use_and_pieces(relax: Relax, choices: Choices) -> tuple[float, Combination]:
    """Return the least use of thrust over all choices of a piece each, and the choice.

    Parameters
    ----------
    relax : bounds the use of all choices between some pieces; exact where each thruster has one.
    choices : (p,) pieces of each thruster, at least one.
    """
    best, chosen = np.inf, tuple(pieces[0] for pieces in choices)
    order = count()
    bound, uses = relax(choices)
    queue = [(bound, next(order), choices, uses)]
    while queue:
        bound, _, some, uses = heapq.heappop(queue)
        if _is_no_better(bound, best):
            break
        rounded = tuple(pieces[int(np.argmax(use))] for pieces, use in zip(some, uses, strict=True))
        use = (
            bound
            if all(len(pieces) == 1 for pieces in some)
            else _compute_least_use_of_pieces(relax, rounded)
        )
        if use < best:
            best, chosen = use, rounded
        if _is_no_better(bound, best):
            break
        for part in _branch_on_thruster(some, uses):
            bound, uses = relax(part)
            if not _is_no_better(bound, best):
                heapq.heappush(queue, (bound, next(order), part, uses))
    return best, chosen


def _is_no_better(bound: float, best: float) -> bool:
    """Return whether a lower bound on the use of thrust rules out a better one than `best`."""
    return bound * (1.0 + GAP) + GAP >= best


def _compute_least_use_of_pieces(relax: Relax, chosen: Combination) -> float:
    """Return the least share of full thrust with one convex piece chosen for each thruster."""
    return relax(tuple((piece,) for piece in chosen))[0]


def _branch_on_thruster(choices: Choices, uses: Sequence[Vector]) -> list[Choices]:
    """Branch on the thruster that is most between two pieces: one set of choices for each piece."""
    between = [float(np.sort(use)[-2]) if len(use) > 1 else -1.0 for use in uses]
    at = int(np.argmax(between))
    return [(*choices[:at], (piece,), *choices[at + 1 :]) for piece in choices[at]]
