"""The C library of dpbench's own solvers: where it is, and how it is called.

An installation has it beside this file; in a checkout `python hatch_build.py` or its first use
compiles it.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.errors import SolverUnavailableError
from dpbench.solvers.own.compiling import compile_own_library_if_missing

REAL, INTEGER, POINTER = ctypes.c_double, ctypes.c_int, ctypes.c_void_p
_FUNCTIONS = {
    "active_set_place": (None, POINTER, INTEGER, INTEGER, POINTER, POINTER),
    "active_set_factorise": (INTEGER, POINTER, POINTER, POINTER),
    "active_set_replace_rows": (INTEGER, POINTER, POINTER),
    "active_set_solve": (INTEGER, POINTER),
    "active_set_is_proof": (INTEGER, POINTER),
    "hildreth_solve": (INTEGER, POINTER, INTEGER, REAL, REAL, POINTER),
}


def _pair_field_names_with_type(kind: type, names: str) -> list[tuple[str, type]]:
    """Return name and type of each field of one kind of a C structure."""
    return [(name, kind) for name in names.split()]


class View(ctypes.Structure):
    """The structure `active_set_view` of `active_set.h`."""

    _fields_ = [("count_near_equal_crossed", INTEGER * 4), ("rows", INTEGER * 8), ("by", REAL * 8)]


class ActiveSet(ctypes.Structure):
    """The structure `active_set` of `active_set.h`."""

    _fields_ = [
        *_pair_field_names_with_type(INTEGER, "n m count iterations"),
        *_pair_field_names_with_type(
            POINTER, "q low high z lam base L active side R T r e z_low lam_low r_low from to"
        ),
        *_pair_field_names_with_type(
            POINTER, "G unit a column first parent rest order sizes blocks P"
        ),
        *_pair_field_names_with_type(INTEGER, "coupled warm block stale"),
        *_pair_field_names_with_type(REAL, "longest steepest largest widest loss"),
        ("found", View),
        *_pair_field_names_with_type(POINTER, "refine"),
    ]


@cache
def load_own_c_library() -> Any:
    """Return the loaded C library, compiled if missing; SolverUnavailableError where that fails."""
    try:
        library = ctypes.PyDLL(str(compile_own_library_if_missing()))
    except (OSError, RuntimeError) as error:
        raise SolverUnavailableError("dpbench's own solvers", str(error)) from None
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class Problem:
    """A QP of n variables and m rows in the library's memory, its arrays as views.

    P (n, n), A (m, n), q (n,), low, high (n + m,): bounds, then rows; z (n,), lam (n + m,): the
    answer.
    """

    def __init__(self, n: int, m: int) -> None:
        N = n + m
        reals = n * (n + 2 * N) + 5 * N + n * (n + 1) // 2 + 11 * n
        self._reals = np.zeros(reals)
        self._integers = np.zeros(m * n + 3 * m + 1 + 3 * n + N, dtype=np.intc)
        self.head = ActiveSet()
        self.pointer = ctypes.c_void_p(ctypes.addressof(self.head))
        data = (array.ctypes.data for array in (self._reals, self._integers))
        load_own_c_library().active_set_place(self.pointer, n, m, *data)
        vectors = {"q": n, "low": N, "high": N, "z": n, "lam": N}
        views = (self._view(self._reals, name, length) for name, length in vectors.items())
        self.q, self.low, self.high, self.z, self.lam = views
        self.P, self.A = np.zeros((n, n)), np.zeros((m, n))
        self.P_pointer, self.A_pointer = self.P.ctypes.data, self.A.ctypes.data

    def copy_arrays_that_depend_on_matrices(self) -> dict[str, NDArray[Any]]:
        """Return what P and A determine, by the names of the structure's arrays."""
        n, m = self.A.shape[1], self.A.shape[0]
        first, sizes = (
            self._view(self._integers, name, length)
            for name, length in (("first", m + 1), ("sizes", n))
        )
        entries, start, blocks = int(first[-1]), 0, 0
        while start < self.head.coupled:
            blocks += sizes[start] ** 2
            start += sizes[start]
        reals = {"P": n * n, "G": (n + m) * n, "unit": n + m, "a": entries, "blocks": blocks}
        integers = {"column": entries, "first": m + 1, "parent": m, "rest": m}
        integers |= {"order": n, "sizes": n}
        memories = (self._reals, reals), (self._integers, integers)
        return {
            name: self._view(memory, name, length)
            for memory, lengths in memories
            for name, length in lengths.items()
        }

    def _view(self, memory: NDArray[Any], name: str, length: int) -> NDArray[Any]:
        """Return numbers that a field of the C structure points to, sharing their memory."""
        start = (getattr(self.head, name) - memory.ctypes.data) // memory.itemsize
        return memory[start : start + length]
