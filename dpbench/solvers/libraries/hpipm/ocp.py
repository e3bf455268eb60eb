"""HPIPM's solver for optimal control through ctypes: a Riccati recursion over the stages.

The stages are found in the pattern of the QP; one without any is solved as a single stage. The time
of a step grows with the number of stages, that of the dense solver with its cube.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dpbench.arrays import Vector
from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.libraries.hpipm import dense as hpipm
from dpbench.solvers.libraries.hpipm.library import (
    OPTION_NAMES,
    TOLERANCE_NAMES,
    Structures,
    pointer,
)
from dpbench.solvers.libraries.hpipm.stages import Part, StageData, addresses, find_stages
from dpbench.solvers.libraries.hpipm.workspace import HpipmWorkspace
from dpbench.solvers.libraries.native_workspace import Point
from dpbench.solvers.one_sided import Sides
from dpbench.solvers.record import by_tolerance

RECORD = replace(
    hpipm.RECORD,
    name="hpipm_ocp",
    method="primal-dual interior point, factorised stage by stage",
    form="csc",
    levels=by_tolerance(*TOLERANCE_NAMES, iter_max=200),
)


class OcpWorkspace(HpipmWorkspace):
    """HPIPM by stages, found anew when other rows have l = u or an infinite side.

    `warm` gives it the previous z, shifted.
    """

    def _convert(self) -> None:
        super()._convert()
        self._pattern = None

    def _find(self) -> None:
        """Find the stages, and what stays while the same limits are equal or infinite."""
        self._pattern = Sides.pattern(self._l, self._u)
        stages = find_stages(self._P, self._A, self._l == self._u)
        self._data = StageData(stages, self._P, self._A, self._low, self._high)

    def _build(self) -> None:
        m = self._m
        self._low[:m], self._high[:m] = self._l, self._u
        if Sides.pattern(self._l, self._u) != self._pattern:
            self._find()
        data = self._data
        sizes, last = tuple(map(pointer, data.sizes)), len(data.stages) - 1
        parts = self._parts = Structures(self._library, "ocp_qp", sizes, self._options, last)
        for k, matrices in enumerate(data.matrices):
            for name, array in matrices.items():
                if array.size:
                    parts.function(f"set_{name}")(k, pointer(array), parts.qp)
        self._set_masks()
        self._allocate()
        self._fill(self._q, everything=True)

    def _set_masks(self) -> None:
        """Mask the sides out that do not exist, whose limits are numbers all the same."""
        sides, parts = self._data.sides, self._parts
        self._infinite = [np.flatnonzero(np.isinf(a[sides])) for a in (self._low, self._high)]
        for k, limits in enumerate(self._data.limits):
            for name, mask in limits.masks(self._low, self._high).items():
                parts.function(f"set_{name}")(k, pointer(mask), parts.qp)

    def _allocate(self) -> None:
        """Buffers of all stages, and their addresses for what is set and got."""
        nx, nu, nbx, nbu, ng, _ = self._data.sizes
        nb, parts = nbx + nbu, self._parts
        by_stage = list(zip(nu.tolist(), nx.tolist(), nb.tolist(), ng.tolist(), strict=True))
        self._cost = Part(parts, [[("r", u), ("q", x)] for u, x, _, _ in by_stage])
        self._b = Part(parts, [[("b", x)] for x in nx[1:].tolist()])
        self._limits = (
            Part(parts, [[("lb", b), ("lg", g)] for _, _, b, g in by_stage]),
            Part(parts, [[("ub", b), ("ug", g)] for _, _, b, g in by_stage]),
        )
        data = self._data
        self._z, self._pi = np.empty(self._n), np.empty(data.dynamics.size)
        self._lower, self._upper = np.empty(data.sides.size), np.empty(data.sides.size)
        variables = np.stack([nu, nx], axis=1).reshape(-1)
        limits = np.stack([nb, ng], axis=1).reshape(-1)
        at_z = addresses(self._z, variables).reshape(-1, 2)
        at_lower = addresses(self._lower, limits).reshape(-1, 2)
        at_upper = addresses(self._upper, limits).reshape(-1, 2)
        none = np.zeros(nx.size, dtype=np.uintp)
        at_pi = addresses(self._pi, nx[1:])
        tables = [*at_z.T, none, none, at_pi]
        tables += [at_lower[:, 0], at_upper[:, 0], at_lower[:, 1], at_upper[:, 1], none, none]
        self._tables = [np.ascontiguousarray(table) for table in tables]
        self._pieces = [pointer(table) for table in self._tables]
        self._get, self._set = parts.function("sol_get_all"), parts.function("sol_set_all")

    def _fill(self, q: Vector, everything: bool = False) -> None:
        data = self._data
        self._cost.gather(q, data.order)
        b = self._b.gather(self._high, data.dynamics)
        b /= data.pivots
        both = zip(self._limits, (self._low, self._high), self._infinite, strict=True)
        for part, limits, infinite in both:
            gathered = part.gather(limits, data.sides)
            if infinite.size:
                gathered[infinite] = 0.0
        for part in (self._cost, self._b, *self._limits):
            part.send(everything)

    def _place_start(self) -> None:
        self._start.z.take(self._data.order, out=self._z)
        self._set(*self._pieces, self._parts.sol)

    def _point(self) -> Point:
        data, m = self._data, self._m
        self._get(self._parts.sol, *self._pieces)
        z, y = np.empty(self._n), np.zeros(m + self._n)
        z[data.order] = self._z
        y[data.sides] = self._upper - self._lower
        y[data.dynamics] = -self._pi / data.pivots
        return z, y[:m], y[m:]


NATIVE = NativeAdapter(RECORD, OcpWorkspace, lambda: (*OPTION_NAMES, "ric_alg"))
