"""Regions of the parameters of a QP: convex, cut by halfspaces, and proved empty where they are.

A region is {t : G t ≤ h, |t_i| ≤ 1} with rows of G of length 1. A cut keeps a point that is `WIDTH`
inside of every halfspace, or is proved to leave none: a Farkas ray y ≥ 0 of the region shrunk by
`WIDTH`, with yᵀ(G t − h + WIDTH) > 0 at every t of the box, is checked by
multiplication. Parameters within `WIDTH` of a boundary between two regions are in none.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from dpbench.arrays import Matrix, Vector
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.solvers.contract import Workspace
from dpbench.solvers.open import open_workspace

WIDTH = 1e-9
"""Half the width of a region that counts as empty, in a box of half the width 1."""
_PARALLEL = 1e-11
_MANY = 32
"""Halfspaces of a region from which on those that others imply are searched for and dropped."""
_ROWS = 16
"""Workspaces have a multiple of so many rows, so that few are opened."""


@dataclass(frozen=True, eq=False)
class Region:
    """A convex region of d parameters: G (k, d) with rows of length 1, h (k,), `inside` (d,)."""

    G: Matrix
    h: Vector
    inside: Vector

    @property
    def is_thin(self) -> bool:
        """Return whether the region's point lies less than `WIDTH` / 2 from a boundary."""
        return bool((self.inside @ self.G.T - self.h > -WIDTH / 2).any())

    def contains(self, points: Matrix) -> Vector:
        """Return which points (p, d) of the box are in the region, as a mask (p,)."""
        return np.asarray((points @ self.G.T <= self.h).all(axis=1))


def make_box(d: int) -> Region:
    """Return the whole box |t_i| ≤ 1 of d parameters."""
    return Region(np.zeros((0, d)), np.zeros(0), np.zeros(d))


class RegionCutter:
    """Cuts of regions of d parameters; `tests` counts those that asked whether a part is empty."""

    def __init__(self, d: int) -> None:
        self.d = d
        self.tests = 0
        self._workspaces: dict[int, tuple[Workspace, Matrix, Vector, Vector]] = {}

    def cut(self, region: Region, functions: Matrix) -> Region | None:
        """Return the part where functions (k, d + 1) of [t; 1] are ≤ 0; None if it is empty."""
        slopes, constants = functions[:, :-1], functions[:, -1]
        lengths = np.sqrt((slopes**2).sum(axis=1))
        flat = lengths < 1e-13
        if (constants[flat] > 1e-12).any():
            return None
        g, b = slopes[~flat] / lengths[~flat, None], -constants[~flat] / lengths[~flat]
        reach = np.abs(g).sum(axis=1)
        if (b < WIDTH - reach).any():
            return None
        cutting = b < reach - WIDTH
        if not cutting.any():
            return region
        joined = _join_halfspaces(region.G, region.h, g[cutting], b[cutting])
        if joined is None:
            return None
        G, h = joined
        if (region.inside @ G.T - h).max() <= -WIDTH:
            return Region(G, h, region.inside)
        inside = self.find_point(G, h, region.inside)
        if inside is None:
            return None
        if len(h) > _MANY:
            G, h = self._drop_implied_halfspaces(G, h, inside)
        return Region(G, h, inside)

    def find_point(self, G: Matrix, h: Vector, start: Vector) -> Vector | None:
        """Return the point of {G t ≤ h − WIDTH} in the box nearest to `start`; None if empty.

        Where rounding decides that, the centre of the region is returned.
        """
        self.tests += 1
        workspace, A, low, high = self._prepare_workspace(len(h))
        A[: len(h)], A[len(h) :] = G, 0.0
        high[: len(h)], high[len(h) :] = h - WIDTH, np.inf
        workspace.update(QPStep(-start, low, high, A=A))
        workspace.solve()
        answer = workspace.read()
        if (G @ answer.z - h < -WIDTH / 2).all():
            return answer.z
        if _is_empty(G, h, answer.y[: len(h)]):
            return None
        point, ray = _find_centre(G, h)
        return None if _is_empty(G, h, ray) else point

    def _prepare_workspace(self, rows: int) -> tuple[Workspace, Matrix, Vector, Vector]:
        """Return a workspace for at least so many rows, with its arrays A, l and u."""
        size = _ROWS * -(-rows // _ROWS)
        if size not in self._workspaces:
            A, high, box = np.zeros((size, self.d)), np.full(size, np.inf), np.ones(self.d)
            workspace = open_workspace("paper_active_set", route="native", policy="fresh")
            workspace.setup(
                QuadraticProgram(np.eye(self.d), np.zeros(self.d), A, -high, high, -box, box)
            )
            self._workspaces[size] = workspace, A, -high, high
        return self._workspaces[size]

    def _drop_implied_halfspaces(
        self, G: Matrix, h: Vector, inside: Vector
    ) -> tuple[Matrix, Vector]:
        """Return the halfspaces of a region without those that the others and the box imply."""
        stays = np.ones(len(h), dtype=bool)
        for k in range(len(h)):
            stays[k] = False
            others = np.vstack([G[stays], -G[k]]), np.append(h[stays], -h[k])
            stays[k] = self.find_point(*others, inside) is not None
        return G[stays], h[stays]


def _join_halfspaces(G: Matrix, h: Vector, g: Matrix, b: Vector) -> tuple[Matrix, Vector] | None:
    """Return halfspaces G t ≤ h and g t ≤ b, of parallel ones the tighter; None if two exclude."""
    if len(h):
        cosines = G @ g.T
        if ((cosines < _PARALLEL - 1.0) & (h[:, None] + b <= 4.0 * WIDTH)).any():
            return None
        same = cosines > 1.0 - _PARALLEL
        if same.any():
            new = ~(same & (h[:, None] <= b)).any(axis=0)
            old = ~(same & (h[:, None] > b)).any(axis=1)
            G, h, g, b = G[old], h[old], g[new], b[new]
    return np.concatenate([G, g]), np.concatenate([h, b])


def _is_empty(G: Matrix, h: Vector, ray: Vector) -> bool:
    """Return whether a ray y ≥ 0 proves that {G t ≤ h − WIDTH} has no point in the box."""
    y = np.maximum(ray, 0.0)
    return bool(-np.abs(y @ G).sum() - y @ (h - WIDTH) > 0.0)


def _find_centre(G: Matrix, h: Vector) -> tuple[Vector, Vector]:
    """Return the centre of the largest ball in a region, and the multipliers of its halfspaces.

    Of a region of width 0 the multipliers are a ray.
    """
    objective = np.append(np.zeros(G.shape[1]), -1.0)
    box = [(-1.0, 1.0)] * G.shape[1] + [(None, None)]
    found = linprog(objective, np.column_stack([G, np.ones(len(h))]), h, bounds=box)
    assert found.x is not None  # The box is bounded and the radius may be negative.
    return found.x[:-1], -found.ineqlin.marginals
