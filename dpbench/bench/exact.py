"""The exactly solved loop: the referee's certified optimum steers the ship.

It is computed once per scenario; every solver's deviation from it is a metric, and the QPs along
it are the sequences for replay.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dpbench.bench.loop import Voyage, closed_loop
from dpbench.bench.port import SolverPort
from dpbench.bench.rawlog import RawLog, loop_layout
from dpbench.errors import CertificateError, ResultsError
from dpbench.mpc.condense import UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.certify import Optimum, Referee
from dpbench.qp.program import Matrix, QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario import Scenario, condense
from dpbench.solvers.contract import Workspace


class ExactWorkspace(Workspace):
    """The referee's optimum behind the workspace contract; scaled QPs only."""

    def __init__(self) -> None:
        super().__init__("exact", "native", "reuse")
        self._referee: Referee | None = None
        self._step: QPStep | None = None
        self._optimum: Optimum | None = None

    def setup(self, qp: QuadraticProgram) -> None:
        """Take the constant matrices."""
        self._referee = Referee(qp.P, qp.A, qp.lb, qp.ub)
        self._step = QPStep(qp.q, qp.l, qp.u)

    def update(self, step: QPStep) -> None:
        """Take the vectors."""
        self._step = step

    def solve(self) -> None:
        """Certify the optimum of the current step."""
        assert self._referee is not None and self._step is not None, "setup comes first"
        self._optimum = self._referee.certify(self._step.q, self._step.l, self._step.u)

    def read(self) -> Solution:
        """The certified optimum; an uncertified one is an error, never a guess."""
        optimum = self._optimum
        assert optimum is not None, "solve comes first"
        if not np.isfinite(optimum.bound):
            raise CertificateError(f"no certified optimum ({optimum.kind})")
        return Solution(Status.SOLVED, optimum.z, optimum.y, optimum.y_box, 0)


@dataclass(frozen=True, eq=False)
class ExactLoop:
    """The exactly solved loop of a scenario.

    theta (K, 16) : [x; y_ref; u_prev; 1] of each step; state (K + 1, 6); tau (K, 3); z (K, n).
    """

    theta: Matrix
    state: Matrix
    tau: Matrix
    z: Matrix

    def save(self, path: Path) -> None:
        """Write to `path` (.npz)."""
        np.savez(path, theta=self.theta, state=self.state, tau=self.tau, z=self.z)

    @classmethod
    def load(cls, path: Path) -> ExactLoop:
        """Read what `save` wrote."""
        with np.load(path, allow_pickle=False) as data:
            return cls(**{name: data[name] for name in ("theta", "state", "tau", "z")})


def solve_exactly(scenario: Scenario) -> ExactLoop:
    """Run the scenario with the certified optimum of every step.

    Raises
    ------
    CertificateError : when a step has no certified optimum, e.g. an infeasible one.
    """
    builder = condense(scenario)
    log = RawLog.in_memory(loop_layout(scenario.steps, builder.n, builder.m, builder.Z.shape[1]))
    port = SolverPort(
        ExactWorkspace(), "condensed_box", base_problem(builder), time.perf_counter_ns
    )
    closed_loop(Voyage(scenario, builder, port, log, "hold", 2**62, time.perf_counter_ns))
    if log.flags[:, 0].any():
        k = int(np.flatnonzero(log.flags[:, 0])[0])
        raise CertificateError(f"{scenario.name}: step {k} has no certified optimum")
    return ExactLoop(log.theta, log.state, log.tau, log.z[0])


def base_problem(builder: CondensedQP) -> QuadraticProgram:
    """The problem at rest in the reference with no force applied: what a workspace sets up with."""
    problem = builder.control
    zero = np.zeros
    step = builder.emit(zero(problem.model.n_x), zero(problem.model.n_y), zero(problem.model.n_u))
    return builder.problem(step)


def sequence_of(
    scenario: Scenario,
    exact: ExactLoop,
    *,
    units: UnitSystem = "scaled",
    first: int = 0,
    count: int | None = None,
) -> QPSequence:
    """The QPs of `count` steps from `first` on along the exactly solved loop."""
    last = len(exact.theta) if count is None else first + count
    if not 0 <= first < last <= len(exact.theta):
        raise ResultsError(
            f"sequence of {scenario.name}",
            "first, count",
            f"{first}:{last}",
            f"steps within 0:{len(exact.theta)}",
        )
    builder = condense(scenario, units=units)
    n_x, n_y = builder.control.model.n_x, builder.control.model.n_y
    steps = [
        builder.emit(row[:n_x], row[n_x : n_x + n_y], row[n_x + n_y : -1])
        for row in exact.theta[first:last]
    ]
    name = scenario.name if first == 0 else f"{scenario.name}[{first}:{last}]"
    return QPSequence(
        name=name,
        base=builder.problem(steps[0]),
        q=np.array([step.q for step in steps]),
        l=np.array([step.l for step in steps]),
        u=np.array([step.u for step in steps]),
        units=None if units == "scaled" else builder.scale,
        scaled=None
        if units == "scaled"
        else sequence_of(scenario, exact, first=first, count=last - first),
        meta={"scenario": scenario.name, "sample_s": scenario.sample_s, "first": first},
    )


def record_sequence(scenario: Scenario, *, units: UnitSystem = "scaled") -> QPSequence:
    """The QPs along the exactly solved loop of a scenario, in memory."""
    return sequence_of(scenario, solve_exactly(scenario), units=units)
