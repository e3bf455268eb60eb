"""Numbers of a controller for its C code: maps, limits, thrusters, inputs and outputs.

A recorded closed loop becomes inputs and commands of the controller, to replay in C.
"""

import re
from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.errors import InputError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.thruster_rows import ThrusterRows
from dpbench.qp.solution import Status
from dpbench.scenario.controllers.controller import (
    FIXED_MODEL,
    Controller,
    stack_lower_and_upper_limits,
)
from dpbench.scenario.controllers.kinds import ForceController, ThrusterController
from dpbench.scenario.scenario import Scenario
from dpbench.ship.plant import Sensors
from dpbench.ship.thrusters import Thruster
from dpbench.ship.vessel import AXIS_NAMES
from dpbench.solvers.contract import DEFAULT, Settings
from dpbench.solvers.open import open_workspace

_MEASURED = (
    ("surge_speed", "velocity[0]", "m/s", "speed ahead over ground"),
    ("sway_speed", "velocity[1]", "m/s", "speed to starboard over ground"),
    ("yaw_rate", "velocity[2]", "rad/s", "turning rate, clockwise seen from above"),
    ("north", "pose[0]", "m", "position north of the origin"),
    ("east", "pose[1]", "m", "position east of the origin"),
    ("heading", "pose[2]", "rad", "heading, clockwise from north; whole turns do not matter"),
    ("reference_north", "reference[0]", "m", "wanted position north"),
    ("reference_east", "reference[1]", "m", "wanted position east"),
    ("reference_heading", "reference[2]", "rad", "wanted heading"),
)


@dataclass(frozen=True)
class Signal:
    """Input or output of the generated controller: name, field in C, unit, meaning, start value."""

    name: str
    field: str
    unit: str
    meaning: str
    start: float = 0.0
    is_integer: bool = False


@dataclass(frozen=True, eq=False)
class ThrusterTables:
    """Limits of the thrusters as rows: normals on the own entries, intact and after a loss.

    normal (r, w) : of each row on its thruster's w ≤ 2 entries, zero behind the last;
    low, high, lost_low, lost_high (r,) [N]; first_row, first_entry (p + 1,) : where the rows and
    entries of a thruster begin; row_max (r,) : change of a row by a maximum increment.
    """

    names: tuple[str, ...]
    normal: Matrix
    low: Vector
    high: Vector
    lost_low: Vector
    lost_high: Vector
    first_row: list[int]
    first_entry: list[int]
    row_max: Vector


@dataclass(frozen=True, eq=False)
class ControllerData:
    """Numbers of the control step of one scenario, in SI units and scaled QP variables.

    gradient (n, 12 or 12 + n_u) : q = gradient [x; y_ref; u_prev]; du_max (n_u,) : rate limits;
    low, high (3,) : limits of the force, those of the ship while nothing has failed.
    thrusters : None where a force is commanded; reachable : whether limits wait for the rate.
    """

    scenario: Scenario
    qp: CondensedQP
    gradient: Matrix
    du_max: Vector
    low: Vector
    high: Vector
    reachable: bool
    thrusters: ThrusterTables | None
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]


def read_controller_data_of_scenario(scenario: Scenario) -> ControllerData:
    """Return the numbers of a scenario's controller; InputError for one without C code."""
    controller = scenario.controller
    _refuse_unsupported_controller(scenario, controller)
    qp, problem = controller.make_condensed_qp_builder(), controller.problem
    tables = None
    if isinstance(controller, ThrusterController):
        rows = controller.control.rows
        tables = _tabulate_limits_after_each_loss(
            rows, controller.control.thrusters.thrusters, problem.row_max
        )
        outputs = _list_thruster_outputs(controller.control.thrusters.thrusters)
        inputs = _list_thruster_loss_inputs(tables.names)
    else:
        outputs, inputs = (
            _list_force_outputs(),
            _list_force_limit_inputs(problem.u_min, problem.u_max),
        )
    theta = problem.model.theta
    last = theta.one if problem.W is not None else theta.u_prev.start
    return ControllerData(
        scenario=scenario,
        qp=qp,
        gradient=np.ascontiguousarray(qp.Z[: qp.n, :last]),
        du_max=problem.du_max,
        low=problem.u_min,
        high=problem.u_max,
        reachable=controller.amplitude == "reachable",
        thrusters=tables,
        inputs=(*(Signal(*measured) for measured in _MEASURED), *inputs),
        outputs=outputs,
    )


def _refuse_unsupported_controller(scenario: Scenario, controller: Controller) -> None:
    """Raise InputError for a controller whose QP matrices change, or that needs more than a QP."""
    where = f"scenario {scenario.name}"
    is_force = type(controller) is ForceController
    if not is_force and not isinstance(controller, ThrusterController):
        cascade = f"a cascade (tuning {controller.tuning_and_horizons_label})"
        found = cascade if controller.allocates else 'limits = "attainable"'
        allowed = (
            "a controller without a cascade, for three forces with limits per axis or for thrusters"
        )
        raise InputError(where, "controller", found, allowed)
    if controller.linearisation is not FIXED_MODEL:
        found, allowed = (
            "matrices that change at each step",
            "a single linearisation and azimuth constraints that stay the same at every step",
        )
        raise InputError(where, "controller", found, allowed)
    if controller.amplitude == "soft" or controller.outputs is not None:
        found = "soft limits" if controller.amplitude == "soft" else "output bounds"
        allowed = "a controller without soft limits and without output bounds"
        raise InputError(where, "controller", found, allowed)
    if scenario.preview:
        raise InputError(
            where,
            "reference.preview",
            "true",
            "false, as the generated code reads only the present setpoint",
        )
    if scenario.estimation.kind != "measured":
        allowed = (
            '"measured", because the input of the generated code is a state that is already '
            "filtered"
        )
        raise InputError(where, "estimator.kind", f'"{scenario.estimation.kind}"', allowed)
    if not is_force and controller.amplitude == "hard":
        raise InputError(where, "controller.amplitude", '"hard"', '"reachable" for thrusters')


def _tabulate_limits_after_each_loss(
    rows: ThrusterRows, thrusters: tuple[Thruster, ...], row_max: Vector
) -> ThrusterTables:
    """Return the limits of a ship's thrusters, intact and with each one lost, as tables."""
    p = len(thrusters)
    first_entry = np.searchsorted(rows.entry, np.arange(p + 1))
    width = int(np.diff(first_entry).max())
    normal = np.zeros((len(rows.G), width))
    for k, t in enumerate(rows.thruster):
        own = slice(int(first_entry[t]), int(first_entry[t + 1]))
        normal[k, : own.stop - own.start] = rows.G[k, own]
    lost = rows.limits_after_loss_of_thrusters(range(p))
    names = make_unique_c_identifiers([thruster.name for thruster in thrusters])
    first_row = np.searchsorted(rows.thruster, np.arange(p + 1)).tolist()
    limits = rows.low, rows.high, lost.low, lost.high
    return ThrusterTables(names, normal, *limits, first_row, first_entry.tolist(), row_max)


def make_unique_c_identifiers(names: list[str]) -> tuple[str, ...]:
    """Return names as C identifiers, numbered where two would be the same."""
    plain = [re.sub(r"\W+", "_", name.lower(), flags=re.ASCII).strip("_") or "t" for name in names]
    return tuple(f"{x}_{i + 1}" if plain.count(x) > 1 else x for i, x in enumerate(plain))


def _list_force_limit_inputs(low: Vector, high: Vector) -> tuple[Signal, ...]:
    """Return the inputs of the generated controller that limit each axis of the force."""
    sides = ("least", "low", low), ("most", "high", high)
    return tuple(
        Signal(
            f"{word}_{axis}", f"{field}[{i}]", unit, f"{word} allowed {axis} now", float(side[i])
        )
        for word, field, side in sides
        for i, (axis, unit) in enumerate(zip(AXIS_NAMES, ("N", "N", "N.m"), strict=True))
    )


def _list_thruster_loss_inputs(names: tuple[str, ...]) -> tuple[Signal, ...]:
    """Return the inputs of the generated controller that take thrusters out of service."""
    meaning = "0 in service, 1 lost: ramps down, 2 tripped: gives nothing at once"
    return tuple(
        Signal(f"lost_{name}", f"lost[{i}]", "", f"{name}: {meaning}", is_integer=True)
        for i, name in enumerate(names)
    )


def _list_force_outputs() -> tuple[Signal, ...]:
    """Return the commanded force as outputs of the generated controller."""
    units = ("N", "N", "N.m")
    words = ("ahead", "to starboard", "clockwise")
    return tuple(
        Signal(f"command_{axis}", f"command[{i}]", unit, f"commanded {axis}, positive {word}")
        for i, (axis, unit, word) in enumerate(zip(AXIS_NAMES, units, words, strict=True))
    )


def _list_thruster_outputs(thrusters: tuple[Thruster, ...]) -> tuple[Signal, ...]:
    """Return the commanded thruster forces as outputs of the generated controller."""
    names = make_unique_c_identifiers([thruster.name for thruster in thrusters])
    outputs: list[Signal] = []
    parts = {
        "azimuth": (("x", "ahead"), ("y", "to starboard")),
        "tunnel": (("y", "to starboard"),),
        "main": (("x", "ahead"),),
    }
    for name, thruster in zip(names, thrusters, strict=True):
        for letter, word in parts[thruster.kind]:
            field, meaning = f"command[{len(outputs)}]", f"force of {name}, positive {word}"
            outputs.append(Signal(f"command_{name}_{letter}", field, "N", meaning))
    return tuple(outputs)


def list_thruster_states_by_sample(controller: Controller, samples: int) -> Matrix:
    """Return the state of each thruster (samples, p): 0 in service, 1 lost, 2 tripped."""
    state = np.array(
        [limits.lost for limits in controller.list_thruster_limits_by_sample(samples)], dtype=float
    )
    control = controller.commanded_thrusters
    for k, entries in () if control is None else control.trips:
        assert control is not None
        state[k:, np.unique(control.rows.entry[entries])] = 2.0
    return state


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Inputs (K, n_in) and commands (K, n_u) of a controller at K samples; sample time [s].

    changes : the samples at which limits change or thrusters are lost.
    unsolved : number of steps with another status than solved.
    """

    inputs: Matrix
    commands: Matrix
    sample_s: float
    changes: tuple[int, ...] = ()
    unsolved: int = 0

    def format_as_csv(self, names: list[str]) -> str:
        """Format the trajectory as CSV text; `names` are those of inputs and commands."""
        lines = [",".join(["time_s", *names])]
        numbers = np.hstack([self.inputs, self.commands])
        for k, row in enumerate(numbers.tolist()):
            lines.append(",".join(repr(x) for x in (k * self.sample_s, *row)))
        return "\n".join(lines) + "\n"


def record_closed_loop_trajectory(
    data: ControllerData, solver: str, steps: int, settings: Settings = "default"
) -> Trajectory:
    """Run a scenario's closed loop with a solver, warm started; return its inputs and outputs."""
    scenario = data.scenario.truncate(steps)
    K, controller = scenario.steps, scenario.controller
    workspace = open_workspace(solver, route="native", policy="warm", settings=settings)
    cell = Cell("closed_loop", scenario.files, solver, "native", "warm", DEFAULT, K)
    setup = build_closed_loop_setup(cell, scenario, workspace, RawLog.in_memory, NO_LIMIT_NS)
    record_closed_loop(setup)
    log = setup.log
    sensors = Sensors(scenario.environment, K, scenario.sample_s)
    measured = np.array([sensors.measure_state(log.state[k], k).copy() for k in range(K)])
    reference = scenario.build_reference_table(K)
    if data.thrusters is not None:
        state = list_thruster_states_by_sample(controller, K)
    else:
        state = np.hstack(
            stack_lower_and_upper_limits(controller.list_planned_force_limits_by_sample(K))
        )
    commands = controller.select_applied_commands(log.tau, log.thrust).copy()
    changes = 1 + np.flatnonzero(np.diff(state, axis=0).any(axis=1))
    inputs = np.hstack([measured, reference, state])
    unsolved = int(np.count_nonzero(log.status[0] != Status.SOLVED))
    return Trajectory(inputs, commands, scenario.sample_s, tuple(changes.tolist()), unsolved)
