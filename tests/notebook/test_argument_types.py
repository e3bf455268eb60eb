"""Arguments of a wrong type: a TypeError of one line that names argument, finding and remedy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dpbench
from dpbench import CondensedQP, condense, load_scenario
from dpbench.errors import ShapeError


def _make_linear_mpc(**changed: Any) -> dpbench.LinearMPC:
    """An integrator with one input, with arguments changed."""
    one: dict[str, Any] = {key: [[1.0]] for key in "ABC"}
    one |= {key: [1.0] for key in ("output_weight", "increment_weight", "u_max", "du_max")}
    one |= {"name": "one", "sample_s": 0.1, "steps": 2, "u_min": [-1.0], "reference": [1.0]}
    one |= {"prediction_horizon": 3, "control_horizon": 2}
    return dpbench.LinearMPC.from_continuous(**one | changed)


CALLS: dict[str, tuple[Callable[[], Any], str]] = {
    "problem": (lambda: CondensedQP("paper"), "CondensedQP: problem: found 'paper'; allowed: a C"),
    "outputs": (
        lambda: CondensedQP(load_scenario("paper").problem, outputs=5),
        "CondensedQP: outputs: found 5; allowed: OutputBounds",
    ),
    "tables": (
        lambda: vars(dpbench.Results)["to_csv"](None, 3),
        "folder: found 3; allowed: the path of a folder",
    ),
    "no folder": (lambda: dpbench.add_runs(None, []), "out: found None; allowed: the path"),
    "one run": (lambda: dpbench.add_runs("x", "daqp"), "runs: found 'daqp'; allowed: a list of"),
    "no run": (lambda: dpbench.add_runs("x", [3]), "runs: found 3; allowed: a list of runs"),
    "report": (lambda: dpbench.write_report(3), "out: found 3; allowed: the path of a result"),
    "export": (lambda: dpbench.export_sequence("paper-30-5", None), "out: found None; allowed: a"),
    "save": (lambda: dpbench.save_sequence("a.npz", "b"), "sequence: found 'b'; allowed: a QPSeq"),
    "jobs": (lambda: dpbench.run_campaign("smoke", jobs="2"), "jobs: found '2'; allowed: a whole"),
    "a flag": (lambda: dpbench.run_campaign("smoke", jobs=True), "jobs: found True; allowed: a w"),
    "shard": (lambda: dpbench.run_campaign("smoke", shard=1), "shard: found 1; allowed: text I/N"),
    "solvers": (lambda: dpbench.run_campaign("smoke", solvers=5), "found 5; allowed: a list of n"),
    "alpha": (lambda: dpbench.compare("a", "b", alpha="x"), "alpha: found 'x'; allowed: a number"),
    "values": (lambda: load_scenario("paper").with_keys(5), "values: found 5; allowed: a mapping"),
    "policy": (lambda: dpbench.open_workspace("daqp", policy=["warm"]), "policy: found ['warm']"),
    "option": (lambda: dpbench.open_workspace("daqp", settings={5: 1}), "settings: found 5; all"),
    "options": (lambda: dpbench.list_solvers().options(3), "name: found 3; allowed: the name of a"),
    "no name": (lambda: dpbench.list_solvers().options(["osqp"]), "name: found ['osqp']; allowed"),
    "choices": (
        lambda: vars(dpbench.Results)["paired_ratios"](None, ["daqp", "osqp"]),
        "choices: found ['daqp', 'osqp']; allowed: names of configurations, each an argument: 'd",
    ),
    "a table": (
        lambda: vars(dpbench.Results)["to_latex"](None, 3),
        "table: found 3; allowed: the name of a table, or a data frame",
    ),
    "a key": (
        lambda: load_scenario("paper").with_keys({3: 4}),
        "values: found 3; allowed: keys as text, such as 'environment.seed'",
    ),
    "options of a function": (
        lambda: dpbench.opener("mine", len)("fresh", 3),
        "options: found 3; allowed: a mapping from names of options to values, or {}",
    ),
    "a plug-in": (
        lambda: dpbench.run_campaign("smoke", "x", solver_module=3),
        "solver_module: found 3; allowed: a Python file, or a list of Python files",
    ),
    "plug-ins": (
        lambda: dpbench.run_campaign("smoke", "x", solver_module=[3]),
        "solver_module: found 3; allowed: a Python file, or a list of Python files",
    ),
    "a scheduler": (
        lambda: dpbench.run_campaign("smoke", "x", engine="dask", scheduler=3),
        "scheduler: found 3; allowed: the address of a Dask scheduler",
    ),
    "certificates": (
        lambda: dpbench.run_campaign("smoke", "x", engine="dask", scheduler="tls://x:1", tls=3),
        "tls: found 3; allowed: the files of the certificate authority, the certificate and the",
    ),
    "a route": (lambda: dpbench.open_workspace("daqp", route=[3]), "route: found [3]; allowed: th"),
    "a reference": (lambda: dpbench.compare("a", "b", reference=[3]), "reference: found [3]; allo"),
    "QPs": (
        lambda: dpbench.export_sequence(3, "x.mat", format="mat"),
        "what: found 3; allowed: a Scenario, a QPSequence, or the name or file of a scenario or",
    ),
    "horizons": (
        lambda: dpbench.export_sequence("paper", "x.npz", horizons=30),
        "horizons: found 30; allowed: text N_p/N_c, such as '30/5'",
    ),
    "exported steps": (
        lambda: dpbench.export_sequence("paper-30-5", "x.npz", steps="9"),
        "steps: found '9'; allowed: a whole number",
    ),
    "optima": (
        lambda: dpbench.save_sequence("a.npz", dpbench.load_sequence("paper-30-5"), [3]),
        "save_sequence: optima: found 3; allowed: a list of Optimum, one per QP",
    ),
    "a plant": (lambda: _make_linear_mpc(name=3), "LinearMPC: name: found 3; allowed: a name with"),
    "signals": (lambda: _make_linear_mpc(inputs=3), "one: inputs: found 3; allowed: a sequence of"),
    "a horizon": (
        lambda: _make_linear_mpc(control_horizon=2.5),
        "one: control_horizon: found 2.5; allowed: a whole number",
    ),
    "a sample": (
        lambda: _make_linear_mpc(sample_s="1"),
        "one: sample_s: found '1'; allowed: a num",
    ),
    "a name": (lambda: dpbench.opener(3, len), "name: found 3; allowed: the name of the solver"),
    "slowdown": (
        lambda: dpbench.run_closed_loop("paper", "daqp", steps=2, slowdown="10"),
        "closed loop: slowdown: found '10'; allowed: 0 (off), or 1 to 1e+09",
    ),
    "deadline": (
        lambda: dpbench.run_closed_loop("paper", "daqp", steps=2, deadline_s="1"),
        "closed loop: deadline_s: found '1'; allowed: above 0 and at most the sample time of 0.3",
    ),
    "backup": (
        lambda: dpbench.run_closed_loop("paper", "daqp", steps=2, backup=5),
        "backup: found 5; allowed: the name of a solver",
    ),
    "a setpoint": (
        lambda: condense("paper").emit(np.zeros(9), [0.0, 0.0, 0.0], np.zeros(3)),
        "emit: y_ref: found [0.0, 0.0, 0.0]; allowed: an array",
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_type_is_named_with_its_argument(name: str) -> None:
    call, words = CALLS[name]
    with pytest.raises(TypeError) as caught:
        call()
    text = str(caught.value)
    assert words in text and "\n" not in text


def test_a_list_where_a_choice_belongs_is_no_choice() -> None:
    words = r"run_closed_loop: fallback: found \['hold'\]; allowed: one of shifted_plan, hold, clip"
    with pytest.raises(dpbench.InputError, match=words):
        dpbench.run_closed_loop("paper", "daqp", fallback=["hold"])
    with pytest.raises(dpbench.InputError, match=r"environment\.seed: found keys 3; allowed: "):
        load_scenario("paper").with_keys({"environment.seed": {3: 4}})
    with pytest.raises(dpbench.InputError, match=r"`tls`: found 'a\.pem'; allowed: the files of"):
        dpbench.run_campaign("smoke", "x", engine="dask", scheduler="tls://x:1", tls="a.pem")


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ((3, 3, 3), "emit: x: found shape (3,); allowed: shape (9,)"),
        ((9, 2, 3), "emit: y_ref: found shape (2,); allowed: shape (3,) or shape (30, 3)"),
        ((9, 3, 5), "emit: u_prev: found shape (5,); allowed: shape (3,)"),
    ],
)
def test_a_step_of_another_size_is_named(sizes: tuple[int, int, int], words: str) -> None:
    """The paper's controller has nine states, three outputs, three forces and horizon 30."""
    x, y_ref, u_prev = map(np.zeros, sizes)
    with pytest.raises(ShapeError) as caught:
        condense("paper").emit(x, y_ref, u_prev)
    assert str(caught.value) == words


def test_no_suite_is_named_by_the_argument_of_the_function() -> None:
    with pytest.raises(dpbench.InputError, match="`suite`: missing; required: `suite` or `seq"):
        dpbench.run_campaign()


def test_numbers_of_numpy_are_those_of_python() -> None:
    two, run = np.int64(2), dpbench.run_closed_loop
    loop = run(load_scenario("paper").with_horizons(np.int64(30), two), "daqp", steps=two)
    assert loop.summary["steps_done"] == 2
    workspace = dpbench.open_workspace("daqp", settings={"iter_limit": np.int64(500)})
    replayed = dpbench.replay("paper-30-5", workspace, repeats=two, warmup_steps=two)
    assert replayed.summary["options"] == '{"iter_limit": 500}'
