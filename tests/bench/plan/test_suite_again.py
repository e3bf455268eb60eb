"""The file `suite.toml` of a result folder plans the same runs again."""

from pathlib import Path

import pytest

from dpbench.bench.plan.run_request import Plan, RunRequest
from dpbench.scenario.problem_files import list_shipped_problem_names


def _plan_again(plan: Plan, folder: Path) -> Plan:
    file = folder / "suite.toml"
    file.write_text(plan.format_suite(), encoding="utf-8")
    return RunRequest(str(file)).make_plan()


@pytest.mark.parametrize("name", ["claims", "horizon", "seas", "smoke"])
def test_a_suite_plans_the_same_runs_again(name: str, tmp_path: Path) -> None:
    assert name in list_shipped_problem_names("suites")
    plan = RunRequest(name).make_plan()
    assert _plan_again(plan, tmp_path).digest == plan.digest


def test_the_choices_of_the_command_are_in_the_file(tmp_path: Path) -> None:
    solvers = ["daqp", "osqp[rho=1.6]"]
    request = RunRequest("seas", solvers=solvers, settings=["1e-2"], steps=12, policies=["fresh"])
    plan = request.make_plan()
    assert _plan_again(plan, tmp_path).digest == plan.digest


def test_chosen_scenarios_are_in_the_comment(tmp_path: Path) -> None:
    plan = RunRequest("smoke", scenarios=["paper"]).make_plan()
    first = plan.format_suite().splitlines()[0]
    assert first == "# Run again: dpbench run suite.toml --scenario paper"
    file = tmp_path / "suite.toml"
    file.write_text(plan.format_suite(), encoding="utf-8")
    assert RunRequest(str(file), scenarios=["paper"]).make_plan().digest == plan.digest
