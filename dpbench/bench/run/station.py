"""Station keeping of the exactly solved loop: what the controller does, whatever the solver."""

import numpy as np

from dpbench.arrays import Flags, Matrix, Vector
from dpbench.bench.run.exact_loop import ExactLoop
from dpbench.scenario.scenario import Scenario
from dpbench.ship.froude import Froude
from dpbench.ship.layout import POSE

RADIUS_M, HEADING_DEG = 5.0, 5.0
"""Limits of the station at full size: the red limits of the example in IMCA M 220."""
ARRIVAL_S = 30.0
"""Time within the limits, at full size, after which a transfer has ended."""
DRIFT = 1.0
"""Growth of a distance, in multiples of the limits, that is no part of a transfer."""


def compute_station_metrics(scenario: Scenario, exact: ExactLoop, steps: int) -> dict[str, float]:
    """Return where the exactly solved loop's ship is in `steps` steps, and how often limits act.

    The ship is on station within `RADIUS_M` and `HEADING_DEG` of its setpoint, lengths and times
    scaled for a model ship. Offsets count from its arrival on, or all if it never arrives; after a
    loss of thrusters or limits those from the arrival on.
    """
    K = min(steps, len(exact.tau))
    offset, heading, distance, arrived, radius_m = _measure_offsets_and_arrivals(
        scenario, exact.state[: K + 1]
    )
    left = arrived & ~(distance <= 1.0)
    counted = arrived if arrived.any() else ~arrived
    largest = int(np.argmax(np.where(counted, offset, -1.0)))
    after_loss = arrived & (np.arange(K + 1) >= _first_loss_sample(scenario))
    return {
        "exact_steps": float(K),
        "station_radius_m": radius_m,
        "exact_offset_max_m": float(offset[largest]),
        "exact_offset_max_s": largest * scenario.sample_s,
        "exact_offset_end_m": float(offset[-1]),
        "exact_heading_max_deg": float(heading[counted].max()),
        "exact_heading_end_deg": float(heading[-1]),
        "exact_loss_offset_max_m": _largest(offset[after_loss]),
        "exact_loss_heading_max_deg": _largest(heading[after_loss]),
        "exact_left_s": float(np.argmax(left)) * scenario.sample_s if left.any() else np.nan,
        "exact_active_share": float(exact.active[:K].mean()),
    }


def _largest(values: Vector) -> float:
    """Return the largest of some values; NaN without any."""
    return float(values.max()) if len(values) else np.nan


def _first_loss_sample(scenario: Scenario) -> float:
    """Return the sample of a scenario's first fault; inf without one."""
    faults = scenario.files["scenario"].get("faults") or ()
    return min((round(fault["at_s"] / scenario.sample_s) for fault in faults), default=np.inf)


def compute_largest_offset_share(scenario: Scenario, state: Matrix) -> float:
    """Return the largest offset of a ship on station, in multiples of the station's limits.

    state : (K + 1, 6) at the samples. Offsets count as in `compute_station_metrics`; NaN where
    one is.
    """
    _, _, distance, arrived, _ = _measure_offsets_and_arrivals(scenario, state)
    return float(distance[arrived if arrived.any() else ~arrived].max())


def _measure_offsets_and_arrivals(
    scenario: Scenario, state: Matrix
) -> tuple[Vector, Vector, Vector, Flags, float]:
    """Return offset [m], heading error [°], distance [limits], arrivals (K,) and radius [m]."""
    scale = Froude(float(scenario.files["vessel"]["model_scale"]))
    wanted = scenario.build_reference_table(len(state))
    north, east, turn = (state[:, POSE] - wanted).T
    offset, heading = np.hypot(north, east), np.degrees(np.abs(turn))
    radius_m = RADIUS_M * scale.length_factor
    distance = np.maximum(offset / radius_m, heading / HEADING_DEG)
    moved = (np.diff(wanted, axis=0, prepend=wanted[:1]) != 0.0).any(axis=1)
    hold = round(ARRIVAL_S * scale.time_and_speed_factor / scenario.sample_s)
    return offset, heading, distance, mask_arrived_samples(distance, moved, hold), radius_m


def mask_arrived_samples(distance: Vector, moved: Flags, hold: int) -> Flags:
    """Return at which samples (K,) the ship has arrived at its setpoint, be it still there or not.

    It has from the start, or after `hold` samples within the limits, until the setpoint moves out
    of reach. A ship that ends `DRIFT` farther from a resting setpoint than it was has arrived, too:
    it has left.

    distance : (K,) from the setpoint, in multiples of the limits; moved : (K,) whether the setpoint
    differs from that of the sample before.
    """
    inside = distance <= 1.0
    arrived = np.zeros(len(distance), dtype=np.bool_)
    has_arrived, stay, away_from = bool(inside[0]), 0, 0
    for k in range(len(distance)):
        if moved[k] and not inside[k]:
            has_arrived, away_from = False, k
        stay = stay + 1 if inside[k] else 0
        has_arrived |= stay >= hold
        arrived[k] = has_arrived
    if not has_arrived and not distance[-1] <= distance[away_from] + DRIFT:
        arrived[away_from:] = True
    return arrived
