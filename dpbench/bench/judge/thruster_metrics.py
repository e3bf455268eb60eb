"""Metrics of controllers that command thrusters: thrust, power, wear, limits.

Power of a propeller grows as |f|^1.5 (constant pitch, at zero speed); the wear of its drive is
measured by how much its thrust varies and how far its azimuth travels.
"""

from collections.abc import Sequence

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.bench.judge.control_metrics import AT_LIMIT
from dpbench.mpc.thruster_rows import LimitRampDown, Limits
from dpbench.scenario.controllers.commanded import ThrusterControl
from dpbench.scenario.controllers.controller import stack_limits
from dpbench.scenario.scenario import Scenario

PUSHING = 0.01
"""Share of its full thrust from which the direction of a thruster counts."""


def compute_used_thrust_and_power_shares(scenario: Scenario, f: Matrix) -> dict[str, Vector]:
    """Return the used shares of full thrust and power (K,) from thruster forces f (K, n_f) [N]."""
    control = scenario.controller.commanded
    if control is None:
        return {}
    thrusters = control.thrusters
    size, most = thrusters.thruster_force_magnitudes(f), thrusters.largest_thrusts_N
    power: Vector = (size**1.5).sum(axis=1) / (most**1.5).sum()
    return {"thrust_share": size.sum(axis=1) / most.sum(), "power_share": power}


def compute_thruster_metrics(
    scenario: Scenario, f: Matrix, limits: Sequence[Limits]
) -> dict[str, float]:
    """Return thrust, power, wear and limit metrics of the thruster forces f (K, n_f) [N]."""
    control = scenario.controller.commanded
    assert control is not None, "a controller of thrusters"
    step_max = control.thrusters.largest_force_changes_per_sample(scenario.sample_s)
    before = np.array([control.force_before(f, k) for k in range(len(f))])
    change = f - before
    shares = compute_used_thrust_and_power_shares(scenario, f)
    per_entry = control.thrusters.repeat_for_each_force_entry(control.thrusters.largest_thrusts_N)
    turned_deg, reversals = _azimuth_travel_and_reversals(control, f, before)
    at_rate = np.abs(change) >= (1.0 - AT_LIMIT) * step_max
    at_limit, violated = _limit_share_and_violations(control, step_max, f, before, limits)
    return {
        "thrust_share": float(shares["thrust_share"].mean()),
        "power_share": float(shares["power_share"].mean()),
        "thrust_variation": float(np.abs(change / per_entry).sum()),
        "azimuth_travel_deg": turned_deg,
        "thrust_reversals": reversals,
        "at_rate_thrusters": float(at_rate.any(axis=1).mean()),
        "at_limit_thrusters": at_limit,
        "limit_violations": violated,
    }


def _azimuth_travel_and_reversals(
    control: ThrusterControl, f: Matrix, before: Matrix
) -> tuple[float, float]:
    """Return how far azimuth thrusters turned [°], and how often fixed thrusters reversed."""
    turned, reversals = 0.0, 0
    parts = zip(control.thrusters.thrusters, control.thrusters.slices_in_force_vector, strict=True)
    for thruster, at in parts:
        now, then = f[:, at], before[:, at]
        least = PUSHING * thruster.thrust_N
        pushing = (np.linalg.norm(now, axis=1) > least) & (np.linalg.norm(then, axis=1) > least)
        if thruster.component_count == 2:
            cross = then[:, 0] * now[:, 1] - then[:, 1] * now[:, 0]
            turned += float(np.abs(np.arctan2(cross, (now * then).sum(axis=1)))[pushing].sum())
        else:
            sides = np.sign(f[np.abs(f[:, at.start]) > least, at.start])
            reversals += int(np.count_nonzero(np.diff(sides)))
    return float(np.degrees(turned)), float(reversals)


def _limit_share_and_violations(
    control: ThrusterControl, step_max: Vector, f: Matrix, before: Matrix, limits: Sequence[Limits]
) -> tuple[float, float]:
    """Return the share of steps with a thruster at its limit, and how many violate a limit.

    What the rate leaves of a limit that has just dropped is not beyond it.
    """
    unit, G = control.rows.largest_row_changes_per_step(step_max), control.rows.G
    low, high = stack_limits(limits[: len(f)])
    lost = np.array([in_force.lost for in_force in limits[: len(f)]])[:, control.rows.thruster]
    along = f @ G.T
    near = AT_LIMIT * unit
    # A thruster that was lost is at nothing, not at a limit.
    at_limit = (((along >= high - near) | (along <= low + near)) & ~lost).any(axis=1)
    beyond = ((along > high) | (along < low)).any(axis=1)
    too_fast = control.exceeds_rate(f, before, step_max)
    ramp_down = LimitRampDown(control.rows, step_max, unit, 1)
    violated = int(too_fast.sum())
    for k in np.flatnonzero(beyond & ~too_fast).tolist():
        change = along[k] - G @ before[k]
        least, most = (
            side[0] * unit
            for side in ramp_down.compute_gradually_tightened_limits(before[k], limits[k])
        )
        outside = (change > most + 1e-9 * unit) | (change < least - 1e-9 * unit)
        violated += bool(outside.any())
    return float(at_limit.mean()), float(violated)
