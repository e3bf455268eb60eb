"""Stability of a controller's loop without limits: the largest |λ| of paper eq. 35.

Below 1 the loop of the controller's own linear model returns to the setpoint while no limit is
active. Above 1 the ship leaves it in any weather and with any solver.
"""

import json
import math
from functools import lru_cache

import numpy as np

from dpbench.errors import InputError
from dpbench.mpc.law import compute_closed_loop_eigenvalues, compute_state_feedback_gains
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents

ROUNDING = 1e-6
"""An eigenvalue up to so far outside the unit circle counts as on it."""


def compute_loop_eigenvalues(scenario: Scenario) -> np.ndarray:
    """Return the eigenvalues of a controller's loop without limits, largest modulus first."""
    problem = scenario.problem
    return compute_closed_loop_eigenvalues(problem.model, compute_state_feedback_gains(problem))


def find_unstable_radius(files: ScenarioDocuments) -> float:
    """Return the largest |λ| of a loop that is unstable without limits, else NaN.

    files : documents of the scenario. NaN, too, where they are incomplete, and where the controller
    weighs its force, which eq. 35 does not cover.
    """
    if not {"name", "scenario", "vessel", "vessel_name"} <= files.keys():
        return math.nan
    scenario = files["scenario"]
    weather = {k: v for k, v in (scenario.get("environment") or {}).items() if k != "seed"}
    # A study has many seas of one controller.
    same = files | {"scenario": scenario | {"environment": weather}}
    radius = _find_spectral_radius(json.dumps(same))
    return radius if radius > 1.0 + ROUNDING else math.nan


@lru_cache(maxsize=4096)
def _find_spectral_radius(text: str) -> float:
    """Return the largest |λ| of the scenario whose documents are given as JSON, or NaN."""
    try:
        scenario = build_scenario_from_documents(json.loads(text))
    except InputError:
        return math.nan
    if scenario.problem.W is not None:
        return math.nan
    return float(abs(compute_loop_eigenvalues(scenario)[0]))


def describe_unstable_loop(horizons: str, radius: float) -> str:
    """Return words for unstable loops: their prediction horizons and their largest |λ|."""
    return (
        f"unstable without limits at `prediction_horizon = {horizons}` "
        f"(largest |λ| {radius:.4f}, paper eq. 35)"
    )
