"""A solver beside others, for its author: a short comment, and the steps that export writes."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.records.thinned_runs import find_worst_steps
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.report.documents.solver_comparison import COMMENT_BYTES, compare_solver
from dpbench.report.report import Report


@pytest.mark.parametrize("solver", ["piqp", "ecos", "scs", "daqp"])
def test_the_comment_is_short_and_names_whom_it_is_beside(written: Any, solver: str) -> None:
    """At most 4 kB; the usual two, without the solver itself."""
    text, worst = compare_solver(written.report, solver)
    assert len(text.encode()) <= COMMENT_BYTES
    others = ["osqp"] if solver == "daqp" else ["osqp", "daqp"]
    assert text.startswith(f"# {solver} compared with {' and '.join(others)}\n")
    assert all(f"| {name} |" in text for name in [solver, *others])
    assert text.count("against") == len(others)
    assert all(step.export_command in text for step in worst)
    assert "\n\nMachine: " in text and f"{solver} 1.0" in text.partition("\nVersions: ")[2]


def test_the_worst_step_is_the_largest_of_one_configuration(written: Any) -> None:
    """The error of its closed loops too; the time of its replays alone."""
    facts, results = written.report.data, written.results
    configuration = facts.verdicts.of["piqp"][0].configuration
    own = [r for r in facts.records.runs if r.configuration == configuration]
    judged = {run.run_id: run.mode for run in own if run.units == "scaled"}
    assert {*judged.values()} == {"closed_loop", "replay"}
    steps = results.steps[results.steps["run_id"].isin(judged)]
    counting = steps[steps["counts"]].astype({"total_ns": float})
    timed = counting[counting["run_id"].map(judged) == "replay"]
    found = find_worst_steps(facts.records, configuration)
    error, time = found[0], next(step for step in found if step.measure == "time")
    assert error.measure == "error"
    assert error.value == counting["error_move"].max()
    assert time.value == timed.groupby(["run_id", "k"])["total_ns"].min().max()
    row = counting[(counting["run_id"] == error.run.run_id) & (counting["k"] == error.step_index)]
    assert np.isclose(row["error_move"].max(), error.value)


def test_the_worst_time_is_chosen_without_waits_for_the_core(records: Any) -> None:
    """Step 7 took 9 ms, 8.5 ms of it waiting, and step 3 took 2 ms, a tenth of it waiting."""
    records.replay("daqp", median_us=20.0, spread=0.0)
    frame = records._steps[-1]
    frame["waited_ns"] = 0
    frame.loc[frame["k"] == 7, ["total_ns", "waited_ns"]] = 9_000_000, 8_500_000
    frame.loc[frame["k"] == 3, ["total_ns", "waited_ns"]] = 2_000_000, 200_000
    view = records.view()
    (time,) = (
        one for one in find_worst_steps(view, view.runs[0].configuration) if one.measure == "time"
    )
    assert (time.step_index, time.value, time.wait_ns) == (3, 2e6, 2e5)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            0.4,
            "\n\n`osqp (qpsolvers fresh, high)` passes everywhere it was run. It is the best of 2 "
            "call modes and settings; usually called, `osqp (qpsolvers fresh)`: fail.\n\n",
        ),
        (
            1e-9,
            "\n\n`osqp (qpsolvers fresh)` passes everywhere it was run. It is the best of 2 call "
            "modes and settings.\n\n",
        ),
    ],
)
def test_the_comment_names_the_configuration(records: Any, error: float, said: str) -> None:
    """Settings `high` pass; the default passes where its answers are right, and is faster."""
    for settings, us, off in (("default", 20.0, error), ("high", 90.0, 1e-9)):
        records.loop("osqp", settings=settings, error=off)
        records.replay("osqp", settings=settings, median_us=us, error=off)
    assert said in compare_solver(Report.from_results(records.results()), "osqp")[0]


def test_every_settings_of_the_solver_is_a_row(records: Any) -> None:
    """The best first; of those that fail the fastest is last, as it fails on the most steps."""
    named = (("default", 4, 0.4, 20.0), ("high", 0, 1e-9, 90.0))
    for settings, failed, error, us in (*named, ("mine", 9, 0.3, 5.0), ("tuned", 4, 0.2, 30.0)):
        options = json.dumps({"rho": us}) if settings in ("mine", "tuned") else ""
        records.loop("osqp", settings=settings, options=options, error=error, failed=failed)
        records.replay("osqp", settings=settings, options=options, median_us=us, error=error)
    text, _ = compare_solver(Report.from_results(records.results()), "osqp")
    rows = [line for line in text.splitlines() if line.startswith("| osqp | ")]
    assert [row.split(" | ")[2] for row in rows] == ["pass", "fail", "fail", "fail"]
    found = [next(n for n in ("high", "mine", "tuned", "fresh") if n in row) for row in rows]
    assert found == ["high", "tuned", "fresh", "mine"]


def test_the_named_configuration_is_the_first_row(records: Any) -> None:
    """The least inaccurate of those that fail; what was not run in closed loop comes last."""
    for settings, error in (("default", 0.4), ("high", 0.02)):
        records.loop("osqp", settings=settings, error=error)
        records.replay("osqp", settings=settings, error=error)
    records.replay("osqp", settings="high", policy="warm", error=0.015)
    text, _ = compare_solver(Report.from_results(records.results()), "osqp")
    assert "\n\n`osqp (qpsolvers fresh, high)` fails: " in text
    assert "the best of 2 call modes and settings with a closed loop and a replay" in text
    rows = [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| osqp | ")]
    assert rows == ["qpsolvers fresh, high", "qpsolvers fresh", "qpsolvers warm, high"]


def test_a_comment_on_one_configuration_compares_it_with_no_other(records: Any) -> None:
    records.loop("daqp", error=0.5)
    records.replay("daqp")
    text, _ = compare_solver(Report.from_results(records.results()), "daqp")
    assert "\n\n`daqp (qpsolvers fresh)` fails: the error of its first move reaches 0.50 " in text
    assert "best of" not in text


def test_the_worst_error_of_a_closed_loop_is_named_without_an_export(records: Any) -> None:
    """The machine and the versions are the last lines; errors of other settings do not count."""
    records.loop("osqp", "turn", error=0.505)
    records.replay("osqp", error=0.16)
    records.replay("osqp", settings="high", error=0.9)
    report = Report.from_results(records.results())
    text, worst = compare_solver(report, "osqp")
    row = next(line for line in text.splitlines() if line.startswith("| error |"))
    assert " of turn, a closed loop | qpsolvers fresh | 0.51 |" in row
    assert (worst[0].export_command, "export turn" in text) == ("", False)
    assert (worst[1].measure, worst[1].run.mode) == ("error", "replay")
    assert worst[1].value < worst[0].value and worst[1].export_command in text
    machine, versions = text.rstrip("\n").split("\n\n")[-2:]
    assert machine.startswith("Machine: ") and "Versions: osqp " in versions


def test_other_names_and_names_of_nobody(written: Any) -> None:
    text, _ = compare_solver(written.report, "piqp", ["clarabel"])
    assert text.startswith("# piqp compared with clarabel\n")
    with pytest.raises(InputError, match=r"--for: found 'piq'; allowed: one of piqp, "):
        compare_solver(written.report, "piq")
    with pytest.raises(InputError, match="--against: found 'nobody'"):
        compare_solver(written.report, "piqp", ["nobody"])
    for choice in ("piqp[tol=1]", "piqp mine"):
        found = f"--for: found '{re.escape(choice)}'; allowed: one of piqp, "
        form = found + ".*, without settings; `dpbench "
        with pytest.raises(InputError, match=form):
            compare_solver(written.report, choice)


@pytest.mark.slow
def test_the_command_writes_a_step_to_export(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    run = "run smoke --solver daqp --solver quadprog --steps 12 --out mine --quiet"
    assert main(run.split()) == 0
    assert main(["report", "mine", "--for", "quadprog", "--json"]) == 0
    assert "dpbench export paper --at" in capsys.readouterr().out
    text = (tmp_path / "mine" / "quadprog.md").read_text("utf-8")
    commands = [line.strip() for line in text.splitlines() if line.startswith("    dpbench")]
    assert main(commands[0].split()[1:]) == 0
    with np.load(commands[0].split()[-1], allow_pickle=False) as stored:
        assert len(stored["q"]) == 1
    assert main(["report", "mine", "--against", "daqp"]) == 2
    assert "found without --for; allowed: together with --for SOLVER" in capsys.readouterr().err
