"""qpOASES through casadi's buffer interface: two-sided, hot start from the working set it keeps.

casadi reuses memory as it was left, so only a new function object starts from nothing; building one
takes some milliseconds. The working set belongs to the homotopy from the previous problem to the
next and is not shifted.
"""

import io
import math
import re
from contextlib import redirect_stdout
from importlib import import_module

import numpy as np

from dpbench.arrays import Vector
from dpbench.qp.solution import Status
from dpbench.solvers.adapter import Claim, NativeAdapter
from dpbench.solvers.contract import Levels, RouteRecord, SolverRecord, make_project_facts
from dpbench.solvers.libraries.native_workspace import NativeWorkspace, Point

EPS = 2.221e-16  # of Constants.hpp
_MPC = {
    "enableRamping": False,
    "enableFarBounds": True,
    "enableFlippingBounds": False,
    "enableRegularisation": True,
    "enableNZCTests": False,
    "enableDriftCorrection": 0,
    "enableEqualities": True,
    "terminationTolerance": 1e9 * EPS,
    "initialStatusBounds": "inactive",
    "numRegularisationSteps": 1,
    "numRefinementSteps": 0,
}
# What Options::setToReliable and setToMPC set beyond setToDefault (Options.cpp); casadi has no
# option for the presets themselves.
LEVELS: Levels = {
    "reliable": {
        "enableFullLITests": True,
        "enableCholeskyRefactorisation": 1,
        "numRefinementSteps": 2,
    },
    "mpc": _MPC,
}

RECORD = SolverRecord(
    name="qpoases",
    family="active set",
    method="parametric (online) active set",
    distribution="casadi",
    module="casadi",
    extra="casadi",
    form="dense",
    routes={
        "native": RouteRecord(
            ("fresh", "warm"),
            updates="vectors",
            start="active set",
            two_sided=True,
            refused={
                "reuse": "casadi keeps its working set from solve to solve and can reset it only "
                "by a complete setup, which is fresh"
            },
        )
    },
    levels=LEVELS,
    project=make_project_facts(
        licence=("LGPL-2.1-or-later", "qpOASES source, head of each file"),
        language=("C++", "qpOASES manual, Introduction"),
        single_precision=("yes, __USE_SINGLE_PRECISION__", "qpOASES source, Constants.hpp"),
    ),
    iteration_limit="nWSR",
    time_limit="CPUtime",
)

# casadi's unified return status.
STATUS = {
    0: Status.SOLVED,
    2: Status.MAX_ITERATIONS,  # "limited": working set recalculations or time
    3: Status.NUMERICAL_ERROR,  # NaN
    4: Status.PRIMAL_INFEASIBLE,
    5: Status.ERROR,  # exception
}
FIXED = {"printLevel": "none", "error_on_fail": False}


class QpoasesWorkspace(NativeWorkspace):
    """Workspace of qpOASES, called through casadi; after the first solve it starts hot."""

    def _prepare_matrices_for_library(self) -> None:
        """Store P and A in qpOASES's memory order, and arrays for its inputs and outputs."""
        n, m = self._n, self._m
        self._inputs = {
            "h": np.asfortranarray(self._P).ravel("K"),
            "a": np.asfortranarray(self._A).ravel("K"),
            **{name: np.empty(size) for name, size in (("g", n), ("lba", m), ("uba", m))},
            "lbx": self._lb,
            "ubx": self._ub,
        }
        outputs = ("x", n), ("cost", 1), ("lam_a", m), ("lam_x", n)
        self._outputs = {name: np.empty(size) for name, size in outputs}

    def _create_library_solver(self) -> None:
        """Store a new CasADi function of qpOASES and give it the addresses of all arrays."""
        dense, n, m = self._library.Sparsity.dense, self._n, self._m
        shapes = {"h": dense(n, n), "a": dense(m, n)}
        options = {**FIXED, **self._options}
        with redirect_stdout(io.StringIO()):
            self._function = self._library.conic("S", "qpoases", shapes, options)
            self._buffer, self._trigger = self._function.buffer()
        for i, name in enumerate(self._function.name_in()):
            if self._inputs.get(name, np.empty(0)).size:
                self._buffer.set_arg(i, self._inputs[name].data)
        for i, name in enumerate(self._function.name_out()):
            if self._outputs[name].size:
                self._buffer.set_res(i, self._outputs[name].data)
        self._send_step_vectors_to_library(self._q, self._l, self._u)

    def _send_step_vectors_to_library(self, q: Vector, low: Vector, high: Vector) -> None:
        """Write a step's cost and row limits into the arrays that qpOASES reads."""
        inputs = self._inputs
        inputs["g"][:], inputs["lba"][:], inputs["uba"][:] = q, low, high

    def _call_library_solve(self) -> None:
        """Call qpOASES on its arrays."""
        self._trigger()

    def _read_status_iterations_and_time(self) -> Claim:
        """Return qpOASES's status and iterations; a NaN cost counts as failure."""
        flag = int(self._buffer.ret())
        iterations = int(self._buffer.stats()["iter_count"])
        if math.isnan(self._outputs["cost"][0]):
            # It reports a problem with NaN as solved, and starts all later ones from there.
            return Status.NUMERICAL_ERROR, iterations, -1, "a cost that is no number"
        return STATUS.get(flag, Status.UNKNOWN), iterations, -1, f"return status {flag}"

    def _copy_solution_and_multipliers(self) -> Point | None:
        """Return solution z and multipliers y, y_box; None if the status is unknown."""
        # Without a reason for a failure, x may be that of an earlier problem.
        if STATUS.get(int(self._buffer.ret()), Status.UNKNOWN) is Status.UNKNOWN:
            return None
        outputs = self._outputs
        return outputs["x"].copy(), outputs["lam_a"].copy(), outputs["lam_x"].copy()


def list_qpoases_options() -> list[str]:
    """Return qpOASES's option names, from casadi's documentation text."""
    text = import_module("casadi").doc_conic("qpoases")
    return [name for name in re.findall(r"^\| (\w+) +\| OT_", text, re.M) if name != "printLevel"]


NATIVE = NativeAdapter(RECORD, QpoasesWorkspace, list_qpoases_options)
