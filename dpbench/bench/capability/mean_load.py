"""Share of a ship's thrust that the mean load of a scenario's weather takes at the setpoint.

Above 1 the ship leaves its station in time, with any controller and solver.
"""

import json
import math
from functools import lru_cache

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.errors import InputError
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.scenario import build_scenario_from_documents
from dpbench.ship.characteristics import compute_mean_weather_force
from dpbench.ship.vessel import Vessel


def compute_share_of_thrust(vessel: Vessel, load: Vector) -> float:
    """Return the share of full thrust that balances a load (3,) [N, N, N·m] on a ship.

    Of a ship without thrusters, it is the largest share of the limits of its axes.
    """
    if vessel.thrusters is not None:
        return ThrusterReach(vessel.thrusters).find_least_thrust_share(-load)
    against = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    return float((np.abs(load) / against).max())


def find_overload(files: ScenarioDocuments) -> float:
    """Return the share of thrust that a scenario's mean load takes if it exceeds 1, else NaN.

    files : documents of the scenario. NaN, too, where they are incomplete.
    """
    if not {"name", "scenario", "vessel", "vessel_name"} <= files.keys():
        return math.nan
    share = _compute_share_of_documents(json.dumps(files))
    return share if share > 1.0 else math.nan


@lru_cache(maxsize=256)
def _compute_share_of_documents(text: str) -> float:
    """Return the share of thrust of the scenario whose documents are given as JSON, or NaN."""
    try:
        scenario = build_scenario_from_documents(json.loads(text))
        load = compute_mean_weather_force(
            scenario.vessel, scenario.environment, float(scenario.reference[2])
        )
    except InputError:
        return math.nan
    return compute_share_of_thrust(scenario.vessel, load)
