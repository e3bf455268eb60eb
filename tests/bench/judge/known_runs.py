"""A ship with round numbers, for control metrics of trajectories worked by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dpbench.bench.judge.control_metrics import control_metrics
from dpbench.bench.run.exact_loop import ExactLoop
from dpbench.scenario.scenario import Scenario, load_scenario

SAMPLE_S = 0.5
Rows = Sequence[Sequence[float]]


def round_ship(sample_s: float = SAMPLE_S, **changes: Any) -> Scenario:
    """Return a scenario with largest forces 200, 50, 20 and largest increments 10, 5, 2.

    The largest force in surge is the one astern, in sway the one to starboard.
    """
    calm = load_scenario("calm")
    ship = replace(
        calm.vessel,
        tau_min=np.array([-200.0, -40.0, -20.0]),
        tau_max=np.array([100.0, 50.0, 20.0]),
        rate_max=np.array([20.0, 10.0, 4.0]) * SAMPLE_S / sample_s,
    )
    weights = {"Q": np.eye(3), "R": np.eye(3)}
    return replace(calm, **({"sample_s": sample_s, "vessel": ship} | weights | changes))


def exact_loop(pose: Rows, tau: Rows, thrust: Rows | None = None) -> ExactLoop:
    """Return an exactly solved loop of these poses [m, m, rad] and forces, at rest."""
    state = np.zeros((len(pose), 6))
    state[:, 3:] = pose
    forces = np.array(tau, dtype=float)
    K = len(forces)
    of_thrusters = np.zeros((K, 0)) if thrust is None else np.array(thrust, dtype=float)
    return ExactLoop(np.zeros((K, 16)), state, forces, of_thrusters, np.zeros((K, 15)), [])


def metrics_of(
    pose: Rows,
    u: Rows | None = None,
    *,
    velocity: Rows | None = None,
    reference: Rows | None = None,
    limits: tuple[Rows, Rows] | None = None,
    exact: ExactLoop | None = None,
    scenario: Scenario | None = None,
) -> dict[str, float]:
    """Return the control metrics of a run.

    Parameters
    ----------
    pose : (K + 1, 3) north, east, heading [m, m, rad] at the sample times.
    u : (K, n_u) what was applied; None for nothing.
    velocity : (K + 1, 3) of the ship; None for a ship at rest.
    reference : (K + 1, 3) or more; None for zero.
    limits : least and most force of each sample (K, 3) or more; None for the ship's own.
    exact : the exactly solved loop; None for one that stays at zero.
    """
    ship = round_ship() if scenario is None else scenario
    K = len(pose) - 1
    state = np.zeros((K + 1, 6))
    state[:, 3:] = pose
    if velocity is not None:
        state[:, :3] = velocity
    applied = np.zeros((K, 3)) if u is None else np.array(u, dtype=float)
    wanted = np.zeros((K + 1, 3)) if reference is None else np.array(reference, dtype=float)
    own = ship.vessel.tau_min, ship.vessel.tau_max
    tables = [np.tile(side, (K, 1)) for side in own] if limits is None else map(np.array, limits)
    low, high = tables
    nothing = np.zeros_like(applied)
    still = exact_loop(np.zeros((K + 1, 3)).tolist(), np.zeros((K, 3)).tolist(), nothing.tolist())
    loop = still if exact is None else exact
    return control_metrics(ship, state, applied, wanted, (low, high), loop)
