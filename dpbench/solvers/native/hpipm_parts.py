"""What HPIPM's C interface works on: its structures, and the limits in its order."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.qp.program import Vector


class Structures:
    """HPIPM's structures of one problem size, and the memory behind them."""

    def __init__(self, library: ctypes.CDLL, sizes: tuple[int, ...]) -> None:
        self._library = library
        self._memory: list[Any] = []
        self.dim = self._make("_dim")
        library.d_dense_qp_dim_set_all(*sizes, self.dim)
        self.qp = self._make("", self.dim)
        self.sol = self._make("_sol", self.dim)
        self.arg = self._make("_ipm_arg", self.dim)
        self.ws: Any = None

    def finish(self) -> None:
        """The workspace, whose size depends on the arguments."""
        self.ws = self._make("_ipm_ws", self.dim, self.arg)

    def _make(self, kind: str, *parts: Any) -> Any:
        library, prefix = self._library, f"d_dense_qp{kind}"
        sizes = [getattr(library, f"{prefix}_{name}") for name in ("strsize", "memsize")]
        for function in sizes:
            function.restype = ctypes.c_size_t
        structure = ctypes.create_string_buffer(sizes[0]())
        memory = ctypes.create_string_buffer(sizes[1](*parts))
        self._memory += [structure, memory]
        getattr(library, f"{prefix}_create")(*parts, structure, memory)
        return structure


def pointer(array: NDArray[Any]) -> Any:
    """The address of an array, for a C function."""
    return ctypes.c_void_p(array.ctypes.data)


class Limits:
    """Which limits of [A; I] are equalities, bounds and general rows, and buffers for them.

    The wheel's HPIPM reads an index it never set when the lower side of a bound is masked out, so a
    bound with an infinite side goes as a general row.
    """

    def __init__(self, low: Vector, high: Vector, m: int) -> None:
        equal = low == high
        finite = np.isfinite(low) & np.isfinite(high)
        number = np.arange(low.size)
        as_bound = (number >= m) & finite & ~equal
        self.equal = np.flatnonzero(equal)
        self.bounds = np.flatnonzero(as_bound)
        self.rows = np.flatnonzero(~equal & ~as_bound)
        # Bounds come before rows, as in HPIPM.
        self.sides = np.concatenate([self.bounds, self.rows])
        self.b = np.empty(self.equal.size)
        self.low, self.high = np.empty(self.sides.size), np.empty(self.sides.size)
        self.infinite = [np.flatnonzero(np.isinf(limit[self.sides])) for limit in (low, high)]

    def fill(self, low: Vector, high: Vector) -> None:
        """Gather the limits of a step; a side that is masked out still has to be a number."""
        low.take(self.sides, out=self.low)
        high.take(self.sides, out=self.high)
        for limit, infinite in zip((self.low, self.high), self.infinite, strict=True):
            if infinite.size:
                limit[infinite] = 0.0
        if self.b.size:
            high.take(self.equal, out=self.b)

    def masks(self) -> list[Vector]:
        """1 for each lower and upper side of the general rows that exists, 0 for the others."""
        masks = [np.ones(self.sides.size) for _ in range(2)]
        for mask, infinite in zip(masks, self.infinite, strict=True):
            mask[infinite] = 0.0
        return [mask[self.bounds.size :].copy() for mask in masks]


def pattern(low: Vector, high: Vector) -> bytes:
    """Equal for limits of the same equal and infinite entries."""
    parts: tuple[NDArray[np.bool_], ...] = (low == high, low == -np.inf, high == np.inf)
    return b"".join(part.tobytes() for part in parts)
