"""Warm starts along a sequence whose matrices change at every step."""

from functools import cache

import numpy as np
import pytest

from dpbench import load_scenario, open_workspace, record_sequence
from dpbench.qp.program import QPSequence
from dpbench.solvers.contract import Workspace
from dpbench.solvers.table import find_solver_availability


@pytest.mark.parametrize("solver", ["daqp", "osqp", "proxqp", "qpalm", "scs", "superadmm"])
def test_a_warm_start_outlives_a_change_of_the_matrices(solver: str) -> None:
    """Along `turn`, whose model turns with the ship: fewer iterations than from a cold start."""
    if not find_solver_availability(solver).ok:
        pytest.skip(f"{solver} is not installed")  # an extra; the core is tested without it
    recorded = _record_turning_ship()
    workspaces = [
        open_workspace(solver, route="native", policy=policy) for policy in ("fresh", "warm")
    ]
    iterations = np.array([_count_iterations(one, recorded) for one in workspaces])
    assert workspaces[1].matrix_updates == len(recorded) - 1
    cold, started = iterations[:, 1:].sum(axis=1)
    assert iterations[0, 0] == iterations[1, 0] and started < cold


@cache
def _record_turning_ship() -> QPSequence:
    return record_sequence(load_scenario("turn").truncate(20))


def _count_iterations(workspace: Workspace, recorded: QPSequence) -> list[int]:
    workspace.setup(recorded.problem(0))
    counts = []
    for k in range(len(recorded)):
        if k:
            workspace.update(recorded.step(k))
        workspace.solve()
        counts.append(workspace.read().iterations)
    return counts
