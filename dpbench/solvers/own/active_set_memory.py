"""The paper's method behind a memory of active sets: a partial explicit MPC.

For an active set W with limits g the answer is affine in the step's vectors (eq. 31-32):

    λ_W = H_WW⁻¹ (C_W base − g),   z = base − P⁻¹C_Wᵀ λ_W,   base = −P⁻¹q,   H = C P⁻¹ Cᵀ

The law of each set that was optimal once is stored. A step tries the laws used last; one whose λ
has the signs of its limits and whose z keeps all others is the optimum. Where none is, the paper's
method solves the step and its set is stored. New matrices empty the memory.
"""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QPStep, QuadraticProgram, Refresh
from dpbench.qp.solution import Solution
from dpbench.solvers.contract import Policy, Route
from dpbench.solvers.own.paper_active_set import NOT_SOLVED_YET, SOLVED, PaperActiveSetWorkspace

TRIED = 4
"""Laws that a step tries, those used last first."""
MOST_BYTES = 4_000_000
"""Size of the stored laws above which the one not used for longest is dropped."""
_TOLERANCE = 1e-10
"""Excess over a limit that a stored law may have, over 1 plus the size of the row."""


@dataclass(frozen=True, eq=False)
class StoredLaw:
    """The affine law of one active set of k rows.

    rows : (k,) of C = [I; A]; side : (k,) 1 at the upper limit, −1 at the lower one.
    gain : (k, n + k), λ_W = gain [base; g]; back : (n, k), P⁻¹C_Wᵀ.
    """

    rows: np.ndarray
    side: Vector
    gain: Matrix
    back: Matrix

    @property
    def size_bytes(self) -> int:
        """Memory of its numbers in double precision."""
        return 8 * (self.gain.size + self.back.size) + 4 * len(self.rows)


def make_law(G: Matrix, C: Matrix, rows: np.ndarray, side: Vector) -> StoredLaw:
    """Return the law of an active set; G (N, n) = C P⁻¹. LinAlgError where its rows depend."""
    back = G[rows].T
    inverse = np.linalg.inv(C[rows] @ back)
    return StoredLaw(rows, side, np.hstack([inverse @ C[rows], -inverse]), back)


class ActiveSetMemoryWorkspace(PaperActiveSetWorkspace):
    """The paper's method with a memory of the sets it found; `warm` keeps it from step to step.

    `hits` counts steps that a stored law answered, with 0 iterations; `multiply_adds` those of the
    last solve that the laws it tried take.
    """

    def __init__(self, solver: str, route: Route, policy: Policy) -> None:
        super().__init__(solver, route, policy)
        self.hits = self.multiply_adds = 0
        self._laws: dict[bytes, StoredLaw] = {}
        self._bytes = 0
        self._remembered: Solution | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Write `qp` into the library and empty the memory."""
        super().setup(qp)
        self._forget()

    def update(self, step: QPStep) -> None:
        """Write a step into the library; new matrices or bounds empty the memory."""
        super().update(step)
        self._remembered = None
        if step.refresh is not Refresh.VECTORS:
            self._forget()

    def _forget(self) -> None:
        """Empty the memory."""
        self._laws.clear()
        self._bytes, self._remembered = 0, None

    def solve(self) -> None:
        """Answer by a stored law, or by the paper's method, whose set is stored then."""
        if self.policy != "warm" or self._problem is None or self._ready < NOT_SOLVED_YET:
            super().solve()
            return
        if not self._laws:
            arrays = self._problem.copy_arrays_that_depend_on_matrices()
            n = len(self._q)
            self._G = arrays["G"].reshape(-1, n)
            self._C = np.vstack([np.eye(n), self._problem.A])
        n = len(self._q)
        base, self.multiply_adds = -self._G[:n] @ self._q, n * n
        for key in list(reversed(self._laws))[:TRIED]:
            if (answer := self._apply(self._laws[key], base)) is not None:
                self._laws[key] = self._laws.pop(key)  # The last one in order is the one used last.
                self._remembered, self.hits = answer, self.hits + 1
                return
        super().solve()
        if self._ending >= 0:
            self._store(self._problem.lam)

    def _apply(self, law: StoredLaw, base: Vector) -> Solution | None:
        """Return the answer of a law if it is the optimum of this step, else None."""
        problem, n = self._problem, len(base)
        assert problem is not None
        g = np.where(law.side > 0, problem.high[law.rows], problem.low[law.rows])
        lam = law.gain @ np.concatenate([base, g])
        self.multiply_adds += law.gain.size
        if not (lam * law.side >= 0.0).all():
            return None
        values = self._C @ (base - law.back @ lam)
        self.multiply_adds += law.back.size + problem.A.size  # of C = [I; A] the I takes none
        values[law.rows] = g
        over = np.maximum(values - problem.high, problem.low - values)
        if not (over <= _TOLERANCE * (1.0 + np.abs(values))).all():
            return None
        multipliers = np.zeros(len(values))
        multipliers[law.rows] = lam
        z = np.clip(values[:n], problem.low[:n], problem.high[:n])
        return Solution(SOLVED, z, multipliers[n:], multipliers[:n], 0)

    def _store(self, lam: Vector) -> None:
        """Store the law of the set of an answer's multipliers; drop old ones above `MOST_BYTES`."""
        side = np.sign(lam).astype(np.int8)
        key = side.tobytes()
        if key not in self._laws:
            rows = np.flatnonzero(side)
            try:
                law = make_law(self._G, self._C, rows, side[rows].astype(np.float64))
            except np.linalg.LinAlgError:
                return
            self._laws[key] = law
            self._bytes += law.size_bytes
        while self._bytes > MOST_BYTES and len(self._laws) > 1:
            self._bytes -= self._laws.pop(next(iter(self._laws))).size_bytes

    def read(self) -> Solution:
        """Return the answer of a stored law, or that of the paper's method."""
        return super().read() if self._remembered is None else self._remembered

    def reset(self) -> None:
        """Make the next solve start with an empty memory."""
        super().reset()
        self._forget()
