"""Sequences derived from a reference loop: consequence analysis and hardest window.

Consequence analysis verifies that after the worst failure the remaining thrusters can make the
force and moment that are required before it (IMO MSC.1/Circ.1580, 1.2.5; MSC/Circ.645, 3.4.2.4),
for ships of equipment class 2 and 3. Required is what the controller applies, through a 60 s filter
and times a dynamic margin, by default the 1.25 of DNV-ST-0111, level 1 (3.2.2):

    τ̄_k = τ̄_{k−1} + a (τ_k − τ̄_{k−1}),   a = 1 − exp(−T_s / 60 s),   τ̄_{−1} = τ_0

Waves and gusts pass before a ship has drifted off. No rule names the 60 s. At each sample every
failure group has a QP (`AllocationAfterLoss`) without feasible point where the loss cannot be held.
Thrust is nominal: interference (MSC/Circ.645, 3.3.3) is for `dpbench capability`.

Hardness comes from the certified optima alone, so it favours no solver. Over the closed loops of
suite `standard` the sum of active limits and their changes correlates better with the iterations of
20 solvers than either of them.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dpbench.arrays import Flags, Floats, Ints, Matrix
from dpbench.errors import InputError
from dpbench.mpc.thruster_rows import ThrusterRows
from dpbench.mpc.thrusters.allocation_qp import AllocationAfterLoss
from dpbench.qp.program import QPSequence
from dpbench.qp.referee.optimum import ACTIVE_MULTIPLIER, Optimum
from dpbench.scenario.controllers.controller import stack_lower_and_upper_limits
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import ThrusterSet

FILTER_S = 60.0  # Time constant of the filter of the force [s]


def select_thruster_rows(scenario: Scenario) -> tuple[ThrusterSet, ThrusterRows]:
    """Return a scenario's commanded thrusters and the rows of their limits; InputError if none."""
    commanded = scenario.controller.commanded_thrusters
    if commanded is None:
        where, allowed = f"consequence analysis of {scenario.name}", '"thrusters" or "cascade"'
        raise InputError(where, "controller.kind", '"forces"', allowed)
    return commanded.thrusters, commanded.rows


def filter_force(tau: Matrix, sample_s: float) -> Matrix:
    """Return forces (K, 3) [N, N, N·m] through a filter of `FILTER_S` that starts at the first."""
    # A campaign starts half a second sooner without: it brings scipy.stats along.
    from scipy.signal import lfilter

    share = -math.expm1(-sample_s / FILTER_S)
    filtered: Matrix
    filtered, _ = lfilter([share], [1.0, share - 1.0], tau, axis=0, zi=(1.0 - share) * tau[:1])
    return filtered


def build_consequence_sequence(
    scenario: Scenario, tau: Matrix, group: str, margin: float
) -> QPSequence:
    """Return the QPs that test if a force tau (K, 3) can be made without a failure group.

    margin : by which the filtered force is multiplied.
    """
    thrusters, rows = select_thruster_rows(scenario)
    # What a fault of the run takes shrinks the limits just as the loss does.
    low, high = stack_lower_and_upper_limits(
        scenario.controller.list_thruster_limits_by_sample(len(tau))
    )
    least, most, _ = rows.limits_after_loss_of_thrusters(thrusters.indices_by_failure_group[group])
    low, high = np.maximum(low, least), np.minimum(high, most)
    allocation = AllocationAfterLoss(thrusters, rows)
    required = margin * filter_force(tau, scenario.sample_s)
    l, u = allocation.stack_row_limits_of_demands(required, low, high)  # noqa: E741 - lower row limits, as in l ≤ Az ≤ u
    base = allocation.make_qp_with_row_limits(l[0], u[0])
    meta: dict[str, str | float | int]
    meta = {"scenario": scenario.name, "group": group, "sample_s": scenario.sample_s}
    name = f"{scenario.name}, {group} lost"
    return QPSequence(name, base, np.zeros((len(tau), base.n)), l, u, meta=meta)


def find_active_limits(optima: Sequence[Optimum]) -> Ints:
    """Return which limits (K, m + n) are active at each optimum: 1 upper, −1 lower, 0 none."""
    multipliers = np.array([np.concatenate((o.y, o.y_box)) for o in optima])
    active = np.abs(multipliers) > ACTIVE_MULTIPLIER
    active &= has_optimum(optima)[:, None]
    return np.where(active, np.sign(multipliers), 0).astype(np.int64)


def has_optimum(optima: Sequence[Optimum]) -> Flags:
    """Return a mask (K,) of the steps with a certified optimum."""
    finite: Flags = np.isfinite([optimum.bound for optimum in optima])
    return finite


def measure_hardness(active: Ints, feasible: Flags) -> Floats:
    """Return each step's hardness (K,): active limits plus their changes since the last step.

    A step without an optimum is harder by 1 than the hardest of all others.

    active : (K, m + n) as of `find_active_limits`; feasible : (K,) whether a step has an optimum.
    """
    before = np.vstack((np.zeros_like(active[:1]), active[:-1]))
    hard: Floats = (active != 0).sum(axis=1) + (active != before).sum(axis=1) + 0.0
    hard[~feasible] = hard.max() + 1.0
    return hard


def find_window_start(hard: Floats, steps: int) -> int:
    """Return where the window of `steps` around the hardest step with the most hardness begins."""
    sums = sliding_window_view(hard, steps).sum(axis=1)
    at = int(np.argmax(hard))
    earliest = max(0, at - steps + 1)
    return earliest + int(np.argmax(sums[earliest : at + 1]))


def find_hardest_window(optima: Sequence[Optimum], first: int, of: int, steps: int) -> int:
    """Return where the hardest `steps` QPs begin among the `of` steps from `first` on."""
    optima = optima[: first + of]
    hard = measure_hardness(find_active_limits(optima), has_optimum(optima))
    return first + find_window_start(hard[first:], steps)
