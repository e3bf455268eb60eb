"""HPIPM through ctypes, on the library in the casadi wheel: two-sided, start primal.

`HpipmWorkspace` is common to its dense solver, here, and the one by stages, in `hpipm_ocp`. HPIPM
takes an infinite side as one that is masked out, and l = u as an equality of its own.
"""

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, NativeAdapter
from dpbench.solvers.contract import (
    INFEASIBLE_CALLED_ERROR,
    Options,
    Policy,
    RouteRecord,
    SolverRecord,
    make_project_facts,
    make_tolerance_presets,
)
from dpbench.solvers.libraries.hpipm_library import (
    INTEGERS,
    HpipmStructures,
    load_hpipm,
    make_c_pointer_to_array,
)
from dpbench.solvers.libraries.native_workspace import (
    NativeWorkspace,
    Point,
    append_identity_rows_for_bounds,
)
from dpbench.solvers.one_sided import LimitSides

TOLERANCE_NAMES = ("tol_stat", "tol_eq", "tol_ineq", "tol_comp")
OPTION_NAMES = ("mode", "mu0", *TOLERANCE_NAMES, "reg_prim", "alpha_min", *INTEGERS[:3])
"""Settings that both interfaces have."""
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
    levels=make_tolerance_presets(*TOLERANCE_NAMES, iter_max=200, always={"kkt_fact_alg": 0}),
    project=make_project_facts(
        licence=("BSD-2-Clause", "HPIPM source, head of each file"),
        language=("C, on BLASFEO", "HPIPM reference guide, Introduction"),
        c_code=(
            "yes (the solver's own source code)",
            "HPIPM reference guide, Introduction",
        ),
        allocation_free=(
            "yes, memory comes from the caller",
            "HPIPM source, *_memsize and *_create",
        ),
        single_precision=("yes, routines s_*", "HPIPM source, s_dense_qp_ipm"),
    ),
    iteration_limit="iter_max",
    build=lambda: load_hpipm().build,
    known_failures={
        Status.NUMERICAL_ERROR: INFEASIBLE_CALLED_ERROR,
        Status.MAX_ITERATIONS: "of 38 feasible QPs of `thrusters_move` 60/10 one ended so with a "
        "cold start and eight with a warm one, at default settings (casadi 3.8.2)",
    },
)


class HpipmWorkspace(NativeWorkspace):
    """Base of HPIPM's dense and stage-wise solvers, which treat limits of rows and bounds alike."""

    _parts: HpipmStructures
    _pattern: bytes | None = None

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        super().__init__(record, policy, options)
        self._library = load_hpipm().functions

    @abstractmethod
    def _send_cost_and_limits_to_hpipm(self, q: Vector) -> None:
        """Pass the linear cost q and the stored limits to HPIPM."""

    @abstractmethod
    def _write_shifted_answer_as_start(self) -> None:
        """Write the previous answer, shifted by a control increment, as HPIPM's start."""

    def _prepare_matrices_for_library(self) -> None:
        """Allocate and store limits of rows and bounds together, (m + n,)."""
        self._low, self._high = self._allocate_limits_of_rows_and_bounds()

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Pass q, limits and warm start on; make new structures if other limits are infinite."""
        if LimitSides.encode_equal_and_infinite_limits(low, high) != self._pattern:
            self._create_library_solver_for_step(q, low, high)
            return
        m = self._m
        self._low[:m], self._high[:m] = low, high
        self._send_cost_and_limits_to_hpipm(q)
        if self._warm:
            given = self._start.shift_stored_answer_if_any()
            if given:
                self._write_shifted_answer_as_start()
            self._parts.select_warm_start(given)

    def _call_library_solve(self) -> None:
        """Call HPIPM's solve function."""
        self._parts.run_hpipm()

    def _read_status_iterations_and_time(self) -> Claim:
        """Return HPIPM's status and iterations."""
        return self._parts.read_status_and_iterations()


class DenseLimits:
    """Limits of rows and variables grouped as HPIPM takes them: equalities, bounds, general rows.

    The wheel's HPIPM reads an index it never set when the lower side of a bound is masked out, so a
    bound with an infinite side goes as a general row.
    """

    def __init__(self, low: Vector, high: Vector, m: int) -> None:
        equal = low == high
        as_bound = (np.arange(low.size) >= m) & np.isfinite(low) & np.isfinite(high) & ~equal
        self.equal = np.flatnonzero(equal)
        self.bounds = np.flatnonzero(as_bound)
        self.rows = np.flatnonzero(~equal & ~as_bound)
        # Bounds come before rows, as in HPIPM.
        self.sides = np.concatenate([self.bounds, self.rows])
        self.b = np.empty(self.equal.size)
        self.low, self.high = np.empty(self.sides.size), np.empty(self.sides.size)
        self.infinite = [np.flatnonzero(np.isinf(limit[self.sides])) for limit in (low, high)]

    def fill_from_step_limits(self, low: Vector, high: Vector) -> None:
        """Copy a step's limits into the arrays of equalities, bounds and rows, 0 where infinite."""
        low.take(self.sides, out=self.low)
        high.take(self.sides, out=self.high)
        for limit, infinite in zip((self.low, self.high), self.infinite, strict=True):
            if infinite.size:
                limit[infinite] = 0.0
        if self.b.size:
            high.take(self.equal, out=self.b)

    def list_masks_of_finite_sides(self) -> list[Vector]:
        """Return which lower and which upper limits of general rows are finite, as 1 or 0."""
        masks = [np.ones(self.sides.size) for _ in range(2)]
        for mask, infinite in zip(masks, self.infinite, strict=True):
            mask[infinite] = 0.0
        return [mask[self.bounds.size :].copy() for mask in masks]


class DenseWorkspace(HpipmWorkspace):
    """HPIPM's dense QP solver with bounds, two-sided general rows and equalities."""

    def _prepare_matrices_for_library(self) -> None:
        """Allocate and store the limits and stacked A and I, so that bounds can be rows."""
        super()._prepare_matrices_for_library()
        self._rows = append_identity_rows_for_bounds(self._A, self._n)

    def _create_library_solver(self) -> None:
        """Store new structures of HPIPM's dense solver with all data written into them."""
        n, m, library = self._n, self._m, self._library
        self._low[:m], self._high[:m] = self._l, self._u
        self._pattern = LimitSides.encode_equal_and_infinite_limits(self._l, self._u)
        limits = self._limits = DenseLimits(self._low, self._high, m)
        sizes = (n, limits.equal.size, limits.bounds.size, limits.rows.size, 0)
        self._parts = parts = HpipmStructures(library, "dense_qp", sizes, self._options)
        lower, upper = limits.list_masks_of_finite_sides()
        constants: dict[str, NDArray[Any]] = {
            "H": self._P,
            "A": np.asfortranarray(self._rows[limits.equal]),
            "C": np.asfortranarray(self._rows[limits.rows]),
            "idxb": (limits.bounds - m).astype(np.intc),
            "lg_mask": lower,
            "ug_mask": upper,
        }
        for name, array in constants.items():
            parts.look_up_hpipm_function(f"set_{name}")(make_c_pointer_to_array(array), parts.qp)
        self._allocate_hpipm_buffers(limits)
        self._send_cost_and_limits_to_hpipm(self._q)

    def _allocate_hpipm_buffers(self, limits: DenseLimits) -> None:
        """Store arrays for vectors, limits, answers, and HPIPM's functions that access them."""
        n_bounds = limits.bounds.size
        self._g, self._z = np.empty(self._n), np.empty(self._n)
        self._pi = np.empty(limits.equal.size)
        self._lower, self._upper = np.empty_like(limits.low), np.empty_like(limits.high)
        inputs, outputs = {"g": self._g, "b": limits.b}, {"v": self._z, "pi": self._pi}
        for side, limit, dual in (
            ("l", limits.low, self._lower),
            ("u", limits.high, self._upper),
        ):
            inputs |= {f"{side}b": limit[:n_bounds], f"{side}g": limit[n_bounds:]}
            outputs |= {f"lam_{side}b": dual[:n_bounds], f"lam_{side}g": dual[n_bounds:]}
        self._setters = self._parts.pair_arrays_with_hpipm_functions("set", inputs)
        self._getters = self._parts.pair_arrays_with_hpipm_functions("sol_get", outputs)

    def _send_cost_and_limits_to_hpipm(self, q: Vector) -> None:
        """Pass the linear cost and limits to HPIPM's dense QP."""
        self._g[:] = q
        self._limits.fill_from_step_limits(self._low, self._high)
        qp = self._parts.qp
        for function, address in self._setters:
            function(address, qp)

    def _write_shifted_answer_as_start(self) -> None:
        """Pass the previous solution to HPIPM as the start."""
        self._library.d_dense_qp_sol_set_v(make_c_pointer_to_array(self._start.z), self._parts.sol)

    def _copy_solution_and_multipliers(self) -> Point:
        """Return solution and multipliers of HPIPM's dense QP."""
        m, sol = self._m, self._parts.sol
        for function, address in self._getters:
            function(sol, address)
        y, limits = np.zeros(m + self._n), self._limits
        y[limits.sides] = self._upper - self._lower
        if limits.equal.size:
            y[limits.equal] = -self._pi
        return self._z.copy(), y[:m], y[m:]


NATIVE = NativeAdapter(RECORD, DenseWorkspace, lambda: (*OPTION_NAMES, "kkt_fact_alg"))
