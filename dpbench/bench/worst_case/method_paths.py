"""The paths of the paper's active-set method over all parameters of a QP.

    minimise ½ zᵀP z + q(t)ᵀz   subject to   low(t) ≤ C z ≤ high(t),   |t_i| ≤ 1

q, low and high are affine in t. From an empty set (a cold start) all that the method compares is
affine in t too: violations, multipliers, and the step lengths t_k = λ_k / a_k at which rows are
dropped. Each comparison therefore cuts a region of parameters by halfspaces, and each part goes its
own path; the method ends everywhere in a part after the same number of iterations. The idea is that
of Cimini & Bemporad (IEEE Trans. Automatic Control 62 (2017) 6094-6109) and Arnström & Axehill
(ibid. 67 (2022) 2758-2770). The steps are those of `dpbench/solvers/own/active_set.c` in exact
arithmetic; a warm start compares ratios of affine functions and is not covered.

An affine function is a vector (d + 1,) of factors of [t; 1].
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.worst_case.parameter_regions import Region, RegionCutter, make_box

KEPT, SHARE, CANDIDATES = 0.95, 0.3, 8
"""As in `active_set.c`: shares of a violation from which a row is brought in, and how many."""
_DEPENDENT, _NO_PART = 1e-10, 1e-9

Row = tuple[int, int]
"""A row of C and its side: 1 at its upper limit, −1 at its lower one."""


@dataclass(frozen=True, eq=False)
class ParametricQP:
    """A QP whose vectors are affine in parameters t (d,).

    P : (n, n); C : (N, n) = [I; A]; q : (n, d + 1); low, high : (N, d + 1).
    """

    P: Matrix
    C: Matrix
    q: Matrix
    low: Matrix
    high: Matrix

    @property
    def d(self) -> int:
        """Number of parameters."""
        return int(self.q.shape[1]) - 1


@dataclass(frozen=True, eq=False)
class Look:
    """The look at all rows that found the violated ones: their values then, and who was brought in.

    values : (N, d + 1); rows : those not active then; picked : rows already taken of them, the
    most violated first; worst : its violation.
    """

    values: Matrix
    rows: tuple[Row, ...]
    picked: tuple[int, ...] = ()
    worst: Vector | None = None


@dataclass(frozen=True, eq=False)
class Incoming:
    """A row on its way into the active set: how far beyond its limit it is, and its multiplier."""

    row: Row
    gap: Vector
    multiplier: Vector


@dataclass(frozen=True, eq=False)
class Path:
    """State of the method after some iterations, for all parameters of a region.

    active : rows, as they came; multipliers : (len(active), d + 1), positive at an upper limit.
    look : None before a look; incoming : None between two rows; done : the method has ended.
    """

    region: Region
    active: tuple[Row, ...]
    multipliers: Matrix
    iterations: int = 0
    look: Look | None = None
    incoming: Incoming | None = None
    done: bool = False


@dataclass(eq=False)
class MethodPaths:
    """Paths of the method from a cold start; `cutter` has the proofs that the others are empty."""

    qp: ParametricQP
    cutter: RegionCutter = field(init=False)

    def __post_init__(self) -> None:
        qp, n = self.qp, len(self.qp.P)
        rows = np.linalg.solve(qp.P, qp.C.T)
        self._H = qp.C @ rows
        self._start = -rows.T @ qp.q
        self._unit = 1.0 / np.sqrt(np.diag(self._H))
        self._most_candidates = min(n // 4 + 1, CANDIDATES)
        self.cutter = RegionCutter(qp.d)

    def start(self) -> Path:
        """Return the path of all parameters before the first look."""
        return Path(make_box(self.qp.d), (), np.zeros((0, self.qp.d + 1)))

    def continue_path(self, path: Path) -> Iterator[Path]:
        """Yield the parts of a path after the next comparison, each with its region."""
        if path.incoming is not None:
            yield from self._bring_in(path, path.incoming)
        elif path.look is None:
            values = self._start.copy()
            for (i, _), multiplier in zip(path.active, path.multipliers, strict=True):
                values -= np.outer(self._H[i], multiplier)
            taken = {i for i, _ in path.active}
            rows = tuple((i, s) for i in range(len(values)) if i not in taken for s in (1, -1))
            yield from self._pick(path, Look(values, rows))
        else:
            yield from self._pick(path, path.look)

    def _split(self, path: Path, options: Iterable[tuple[list[Vector], Path]]) -> Iterator[Path]:
        """Yield each option, with the part of a path's region where its functions are ≤ 0."""
        for functions, option in options:
            stacked = np.asarray(functions).reshape(-1, self.qp.d + 1)
            region = self.cutter.cut(path.region, stacked)
            if region is not None:
                yield replace(option, region=region)

    def _gap(self, row: Row, value: Vector) -> Vector:
        """Return how far a row of a given value is beyond its limit, negative inside."""
        i, side = row
        gap: Vector = value - self.qp.high[i] if side > 0 else self.qp.low[i] - value
        return gap

    def _pick(self, path: Path, look: Look) -> Iterator[Path]:
        """Take the most violated row of a look that is not taken yet, if one is violated."""
        violations = {
            row: self._unit[row[0]] * self._gap(row, look.values[row[0]])
            for row in look.rows
            if row[0] not in look.picked
        }
        # What is violated nowhere in the box needs no comparison.
        possible = {r: f for r, f in violations.items() if np.abs(f[:-1]).sum() + f[-1] > 0.0}
        none_left = replace(path, look=None, done=not look.picked)
        yield from self._split(path, [(list(possible.values()), none_left)])
        for row, by in possible.items():
            worst_of_rest = [-by] + [f - by for other, f in possible.items() if other != row]
            for part in self._split(path, [(worst_of_rest, path)]):
                yield from self._take(part, look, row, by)

    def _take(self, path: Path, look: Look, row: Row, by: Vector) -> Iterator[Path]:
        """Bring a row of a look in, unless others brought in since have nearly cured it."""
        i = row[0]
        now_at = replace(
            look,
            picked=(*look.picked, i),
            worst=by if look.worst is None else look.worst,
        )
        # The list of rows found is short: after its last one the method looks again.
        after = None if len(now_at.picked) >= self._most_candidates else now_at
        path = replace(path, look=after)
        none = np.zeros(self.qp.d + 1)
        if look.worst is None:
            yield replace(path, incoming=Incoming(row, self._gap(row, look.values[i]), none))
            return
        value = self._start[i].copy()
        for (k, _), multiplier in zip(path.active, path.multipliers, strict=True):
            value -= self._H[i, k] * multiplier
        least, share = KEPT * by, SHARE * look.worst
        gaps = {side: self._gap((i, side), value) for side in (1, -1)}
        now = {side: self._unit[i] * gap for side, gap in gaps.items()}
        options = [([now[1] - least, now[-1] - least], path)]
        for side, gap in gaps.items():
            options += [
                (
                    [share - now[side], least - now[side]],
                    replace(path, incoming=Incoming((i, side), gap, none)),
                ),
                ([least - now[side], now[side] - share], path),
            ]
        yield from self._split(path, options)

    def _bring_in(self, path: Path, incoming: Incoming) -> Iterator[Path]:
        """Raise the multiplier of a row until it is at its limit or another row has to leave."""
        (j, side), gap = incoming.row, incoming.gap
        path = replace(path, iterations=path.iterations + 1)
        active = [i for i, _ in path.active]
        R = np.linalg.solve(self._H[np.ix_(active, active)], self._H[active, j])
        square = float(self._H[j, j] - self._H[j, active] @ R)
        dependent = len(active) == len(self.qp.P) or square <= _DEPENDENT * self._H[j, j]
        slopes = side * R
        blocking = {
            k: path.multipliers[k] / slopes[k]
            for k, (i, s) in enumerate(path.active)
            if slopes[k] * s > 0.0
            and not (dependent and abs(slopes[k]) * self._unit[j] < _NO_PART * self._unit[i])
        }
        options = []
        if not dependent:
            full = self._step(path, incoming, slopes, gap / square)
            options.append(([gap / square - t for t in blocking.values()], full))
        elif not blocking:
            yield replace(path, done=True)  # The rows contradict each other: infeasible.
        for k, t in blocking.items():
            first = [t - other for at, other in blocking.items() if at != k]
            left = gap if dependent else gap - square * t
            stepped = self._step(path, incoming, slopes, t, dropped=k, gap=left)
            options.append((first if dependent else [*first, t - gap / square], stepped))
        yield from self._split(path, options)

    def _step(
        self,
        path: Path,
        incoming: Incoming,
        slopes: Vector,
        length: Vector,
        *,
        dropped: int | None = None,
        gap: Vector | None = None,
    ) -> Path:
        """Return the path after a step: the row is in, or `dropped` is out and a gap left."""
        multipliers = path.multipliers - np.outer(slopes, length)
        own = incoming.multiplier + incoming.row[1] * length
        if dropped is None or gap is None:
            active = (*path.active, incoming.row)
            return replace(
                path, active=active, multipliers=np.vstack([multipliers, own]), incoming=None
            )
        stay = [k for k in range(len(path.active)) if k != dropped]
        return replace(
            path,
            active=tuple(path.active[k] for k in stay),
            multipliers=multipliers[stay],
            incoming=Incoming(incoming.row, gap, own),
        )
