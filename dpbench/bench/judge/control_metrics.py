"""Closed-loop metrics of one run (docs/method.md, section Control), from arrays alone.

Those of thrusters are thrust, power, wear and limits. Power of a propeller grows as |f|^1.5
(constant pitch, at zero speed); the wear of its drive is measured by how much its thrust varies and
how far its azimuth travels.
"""

import json
from collections.abc import Sequence

import numpy as np

from dpbench.arrays import Flags, Floats, Matrix, Vector
from dpbench.bench.record.schema import FORCES, POSE_AXES
from dpbench.bench.run.exact_loop import ExactLoop
from dpbench.mpc.thruster_rows import LimitRampDown, Limits
from dpbench.scenario.controllers.controller import ThrusterControl, stack_lower_and_upper_limits
from dpbench.scenario.scenario import Scenario
from dpbench.ship.layout import POSE, VELOCITY

AT_LIMIT = 1e-6
"""Share of the limit's own step within which a force is at the limit."""
PUSHING = 0.01
"""Share of its full thrust from which the direction of a thruster counts."""


def compute_control_metrics(
    scenario: Scenario, state: Matrix, u: Matrix, reference: Matrix, exact: ExactLoop
) -> dict[str, float]:
    """Return pose error, settling, effort and cost metrics of a closed loop of K steps.

    state : (K + 1, 6) [u, v, r, n, e, ψ] at the samples; u : (K, n_u) force or thruster forces.
    reference : at least (K + 1, 3) [n, e, ψ]; exact : the reference loop, at least as long.
    """
    K, controller = len(u), scenario.controller
    tau = controller.convert_commands_to_ship_force(u)
    exact_u = controller.select_applied_commands(exact.tau, exact.thrust)[:K]
    dt = scenario.sample_s
    error = state[:K, POSE] - reference[:K]
    north, east, turn = error.T
    radius = np.hypot(north, east)
    heading = np.degrees(np.abs(turn))
    t = np.arange(K, dtype=np.float64) * dt
    metrics = {
        "r_rms_m": _root_mean_square(radius),
        "r_95_m": float(np.quantile(radius, 0.95)),
        "r_max_m": float(radius.max()),
        "r_tail_max_m": float(radius[K // 2 :].max()),
        "heading_rms_deg": _root_mean_square(heading),
        "heading_max_deg": float(heading.max()),
        "settle_s": _settling_time_of_flags(t, (radius <= 1.0) & (heading <= 1.0), dt, hold_s=30.0),
        "settle_0p1m_s": _settling_time_of_flags(t, radius <= 0.1, dt, hold_s=None),
        "share_1m": float(np.mean(radius <= 1.0)),
        "pose_error": float(np.mean(radius + 0.75**radius * np.abs(turn))),
        "closed_loop_cost": _compute_quadratic_cost(scenario, state[: K + 1], u, reference),
        "exact_cost": _compute_quadratic_cost(scenario, exact.state[: K + 1], exact_u, reference),
    }
    return (
        metrics
        | _compute_zone_shares(radius, heading)
        | _compute_axis_error_metrics(t, error, dt)
        | _compute_effort_metrics(scenario, state[:K, VELOCITY], tau)
        | _compare_with_exact_loop(state[:K], tau, exact)
    )


def shift_forces_by_one_step(forces: Matrix) -> Matrix:
    """Return the force before each of K forces (K, n); zero before the first."""
    return np.vstack([np.zeros(forces.shape[1]), forces[:-1]])


def _compute_zone_shares(radius: Vector, heading: Vector) -> dict[str, float]:
    """Return the shares of time in the green, yellow and red zone of position and heading."""
    green = (radius <= 3.0) & (heading <= 3.0)
    red = (radius > 5.0) | (heading > 5.0)
    return {
        "share_green": float(np.mean(green)),
        "share_red": float(np.mean(red)),
        "share_yellow": float(np.mean(~green & ~red)),
    }


def _compute_axis_error_metrics(t: Vector, error: Matrix, dt: float) -> dict[str, float]:
    """Return IAE, ISE, ITAE and overshoot of each axis by column, from its errors (steps, 3)."""
    metrics = {}
    for i, axis in enumerate(POSE_AXES):
        size = np.abs(error[:, i])
        metrics[f"iae_{axis}"] = float(size.sum() * dt)
        metrics[f"ise_{axis}"] = float((size**2).sum() * dt)
        metrics[f"itae_{axis}"] = float((t * size).sum() * dt)
        metrics[f"overshoot_{axis}"] = _overshoot_of_error(error[:, i])
    return metrics


def _root_mean_square(values: Floats) -> float:
    """Return the root mean square of some values."""
    return float(np.sqrt(np.mean(values**2)))


def _settling_time_of_flags(t: Vector, inside: Flags, dt: float, hold_s: float | None) -> float:
    """Return the first time [s] after which `inside` stays true for `hold_s` (None: to the end)."""
    if hold_s is None:
        outside = np.flatnonzero(~inside)
        first = int(outside[-1]) + 1 if len(outside) else 0
        return float(t[first]) if first < len(t) else np.inf
    needed = max(1, round(hold_s / dt))
    if len(inside) < needed:
        return np.inf
    held = np.convolve(inside, np.ones(needed), mode="valid") >= needed - 0.5
    return float(t[np.argmax(held)]) if held.any() else np.inf


def _overshoot_of_error(error: Vector) -> float:
    """Return the overshoot: the largest error of opposite sign to the first; NaN if that is 0."""
    if error[0] == 0.0:
        return np.nan
    return float(max(0.0, np.max(-np.sign(error[0]) * error)))


def _compute_quadratic_cost(
    scenario: Scenario, state: Matrix, u: Matrix, reference: Matrix
) -> float:
    """Return the quadratic control cost of K steps: pose error, input change, thruster input."""
    error = state[1:, POSE] - reference[1 : len(state)]
    change = np.diff(u, axis=0, prepend=np.zeros((1, u.shape[1])))
    problem = scenario.problem
    cost = np.einsum("ki,ij,kj->", error, problem.Q, error)
    cost += np.einsum("ki,ij,kj->", change, problem.R, change)
    if problem.W is not None:
        cost += np.einsum("ki,ij,kj->", u, problem.W, u)
    return 0.5 * float(cost)


def _compute_effort_metrics(scenario: Scenario, nu: Matrix, tau: Matrix) -> dict[str, float]:
    """Return thrust effort [s], total variation and work [J] of the applied forces."""
    largest = np.maximum(scenario.vessel.tau_max, -scenario.vessel.tau_min)
    power = np.abs(np.einsum("ki,ki->k", tau, nu))
    return {
        "effort_s": float(((tau / largest) ** 2).sum() * scenario.sample_s),
        "total_variation": compute_force_travel(scenario, tau),
        "work_J": float(power.sum() * scenario.sample_s),
    }


def compute_force_travel(scenario: Scenario, tau: Matrix) -> float:
    """Return the total variation of applied forces (K, 3), in multiples of the largest forces."""
    largest = np.maximum(scenario.vessel.tau_max, -scenario.vessel.tau_min)
    return float(np.abs((tau - shift_forces_by_one_step(tau)) / largest).sum())


def _compare_with_exact_loop(state: Matrix, tau: Matrix, exact: ExactLoop) -> dict[str, float]:
    """Return the largest and RMS deviation of pose and force from the reference loop."""
    K = len(tau)
    north, east, turn = (state - exact.state[:K])[:, POSE].T
    position = np.hypot(north, east)
    heading = np.degrees(np.abs(turn))
    force = np.abs(tau[:, :2] - exact.tau[:K, :2]).max(axis=1)
    return {
        "dev_position_max_m": float(position.max()),
        "dev_position_rms_m": _root_mean_square(position),
        "dev_heading_max_deg": float(heading.max()),
        "dev_heading_rms_deg": _root_mean_square(heading),
        "dev_force_max_N": float(force.max()),
        "dev_force_rms_N": _root_mean_square(force),
    }


def compute_axis_limit_metrics(
    scenario: Scenario, tau: Matrix, limits: Sequence[Limits]
) -> dict[str, float]:
    """Return shares of steps at limits of each axis, and violations, of applied tau (K, 3)."""
    du_max, before = scenario.problem.du_max, shift_forces_by_one_step(tau)
    low, high = stack_lower_and_upper_limits(limits[: len(tau)])
    near = AT_LIMIT * du_max
    at_amplitude = (tau >= high - near) | (tau <= low + near)
    # What the rate leaves of a limit that has just dropped is no violation.
    above = tau > np.maximum(high, before - du_max)
    below = tau < np.minimum(low, before + du_max)
    violated = (above | below).any(axis=1) | _mask_steps_over_rate_limit(scenario, tau)
    shares = {f"at_amplitude_{force}": at_amplitude[:, i] for i, force in enumerate(FORCES)}
    return (
        _compute_rate_limit_shares(scenario, tau)
        | {name: float(share.mean()) for name, share in shares.items()}
        | {"limit_violations": float(violated.sum())}
    )


def compute_joint_limit_metrics(
    scenario: Scenario, tau: Matrix, limits: Sequence[Limits]
) -> dict[str, float]:
    """Return shares of steps at limits that thrusters set jointly, and the number of violations."""
    problem = scenario.problem
    near = AT_LIMIT * problem.row_max
    low, high = stack_lower_and_upper_limits(limits[: len(tau)])
    along, before = tau @ problem.G.T, shift_forces_by_one_step(tau) @ problem.G.T
    at_limit = ((along >= high - near) | (along <= low + near)).any(axis=1)
    # Outside a set that has shrunk the force must come nearer: a smaller share of the whole set.
    outside = ((along > high + near) | (along < low - near)).any(axis=1)
    share, share_before = (
        np.maximum(rows / problem.u_max, rows / problem.u_min).max(axis=1)
        for rows in (along, before)
    )
    violated = (outside & (share > share_before + 1e-9)) | _mask_steps_over_rate_limit(
        scenario, tau
    )
    return _compute_rate_limit_shares(scenario, tau) | {
        "limit_violations": float(violated.sum()),
        "at_limit_thrusters": float(at_limit.mean()),
    }


def _compute_rate_limit_shares(scenario: Scenario, tau: Matrix) -> dict[str, float]:
    """Return by column the share of steps at which each force changes at its rate limit."""
    du_max = scenario.problem.du_max
    at_rate = np.abs(tau - shift_forces_by_one_step(tau)) >= du_max - AT_LIMIT * du_max
    return {f"at_rate_{force}": float(at_rate[:, i].mean()) for i, force in enumerate(FORCES)}


def _mask_steps_over_rate_limit(scenario: Scenario, tau: Matrix) -> Flags:
    """Return whether each applied force (K, 3) changed faster than the rate limit: (K,)."""
    ship, du_max = scenario.vessel, scenario.problem.du_max
    # Beyond one unit in the last place of the force itself a difference is no rounding.
    rounding = 4 * np.spacing(np.maximum(ship.tau_max, -ship.tau_min))
    too_fast: Flags = (np.abs(tau - shift_forces_by_one_step(tau)) > du_max + rounding).any(axis=1)
    return too_fast


def compute_used_thrust_and_power_shares(scenario: Scenario, f: Matrix) -> dict[str, Vector]:
    """Return the used shares of full thrust and power (K,) from thruster forces f (K, n_f) [N]."""
    control = scenario.controller.commanded_thrusters
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
    control = scenario.controller.commanded_thrusters
    assert control is not None, "a controller of thrusters"
    step_max = control.thrusters.largest_force_changes_per_sample(scenario.sample_s)
    before = np.array([control.get_force_before_step(f, k) for k in range(len(f))])
    change = f - before
    shares = compute_used_thrust_and_power_shares(scenario, f)
    per_entry = control.thrusters.repeat_for_each_force_entry(control.thrusters.largest_thrusts_N)
    turned_deg, reversals = _azimuth_travel_and_reversals(control, f, before)
    at_rate = np.abs(change) >= (1.0 - AT_LIMIT) * step_max
    at_limit, violated = _compute_limit_share_and_violations(control, step_max, f, before, limits)
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


def _compute_limit_share_and_violations(
    control: ThrusterControl, step_max: Vector, f: Matrix, before: Matrix, limits: Sequence[Limits]
) -> tuple[float, float]:
    """Return the share of steps with a thruster at its limit, and how many violate a limit.

    What the rate leaves of a limit that has just dropped is not beyond it.
    """
    unit, G = control.rows.largest_row_changes_per_step(step_max), control.rows.G
    low, high = stack_lower_and_upper_limits(limits[: len(f)])
    along = f @ G.T
    at_limit = _mask_rows_at_limit(control, step_max, f, limits).any(axis=1)
    beyond = ((along > high) | (along < low)).any(axis=1)
    too_fast = control.exceeds_rate_limits(f, before, step_max)
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


def _mask_rows_at_limit(
    control: ThrusterControl, step_max: Vector, f: Matrix, limits: Sequence[Limits]
) -> Flags:
    """Return at which rows (K, r) of the limits forces f (K, n_f) are, lost thrusters excepted."""
    rows, along = control.rows, f @ control.rows.G.T
    low, high = stack_lower_and_upper_limits(limits[: len(f)])
    near = AT_LIMIT * rows.largest_row_changes_per_step(step_max)
    # A thruster that was lost is at nothing, not at a limit.
    lost = np.array([in_force.lost for in_force in limits[: len(f)]])[:, rows.thruster]
    at_limit: Flags = ((along >= high - near) | (along <= low + near)) & ~lost
    return at_limit


def describe_thruster_use_as_json(
    scenario: Scenario, f: Matrix, limits: Sequence[Limits], left_s: float
) -> str:
    """Return `exact_thruster_use` of the thruster forces f (K, n_f) [N]; "" without thrusters.

    left_s : when the ship leaves its station [s], or NaN.
    """
    control = scenario.controller.commanded_thrusters
    if control is None:
        return ""
    end = len(f) if np.isnan(left_s) else max(1, round(left_s / scenario.sample_s))
    faults = scenario.files["scenario"].get("faults") or ()
    lost_at = [round(fault["at_s"] / scenario.sample_s) for fault in faults if fault.get("lost")]
    first = max((k for k in lost_at if k < end), default=0)
    thrusters, most = control.thrusters, control.thrusters.largest_thrusts_N
    step_max = thrusters.largest_force_changes_per_sample(scenario.sample_s)
    before = np.array([control.get_force_before_step(f, k) for k in range(first, end)])
    f, limits = f[first:end], limits[first:end]
    share, left = thrusters.thruster_force_magnitudes(f) / most, ~limits[-1].lost
    at_limit = _mask_rows_at_limit(control, step_max, f, limits)
    at_rate = np.abs(f - before) >= (1.0 - AT_LIMIT) * step_max
    # An idle azimuth is at the corner of its sector.
    at_limit &= (share > PUSHING)[:, control.rows.thruster]
    used = {
        thrusters.thrusters[i].name: [
            *_mean_and_largest(share[:, i]),
            float(at_limit[:, control.rows.thruster == i].any(axis=1).mean()),
            float(at_rate[:, control.rows.entry == i].any(axis=1).mean()),
        ]
        for i in np.flatnonzero(left).tolist()
    }
    total = share[:, left] @ most[left] / most[left].sum() if used else np.zeros(1)
    window_s = [first * scenario.sample_s, end * scenario.sample_s]
    use = {"window_s": window_s, "thrust": _mean_and_largest(total), "thrusters": used}
    return json.dumps(use, ensure_ascii=False)


def _mean_and_largest(values: Vector) -> list[float]:
    """Return the mean and the largest of some values."""
    return [float(values.mean()), float(values.max())]
