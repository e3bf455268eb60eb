"""The file `suite.toml` of a result folder plans the same runs again."""

from pathlib import Path

import pytest

from dpbench import load_scenario, record_sequence, save_sequence
from dpbench.bench.plan.run_request import Plan, RunRequest
from dpbench.scenario.problem_files import find_problem_path, list_shipped_problem_names


def _plan_again(plan: Plan, folder: Path) -> Plan:
    file = folder / "suite.toml"
    file.write_text(plan.format_suite(file.parent), encoding="utf-8")
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
    first = plan.format_suite(tmp_path).splitlines()[0]
    assert first == "# Run again: dpbench run suite.toml --scenario paper"
    file = tmp_path / "suite.toml"
    file.write_text(plan.format_suite(file.parent), encoding="utf-8")
    assert RunRequest(str(file), scenarios=["paper"]).make_plan().digest == plan.digest


def test_files_are_found_from_the_result_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorded sequence, a scenario of a suite and one of the command, by relative names."""
    folder = tmp_path / "results" / "one"
    folder.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("paper").truncate(6)
    save_sequence("mine.npz", record_sequence(scenario))
    recorded = RunRequest(sequence="mine.npz", solvers=["daqp"]).make_plan()
    assert len(_plan_again(recorded, folder).cells) == len(recorded.cells)

    paper = find_problem_path("scenarios", "paper")
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "sea.toml").write_text(paper.read_text("utf-8"), encoding="utf-8")
    (tmp_path / "lab" / "suite.toml").write_text(
        'title = "One sea"\nsolvers = ["daqp"]\n[[closed_loop]]\nscenarios = ["sea.toml"]\n',
        encoding="utf-8",
    )
    own = RunRequest("lab/suite.toml").make_plan()
    assert len(_plan_again(own, folder).cells) == len(own.cells) > 0
    text = RunRequest("smoke", scenarios=["lab/sea.toml"]).make_plan().format_suite(folder)
    assert text.startswith("# Run again: dpbench run suite.toml --scenario ../../lab/sea.toml\n")
