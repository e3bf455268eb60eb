"""HPIPM's solver for optimal control through ctypes: a Riccati recursion over the stages.

    minimise    Σ ½ [u; x]ᵀ [R S; Sᵀ Q] [u; x] + [r; q]ᵀ [u; x]               of each stage
    subject to  x_{k+1} = A_k x_k + B_k u_k + b_k
                lb ≤ [u; x] ≤ ub,  lg ≤ C x + D u ≤ ug

The stages are those of `QuadraticProgram.stages`; a QP without any is solved as a single stage.
HPIPM condenses blocks of them into one stage each before it solves (partial condensing). The time
of a step grows with the number of stages, that of the dense solver with its cube.

Vectors of all stages are in one array each, so that a step gathers them at once, and only those of
the stages in which something has changed are handed over.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Indices, Matrix, Vector
from dpbench.errors import SettingsError
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import NativeAdapter
from dpbench.solvers.contract import (
    INFEASIBLE_CALLED_ERROR,
    Options,
    Policy,
    SolverRecord,
    make_tolerance_presets,
)
from dpbench.solvers.libraries import hpipm
from dpbench.solvers.libraries.hpipm import HpipmWorkspace
from dpbench.solvers.libraries.hpipm_library import (
    CondensedStructures,
    HpipmStructures,
    make_c_pointer_to_array,
)
from dpbench.solvers.libraries.native_workspace import Point
from dpbench.solvers.one_sided import LimitSides

BLOCK_SIZE = "cond_block_size"
"""Setting: stages with inputs that are condensed into one; named as in acados."""
RECORD = replace(
    hpipm.RECORD,
    name="hpipm_ocp",
    method="primal-dual interior point, factorised stage by stage",
    form="csc",
    # The fastest or within a tenth of it at every horizon that was tried (docs/guide/settings.md).
    levels=make_tolerance_presets(*hpipm.TOLERANCE_NAMES, iter_max=200, always={BLOCK_SIZE: 5}),
    known_failures={Status.NUMERICAL_ERROR: INFEASIBLE_CALLED_ERROR},
)
NOTHING: Indices = np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Stage:
    """Variables and rows of a QP that belong to one stage of its optimal control problem.

    inputs, states : its variables.
    dynamics : for each state, the row that defines it; none in stage 0.
    rows : the other rows, which have variables of this stage only.
    """

    inputs: Indices
    states: Indices
    dynamics: Indices
    rows: Indices

    @property
    def variable_indices(self) -> Indices:
        """Indices in the QP of the stage's variables: inputs, then states."""
        return np.concatenate([self.inputs, self.states])


def split_qp_into_stages(
    sizes: Sequence[tuple[int, int]], P: Matrix, A: Matrix, equal: Flags
) -> list[Stage]:
    """Return a QP's stages as of an optimal control problem; one stage if that is not possible.

    A row with l = u that ends in a state, as the first one to do so, defines this state by the
    stage before. The cost and all other rows couple variables of one stage only.

    sizes : (states, inputs) of each stage, in the order of the variables; no state in the first.
    P : (n, n) symmetric cost; A : (m, n) rows; equal : (m,) which rows have l = u.
    """
    m, n = A.shape
    single = [Stage(np.arange(n), NOTHING, NOTHING, np.arange(m))]
    if not sizes or sizes[0][0] or sum(map(sum, sizes)) != n:
        return single
    stage_of = np.repeat(np.arange(len(sizes)), [sum(size) for size in sizes])
    is_state = np.concatenate([np.arange(x + u) < x for x, u in sizes])
    used = A != 0.0
    last = np.where(used.any(axis=1), n - 1 - used[:, ::-1].argmax(axis=1), 0)
    defining = np.full(n, -1, dtype=np.intp)
    candidates = np.flatnonzero(equal & is_state[last])[::-1]
    defining[last[candidates]] = candidates
    dynamics, of_row = defining[is_state], stage_of[last]
    if (dynamics < 0).any():
        return single
    allowed = of_row[:, np.newaxis] == stage_of
    allowed[dynamics] = of_row[dynamics, np.newaxis] == stage_of + 1
    allowed[dynamics, last[dynamics]] = True
    if (used & ~allowed).any() or P[stage_of[:, np.newaxis] != stage_of].any():
        return single
    of_row[dynamics] = -1
    stages = []
    for k in range(len(sizes)):
        here = np.flatnonzero(stage_of == k)
        states = here[is_state[here]]
        rows = np.flatnonzero(of_row == k)
        stages.append(Stage(here[~is_state[here]], states, defining[states], rows))
    return stages


def select_limit_rows(A: Matrix, numbers: Indices) -> Matrix:
    """Return rows of [A; I] by number: those of A, or of the identity for a variable's bounds."""
    m, n = A.shape
    rows, own = np.zeros((numbers.size, n)), numbers >= m
    rows[~own] = A[numbers[~own]]
    rows[own, numbers[own] - m] = 1.0
    return rows


def group_stages_into_blocks(stages: list[Stage], size: int) -> tuple[list[Stage], list[int]]:
    """Return the stages and the number of them in each block that is condensed into one stage.

    A block has `size` stages with inputs; those without inputs join the block before, which makes
    it no larger. Size 1 condenses nothing. An empty stage follows a block that is the only one.
    """
    counts: list[int] = []
    moves = 0
    for stage in stages:
        moved = stage.inputs.size > 0
        if not counts or size == 1 or (moved and moves == size):
            counts.append(0)
            moves = 0
        counts[-1] += 1
        moves += moved
    if len(counts) > 1:
        return stages, counts
    # HPIPM's recursion is wrong where there is no step from a stage to another.
    return [*stages, Stage(NOTHING, NOTHING, NOTHING, NOTHING)], [*counts, 1]


class StageLimits:
    """Limits of one stage for HPIPM, split into bounds on variables and general rows.

    A row that is one variable itself is a bound of it, if it has no other. A limit without any
    finite side is none; one infinite side is masked out, which this interface of HPIPM bears in
    bounds too.
    """

    def __init__(self, stage: Stage, A: Matrix, low: Vector, high: Vector) -> None:
        numbers = np.concatenate([stage.rows, A.shape[0] + stage.variable_indices])
        numbers = numbers[~((low[numbers] == -np.inf) & (high[numbers] == np.inf))]
        rows = select_limit_rows(A, numbers)
        single = (np.count_nonzero(rows, axis=1) == 1) & (rows.sum(axis=1) == 1.0)
        candidates = np.flatnonzero(single)[::-1]
        bound_of: dict[int, int] = {}
        # Bounds of the variables stand behind the rows and come first here.
        for variable, number in zip(
            rows[candidates].argmax(axis=1), numbers[candidates], strict=True
        ):
            bound_of.setdefault(int(variable), int(number))
        bounded = [i for i, v in enumerate(stage.variable_indices.tolist()) if v in bound_of]
        self.positions = np.array(bounded, dtype=np.intc)
        self.bounds: Indices = np.array(
            [bound_of[v] for v in stage.variable_indices[bounded].tolist()], dtype=np.intp
        )
        self.rows: Indices = np.setdiff1d(numbers, self.bounds)

    @property
    def limit_row_numbers(self) -> Indices:
        """Numbers of the stage's limits as rows of [A; I]: bounds, then general rows."""
        return np.concatenate([self.bounds, self.rows])

    def make_masks_of_finite_sides(self, low: Vector, high: Vector) -> dict[str, Vector]:
        """Return 1 for finite and 0 for infinite limits, by HPIPM's names; only with a 0."""
        # A NaN is a limit like any other.
        masks = {
            f"{side}{kind}_mask": 1.0 - np.isinf(limit[numbers])
            for side, limit in (("l", low), ("u", high))
            for kind, numbers in (("b", self.bounds), ("g", self.rows))
        }
        return {name: mask for name, mask in masks.items() if not mask.all()}


class StageData:
    """A QP's matrices stage by stage for HPIPM, and the order of variables, dynamics and limits.

    stages : as found; P : cost; A : rows; low, high : limits of [A; I].
    order : the variables, dynamics : their defining rows, sides : the limits, stage by stage.
    pivots : what the variable that a row of `dynamics` defines is multiplied with.
    """

    def __init__(
        self, stages: list[Stage], P: Matrix, A: Matrix, low: Vector, high: Vector
    ) -> None:
        self.stages = stages
        self.limits = [StageLimits(stage, A, low, high) for stage in stages]
        self.order = np.concatenate([stage.variable_indices for stage in stages])
        self.dynamics = np.concatenate([stage.dynamics for stage in stages])
        self.sides = np.concatenate([limits.limit_row_numbers for limits in self.limits])
        states = np.concatenate([stage.states for stage in stages])
        self.pivots: Vector = A[self.dynamics, states]
        self.matrices = [
            self._make_stage_matrices_by_hpipm_name(k, P, A) for k in range(len(stages))
        ]

    def _make_stage_matrices_by_hpipm_name(
        self, k: int, P: Matrix, A: Matrix
    ) -> dict[str, NDArray[Any]]:
        """Return the cost and constraint matrices of stage k by HPIPM's names."""
        stage, limits = self.stages[k], self.limits[k]
        u, x, general = stage.inputs, stage.states, select_limit_rows(A, limits.rows)
        matrices: dict[str, NDArray[Any]] = {
            "R": P[np.ix_(u, u)],
            "Q": P[np.ix_(x, x)],
            "S": P[np.ix_(u, x)],
            "C": general[:, x],
            "D": general[:, u],
        }
        if k + 1 < len(self.stages):
            after = self.stages[k + 1]
            defining = A[after.dynamics]
            factor = -defining[np.arange(after.states.size), after.states][:, None]
            matrices |= {"A": defining[:, x] / factor, "B": defining[:, u] / factor}
        matrices = {name: np.asfortranarray(matrix) for name, matrix in matrices.items()}
        return matrices | {"idxb": limits.positions}

    @property
    def size_arrays_for_hpipm(self) -> list[NDArray[np.intc]]:
        """Numbers of states, inputs, bounds and rows in each stage, as arrays for HPIPM."""
        inputs = np.array([stage.inputs.size for stage in self.stages])
        on_inputs = [
            np.count_nonzero(limits.positions < n)
            for limits, n in zip(self.limits, inputs, strict=True)
        ]
        sizes = (
            [stage.states.size for stage in self.stages],
            inputs,
            [a.positions.size - n for a, n in zip(self.limits, on_inputs, strict=True)],
            on_inputs,
            [limits.rows.size for limits in self.limits],
            np.zeros(inputs.size),
        )
        return [np.array(size, dtype=np.intc) for size in sizes]


class StagedVector:
    """A vector over all stages, passed to HPIPM only for stages in which it has changed.

    calls : for each stage, the setters and how many entries of the vector each takes in turn.
    """

    def __init__(self, parts: HpipmStructures, calls: list[list[tuple[str, int]]]) -> None:
        sizes = [sum(size for _, size in stage) for stage in calls]
        self.values = np.zeros(sum(sizes))
        self._new = np.empty_like(self.values)
        self._changed = np.empty(self.values.shape, dtype=np.bool_)
        self._stage_of = np.repeat(np.arange(len(calls)), sizes)
        self._qp = parts.qp
        self._calls: list[list[tuple[Any, Any]]] = []
        at = 0
        for stage in calls:
            self._calls.append([])
            for name, size in stage:
                if size:
                    address = make_c_pointer_to_array(self.values[at : at + size])
                    self._calls[-1].append((parts.look_up_hpipm_function(f"set_{name}"), address))
                at += size

    def gather_entries_in_stage_order(self, source: Vector, numbers: Indices) -> Vector:
        """Store and return entries of a QP vector in stage order, to be sent to HPIPM later."""
        return source.take(numbers, out=self._new)

    def send_gathered_entries_to_hpipm(self, everything: bool = False) -> None:
        """Pass the selected entries to HPIPM, for stages where they changed or for all."""
        changed = np.not_equal(self._new, self.values, out=self._changed)
        if not (everything or changed.any()):
            return
        self.values[:] = self._new
        for k in set(self._stage_of.tolist() if everything else self._stage_of[changed].tolist()):
            for function, address in self._calls[k]:
                function(k, address, self._qp)


def list_addresses_of_array_pieces(array: Vector, sizes: Iterable[int]) -> NDArray[np.uintp]:
    """Return the memory addresses of consecutive pieces of an array, given their sizes."""
    first = np.concatenate([[0], np.cumsum(list(sizes), dtype=np.intp)[:-1]])
    return (array.ctypes.data + array.itemsize * first).astype(np.uintp)


class OcpWorkspace(HpipmWorkspace):
    """HPIPM's stage-wise optimal control solver, for a QP in which stages are found."""

    def __init__(self, record: SolverRecord, policy: Policy, options: Options) -> None:
        options = dict(options)
        size = options.pop(BLOCK_SIZE)
        if not (isinstance(size, int) and size >= 1):
            where = f"settings of {record.name}"
            raise SettingsError(where, BLOCK_SIZE, repr(size)[:80], "a whole number of 1 or more")
        super().__init__(record, policy, options)
        self._block_size = size

    def _prepare_matrices_for_library(self) -> None:
        """Allocate and store the limits; have the stages of the QP found again."""
        super()._prepare_matrices_for_library()
        self._pattern = None

    def _create_library_solver(self) -> None:
        """Store new structures of HPIPM's OCP solver with the data of all stages."""
        m = self._m
        self._low[:m], self._high[:m] = self._l, self._u
        pattern = LimitSides.encode_equal_and_infinite_limits(self._l, self._u)
        if pattern != self._pattern:
            self._pattern = pattern
            stages = split_qp_into_stages(self._stages, self._P, self._A, self._l == self._u)
            stages, self._counts = group_stages_into_blocks(stages, self._block_size)
            self._data = StageData(stages, self._P, self._A, self._low, self._high)
        data = self._data
        sizes = tuple(map(make_c_pointer_to_array, data.size_arrays_for_hpipm))
        counts, last = self._counts, len(data.stages) - 1
        self._parts = parts = (
            CondensedStructures(self._library, sizes, self._options, counts)
            if len(counts) <= last
            else HpipmStructures(self._library, "ocp_qp", sizes, self._options, last)
        )
        for k, matrices in enumerate(data.matrices):
            for name, array in matrices.items():
                if array.size:
                    parts.look_up_hpipm_function(f"set_{name}")(
                        k, make_c_pointer_to_array(array), parts.qp
                    )
        self._mask_infinite_sides()
        self._allocate_hpipm_buffers()
        self._send_cost_and_limits_to_hpipm(self._q, everything=True)

    def _mask_infinite_sides(self) -> None:
        """Have HPIPM ignore infinite limits, which it cannot take as numbers."""
        sides, parts = self._data.sides, self._parts
        self._infinite = [np.flatnonzero(np.isinf(a[sides])) for a in (self._low, self._high)]
        for k, limits in enumerate(self._data.limits):
            for name, mask in limits.make_masks_of_finite_sides(self._low, self._high).items():
                parts.look_up_hpipm_function(f"set_{name}")(
                    k, make_c_pointer_to_array(mask), parts.qp
                )

    def _allocate_hpipm_buffers(self) -> None:
        """Allocate and store arrays for vectors, limits and answers of all stages."""
        nx, nu, nbx, nbu, ng, _ = self._data.size_arrays_for_hpipm
        nb, parts = nbx + nbu, self._parts
        by_stage = list(zip(nu.tolist(), nx.tolist(), nb.tolist(), ng.tolist(), strict=True))
        self._cost = StagedVector(parts, [[("r", u), ("q", x)] for u, x, _, _ in by_stage])
        self._b = StagedVector(parts, [[("b", x)] for x in nx[1:].tolist()])
        self._limits = (
            StagedVector(parts, [[("lb", b), ("lg", g)] for _, _, b, g in by_stage]),
            StagedVector(parts, [[("ub", b), ("ug", g)] for _, _, b, g in by_stage]),
        )
        data = self._data
        self._z, self._pi = np.empty(self._n), np.empty(data.dynamics.size)
        self._lower, self._upper = np.empty(data.sides.size), np.empty(data.sides.size)
        variables = np.stack([nu, nx], axis=1).reshape(-1)
        limits = np.stack([nb, ng], axis=1).reshape(-1)
        at_z = list_addresses_of_array_pieces(self._z, variables).reshape(-1, 2)
        at_lower = list_addresses_of_array_pieces(self._lower, limits).reshape(-1, 2)
        at_upper = list_addresses_of_array_pieces(self._upper, limits).reshape(-1, 2)
        none = np.zeros(nx.size, dtype=np.uintp)
        at_pi = list_addresses_of_array_pieces(self._pi, nx[1:])
        tables = [*at_z.T, none, none, at_pi]
        tables += [at_lower[:, 0], at_upper[:, 0], at_lower[:, 1], at_upper[:, 1], none, none]
        self._tables = [np.ascontiguousarray(table) for table in tables]
        self._pieces = [make_c_pointer_to_array(table) for table in self._tables]
        self._get, self._set = (
            parts.look_up_hpipm_function("sol_get_all"),
            parts.look_up_hpipm_function("sol_set_all"),
        )

    def _send_cost_and_limits_to_hpipm(self, q: Vector, everything: bool = False) -> None:
        """Pass cost, dynamics and limits to HPIPM: only what changed, or `everything`."""
        data = self._data
        self._cost.gather_entries_in_stage_order(q, data.order)
        b = self._b.gather_entries_in_stage_order(self._high, data.dynamics)
        b /= data.pivots
        both = zip(self._limits, (self._low, self._high), self._infinite, strict=True)
        for part, limits, infinite in both:
            gathered = part.gather_entries_in_stage_order(limits, data.sides)
            if infinite.size:
                gathered[infinite] = 0.0
        for part in (self._cost, self._b, *self._limits):
            part.send_gathered_entries_to_hpipm(everything)

    def _write_shifted_answer_as_start(self) -> None:
        """Write the previous z, shifted by a control increment, as HPIPM's start."""
        self._start.z.take(self._data.order, out=self._z)
        self._set(*self._pieces, self._parts.sol)

    def _copy_solution_and_multipliers(self) -> Point:
        """Return solution and multipliers of all stages in the order of the QP."""
        data, m = self._data, self._m
        self._get(self._parts.sol, *self._pieces)
        z, y = np.empty(self._n), np.zeros(m + self._n)
        z[data.order] = self._z
        y[data.sides] = self._upper - self._lower
        y[data.dynamics] = -self._pi / data.pivots
        return z, y[:m], y[m:]


NATIVE = NativeAdapter(RECORD, OcpWorkspace, lambda: (*hpipm.OPTION_NAMES, "ric_alg", BLOCK_SIZE))
