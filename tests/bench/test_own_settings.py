"""Custom settings reach the solver, and the results say which they were."""

from pathlib import Path

import pytest

from dpbench import load_results, run_campaign
from dpbench.errors import InputError

pytestmark = pytest.mark.slow

SUITE = """
title = "A suite for one test"
solvers = ["osqp"]
baseline_law = false
cell_limit_s = 60.0
rounds = 1
warmup_steps = 0

[settings.short]
osqp = { max_iter = 7, check_termination = 1, eps_abs = 1e-13, eps_rel = 0.0 }

[[closed_loop]]
scenarios = ["paper"]
settings = ["default", "short"]
steps = 4
"""


def test_each_set_of_options_runs_and_is_recorded(tmp_path: Path) -> None:
    """OSQP's iterations are those that each limit of its own allows."""
    suite, out = tmp_path / "suite.toml", tmp_path / "out"
    suite.write_text(SUITE)
    strict = "check_termination=1,eps_abs=1e-13,eps_rel=0.0"
    solvers = ["osqp", f"osqp[max_iter=[3,5],{strict}]"]
    run_campaign(suite, out, solvers=solvers)
    runs = load_results(out).runs.set_index("settings")
    limits = {"short": 7, "check_termination=1,eps_abs=1e-13,eps_rel=0.0,max_iter=3": 3}
    limits["check_termination=1,eps_abs=1e-13,eps_rel=0.0,max_iter=5"] = 5
    assert set(runs.index) == {"default", *limits}
    assert runs["options"]["default"] == ""
    for name, limit in limits.items():
        assert runs["iterations_max"][name] == limit
        assert f'"max_iter": {limit}' in runs["options"][name]
    # Other options under the same name are another run, which the folder has not been asked for.
    suite.write_text(SUITE.replace("max_iter = 7", "max_iter = 8"))
    with pytest.raises(InputError, match="finished runs that were not requested"):
        run_campaign(suite, out, solvers=solvers)
