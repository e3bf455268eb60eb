"""The reference loop: the referee's certified optimum controls the ship.

Every solver's deviation from it is a metric, and the QPs along it are the sequences for replay.
Its station keeping is what the controller does, whatever the solver.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Matrix, Vector
from dpbench.bench.record.cell import DEFAULT_FALLBACK
from dpbench.bench.record.npz import open_arrays, write_arrays_uncompressed
from dpbench.bench.record.raw_log import RawLog, make_loop_layout
from dpbench.bench.run.closed_loop import ClosedLoopSetup, record_closed_loop
from dpbench.bench.run.formulation import BoxFormulation, Case, QPBuilder
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.errors import CertificateError, InputError, ResultsError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram, SparseEquivalent, Units
from dpbench.qp.referee.optimum import ACTIVE_MULTIPLIER, Kind, Optimum
from dpbench.qp.referee.referee import Referee, get_shared_referee
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.plants.contract import PlantMaker
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario, resolve_to_scenario
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.froude import Froude
from dpbench.ship.layout import POSE
from dpbench.ship.plant import SUBSTEPS
from dpbench.solvers.contract import Workspace

_OF_LOOP = ("theta", "state", "tau", "thrust", "z", "active")
_OF_OPTIMUM = ("z", "y", "y_box", "bound", "kind")
ALLOCATED = "allocated"
"""Prefix of the arrays with the optima of allocations in a stored loop."""
_DRAWN = "drawn_"
Part = Literal["controller", "allocation"]
"""QPs of a loop's controller, or the second ones of a cascade."""
RADIUS_M, HEADING_DEG = 5.0, 5.0
"""Limits of the station at full size: the red limits of the example in IMCA M 220."""
ARRIVAL_S = 30.0
"""Time within the limits, at full size, after which a transfer has ended."""
DRIFT = 1.0
"""Growth of a distance, in multiples of the limits, that is no part of a transfer."""
RISE_S = 10.0
"""Time at the end of a loop, at full size, over which the change of the offset is its trend."""
UNDAMPED_SHARE = 0.9
"""Share of the swing since a loss from which on the swing at the end counts as undamped."""
CAUSED_BY_LOSS = 2.0
"""Factor on the swing before a loss below which the swing after it may be that of the weather."""


StepReport = Callable[[int, int], None]
"""Receiver of the number of steps done, and of all."""


class ExactWorkspace(Workspace):
    """A solver whose answers are certified optima; scaled QPs only.

    report : called after each step with the steps done and with `steps`.
    """

    def __init__(self, report: StepReport | None = None, steps: int = 0) -> None:
        super().__init__("exact", "native", "reuse")
        self._report, self._steps = report, steps
        self._base: QuadraticProgram | None = None
        self._referee: Referee | None = None
        self._step: QPStep | None = None
        self.optima: list[Optimum] = []
        """The optimum of every solved step, in order."""

    def setup(self, qp: QuadraticProgram) -> None:
        """Store the matrices of a QP and prepare certifying its optima."""
        self._base = qp
        matrices = qp.P, qp.A, qp.lb, qp.ub
        self._referee = (
            self._referee.for_changed_matrices(*matrices)
            if self._referee
            else get_shared_referee(*matrices)
        )
        self._step = QPStep(qp.q, qp.l, qp.u)

    def update(self, step: QPStep) -> None:
        """Store a step's QP as the next to solve; set up anew where its matrices have changed."""
        assert self._base is not None, "setup comes first"
        if self._base.changed_by(step):
            self.setup(self._base.at(step))
        self._step = step

    def solve(self) -> None:
        """Find and certify the optimum of the current step's QP, and store it."""
        assert self._referee is not None and self._step is not None, "setup comes first"
        step = self._step
        self.optima.append(self._referee.certify_vectors(step.q, step.l, step.u))
        if self._report is not None:
            self._report(len(self.optima), self._steps)

    def read(self) -> Solution:
        """Return the certified optimum; no answer where infeasible or where nothing is proven."""
        assert self.optima, "solve comes first"
        optimum = self.optima[-1]
        status = Status.SOLVED if np.isfinite(optimum.bound) else Status.PRIMAL_INFEASIBLE
        return Solution(status, optimum.z, optimum.y, optimum.y_box, 0)


@dataclass(frozen=True, eq=False)
class ExactLoop:
    """The reference loop of a scenario: states, forces and certified optima of every step.

    Attributes
    ----------
    theta (K, 16) : [x; y_ref; u_prev; 1]; state (K + 1, 6); tau (K, 3); thrust (K, n_f); z (K, n).
    active : (K,) whether the controller's QP has an active limit, or no feasible point; limits that
        keep a lost thruster at zero do not count.
    optima : certified, of each step in scaled units.
    demand (K, 3), allocated : of a cascade, the demanded force and the optima of its second QPs.
    drawn : what all runs in the same weather share, drawn by the environment.
    """

    theta: Matrix
    state: Matrix
    tau: Matrix
    thrust: Matrix
    z: Matrix
    active: Flags
    optima: list[Optimum]
    demand: Matrix | None = None
    allocated: list[Optimum] = field(default_factory=list)
    drawn: WeatherDraw = field(default_factory=dict)

    def require_certificates(self, name: str) -> None:
        """Raise CertificateError where nothing is proven of a step; `name` is the scenario's."""
        for optima in (self.optima, self.allocated):
            for k, optimum in enumerate(optima):
                if optimum.kind == "none":
                    why = f": {optimum.reason}" if optimum.reason else ""
                    raise CertificateError(f"{name}: step {k} has no certified optimum{why}")

    def save(self, path: Path) -> None:
        """Write the states, forces and certified optima of the loop to a file."""
        arrays: dict[str, NDArray[Any]] = {name: getattr(self, name) for name in _OF_LOOP}
        arrays |= _optima_to_arrays(self.optima, "optimum")
        if self.demand is not None:
            arrays["demand"] = self.demand
        if self.allocated:
            arrays |= _optima_to_arrays(self.allocated, ALLOCATED)
        arrays |= {f"{_DRAWN}{name}": array for name, array in self.drawn.items()}
        write_arrays_uncompressed(path, arrays)

    @classmethod
    def load(cls, path: Path, *, with_optima: bool = True) -> "ExactLoop":
        """Return the reference loop in a file; ResultsError where it is damaged or gone."""
        with open_arrays(path) as stored:
            arrays = {name: stored[name] for name in _OF_LOOP}
            demand, drawn = stored.get("demand"), parse_stored_weather(stored)
            names = ("optimum", ALLOCATED) if with_optima else ()
            optima, second = (
                _arrays_to_optima(stored, name) if name in names and f"{name}_z" in stored else []
                for name in ("optimum", ALLOCATED)
            )
        return cls(**arrays, optima=optima, demand=demand, allocated=second, drawn=drawn)


def parse_stored_weather(stored: Mapping[str, NDArray[Any]]) -> WeatherDraw:
    """Return the precomputed weather in the arrays of a stored loop."""
    names = [name for name in stored if name.startswith(_DRAWN)]
    return {name.removeprefix(_DRAWN): stored[name] for name in names}


def read_allocation_sizes(stored: Mapping[str, NDArray[Any]]) -> tuple[int, int] | None:
    """Return n and m of a stored loop's thrust-allocation QPs; None where it has none."""
    if "demand" not in stored:
        return None
    if f"{ALLOCATED}_z" not in stored:
        return 0, 0
    return stored[f"{ALLOCATED}_z"].shape[1], stored[f"{ALLOCATED}_y"].shape[1]


def _optima_to_arrays(optima: list[Optimum], name: str) -> dict[str, NDArray[Any]]:
    """Return certified optima as arrays over steps, by name with a prefix."""
    return {
        f"{name}_{part}": np.array([getattr(optimum, part) for optimum in optima])
        for part in _OF_OPTIMUM
    }


def _arrays_to_optima(stored: Mapping[str, NDArray[Any]], name: str) -> list[Optimum]:
    """Return the certified optima that are stored as arrays whose names have a prefix."""
    z, y, y_box, bound, kind = (stored[f"{name}_{part}"] for part in _OF_OPTIMUM)
    return [
        Optimum(z[k], y[k], y_box[k], float(bound[k]), cast(Kind, str(kind[k])))
        for k in range(len(z))
    ]


def solve_loop_exactly(
    scenario: Case, report: StepReport | None = None, *, plant: PlantMaker | None = None
) -> ExactLoop:
    """Run a scenario's closed loop with the certified optimum of every step; return its record.

    report : called with the steps done and the steps of the loop, after each.
    plant : makes a custom plant, an instance for this loop, which replaces the ship.

    Where a step has no feasible point, or nothing can be proven, the loop follows its last plan.
    """
    builder = QPBuilder(scenario)
    layout = make_loop_layout(
        scenario.steps, *builder.sizes, states=builder.states, inputs=builder.inputs
    )
    log = RawLog.in_memory(layout)
    base = build_problem_at_rest(builder.condensed)
    workspace, second = ExactWorkspace(report, scenario.steps), ExactWorkspace()
    clock = time.perf_counter_ns
    timed_solver = TimedSolver(workspace, BoxFormulation(base), clock)
    drawn: WeatherDraw = {}
    if isinstance(scenario, Scenario):
        drawn = scenario.environment.draw_wind_and_waves_at_stages(
            scenario.steps, scenario.sample_s, SUBSTEPS
        )
    setup = ClosedLoopSetup(scenario, builder, timed_solver, log, DEFAULT_FALLBACK, 2**62, clock)
    setup.drawn, setup.plant = drawn, plant
    if builder.allocation is not None:
        setup.allocating = TimedSolver(
            second, BoxFormulation(builder.allocation.make_qp_of_zero_demand()), clock
        )
    record_closed_loop(setup)
    active = _mask_steps_with_active_limits(
        base, workspace.optima, _mask_rows_without_force_by_step(builder)
    )
    loop = log.theta, log.state, log.tau, log.thrust, log.z[0], active, workspace.optima
    demand = log.demand if scenario.controller.allocates else None
    return ExactLoop(*loop, demand, second.optima, drawn)


def _mask_rows_without_force_by_step(builder: QPBuilder) -> list[Flags]:
    """Return at each step the rows (m,) of lost thrusters and of axes without any force."""
    condensed, rows = builder.condensed, []
    thrusters = condensed.control.thrusters
    for limits in builder.limits:
        fixed = limits.low == limits.high
        if thrusters is not None:
            fixed |= limits.lost[thrusters.thruster]
        rows.append(condensed.repeat_flags_for_each_move(fixed))
    return rows


def _mask_steps_with_active_limits(
    qp: QuadraticProgram, optima: Sequence[Optimum], without_force: Sequence[Flags]
) -> Flags:
    """Return in which steps (K,) a limit is active, or no feasible point exists.

    The lower bounds of slacks do not count: they are active where a soft limit is not. Nor do rows
    that keep a lost thruster at zero.
    """
    is_move = np.arange(qp.n) % (qp.block or qp.n) < (qp.moves or qp.n)
    return np.array(
        [
            optimum.kind == "infeasible"
            or bool((np.abs(optimum.y[~without]) > ACTIVE_MULTIPLIER).any())
            or bool((np.abs(optimum.y_box[is_move]) > ACTIVE_MULTIPLIER).any())
            for optimum, without in zip(optima, without_force, strict=True)
        ],
        dtype=np.bool_,
    )


def build_problem_at_rest(builder: CondensedQP) -> QuadraticProgram:
    """Return the QP of a ship at rest at its setpoint without force, for a solver's set-up."""
    problem = builder.control
    zero = np.zeros
    step = builder.emit(zero(problem.model.n_x), zero(problem.model.n_y), zero(problem.model.n_u))
    return builder.problem(step)


def rebuild_sequence(
    scenario: Case,
    exact: ExactLoop,
    *,
    units: UnitSystem = "scaled",
    first: int = 0,
    count: int | None = None,
    part: Part = "controller",
) -> QPSequence:
    """Return the MPC QPs of `count` steps from `first` on of a loop already solved exactly."""
    last = len(exact.theta) if count is None else first + count
    if not 0 <= first < last <= len(exact.theta):
        where, allowed = f"sequence of {scenario.name}", f"steps within 0:{len(exact.theta)}"
        raise ResultsError(where, "first, count", f"{first}:{last}", allowed)
    builder, steps = QPBuilder(scenario, units), range(first, last)
    if part == "allocation":
        emitted, base = _rebuild_allocation_steps(scenario, exact, builder, steps)
    else:
        emitted = [builder.rebuild(k, exact.theta[k]) for k in steps]
        base = builder.condensed.problem(emitted[0])
    whole = scenario.name if part == "controller" else f"{scenario.name}-{part}"
    name = whole if first == 0 else f"{whole}[{first}:{last}]"
    scaled, sparse = None, None
    if units != "scaled":
        scaled = rebuild_sequence(scenario, exact, first=first, count=last - first, part=part)
    if part == "controller":
        theta = exact.theta[first:last]
        sparse = partial(_rebuild_sparse_sequence, scenario, theta, units, first, name)
    return QPSequence(
        name=name,
        base=base,
        P=_stack_matrices([step.P for step in emitted]),
        A=_stack_matrices([step.A for step in emitted]),
        **_stack_q_l_u(emitted),
        units=_choose_si_units(scenario, part),
        scaled=scaled,
        meta={
            "scenario": scenario.name,
            "sample_s": scenario.sample_s,
            "first": first,
            **scenario.problem.horizons_by_name,
        },
        sparse_equivalent=sparse,
        documents={**scenario.files} if isinstance(scenario, Scenario) else {},
    )


def _rebuild_allocation_steps(
    scenario: Case, exact: ExactLoop, builder: QPBuilder, steps: range
) -> tuple[list[QPStep], QuadraticProgram]:
    """Return a cascade's thrust-allocation QPs, and the problem of the first."""
    allocation, demand = builder.allocation, exact.demand
    if allocation is None or demand is None:
        why = 'as only a cascade with allocation = "qp" has allocation QPs'
        allowed = f"'controller' for scenario {scenario.name}, {why}"
        raise InputError("`part`", "", "'allocation'", allowed)
    emitted = [builder.rebuild_allocation(k, demand, exact.thrust) for k in steps]
    return emitted, allocation.problem(emitted[0])


def _choose_si_units(scenario: Case, part: Part) -> Units:
    """Return what 1 is in SI of the scaled QPs of a scenario's controller or allocation."""
    allocation = scenario.controller.make_allocation_qp_builder("si")
    if part == "allocation" and allocation is not None:
        return allocation.scale
    return scenario.controller.make_condensed_qp_builder("si").scale


def _rebuild_sparse_sequence(
    scenario: Case, theta: Matrix, units: UnitSystem, first: int, name: str
) -> SparseEquivalent:
    """Return the sparse-form QPs of recorded parameters θ (K, 16), and the map back to z."""
    builder = QPBuilder(scenario, units, sparse=True)
    staged = builder.staged
    assert staged is not None, "asked for"
    steps = [builder.rebuild(k, row) for k, row in enumerate(theta, first)]
    sequence = QPSequence(name, staged.problem(steps[0]), **_stack_q_l_u(steps))
    return SparseEquivalent(sequence, staged.convert_solution_to_condensed)


def _stack_q_l_u(steps: Sequence[QPStep]) -> dict[str, Any]:
    """Return the QP vectors q (K, n), l (K, m) and u (K, m) of K steps, by name."""
    return {name: np.array([getattr(step, name) for step in steps]) for name in ("q", "l", "u")}


def _stack_matrices(matrices: list[Matrix | None]) -> Floats | None:
    """Return all steps' matrices stacked into one array; None where no step has new ones."""
    brought = [matrix for matrix in matrices if matrix is not None]
    return np.array(brought) if brought else None


def record_sequence(
    scenario: Case | str | Path,
    *,
    units: UnitSystem = "scaled",
    part: Part = "controller",
    plant: PlantMaker | None = None,
) -> QPSequence:
    """Solve a scenario's loop exactly and return the QPs of its controller or allocation.

    scenario : an object, a name or a TOML file, or a `LinearMPC`. plant : as of `run_closed_loop`.
    CertificateError where nothing is proven of a step.

    Examples
    --------
    >>> from dpbench import load_scenario
    >>> record_sequence(load_scenario("paper").truncate(5))
    <QPSequence paper: 5 QPs of 15 variables, 15 rows, constant matrices>
    """
    case = scenario if isinstance(scenario, LinearMPC) else resolve_to_scenario(scenario)
    exact = solve_loop_exactly(case, plant=plant)
    exact.require_certificates(case.name)
    return rebuild_sequence(case, exact, units=units, part=part)


def compute_station_metrics(scenario: Scenario, exact: ExactLoop, steps: int) -> dict[str, float]:
    """Return how a ship in a reference loop keeps station, and how often limits act."""
    K = min(steps, len(exact.tau))
    active = {"exact_active_share": float(exact.active[:K].mean())}
    return compute_track_metrics(scenario, exact.state[: K + 1]) | active


def compute_track_metrics(scenario: Scenario, state: Matrix) -> dict[str, float]:
    """Return the columns `exact_*` on station keeping, from a ship's states (K + 1, 6).

    The ship is on station within `RADIUS_M` and `HEADING_DEG` of its setpoint, lengths and times
    scaled for a model ship. Offsets count from its arrival on, or all if it never arrives; after a
    loss of thrusters or limits those from the arrival on. Those before are of a transfer.
    """
    K = len(state) - 1
    offset, heading, distance, arrived, radius_m = _measure_offsets_and_arrivals(scenario, state)
    left = arrived & ~(distance <= 1.0)
    counted = arrived if arrived.any() else ~arrived
    largest = int(np.argmax(np.where(counted, offset, -1.0)))
    after_loss = arrived & (np.arange(K + 1) >= _first_loss_sample(scenario))
    rise = round(RISE_S * _read_scale(scenario).time_and_speed_factor / scenario.sample_s)
    return {
        "exact_steps": float(K),
        "station_radius_m": radius_m,
        "exact_offset_max_m": float(offset[largest]),
        "exact_offset_max_s": largest * scenario.sample_s,
        "exact_offset_end_m": float(offset[-1]),
        "exact_offset_rise_m": float(offset[-1] - offset[max(0, K - max(1, rise))]),
        "exact_heading_max_deg": float(heading[counted].max()),
        "exact_heading_end_deg": float(heading[-1]),
        "exact_loss_offset_max_m": _largest(offset[after_loss]),
        "exact_loss_heading_max_deg": _largest(heading[after_loss]),
        "exact_loss_swing_m": _measure_undamped_swing_m(scenario, state, arrived),
        "exact_left_s": float(np.argmax(left)) * scenario.sample_s if left.any() else np.nan,
        "exact_transfer_offset_max_m": _largest(offset[~arrived]),
        "exact_transfer_s": _find_transfer_end(distance, arrived) * scenario.sample_s,
    }


def _largest(values: Vector) -> float:
    """Return the largest of some values; NaN without any."""
    return float(values.max()) if len(values) else np.nan


def _measure_undamped_swing_m(scenario: Scenario, state: Matrix, arrived: Flags) -> float:
    """Return the range [m] of a ship's position north or east in the last third since a loss.

    0 where that is less than `UNDAMPED_SHARE` of the range since the loss, or less than
    `CAUSED_BY_LOSS` times the range in the last half of the time before it. NaN without a loss.
    arrived : (K + 1,), whether the ship has arrived on station.
    """
    offset = (state[:, POSE] - scenario.build_reference_table(len(state)))[:, :2]
    is_lost = np.arange(len(state)) >= _first_loss_sample(scenario)
    after, before = offset[arrived & is_lost], offset[arrived & ~is_lost]
    if not len(after):
        return np.nan
    swing_m = _measure_range_m(after[2 * len(after) // 3 :])
    least_m = UNDAMPED_SHARE * _measure_range_m(after)
    usual_m = _measure_range_m(before[len(before) // 2 :])
    return swing_m if swing_m >= max(least_m, CAUSED_BY_LOSS * usual_m) else 0.0


def _measure_range_m(position: Matrix) -> float:
    """Return the range [m] of a position (K, 2), north or east, the larger; 0 for K = 0."""
    return float(np.ptp(position, axis=0).max()) if len(position) else 0.0


def _find_transfer_end(distance: Vector, arrived: Flags) -> float:
    """Return the sample from which a ship is within its limits after its last transfer.

    distance, arrived : (K,), as of `mask_arrived_samples`. NaN if no transfer ends.
    """
    if arrived.all() or not arrived[-1]:
        return np.nan
    return float(np.flatnonzero(~arrived & ~(distance <= 1.0))[-1] + 1)


def _first_loss_sample(scenario: Scenario) -> float:
    """Return the sample of a scenario's first fault; inf without one."""
    faults = scenario.files["scenario"].get("faults") or ()
    return min((round(fault["at_s"] / scenario.sample_s) for fault in faults), default=np.inf)


def compute_largest_offset_share(scenario: Scenario, state: Matrix) -> float:
    """Return the largest offset of a ship on station, in multiples of the station's limits.

    state : (K + 1, 6) at the samples. Offsets count as in `compute_track_metrics`; NaN where
    one is.
    """
    _, _, distance, arrived, _ = _measure_offsets_and_arrivals(scenario, state)
    return float(distance[arrived if arrived.any() else ~arrived].max())


def _read_scale(scenario: Scenario) -> Froude:
    """Return the scale of a scenario's ship."""
    return Froude(float(scenario.files["vessel"]["model_scale"]))


def _measure_offsets_and_arrivals(
    scenario: Scenario, state: Matrix
) -> tuple[Vector, Vector, Vector, Flags, float]:
    """Return a ship's offset [m], heading error [°], distance [limits], arrivals, radius [m]."""
    scale = _read_scale(scenario)
    wanted = scenario.build_reference_table(len(state))
    north, east, turn = (state[:, POSE] - wanted).T
    offset, heading = np.hypot(north, east), np.degrees(np.abs(turn))
    radius_m = RADIUS_M * scale.length_factor
    distance = np.maximum(offset / radius_m, heading / HEADING_DEG)
    moved = (np.diff(wanted, axis=0, prepend=wanted[:1]) != 0.0).any(axis=1)
    hold = round(ARRIVAL_S * scale.time_and_speed_factor / scenario.sample_s)
    return offset, heading, distance, mask_arrived_samples(distance, moved, hold), radius_m


def mask_arrived_samples(distance: Vector, moved: Flags, hold: int) -> Flags:
    """Return at which samples (K,) the ship has arrived at its setpoint, be it still there or not.

    It has from the start, or after `hold` samples within the limits, until the setpoint moves out
    of reach. A ship that ends `DRIFT` farther from a resting setpoint than it was has arrived, too:
    it has left.

    distance : (K,) from the setpoint, in multiples of the limits; moved : (K,) whether the setpoint
    differs from that of the sample before.
    """
    inside = distance <= 1.0
    arrived = np.zeros(len(distance), dtype=np.bool_)
    has_arrived, stay, away_from = bool(inside[0]), 0, 0
    for k in range(len(distance)):
        if moved[k] and not inside[k]:
            has_arrived, away_from = False, k
        stay = stay + 1 if inside[k] else 0
        has_arrived |= stay >= hold
        arrived[k] = has_arrived
    if not has_arrived and not distance[-1] <= distance[away_from] + DRIFT:
        arrived[away_from:] = True
    return arrived
