"""Search space of a scenario: how the ship starts, and what pushes it.

A point x in [−1, 1]^d makes a scenario with documents of its own, as any file under
`problems/scenarios/`:

    x[0:3]  start, relative to the reference: sign(x)·x²·reach [m, m, rad], which samples small
            offsets as closely as large ones
    x[3:6]  speed at the start over ground, along the ship's axes: sign(x)·x²·reach [m/s, rad/s]
    x[6:9]  steady force: x · what the thrusters can hold
    x[9:12] force added within one sample, which stays: 2 · x · what they can hold, enough to
            reverse the sum
    x[12]   when that happens, from the first sample to the last
    x[13]   when the first fault happens; only where the scenario has faults

A run starts without force (docs/method.md), and is long enough to reach the limits.
"""

import copy

import numpy as np

from dpbench.arrays import Vector
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents
from dpbench.ship.froude import Froude

REACH = np.array([20.0, 20.0, np.radians(20.0)])
"""Smallest reach of the start [m, m, rad], at full size: that of a large move.

It is within the 30° in which a linearised model is fine.
"""
SPEED_REACH = np.array([1.0, 1.0, np.radians(1.0)])
"""Smallest reach of the speed [m/s, m/s, rad/s], at full size: a ship that arrives."""
_KN_PER_N = 1e-3
_START, _SPEED, _STEADY, _ON_TOP = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
_WHEN, _FIRST_FAULT = 12, 13


class SearchSpace:
    """The variants, of `steps` samples, that a search tries: start, speed, steady and sudden force.

    All share the ship, controller and weather of `scenario`; a start further from the reference
    than `REACH`, or faster than `SPEED_REACH`, widens the reach.
    """

    def __init__(self, scenario: Scenario, steps: int, name: str) -> None:
        self._files, self._steps, self._name = scenario.files, steps, name
        scale = Froude(float(scenario.files["vessel"]["model_scale"]))
        # The documents speak of a full-size ship, the scenario of the one it is run with.
        self._reference = scenario.reference / scale.pose_factors
        self._reach = np.maximum(
            REACH, np.abs(scenario.start - scenario.reference) / scale.pose_factors
        )
        self._fastest = np.maximum(SPEED_REACH, np.abs(scenario.velocity) / scale.velocity_factors)
        vessel = scenario.vessel
        self._force_kN = (
            _KN_PER_N * np.minimum(-vessel.tau_min, vessel.tau_max) / scale.force_and_moment_factors
        )
        faults = scenario.files["scenario"]["faults"]
        self._first_fault_s = min((fault["at_s"] for fault in faults), default=None)

    @property
    def dimensions(self) -> int:
        """Number d of parameters that make a variant of the scenario."""
        return _FIRST_FAULT if self._first_fault_s is None else _FIRST_FAULT + 1

    def build_variant(self, point: Vector) -> Scenario:
        """Return the scenario variant that a point (d,) in [−1, 1]^d describes."""
        files = copy.deepcopy(self._files)
        files["name"] = self._name
        table = files["scenario"]
        sample_s = float(table["sample_s"])
        duration_s = self._steps * sample_s
        closely = np.sign(point) * point**2
        north_m, east_m, heading = self._reference + closely[_START] * self._reach
        surge_mps, sway_mps, yaw_rate = closely[_SPEED] * self._fastest
        table["duration_s"] = duration_s
        table["start"] = {
            "north_m": float(north_m),
            "east_m": float(east_m),
            "heading_deg": float(np.degrees(heading)),
            "surge_mps": float(surge_mps),
            "sway_mps": float(sway_mps),
            "yaw_degps": float(np.degrees(yaw_rate)),
        }
        weather = table["environment"]
        # A weather that builds up over a minute would not be there yet.
        weather["ramp_s"] = 0.0
        weather["mean_kN"] = (point[_STEADY] * self._force_kN).tolist()
        weather["squalls"].append(
            {
                "start_s": _scale_to_time(point[_WHEN], duration_s, sample_s),
                "rise_s": sample_s,
                "hold_until_s": 2.0 * duration_s,
                "decay_s": sample_s,
                "force_kN": (2.0 * point[_ON_TOP] * self._force_kN).tolist(),
            }
        )
        if self._first_fault_s is not None:
            later = _scale_to_time(point[_FIRST_FAULT], duration_s, sample_s) - self._first_fault_s
            for fault in table["faults"]:
                fault["at_s"] = max(0.0, fault["at_s"] + later)
        return build_scenario_from_documents(files, where=f"variant of {self._name}")


def _scale_to_time(share: float, duration_s: float, sample_s: float) -> float:
    """Return the time [s] for a number in [−1, 1]: −1 is the first sample, 1 the last."""
    return float(0.5 * (1.0 + share) * (duration_s - sample_s))
