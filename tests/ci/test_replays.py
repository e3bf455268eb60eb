"""The benchmark of a replay: facts it stores, answers it refuses."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dpbench import QPSequence, QPStep, load_scenario, open_workspace, record_sequence
from dpbench.ci.replays import ReplayBenchmark
from dpbench.errors import InputError
from dpbench.solvers.table import load_plugin_solver_from_file

LAZY = """
import numpy as np
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

def solve(qp):
    return Solution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), np.zeros(qp.n), 1)

RECORD = solver_record("lazy", method="none")
open = opener("lazy", solve)
"""


class CallsTwice:
    """Stands for the fixture of pytest-benchmark."""

    def __init__(self) -> None:
        self.extra_info: dict[str, Any] = {}

    def __call__(self, function: Callable[[], object]) -> object:
        function()
        return function()


@pytest.fixture(scope="module")
def few() -> QPSequence:
    """A few QPs of the paper's transfer."""
    return record_sequence(load_scenario("paper").truncate(12))


@pytest.mark.parametrize(("solver", "policy"), [("daqp", "fresh"), ("osqp", "warm")])
def test_a_replay_stores_its_facts(few: QPSequence, solver: str, policy: str) -> None:
    """The facts are solver, accuracy and iterations, which do not depend on the clock."""
    benchmark = CallsTwice()
    ReplayBenchmark(benchmark)(few, solver, policy=policy, settings="high")
    info = benchmark.extra_info
    assert info["solver"] == f"{solver} (qpsolvers, {policy})"
    assert (info["steps_done"], info["failed_steps"], info["claimed_not_true"]) == (12, 0, 0)
    assert 0.0 <= info["error_move_max"] < 1e-3
    # DAQP counts none here; its error is compared all the same.
    assert ("iterations" in info["exact"]) == (solver != "daqp")
    assert info["exact"]["error_move_max"] == info["error_move_max"]
    assert info["active_share"] > 0.0


def test_a_false_answer_fails_the_test(few: QPSequence, tmp_path: Path) -> None:
    """A plug-in's file is loaded; what it claims is checked, and a test may allow more."""
    file, benchmark = tmp_path / "lazy.py", CallsTwice()
    file.write_text(LAZY, encoding="utf-8")
    with pytest.raises(
        pytest.fail.Exception,
        match=r"^wrong answers: lazy \(.*\) on .*: largest error of the first move \S+ "
        r"maximum increments at step 0 \(allowed 0.01, exceeded in 12 of 12 steps\), "
        r"12 of 12 steps done, 0 failed \(allowed 0\)$",
    ):
        ReplayBenchmark(benchmark)(few, file)
    assert benchmark.extra_info["claimed_not_true"] > 0
    ReplayBenchmark(CallsTwice())(few, "lazy", error_move=1e9)


def test_a_solver_that_overwrites_its_problem_fails_the_test(
    few: QPSequence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its second pass would be of other problems than those that were checked."""
    workspace = open_workspace("quadprog")
    solve, given = workspace.solve, []

    def keep(step: QPStep) -> None:
        given.append(step)

    def spoil() -> None:
        update(given[-1])
        solve()
        given[-1].q[:] *= 1.001

    update = workspace.update
    monkeypatch.setattr(workspace, "update", keep)
    monkeypatch.setattr(workspace, "solve", spoil)
    with pytest.raises(pytest.fail.Exception, match="overwrites the problem, so"):
        ReplayBenchmark(CallsTwice())(few, workspace)


def test_options_are_not_for_a_workspace(few: QPSequence) -> None:
    """They would be ignored."""
    with pytest.raises(InputError, match="give them to open_workspace"):
        ReplayBenchmark(CallsTwice())(few, open_workspace("quadprog"), policy="fresh")


def test_files_are_found_beside_the_test_and_cut(tmp_path: Path) -> None:
    """A relative file is in the test's folder, then in the root; `steps` cuts the sequence."""
    root, folder = tmp_path, tmp_path / "tests"
    folder.mkdir()
    (root / "near.py").write_text(LAZY.replace("lazy", "far_lazy"), encoding="utf-8")
    (folder / "near.py").write_text(LAZY.replace("lazy", "near_lazy"), encoding="utf-8")
    run = ReplayBenchmark(CallsTwice(), folder, root)(
        "paper-30-5", "near.py", steps=3, error_move=1e9
    )
    assert run.label.startswith("near_lazy") and run.summary["steps_done"] == 3


def test_a_missing_package_of_a_plug_in_is_named(few: QPSequence, tmp_path: Path) -> None:
    """The message is that of `dpbench run`, which names no package to download."""
    file = tmp_path / "needs.py"
    file.write_text("import nowhere_at_all.part\n", encoding="utf-8")
    with pytest.raises(InputError) as found:
        ReplayBenchmark(CallsTwice())(few, file)
    with pytest.raises(InputError) as same:
        load_plugin_solver_from_file(file)
    remedy = (
        "install the package of this module (in its repository: `pip install .`) or set PYTHONPATH "
        "to the folder that contains it"
    )
    fault = f"{file}: ModuleNotFoundError: No module named 'nowhere_at_all'; {remedy}"
    assert [str(one.value) for one in (found, same)] == [f"solver module {fault}"] * 2


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"step": 20}, "found argument step; allowed: one of steps, "),
        ({"error_move": "1%"}, "error_move: found '1%'; allowed: a number, such as 0.01"),
        ({"steps": "20"}, "steps: found '20'; allowed: a whole number"),
        ({"failed_steps": 0.5}, "failed_steps: found 0.5; allowed: a whole number"),
        ({"solver": None}, "solver: found None; allowed: a name, the .py file of a plug-in or "),
        ({"sequence": 3}, "sequence: found 3; allowed: a QPSequence, a name or a .npz file"),
    ],
)
def test_a_mistake_in_an_argument_is_named(arguments: dict[str, Any], text: str) -> None:
    """Before a sequence is loaded; the frames in dpbench are hidden from pytest's traceback."""
    given: dict[str, Any] = {"sequence": "paper-30-5", "solver": "daqp"} | arguments
    with pytest.raises(TypeError, match=f"^dpbench_replay: {re.escape(text)}") as found:
        ReplayBenchmark(CallsTwice())(**given)
    (shown,) = found.traceback.filter(found)
    assert shown.path == Path(__file__)


def test_an_unknown_name_has_a_short_traceback() -> None:
    """The test alone is shown, as the mistake is there."""
    with pytest.raises(InputError, match="dapq") as found:
        ReplayBenchmark(CallsTwice())("paper-30-5", "dapq")
    (shown,) = found.traceback.filter(found)
    assert shown.path == Path(__file__)
