"""Consequence analysis: after the loss of a failure group, can the rest make the force it takes?

IMO asks of ships of equipment class 2 and 3 for software that verifies, again and again, that the
ship stays where it is even if the worst failure occurs (MSC.1/Circ.1580, 1.2.5): that the
thrusters which remain can make the force and moment that are required before the failure
(MSC/Circ.645, 3.4.2.4). Required is what the controller applies, averaged:

    τ̄_k = τ̄_{k−1} + a (τ_k − τ̄_{k−1}),   a = 1 − exp(−T_s / 60 s),   τ̄_{−1} = 0

The mean is what lasts; waves and gusts pass before a ship has drifted off. No rule names the 60 s.
At each sample every group has a QP (`LossAllocation`), in which what is lost gives nothing, like
what the run has lost before; it has no feasible point where the loss cannot be held. Thrust is
nominal: interference between thrusters (MSC/Circ.645, 3.3.3) is for `dpbench capability`.
"""

from __future__ import annotations

import math

import numpy as np

from dpbench.arrays import Matrix
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import ThrusterRows
from dpbench.mpc.thrusters.static_allocation import LossAllocation
from dpbench.qp.program import QPSequence
from dpbench.scenario.controllers.controller import limit_tables
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import ThrusterSet

AVERAGE_S = 60.0
"""Time constant of the mean of the force [s]."""


def steered_rows(scenario: Scenario) -> tuple[ThrusterSet, ThrusterRows]:
    """The thrusters of a scenario and their limits; InputError where none are commanded."""
    commanded = scenario.controller.commanded
    if commanded is None:
        where, allowed = f"consequence analysis of {scenario.name}", '"thrusters" or "cascade"'
        raise InputError(where, "controller.kind", '"forces"', allowed)
    return commanded.thrusters, commanded.rows


def required_force(tau: Matrix, sample_s: float) -> Matrix:
    """τ̄ (K, 3), the mean of forces (K, 3) [N, N, N·m] over `AVERAGE_S`, known at each sample."""
    # A campaign starts half a second sooner without: it brings scipy.stats along.
    from scipy.signal import lfilter

    share = -math.expm1(-sample_s / AVERAGE_S)
    mean: Matrix = lfilter([share], [1.0, share - 1.0], tau, axis=0)
    return mean


def consequence_sequence(scenario: Scenario, tau: Matrix, group: str) -> QPSequence:
    """The QPs of a failure group's loss along a run.

    Parameters
    ----------
    scenario : commands thrusters; tau : (K, 3) the force of its run [N, N, N·m].
    group : a failure group of its ship.
    """
    thrusters, rows = steered_rows(scenario)
    # What a fault of the run takes shrinks the limits just as the loss does.
    low, high = limit_tables(scenario.controller.thruster_limits(len(tau)))
    least, most, _ = rows.without(thrusters.groups[group])
    low, high = np.maximum(low, least), np.minimum(high, most)
    allocation = LossAllocation(thrusters, rows)
    l, u = allocation.limits(required_force(tau, scenario.sample_s), low, high)  # noqa: E741 - as in the program
    base = allocation.problem(l[0], u[0])
    meta: dict[str, str | float | int]
    meta = {"scenario": scenario.name, "group": group, "sample_s": scenario.sample_s}
    name = f"{scenario.name}, {group} lost"
    return QPSequence(name, base, np.zeros((len(tau), base.n)), l, u, meta=meta)
