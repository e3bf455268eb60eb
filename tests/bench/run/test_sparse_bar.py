"""Exact solvers reach the condensed problem's certified plan in the sparse form, to 1e-7."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dpbench import load_scenario, open_workspace, record_sequence
from dpbench.bench.run.formulation import in_replay
from dpbench.bench.sequences.recording import with_horizons
from dpbench.qp.referee.referee import certify
from dpbench.solvers.table import available

BAR = 1e-7
"""error_plan: the largest error of any move of the plan, in rate-limit steps."""

PIQP = {
    **dict.fromkeys(("eps_abs", "eps_duality_gap_abs"), 1e-12),
    **dict.fromkeys(("eps_rel", "eps_duality_gap_rel"), 0.0),
    "max_iter": 1000,
    "tau": 0.9,
}
HPIPM = {
    "mode": "BALANCE",
    **dict.fromkeys(("tol_stat", "tol_eq"), 1e-10),
    "tol_ineq": 1e-12,
    # Where a limit is weakly active the error is the root of what is left of λ·slack.
    "tol_comp": 1e-14,
    "iter_max": 200,
}
SETTINGS: dict[str, Any] = {"piqp_multistage": PIQP, "hpipm_ocp": HPIPM, "hpipm": HPIPM}
# HPIPM's dense solver factorises all n = 300 variables at once.
STEPS = {"hpipm": 5}


@pytest.mark.parametrize("solver", [name for name in SETTINGS if available(name).ok])
@pytest.mark.parametrize(
    ("scenario", "horizons", "steps"),
    [("paper", (30, 5), 40), ("paper_tight", (30, 5), 40), ("rough", (60, 10), 15)],
)
def test_exact_solvers_meet_the_bar(
    solver: str, scenario: str, horizons: tuple[int, int], steps: int
) -> None:
    """Every answer is claimed, and each of its moves is that of the certified optimum."""
    case = with_horizons(load_scenario(scenario), *horizons).first(STEPS.get(solver, steps))
    condensed = record_sequence(case)
    sequence, form = in_replay("sparse", condensed)
    workspace = open_workspace(solver, route="native", policy="reuse", settings=SETTINGS[solver])
    workspace.setup(sequence.base)
    for k in range(len(sequence)):
        workspace.update(sequence.step(k))
        workspace.solve()
        found = workspace.read()
        assert found.claimed
        optimum = certify(condensed.problem(k))
        assert optimum.bound < BAR
        assert np.abs(form.solution(found).z - optimum.z).max() <= BAR
