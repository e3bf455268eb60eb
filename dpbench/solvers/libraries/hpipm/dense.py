"""HPIPM's dense solver through ctypes, on the library in the casadi wheel: two-sided, start primal.

HPIPM takes an infinite side as one that is masked out, and l = u as an equality of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector
from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.libraries.hpipm.library import (
    OPTION_NAMES,
    TOLERANCE_NAMES,
    Limits,
    Structures,
    blasfeo_build,
    pointer,
)
from dpbench.solvers.libraries.hpipm.workspace import HpipmWorkspace
from dpbench.solvers.libraries.native_workspace import Point, stacked
from dpbench.solvers.one_sided import Sides
from dpbench.solvers.record import RouteRecord, SolverRecord, by_tolerance, stated

RECORD = SolverRecord(
    name="hpipm",
    family="interior point",
    method="primal-dual interior point, dense",
    distribution="casadi",
    module="casadi",
    extra="casadi",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh", "reuse", "warm"),
            updates="vectors",
            start="primal",
            two_sided=True,
            detects_infeasibility=False,
        )
    },
    # It meets equalities by a Schur complement by default, which takes a positive definite cost;
    # by the null space (0) it takes any convex one.
    levels=by_tolerance(*TOLERANCE_NAMES, iter_max=200, always={"kkt_fact_alg": 0}),
    project=stated(
        licence=("BSD-2-Clause", "HPIPM source, head of each file"),
        language=("C, on BLASFEO", "HPIPM reference guide, Introduction"),
        c_code=("it is C to embed", "HPIPM reference guide, Introduction"),
        allocation_free=(
            "yes, memory comes from the caller",
            "HPIPM source, *_memsize and *_create",
        ),
        single_precision=("yes, routines s_*", "HPIPM source, s_dense_qp_ipm"),
    ),
    build=blasfeo_build,
)


class DenseWorkspace(HpipmWorkspace):
    """HPIPM on lb ≤ v ≤ ub, lg ≤ C v ≤ ug, A v = b; `warm` gives it the previous v, shifted."""

    def _convert(self) -> None:
        super()._convert()
        self._rows = stacked(self._A, self._n)

    def _build(self) -> None:
        n, m, library = self._n, self._m, self._library
        self._low[:m], self._high[:m] = self._l, self._u
        self._pattern = Sides.pattern(self._l, self._u)
        limits = self._limits = Limits(self._low, self._high, m)
        n_bounds = limits.bounds.size
        sizes = (n, limits.equal.size, n_bounds, limits.rows.size, 0)
        self._parts = parts = Structures(library, "dense_qp", sizes, self._options)
        lower, upper = limits.masks()
        constants: dict[str, NDArray[Any]] = {
            "H": self._P,
            "A": np.asfortranarray(self._rows[limits.equal]),
            "C": np.asfortranarray(self._rows[limits.rows]),
            "idxb": (limits.bounds - m).astype(np.intc),
            "lg_mask": lower,
            "ug_mask": upper,
        }
        for name, array in constants.items():
            getattr(library, f"d_dense_qp_set_{name}")(pointer(array), parts.qp)
        self._allocate(n_bounds)
        self._fill(self._q)

    def _allocate(self, n_bounds: int) -> None:
        """Buffers and their addresses: what is set at each step, and what is got."""
        limits = self._limits
        self._g, self._z = np.empty(self._n), np.empty(self._n)
        self._pi = np.empty(limits.equal.size)
        self._lower, self._upper = np.empty_like(limits.low), np.empty_like(limits.high)
        given = {
            "g": self._g,
            "b": limits.b,
            "lb": limits.low[:n_bounds],
            "lg": limits.low[n_bounds:],
            "ub": limits.high[:n_bounds],
            "ug": limits.high[n_bounds:],
        }
        wanted = {
            "v": self._z,
            "pi": self._pi,
            "lam_lb": self._lower[:n_bounds],
            "lam_lg": self._lower[n_bounds:],
            "lam_ub": self._upper[:n_bounds],
            "lam_ug": self._upper[n_bounds:],
        }
        self._setters = self._parts.calls("set", given)
        self._getters = self._parts.calls("sol_get", wanted)

    def _fill(self, q: Vector) -> None:
        self._g[:] = q
        self._limits.fill(self._low, self._high)
        qp = self._parts.qp
        for function, address in self._setters:
            function(address, qp)

    def _place_start(self) -> None:
        self._library.d_dense_qp_sol_set_v(pointer(self._start.z), self._parts.sol)

    def _point(self) -> Point:
        m, sol = self._m, self._parts.sol
        for function, address in self._getters:
            function(sol, address)
        y, limits = np.zeros(m + self._n), self._limits
        y[limits.sides] = self._upper - self._lower
        if limits.equal.size:
            y[limits.equal] = -self._pi
        return self._z.copy(), y[:m], y[m:]


NATIVE = NativeAdapter(RECORD, DenseWorkspace, lambda: (*OPTION_NAMES, "kkt_fact_alg"))
