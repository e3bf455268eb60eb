"""The template process that cells are forked from: importing this module prepares it.

It loads all but solvers, compiles kernels, and starts no thread; a fork of it takes milliseconds
where a fresh interpreter takes half a second.
"""

import gc
import time
from dataclasses import replace

import numpy as np

from dpbench.bench.run.replay import time_speed_and_load_tests
from dpbench.bench.workers import worker
from dpbench.bench.workers.interrupts import forget_interrupts
from dpbench.mpc.condense import ControlProblem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.model import build_prediction_model
from dpbench.mpc.move_limits import write_limited_command
from dpbench.mpc.reference import shift_target_heading_near_start
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.referee.referee import certify
from dpbench.ship.plant import SUBSTEPS, ShipPlant
from dpbench.ship.vessel import HullDrag, Vessel

__all__ = ["worker"]


def _compile_kernels() -> None:
    """Call all Numba-compiled code once, so that forked workers need not compile it."""
    three = np.ones(3)
    ship = Vessel("", "", "", 1.0, np.eye(3), np.eye(3), -three, three, three)
    hull = HullDrag(along=1.0, across=1.0, centre_m=0.0, length_m=1.0, fading_mps=1.0)
    for drag, loads, columns in ((None, None, 3), (None, np.zeros(6), 9), (hull, np.zeros(6), 9)):
        plant = ShipPlant(replace(ship, drag=drag), np.zeros(6), 0.1, loads=loads)
        plant.advance_by_one_sample(three, np.zeros((2 * SUBSTEPS + 1, columns)))
    write_limited_command(three, three, three, -three, three, np.empty(3))
    shift_target_heading_near_start(three, three)
    model = build_prediction_model(ship.M, ship.D, 0.0, 0.1)
    CondensedQP(ControlProblem(model, 3, 2, np.eye(3), np.eye(3), -three, three, three))
    time_speed_and_load_tests(time.perf_counter_ns)
    # At a limit, so that the referee looks for the active set too.
    rows = np.eye(3), -3.0 * three, 3.0 * three
    certify(QuadraticProgram(np.eye(3), -2.0 * three, *rows, -three, three))


_compile_kernels()
# A collection in a fork would walk, and thereby copy, the whole heap: 0.2 s of every process.
gc.collect()
gc.freeze()
# From here on the server of the templates minds Ctrl-C itself, and a cell is interrupted by it.
forget_interrupts()
