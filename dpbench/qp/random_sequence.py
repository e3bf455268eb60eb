"""Random parametric QPs with a planted optimum, which depends on no solver.

Chosen first are z*, the limits it meets and their multipliers; what makes it the optimum follows:

    q = −(P z* + Aᵀy + y_box),   l ≤ A z* ≤ u,   lb ≤ z* ≤ ub,   y_i ≠ 0 only at a limit met

All numbers lie on binary grids coarse enough that no sum is rounded: the optimality conditions hold
to the last bit. P, A, lb, ub are constant; q, l, u walk along smooth paths with two jumps.

P = Q Λ Qᵀ with λ = c^−½ … c^½ for a condition c, or P = B Bᵀ of less than full rank, which is
semidefinite to the last bit; A has rows of unit norm to within 1e-4, the spacing of its grid.
"""

import math
import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QuadraticProgram, has_equal_blocks

MARGIN = 0.25  # By how much the limits of an infeasible step contradict each other
NEAR = 2.0**-26  # Distance to a limit that is missed by less than most tolerances
LARGEST = (120, 300)  # Most variables and rows; with more, sums would be rounded
POINT = 2.0**-10  # Grid of z, of multipliers and of slacks
ROW = 2.0**-16  # Grid of the entries of A
COST_BITS = 36
"""Bits of an entry of P below the largest eigenvalue: with |z| ≤ 2 on its grid and n ≤ 120 every
partial sum of Pz stays below 2^53 units, and the smallest of 1e8 eigenvalues is kept to 1 %."""
FACTOR = 2.0**-7  # Grid of the factor of a semidefinite P


@dataclass(frozen=True)
class Family:
    """Family of random QPs, defined by the properties that make them hard.

    cond : condition of P where a recipe names none; semidefinite : P has less than full rank.
    touching : rows and bounds met with a zero multiplier, as a share of n.
    twins : share of rows that are written twice; equal, free, one_sided : shares of rows.
    open_bounds : share of bounds that are infinite.
    infeasible : every third step has no feasible point.
    """

    shows: str
    cond: float = 1e2
    semidefinite: bool = False
    touching: float = 0.0
    twins: float = 0.0
    equal: float = 0.0
    free: float = 0.0
    one_sided: float = 0.0
    open_bounds: float = 0.0
    infeasible: bool = False


FAMILIES: dict[str, Family] = {
    "plain": Family("every limit that is met has a multiplier"),
    "degenerate": Family(
        "more limits met than there are variables, rows written twice", touching=1.0, twins=0.3
    ),
    "weakly_active": Family("limits met with a zero multiplier, or missed by 1.5e-8", touching=0.3),
    "equal": Family("rows with l = u among others", equal=0.3),
    "free": Family("rows without any limit, or with one", free=0.4, one_sided=0.3),
    "infinite_bounds": Family(
        "half of the bounds infinite, rows with one limit", one_sided=0.4, open_bounds=0.5
    ),
    "no_rows": Family("bounds alone, m = 0"),
    "semidefinite": Family("P of less than full rank, the optimum unique", semidefinite=True),
    "ill_conditioned": Family("cond(P) = 1e8", cond=1e8),
    "infeasible_steps": Family(
        "every third step has no feasible point, by a margin of 0.25", twins=0.2, infeasible=True
    ),
}


@dataclass(frozen=True)
class RandomRecipe:
    """Parameters from which a random QP sequence is generated.

    family : a name of `FAMILIES`.
    n, m : variables and rows, at most `LARGEST`; seed : of everything random.
    steps : length of the sequence; block : as in `QuadraticProgram`.
    cond : condition of P, 0 for that of the family.
    """

    family: str
    n: int
    m: int
    seed: int
    steps: int = 24
    block: int = 0
    cond: float = 0.0

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise _make_recipe_input_error(
                "family", repr(self.family), f"one of {', '.join(FAMILIES)}"
            )
        if not 2 <= self.n <= LARGEST[0]:
            raise _make_recipe_input_error("n", self.n, f"2 to {LARGEST[0]}")
        rows = {"degenerate": self.n, "no_rows": 0, "plain": 0, "semidefinite": 0}
        least = rows.get(self.family, 2)
        most = LARGEST[1] if self.family != "no_rows" else 0
        if not least <= self.m <= most:
            allowed = f"{least} to {most} for {self.family} with n = {self.n}"
            raise _make_recipe_input_error("m", self.m, allowed)
        if self.seed < 0 or self.steps < 1:
            raise _make_recipe_input_error(
                "seed, steps", (self.seed, self.steps), "0 or more, 1 or more"
            )
        if self.block < 0 or not has_equal_blocks(self.n, self.m, self.block):
            allowed = f"0, or a divisor of n = {self.n} such that n / block divides m = {self.m}"
            raise _make_recipe_input_error("block", self.block, allowed)
        if self.cond != 0.0 and not 1.0 <= self.cond <= 1e8:
            raise _make_recipe_input_error(
                "cond", self.cond, "1 to 1e8, or 0 for that of the family"
            )

    @property
    def sequence_name(self) -> str:
        """Unique name of the recipe, e.g. `plain-n12-m30-s1`."""
        usual = {"steps": 24, "block": 0, "cond": 0.0}
        values = {key: getattr(self, key) for key in usual}
        extra = "".join(f"-{key}{value:g}" for key, value in values.items() if value != usual[key])
        return f"{self.family}-n{self.n}-m{self.m}-s{self.seed}{extra}"


def _make_recipe_input_error(key: str, found: object, allowed: str) -> InputError:
    """Return the InputError for a parameter that a recipe does not allow."""
    return InputError("random recipe", key, found, allowed)


def round_to_multiples(x: Vector, unit: float) -> Vector:
    """Round numbers to the nearest multiples of `unit`, a power of two."""
    return np.rint(x / unit) * unit


def draw_random_positive_definite_matrix(rng: np.random.Generator, n: int, cond: float) -> Matrix:
    """Draw a random positive definite P (n, n) with condition number `cond`."""
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P = (Q * np.geomspace(cond**-0.5, cond**0.5, n)) @ Q.T
    unit = 2.0 ** (math.ceil(0.5 * math.log2(cond)) - COST_BITS)
    return round_to_multiples(0.5 * (P + P.T), unit)


def draw_random_semidefinite_matrix(rng: np.random.Generator, n: int, rank: int) -> Matrix:
    """Draw a random positive semidefinite P (n, n) of exactly the given rank."""
    B = round_to_multiples(rng.normal(size=(n, rank)) / math.sqrt(rank), FACTOR)
    return B @ B.T


def draw_random_unit_rows(rng: np.random.Generator, m: int, n: int) -> Matrix:
    """Draw random constraint rows (m, n) of unit norm, every second one sparse."""
    A = rng.normal(size=(m, n))
    sparse = rng.random((m, n)) < 0.75
    sparse[::2] = False
    # One entry stays, so that there is a direction left.
    sparse[np.arange(m), rng.integers(0, n, m)] = False
    A[sparse] = 0.0
    return round_to_multiples(A / np.linalg.norm(A, axis=1, keepdims=True), ROW)


JUMPS = 2  # of the signals


@dataclass(frozen=True, eq=False)
class PlantedSequence:
    """Random QP sequence together with its known optima, chosen before the QPs were built.

    feasible (K,); z (K, n) optimum, NaN where infeasible; y (K, m), y_box (K, n) its multipliers,
    or the Farkas vector of an infeasible step.
    """

    sequence: QPSequence
    feasible: Flags
    z: Matrix
    y: Matrix
    y_box: Matrix


def generate_random_sequence(recipe: RandomRecipe) -> QPSequence:
    """Generate the random QP sequence of a recipe, identical to the bit each time."""
    return generate_random_sequence_with_optima(recipe).sequence


def generate_random_sequence_with_optima(recipe: RandomRecipe) -> PlantedSequence:
    """Generate the random QP sequence of a recipe together with its known optima."""
    family = FAMILIES[recipe.family]
    seed = [recipe.seed, recipe.n, recipe.m, zlib.crc32(recipe.family.encode())]
    rng = np.random.default_rng(seed)
    frame = _draw_constant_matrices_and_bounds(recipe, family, rng)
    signals = _draw_smooth_signals_with_jumps(rng, recipe.steps, recipe.m + recipe.n)
    share = 0.4 + 0.2 * np.sin(2.0 * np.pi * (np.arange(recipe.steps) / 12.0 + rng.random()))
    steps = []
    for k in range(recipe.steps):
        count = max(1, round(float(share[k]) * recipe.n))
        step = _build_step_around_known_optimum(frame, family, signals[k], count)
        if family.infeasible and k % 3 == 2:
            step = _copy_step_made_infeasible(frame, step, int(rng.integers(recipe.m)), k)
        steps.append(step)
    first = steps[0]
    limits = first.l, first.u, frame.lower_bounds, frame.upper_bounds
    base = QuadraticProgram(frame.P, first.q, frame.A, *limits, recipe.block)
    q, l, u, z, y, y_box = (np.array(part) for part in zip(*steps, strict=True))  # noqa: E741
    sequence = QPSequence(recipe.sequence_name, base, q, l, u, meta={"family": recipe.family})
    return PlantedSequence(sequence, np.isfinite(z).all(axis=1), z, y, y_box)


@dataclass(frozen=True, eq=False)
class _ConstantParts:
    """Parts of a random QP sequence that are constant over its steps.

    lo, hi (n,) : where bounds are, or would be; half (m,) : half the width of a row.
    above, below (m+n,) : whether there is an upper and a lower limit. equal (m+n,) : l = u.
    twin (m+n,) : the row that this one is a copy of, up to `sign`; −1 for none.
    """

    P: Matrix
    A: Matrix
    lo: Vector
    hi: Vector
    half: Vector
    above: Flags
    below: Flags
    equal: Flags
    twin: Indices
    sign: Vector

    @property
    def lower_bounds(self) -> Vector:
        """Lower bounds (n,) of the variables, −inf where there is none."""
        return np.where(self.below[len(self.half) :], self.lo, -np.inf)

    @property
    def upper_bounds(self) -> Vector:
        """Upper bounds (n,) of the variables, inf where there is none."""
        return np.where(self.above[len(self.half) :], self.hi, np.inf)


class _PlantedStep(NamedTuple):
    """One random QP step with its known optimum, or its Farkas vector where infeasible."""

    q: Vector
    l: Vector  # noqa: E741 - as in QuadraticProgram
    u: Vector
    z: Vector
    y: Vector
    y_box: Vector


def _draw_constant_matrices_and_bounds(
    recipe: RandomRecipe, family: Family, rng: np.random.Generator
) -> _ConstantParts:
    """Draw a random QP sequence's constant matrices and bounds, and which row limits exist."""
    n, m = recipe.n, recipe.m
    rank, cond = n - max(1, n // 5), recipe.cond or family.cond
    P = (
        draw_random_semidefinite_matrix(rng, n, rank)
        if family.semidefinite
        else draw_random_positive_definite_matrix(rng, n, cond)
    )
    A = draw_random_unit_rows(rng, m, n)
    twin, sign = np.full(m + n, -1, dtype=np.intp), np.ones(m + n)
    for pair in range(min(m // 2, max(1, round(0.5 * family.twins * m))) if family.twins else 0):
        i, j = 2 * pair, 2 * pair + 1
        # A row written twice may be written the other way round; to contradict it, it may not.
        twin[j], sign[j] = i, 1.0 if family.infeasible or pair % 2 else -1.0
        A[j] = sign[j] * A[i]
    kind = rng.permutation(m) / max(1, m)
    free, one_sided = kind < family.free, kind >= 1.0 - family.one_sided
    equal = np.zeros(m + n, dtype=bool)
    if family.equal:
        # At most a third of n, so that the other limits have a choice left.
        equal[rng.permutation(m)[: min(round(family.equal * m), max(1, n // 3))]] = True
    upper_kept = rng.random(m) < 0.5
    open_lo, open_hi = (rng.random(n) < family.open_bounds for _ in range(2))
    ends = (0.5, 1.5, n), (0.5, 1.5, n), (0.25, 1.0, m)
    lo, hi, half = (round_to_multiples(rng.uniform(*interval), POINT) for interval in ends)
    above = np.concatenate((~free & ~(one_sided & ~upper_kept), ~open_hi))
    below = np.concatenate((~free & ~(one_sided & upper_kept), ~open_lo))
    return _ConstantParts(P, A, -lo, hi, half, above, below, equal, twin, sign)


def _draw_smooth_signals_with_jumps(rng: np.random.Generator, K: int, N: int) -> Matrix:
    """Draw K steps of N smooth random signals of size 0.5 to 2, with common jumps."""
    size, speed = rng.uniform(0.5, 2.0, N), rng.uniform(0.2, 1.0, N)
    jumps = np.sort(rng.integers(1, max(2, K), JUMPS))
    phase = rng.random((JUMPS + 1, N))[np.searchsorted(jumps, np.arange(K), side="right")]
    turns = speed * np.arange(K)[:, np.newaxis] / 12.0 + phase
    return size * np.sin(2.0 * np.pi * turns)


def _choose_active_sides_multipliers_and_near_misses(
    frame: _ConstantParts, family: Family, s: Vector, count: int
) -> tuple[Vector, Vector, Flags]:
    """Choose the limits that an optimum meets; return sides (±1, 0), multipliers, near misses."""
    n = len(frame.lo)
    side = np.where(s > 0, 1.0, -1.0)
    side = np.where(frame.above & frame.below, side, np.where(frame.above, 1.0, -1.0))
    may = (frame.above | frame.below) & ~frame.equal & (frame.twin < 0)
    order = np.argsort(-np.abs(np.where(may, s, 0.0)), kind="stable")[: int(may.sum())]
    held = order[: max(1, count - int(frame.equal.sum()))]
    touched = order[len(held) :][: max(1, round(family.touching * n)) if family.touching else 0]
    y = np.zeros(len(s))
    y[held] = side[held] * round_to_multiples(0.125 + np.abs(s[held]), POINT)
    y[frame.equal] = round_to_multiples(s[frame.equal], POINT)
    met = np.zeros(len(s))
    met[held], met[touched] = side[held], side[touched]
    near = np.zeros(len(s), dtype=bool)
    # Exact degeneracy needs exact limits; a near miss would make a vertex of its own.
    near[touched[1::3]] = family.touching < 1.0
    copies = np.flatnonzero(frame.twin >= 0)
    if not family.infeasible:
        for values in (met, y):
            values[copies] = frame.sign[copies] * values[frame.twin[copies]]
    return met, y, near


def _build_step_around_known_optimum(
    frame: _ConstantParts, family: Family, s: Vector, count: int
) -> _PlantedStep:
    """Build one QP step around a chosen optimum, from random numbers s (m + n,)."""
    m = len(frame.half)
    met, y, near = _choose_active_sides_multipliers_and_near_misses(frame, family, s, count)
    wave = 0.9 * np.clip(0.5 * s, -1.0, 1.0)
    middle, half = 0.5 * (frame.hi + frame.lo), 0.5 * (frame.hi - frame.lo)
    z = round_to_multiples(middle + half * wave[m:], POINT)
    z = np.where(met[m:] > 0, frame.hi, np.where(met[m:] < 0, frame.lo, z))
    w = frame.A @ z
    above, below = (
        round_to_multiples(frame.half * (1.0 + side * wave[:m]), POINT) for side in (-1.0, 1.0)
    )
    close = np.where(near[:m], NEAR, 0.0)
    upper, lower, equal = met[:m] > 0, met[:m] < 0, frame.equal[:m]
    u = w + np.where(equal, 0.0, np.where(upper, close, np.where(lower, 2.0 * frame.half, above)))
    l = w - np.where(  # noqa: E741 - as in QuadraticProgram
        equal, 0.0, np.where(lower, close, np.where(upper, 2.0 * frame.half, below))
    )
    q = -(frame.P @ z + y[:m] @ frame.A + y[m:])
    limits = np.where(frame.below[:m], l, -np.inf), np.where(frame.above[:m], u, np.inf)
    return _PlantedStep(q, *limits, z, y[:m], y[m:])


def _copy_step_made_infeasible(
    frame: _ConstantParts, step: _PlantedStep, row: int, k: int
) -> _PlantedStep:
    """Return the step made infeasible, by the bounds or by a row's copy in turn, and a proof."""
    l, u, a = step.l.copy(), step.u.copy(), frame.A[row]  # noqa: E741 - as in QuadraticProgram
    y = np.zeros(len(l))
    if k % 2:
        l[row] = float(np.maximum(a * frame.lo, a * frame.hi).sum()) + MARGIN
        u[row] = l[row] + frame.half[row]
        y[row] = -1.0
        y_box = a.copy()
    else:
        copies = np.flatnonzero(frame.twin >= 0)
        copy = copies[row % len(copies)]
        row = int(frame.twin[copy])
        l[copy] = u[row] + MARGIN
        u[copy] = l[copy] + frame.half[copy]
        y[row], y[copy] = 1.0, -1.0
        y_box = np.zeros(len(step.z))
    return _PlantedStep(step.q, l, u, np.full(len(step.z), np.nan), y, y_box)
