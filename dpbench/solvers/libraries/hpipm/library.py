"""What HPIPM's C interface works on: its library, its structures, the limits in its order."""

from __future__ import annotations

import ctypes
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim
from dpbench.solvers.contract import Options
from dpbench.solvers.record import Build

MODES = ("SPEED_ABS", "SPEED", "BALANCE", "ROBUST")
TOLERANCE_NAMES = ("tol_stat", "tol_eq", "tol_ineq", "tol_comp")
REALS = ("mu0", *TOLERANCE_NAMES, "reg_prim", "alpha_min")
INTEGERS = ("iter_max", "pred_corr", "cond_pred_corr", "kkt_fact_alg", "ric_alg")
OPTION_NAMES = ("mode", *REALS, *INTEGERS[:3])
"""Settings that both interfaces have."""


STATUS = {
    0: Status.SOLVED,
    1: Status.MAX_ITERATIONS,
    2: Status.NUMERICAL_ERROR,  # step length at its minimum
    3: Status.NUMERICAL_ERROR,  # NaN in the solution
    4: Status.PRIMAL_INFEASIBLE,  # inconsistent equalities
}


TEXT_BYTES = 256
"""More than BLASFEO writes: names of four vector instructions at most."""


def load_library() -> ctypes.CDLL:
    """HPIPM's library of the casadi wheel."""
    # Whoever loads libhpipm needs libblasfeo first. Its names stay its own: PIQP's factorisation by
    # stages brings another BLASFEO of the same names, and would call this one and corrupt memory.
    _load_blasfeo()
    return ctypes.CDLL(str(_folder() / "libhpipm.so"))


def _folder() -> Path:
    return Path(str(import_module("casadi").__file__)).parent


def _load_blasfeo() -> ctypes.CDLL:
    return ctypes.CDLL(str(_folder() / "libblasfeo.so"))


def blasfeo_build() -> Build:
    """Read the vector instructions that HPIPM's linear algebra was compiled for.

    Every target of BLASFEO but the generic one needs some.
    """
    return build_of(_load_blasfeo())


def build_of(library: Any) -> Build:
    """Read the build of a BLASFEO that is loaded; one that does not say is not called anything."""
    if not hasattr(library, "blasfeo_processor_library_features"):
        return Build()
    features, text = ctypes.c_int(), ctypes.create_string_buffer(TEXT_BYTES)
    library.blasfeo_processor_library_features(ctypes.byref(features))
    if features.value == 0:
        return Build("BLASFEO generic", generic=True)
    library.blasfeo_processor_library_string(text)
    return Build(f"BLASFEO {' '.join(text.value.decode('ascii').split())}")


class Structures:
    """HPIPM's structures of one problem size, and the memory behind them.

    Parameters
    ----------
    kind : "dense_qp" or "ocp_qp".
    sizes : what `dim_set_all` takes; options : settings by name.
    stages : what the structure of the sizes is made of: nothing, or the number of the last stage.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        kind: str,
        sizes: tuple[Any, ...],
        options: Options,
        *stages: int,
    ) -> None:
        self._library, self._kind = library, f"d_{kind}"
        self._memory: list[Any] = []
        self.dim = self._make("_dim", *stages)
        self.function("dim_set_all")(*sizes, self.dim)
        self.qp = self._make("", self.dim)
        self.sol = self._make("_sol", self.dim)
        self.arg = self._make("_ipm_arg", self.dim)
        self._set_arguments(dict(options))
        # Its size depends on the arguments.
        self.ws = self._make("_ipm_ws", self.dim, self.arg)
        self._solve = self.function("ipm_solve")
        self._set_warm_start = self.function("ipm_arg_set_warm_start")
        self._warm_flags = [ctypes.byref(ctypes.c_int(flag)) for flag in (0, 1)]
        self._flag, self._count = ctypes.c_int(), ctypes.c_int()
        self._asked = [
            (self.function("ipm_get_status"), ctypes.byref(self._flag)),
            (self.function("ipm_get_iter"), ctypes.byref(self._count)),
        ]

    def function(self, name: str) -> Any:
        """Look up a function of the library for this kind of problem."""
        return getattr(self._library, f"{self._kind}_{name}")

    def calls(self, verb: str, arrays: dict[str, Vector]) -> list[tuple[Any, Any]]:
        """Return the function and the address of each array that is not empty, to set or get it."""
        named = [(name, array) for name, array in arrays.items() if array.size]
        return [(self.function(f"{verb}_{name}"), pointer(array)) for name, array in named]

    def start_warm(self, given: bool) -> None:
        """Whether the next solve begins with what is in `sol`."""
        self._set_warm_start(self._warm_flags[given], self.arg)

    def solve(self) -> None:
        """Solve `qp` into `sol`."""
        self._solve(self.qp, self.sol, self.arg, self.ws)

    def outcome(self) -> Claim:
        """Read HPIPM's claim about the last solve."""
        for function, target in self._asked:
            function(self.ws, target)
        flag = self._flag.value
        return STATUS.get(flag, Status.UNKNOWN), self._count.value, -1, f"status {flag}"

    def _set_arguments(self, options: dict[str, Any]) -> None:
        mode = MODES.index(str(options.pop("mode", "SPEED")))
        self.function("ipm_arg_set_default")(mode, self.arg)
        for name, value in options.items():
            number: Any = ctypes.c_int if name in INTEGERS else ctypes.c_double
            self.function(f"ipm_arg_set_{name}")(ctypes.byref(number(value)), self.arg)

    def _make(self, kind: str, *parts: Any) -> Any:
        library, prefix = self._library, f"{self._kind}{kind}"
        sizes = [getattr(library, f"{prefix}_{name}") for name in ("strsize", "memsize")]
        for function in sizes:
            function.restype = ctypes.c_size_t
        structure = ctypes.create_string_buffer(sizes[0]())
        memory = ctypes.create_string_buffer(sizes[1](*parts))
        self._memory += [structure, memory]
        getattr(library, f"{prefix}_create")(*parts, structure, memory)
        return structure


def pointer(array: NDArray[Any]) -> Any:
    """Return the address of an array, for a C function."""
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
