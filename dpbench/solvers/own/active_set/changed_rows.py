"""Rows of A that are others than before, as of thrusters that turn: what is made of them anew.

With the rows of I in C, of which K, H and J hold −P⁻¹, P⁻¹ and L⁻ᵀ, everything else of a row a of A
is a combination of what they have:

    K e_a = Σ a_l K e_l,    H e_a = Σ a_l H e_l,    J_a = Σ a_l J_l

A few entries in a few rows so cost a few per cent of factorising P and of all products of rows. The
active set stays; its factor is made again from H.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from dpbench.arrays import Ints, Matrix, Vector
from dpbench.solvers.own.active_set.factor import CLOSE
from dpbench.solvers.own.active_set.layout import (
    BEFORE,
    CHECK,
    HEAD,
    LONGEST,
    MASK,
    MOST,
    MOST_MULTIPLIER,
    N_PAD,
    SUM,
    UNIT,
    ZERO_ROW,
    M,
    N,
    compiled,
    width_of,
)

MANY = 8
"""Entries of changed rows a variable from which on to make everything anew takes no longer."""


@compiled
def list_changed(S: Matrix, A: int, new: Matrix) -> tuple[int, int]:
    """How many rows of A changed, listed in BEFORE, and their entries; −1 if one is not finite."""
    n, m = int(S[HEAD, N]), int(S[HEAD, M])
    count, entries, largest = 0, 0, 1.0
    for i in range(m):
        differs, filled, bad, most = 0, 0, 0, 0.0
        for k in range(n):
            a = new[i, k]
            differs += a != S[A + i, k]
            filled += a != 0.0
            bad += not abs(a) < inf
            most = max(most, abs(a))
        if bad:
            return -1, 0
        largest = max(largest, most)
        if differs:
            S[BEFORE, count] = i
            count, entries = count + 1, entries + filled
    S[CHECK, MOST] = MOST_MULTIPLIER / largest
    return count, entries


@compiled
def gather(S: Matrix, A: int, new: Matrix, count: int, row: Ints, share: Vector) -> Ints:
    """Where the entries of each changed row begin in `row` and `share`, which are written to."""
    n, first = int(S[HEAD, N]), np.empty(count + 1, np.int64)
    first[0] = 0
    for c in range(count):
        i, end = int(S[BEFORE, c]) & MASK, first[c]
        for k in range(n):
            if new[i, k] != 0.0:
                row[end], share[end] = k, new[i, k]
                end += 1
        first[c + 1] = end
    return first


@compiled
def write(S: Matrix, P: int, A: int, new: Matrix, count: int) -> bool:
    """Write the changed rows into A, [P Aᵀ] and SUM.

    Returns whether any entry was zero before.
    """
    n, n_pad, grown = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, False
    for c in range(count):
        i, terms = int(S[BEFORE, c]) & MASK, 0.0
        for k in range(n):
            a, before = new[i, k], S[A + i, k]
            terms += abs(a)
            if a != before:
                grown |= before == 0.0
                S[A + i, k] = S[P + k, n_pad + i] = a
        S[SUM, n_pad + i] = terms
    return grown


@compiled
def columns(S: Matrix, block: int, rows: int, first: Ints, row: Ints, share: Vector) -> bool:
    """Write the columns of changed rows in a block of K or H.

    Returns whether any entry was zero before.
    """
    n_pad, grown = int(S[HEAD, N_PAD]) & MASK, False
    for r in range(block, block + rows):
        for c in range(len(first) - 1):
            total = 0.0
            for e in range(first[c], first[c + 1]):
                total += share[e] * S[r, row[e] & MASK]
            at = n_pad + (int(S[BEFORE, c]) & MASK)
            grown |= (S[r, at] == 0.0) & (total != 0.0)
            S[r, at] = total
    return grown


@compiled
def rows_of(S: Matrix, block: int, width: int, first: Ints, row: Ints, share: Vector) -> None:
    """Write the changed rows of H or J."""
    n_pad = int(S[HEAD, N_PAD]) & MASK
    for c in range(len(first) - 1):
        r = block + n_pad + (int(S[BEFORE, c]) & MASK)
        for i in range(width):
            S[r, i] = 0.0
        for e in range(first[c], first[c + 1]):
            a, by = share[e], block + (row[e] & MASK)
            for i in range(width):
                S[r, i] += a * S[by, i]


@compiled
def lengths(S: Matrix, H: int, first: Ints, row: Ints, share: Vector) -> bool:
    """Write UNIT of the changed rows.

    Returns False if the factors of P have to tell what they cancel to.
    """
    n_pad, width = int(S[HEAD, N_PAD]) & MASK, width_of(S)
    for c in range(len(first) - 1):
        i, terms = n_pad + (int(S[BEFORE, c]) & MASK), 0.0
        for e in range(first[c], first[c + 1]):
            k = row[e] & MASK
            terms += share[e] * share[e] * S[H + k, k]
        if S[H + i, i] < CLOSE * terms:
            return False
        length = sqrt(S[H + i, i])
        S[UNIT, i] = 1.0 / length if length > ZERO_ROW else 1.0
    least = inf
    for i in range(width):
        least = min(least, S[UNIT, i] if S[UNIT, i] > 0.0 else inf)
    S[CHECK, LONGEST] = 1.0 / least
    return True


@compiled
def change(S: Matrix, K: int, P: int, H: int, J: int, A: int, new: Matrix) -> int:
    """Take over A; 1 if rows of S now are filled in elsewhere, −1 if all has to be made anew."""
    n, n_pad, width = int(S[HEAD, N]), int(S[HEAD, N_PAD]) & MASK, width_of(S)
    count, entries = list_changed(S, A, new)
    if count <= 0 or entries > MANY * n:
        return 0 if count == 0 else -1
    row, share = np.empty(entries, np.int64), np.empty(entries)
    first = gather(S, A, new, count, row, share)
    grown = write(S, P, A, new, count)
    grown |= columns(S, K, n, first, row, share)
    grown |= columns(S, H, width, first, row, share)
    rows_of(S, H, width, first, row, share)
    rows_of(S, J, n_pad, first, row, share)
    return int(grown) if lengths(S, H, first, row, share) else -1
