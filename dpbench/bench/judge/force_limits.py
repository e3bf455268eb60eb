"""How often a controller of forces was at its limits, and beyond them, in one run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dpbench.arrays import Flags, Matrix
from dpbench.bench.judge.control_metrics import AT_LIMIT, before_each
from dpbench.bench.record.schema import FORCES
from dpbench.mpc.thruster_rows import Limits
from dpbench.scenario.controllers.controller import limit_tables
from dpbench.scenario.scenario import Scenario


def axis_limit_metrics(
    scenario: Scenario, tau: Matrix, limits: Sequence[Limits]
) -> dict[str, float]:
    """Shares of steps at the limits of each axis, and steps beyond one.

    Parameters
    ----------
    tau : (K, 3) forces applied; limits : those in force, of at least K samples.
    """
    du_max, before = scenario.problem.du_max, before_each(tau)
    low, high = limit_tables(limits[: len(tau)])
    near = AT_LIMIT * du_max
    at_amplitude = (tau >= high - near) | (tau <= low + near)
    # What the rate leaves of a limit that has just dropped is no violation.
    above = tau > np.maximum(high, before - du_max)
    below = tau < np.minimum(low, before + du_max)
    violated = (above | below).any(axis=1) | _too_fast(scenario, tau)
    shares = {f"at_amplitude_{force}": at_amplitude[:, i] for i, force in enumerate(FORCES)}
    return (
        _rate_shares(scenario, tau)
        | {name: float(share.mean()) for name, share in shares.items()}
        | {"limit_violations": float(violated.sum())}
    )


def joint_limit_metrics(
    scenario: Scenario, tau: Matrix, limits: Sequence[Limits]
) -> dict[str, float]:
    """Return the same of a force limited as a whole, by what its thrusters give together."""
    problem = scenario.problem
    near = AT_LIMIT * problem.row_max
    low, high = limit_tables(limits[: len(tau)])
    along, before = tau @ problem.G.T, before_each(tau) @ problem.G.T
    at_limit = ((along >= high - near) | (along <= low + near)).any(axis=1)
    # Outside a set that has shrunk the force must come nearer: a smaller share of the whole set.
    outside = ((along > high + near) | (along < low - near)).any(axis=1)
    share, share_before = (
        np.maximum(rows / problem.u_max, rows / problem.u_min).max(axis=1)
        for rows in (along, before)
    )
    violated = (outside & (share > share_before + 1e-9)) | _too_fast(scenario, tau)
    return _rate_shares(scenario, tau) | {
        "limit_violations": float(violated.sum()),
        "at_limit_thrusters": float(at_limit.mean()),
    }


def _rate_shares(scenario: Scenario, tau: Matrix) -> dict[str, float]:
    """Shares of steps at the rate limit of each axis."""
    du_max = scenario.problem.du_max
    at_rate = np.abs(tau - before_each(tau)) >= du_max - AT_LIMIT * du_max
    return {f"at_rate_{force}": float(at_rate[:, i].mean()) for i, force in enumerate(FORCES)}


def _too_fast(scenario: Scenario, tau: Matrix) -> Flags:
    """Whether each force (K, 3) is beyond the rate limits: (K,)."""
    ship, du_max = scenario.vessel, scenario.problem.du_max
    # Beyond one unit in the last place of the force itself a difference is no rounding.
    rounding = 4 * np.spacing(np.maximum(ship.tau_max, -ship.tau_min))
    too_fast: Flags = (np.abs(tau - before_each(tau)) > du_max + rounding).any(axis=1)
    return too_fast
