"""A ship with round numbers, for control metrics of trajectories worked by hand."""

from collections.abc import Callable, Sequence
from dataclasses import fields as dataclass_fields, replace
from typing import Any

import numpy as np

from dpbench import open_workspace
from dpbench.bench.judge.control_metrics import (
    compute_axis_limit_metrics,
    compute_control_metrics,
    compute_joint_limit_metrics,
)
from dpbench.bench.judge.evaluation import EvaluatedCell, evaluate_loop_log
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.exact_loop import ExactLoop, solve_loop_exactly
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.model import StateSpace
from dpbench.mpc.thruster_rows import Limits
from dpbench.scenario.controllers.controller import Controller, ThrusterControl
from dpbench.scenario.controllers.kinds import ThrusterController
from dpbench.scenario.scenario import Scenario, load_scenario

SAMPLE_S = 0.5
Rows = Sequence[Sequence[float]]


def round_ship(sample_s: float = SAMPLE_S, **changes: Any) -> Scenario:
    """Return a scenario with largest forces 200, 50, 20 and largest increments 10, 5, 2.

    The largest force in surge is the one astern, in sway the one to starboard.
    """
    calm = load_scenario("calm")
    ship = replace(
        calm.vessel,
        tau_min=np.array([-200.0, -40.0, -20.0]),
        tau_max=np.array([100.0, 50.0, 20.0]),
        rate_max=np.array([20.0, 10.0, 4.0]) * SAMPLE_S / sample_s,
    )
    problem = replace(
        calm.problem,
        **(
            {
                "Q": np.eye(3),
                "R": np.eye(3),
                "du_max": ship.largest_force_change_per_sample(sample_s),
            }
            | changes
        ),
    )
    controller = replace(calm.controller, problem=problem)
    return replace(calm, sample_s=sample_s, vessel=ship, controller=controller)


def with_controller(kind: type[Controller], problem: ControlProblem, **fields: Any) -> Scenario:
    ship = round_ship()
    own = {f.name: getattr(ship.controller, f.name) for f in dataclass_fields(Controller)}
    return replace(ship, controller=kind(**(own | {"problem": problem} | fields)))


def thruster_ship(control: ThrusterControl, R: np.ndarray | None = None) -> Scenario:
    """Return the ship of round numbers whose controller commands these thrusters."""
    own, rows, thrusters = round_ship().problem, control.rows, control.thrusters
    problem = replace(
        own,
        model=StateSpace(own.model.A, own.model.B @ thrusters.T_e, own.model.C),
        R=np.eye(thrusters.n_f) if R is None else R,
        u_min=rows.low,
        u_max=rows.high,
        du_max=thrusters.largest_force_changes_per_sample(SAMPLE_S),
        thrusters=rows,
        W=control.W,
    )
    return with_controller(ThrusterController, problem, control=control)


def exact_loop(pose: Rows, tau: Rows, thrust: Rows | None = None) -> ExactLoop:
    state = np.zeros((len(pose), 6))
    state[:, 3:] = pose
    forces = np.array(tau, dtype=float)
    K = len(forces)
    of_thrusters = np.zeros((K, 0)) if thrust is None else np.array(thrust, dtype=float)
    return ExactLoop(
        np.zeros((K, 16)),
        state,
        forces,
        of_thrusters,
        np.zeros((K, 15)),
        np.zeros(K, dtype=bool),
        [],
    )


def metrics_of(
    pose: Rows,
    u: Rows | None = None,
    *,
    velocity: Rows | None = None,
    reference: Rows | None = None,
    limits: tuple[Rows, Rows] | None = None,
    exact: ExactLoop | None = None,
    scenario: Scenario | None = None,
) -> dict[str, float]:
    """Return the control metrics of a run; what is not given is zero, or the ship's own.

    pose, velocity, reference : (K + 1, 3); pose in [m, m, rad]. u : (K, n_u).
    limits : least and most force of each sample (K, 3).
    """
    ship = round_ship() if scenario is None else scenario
    K = len(pose) - 1
    state = np.zeros((K + 1, 6))
    state[:, 3:] = pose
    if velocity is not None:
        state[:, :3] = velocity
    applied = np.zeros((K, 3)) if u is None else np.array(u, dtype=float)
    wanted = np.zeros((K + 1, 3)) if reference is None else np.array(reference, dtype=float)
    own = ship.vessel.tau_min, ship.vessel.tau_max
    tables = [np.tile(side, (K, 1)) for side in own] if limits is None else map(np.array, limits)
    low, high = tables
    nothing = np.zeros_like(applied)
    still = exact_loop(np.zeros((K + 1, 3)).tolist(), np.zeros((K, 3)).tolist(), nothing.tolist())
    loop = still if exact is None else exact
    metrics = compute_control_metrics(ship, state, applied, wanted, loop)
    of_limits = {
        "axis_limits": compute_axis_limit_metrics,
        "joint_limits": compute_joint_limit_metrics,
    }
    in_force = [Limits(*sides) for sides in zip(low, high, strict=True)]
    for group in set(of_limits) & set(ship.controller.metric_groups):
        metrics |= of_limits[group](ship, applied, in_force)
    return metrics


def judged_loop(
    change: Callable[[RawLog], Any] | None, name: str, units: str, steps: int, backup: str = ""
) -> tuple[EvaluatedCell, RawLog, Cell]:
    """Return a short loop by daqp, its log changed before it is judged."""
    case = load_scenario(name).truncate(steps)
    given: dict[str, Any] = {"units": units, "backup": backup}
    cell = Cell("closed_loop", case.files, "daqp", "native", "reuse", "high", steps, **given)
    workspace = open_workspace("daqp", route="native", policy="reuse", settings="high")
    setup = build_closed_loop_setup(cell, case, workspace, RawLog.in_memory, NO_LIMIT_NS)
    assert record_closed_loop(setup)
    if change is not None:
        change(setup.log)
    return evaluate_loop_log(cell, setup.log, solve_loop_exactly(case)), setup.log, cell
