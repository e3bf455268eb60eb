"""A recorded closed loop as inputs and commands of the controller, to replay in C."""

from dataclasses import dataclass

import numpy as np

from dpbench.arrays import Matrix
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.codegen.controller_data import ControllerData, list_thruster_states_by_sample
from dpbench.scenario.controllers.controller import stack_lower_and_upper_limits
from dpbench.ship.plant import Sensors
from dpbench.solvers.open import open_workspace


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Inputs (K, n_in) and commands (K, n_u) of a controller at K samples; sample time [s]."""

    inputs: Matrix
    commands: Matrix
    sample_s: float

    def format_as_csv(self, names: list[str]) -> str:
        """Format the trajectory as CSV text; `names` are those of inputs and commands."""
        lines = [",".join(["time_s", *names])]
        numbers = np.hstack([self.inputs, self.commands])
        for k, row in enumerate(numbers.tolist()):
            lines.append(",".join(repr(x) for x in (k * self.sample_s, *row)))
        return "\n".join(lines) + "\n"


def record_closed_loop_trajectory(
    data: ControllerData, solver: str, steps: int, settings: str = "default"
) -> Trajectory:
    """Run a scenario's closed loop with a solver, warm started; return its inputs and outputs."""
    scenario = data.scenario.truncate(steps)
    K, controller = scenario.steps, scenario.controller
    workspace = open_workspace(solver, policy="warm", settings=settings)
    cell = Cell("closed_loop", scenario.files, solver, "native", "warm", settings, K)
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
    return Trajectory(np.hstack([measured, reference, state]), commands, scenario.sample_s)
