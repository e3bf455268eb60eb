"""Two result folders against each other, with planted differences: verdicts, refusals, exits."""

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import InputError, compare
from dpbench.analysis.compare.pairs import Pair, make_problem_key
from dpbench.analysis.records.run_record import build_run_records
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import convert_to_run_columns, convert_to_step_columns
from dpbench.cli.main import main
from dpbench.report.compare.comparison import _merge_verdicts
from dpbench.report.compare.page import describe_verdict, make_lead_sentences, write_comparison
from dpbench.report.ship.ship_text import LOST
from tests.conftest import MadeRecords
from tests.report.conftest import run_row
from tests.result_folder import StepsInMemory, write_results

STEPS, ROUNDS = 100, 8
ARMS = ("daqp", "quadprog", "piqp", "proxqp", "osqp", "qpalm", "scs", "clarabel")
QUIET: dict[str, Any] = {
    **{"reference_kernel_ns": 5e4, "rounds": ROUNDS, "disturbed_rounds": 0, "rerun_rounds": 0},
    **{"counting_disturbed": 0, "replay_s": 1.0, "involuntary_switches": 0.0, "steal_s": 0.0},
}
Make = Callable[..., Path]


def identity(mode: str, solver: str, columns: Mapping[str, Any]) -> dict[str, Any]:
    given = QUIET | {"true_share": 1.0} | columns
    return run_row(f"{mode}-{solver}", mode, solver, STEPS, **given)


def replay_rows(
    run_id: str, factor: float, rng: np.random.Generator, error: np.ndarray
) -> pd.DataFrame:
    """Times of 20 µs times a pattern that all runs share, a factor, and noise of each sample."""
    k = np.tile(np.arange(STEPS), ROUNDS)
    noise = np.exp(0.02 * rng.exponential(size=k.size))
    total = 2e4 * (1.5 + np.sin(k / 7.0)) * factor * noise
    return pd.DataFrame(
        {
            "run_id": run_id,
            "repeat": np.repeat(np.arange(1, ROUNDS + 1), STEPS),
            "counts": True,
            "k": k,
            "total_ns": np.round(total).astype(np.int64),
            "true": np.tile(error <= 1e-2, ROUNDS),
            "error_move": np.tile(error, ROUNDS),
            "error_plan": np.tile(error, ROUNDS),
        }
    )


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Makes a result folder of replays, and of a closed loop where its figures are given."""

    def folder(
        name: str,
        *,
        seed: int,
        slow: Mapping[str, float] = {},
        machine: float = 1.0,
        errors: Mapping[str, float] = {},
        loop: Mapping[str, Any] | None = None,
        machine_id: str = "one",
        configurations: tuple[str, ...] = ARMS,
        **columns: Any,
    ) -> Path:
        rng = np.random.default_rng(seed)
        runs, steps = [], []
        for solver in configurations:
            factor = machine * slow.get(solver, 1.0) * np.exp(0.003 * rng.standard_normal())
            error = np.full(STEPS, 1e-6)
            error[3] = errors.get(solver, 1e-6)
            row = identity("replay", solver, columns)
            runs.append(row)
            steps.append(replay_rows(row["run_id"], factor, rng, error))
        if loop is not None:
            runs.append(identity("closed_loop", "daqp", loop))
        described = {"id": machine_id, "kernel": f"Linux of {machine_id}"}
        recorded = StepsInMemory(convert_to_step_columns(pd.concat(steps, ignore_index=True)))
        table = convert_to_run_columns(pd.DataFrame(runs))
        write_results(tmp_path / name, Results(table, recorded, described, {"name": "synthetic"}))
        return tmp_path / name

    return folder


def verdicts(found: pd.DataFrame) -> dict[str, str]:
    """Verdict by solver."""
    return dict(zip(found["solver"], found["verdict"], strict=True))


@pytest.mark.slow
def test_planted_ratios_are_found_and_the_others_are_equivalent(make: Make) -> None:
    """1.3 and 1/1.3 in two configurations; the machine's own 1.1 is taken out and said."""
    a = make("a", seed=1)
    b = make(
        "b", seed=2, slow={"piqp": 1.3, "scs": 1 / 1.3}, machine=1.1, reference_kernel_ns=5.5e4
    )
    found = compare(a, b)
    expected = dict.fromkeys(ARMS, "equivalent") | {"piqp": "slower", "scs": "faster"}
    assert verdicts(found.times) == expected
    row = found.times.set_index("solver").loc["piqp"]
    assert row[["ratio", "raw", "machine"]].tolist() == pytest.approx([1.3, 1.43, 1.1], rel=0.02)
    assert row["low"] < 1.3 < row["high"]
    assert found.worse
    assert any("1.100 (reference kernel)" in line for line in found.lines)
    assert found.markdown().startswith("# Comparison: slower\n")


@pytest.mark.slow
def test_a_smaller_time_is_faster_only_with_verified_answers(make: Make) -> None:
    """The same times, once with every answer of B verified and once without."""
    a, slow = make("a", seed=1), {"scs": 1 / 1.3}
    headlines = []
    for share in (1.0, 0.99):
        found = compare(a, make(f"b{share}", seed=2, slow=slow, true_share=share))
        headlines.append((verdicts(found.times)["scs"], found.headline))
    assert headlines == [("faster", "faster"), ("faster, not all verified", "no difference shown")]
    assert "1 faster, not all verified" in found.markdown()


@pytest.mark.slow
def test_the_verdict_of_a_solver_is_that_of_its_configurations(make: Make) -> None:
    usual = {"r_rms_m": 0.3}
    a = make("a", seed=1, loop=usual)
    slow = {"piqp": 1.3, "scs": 1 / 1.3}
    b = make("b", seed=2, slow=slow, loop={"r_rms_m": 0.4}, errors={"osqp": 0.5})
    found = compare(a, b)
    first = found.tables[0]
    output = {row[0]: (row[1], row[2]) for row in first.rows}
    assert output["piqp"][0] == "slower" and output["scs"][0] == "faster"
    assert output["osqp"] == ("equivalent", "worse")
    steered = set(found.answers[found.answers["figure"] == "r_rms_m"]["solver"])
    assert {solver for solver, words in output.items() if words[1] == "worse"} == steered | {"osqp"}


def test_one_configuration_slower_and_one_faster_are_both_said() -> None:
    order = ("slower", "faster", "no difference shown", "equivalent")
    assert _merge_verdicts(Counter(slower=1, faster=2, equivalent=3), order) == "slower and faster"
    assert _merge_verdicts(Counter({"no difference shown": 1, "equivalent": 9}), order) == order[2]
    assert _merge_verdicts(Counter(), order) == "–"


@pytest.mark.slow
def test_what_all_configurations_share_is_a_regression_only_beyond_the_kernel(make: Make) -> None:
    a = make("a", seed=1)
    machine = compare(a, make("slow", seed=2, machine=2.0, reference_kernel_ns=1e5))
    assert not machine.worse
    code = compare(a, make("code", seed=3, machine=2.0))
    assert code.worse
    assert set(code.times["verdict"]) == {"equivalent"}
    (line,) = [line for line in code.lines if line.startswith("`paper`")]
    assert line.endswith("slower in a part that all configurations share")


def test_a_lost_ship_comes_before_any_comparison(records: Any, tmp_path: Path) -> None:
    records.loop("daqp")
    a = records.write(tmp_path / "a")
    records.loop("daqp", "rough", exact_left_s=9.0)
    found = compare(a, records.write(tmp_path / "b"))
    held = "in the weather of 1 of 2 scenarios (it holds it in 1)"
    assert found.lines[0].startswith(f"B: {LOST} {held}, whatever the solver: in `rough`")
    assert found.lines[1].startswith("A: ") and LOST not in "".join(found.lines[1:])


@pytest.mark.slow
def test_what_the_harness_lost_is_no_regression(make: Make) -> None:
    a = make("a", seed=1)
    for folders in ((a, make("b", seed=2, outcome="lost")), (make("c", seed=2, outcome="lost"), a)):
        found = compare(*folders)
        assert not found.worse and not found.pairs.pairs
        assert any(line.startswith("lost by the harness, not compared: ") for line in found.lines)


@pytest.mark.slow
def test_windows_of_hardest_steps_are_compared_by_accuracy_alone(
    make: Make, tmp_path: Path
) -> None:
    """Two windows alone leave no step time; as many replays of a whole sequence do."""
    cell = {"scenario": {"name": "paper"}, "source": {"kind": "hardest", "of": 450}}
    both: dict[str, Any] = {"configurations": ("daqp", "piqp")}
    window = both | {"cell": json.dumps(cell)}
    found = compare(make("a", seed=1, **window), make("b", seed=2, **window))
    assert "2 windows: step times without a verdict" in found.lines
    (times,) = (table for table in found.tables if "window" in table.heads)
    rows = [dict(zip(times.heads, row, strict=True)) for row in times.rows]
    assert [row["configuration"] for row in rows] == ["daqp (native fresh)", "piqp (native fresh)"]
    for row in rows:
        # The mean ratio is between the least and the largest of the steps.
        assert 0.5 < float(row["B/A"]) < 2.0 and row["steps"].endswith(" of 450")
        assert float(row["B p99 [µs]"]) <= float(row["B largest [µs]"])
    assert found.headline == "no difference shown, accuracy only"
    page = write_comparison(tmp_path / "compare.html", found).read_text(encoding="utf-8")
    assert "no difference shown, accuracy only" in page
    whole = compare(make("c", seed=1, **both), make("d", seed=2, **both))
    assert not any("windows: step times" in line for line in whole.lines)
    assert not any("window" in table.heads for table in whole.tables)
    assert whole.headline == "no difference shown"


@pytest.mark.slow
def test_windows_without_steps_are_compared_by_their_columns(make: Make) -> None:
    """A folder without steps has the p99, the largest step time and the median of each window."""
    cell = {"scenario": {"name": "paper"}, "source": {"kind": "hardest", "of": 450}}
    window: dict[str, Any] = {"configurations": ("daqp",), "cell": json.dumps(cell)}
    times = {"algo_p50_ns": 2e4, "window_p99_ns": 5e4, "algo_max_ns": 6e4}
    a = make("a", seed=1, **window, **times)
    b = make("b", seed=2, **window, **{name: 1.5 * ns for name, ns in times.items()})
    (b / "steps.parquet").unlink()
    (table,) = (table for table in compare(a, b).tables if "window" in table.heads)
    (row,) = (dict(zip(table.heads, row, strict=True)) for row in table.rows)
    found = [float(row[f"{run} {what} [µs]"]) for what in ("p99", "largest") for run in "AB"]
    assert found == [50.0, 75.0, 60.0, 90.0]
    assert row["B/A"] == "1.500" and "ratio of medians" in table.note


STOLEN = {"steal_s": 0.08}
HIDDEN: dict[str, Any] = {"steal_s": np.nan, "replay_s": np.nan, "involuntary_switches": np.nan}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        (STOLEN, STOLEN, "both runs were disturbed"),
        ({}, STOLEN, "run B was disturbed"),
        (STOLEN, {}, "run A was disturbed"),
        ({"disturbed_rounds": 1}, {}, "run A was disturbed"),
        ({}, {"involuntary_switches": 11.0}, "run B was disturbed"),
        (HIDDEN, {}, "no counters show how quiet run A was"),
        ({}, {"reference_kernel_ns": np.nan}, "the reference kernel was not timed"),
    ],
)
def test_what_all_configurations_share_is_judged_on_a_quiet_machine_alone(
    make: Make, tmp_path: Path, capsys: Any, before: Any, after: Any, reason: str
) -> None:
    """1.496 in all configurations and 1.025 in the kernel; exit code 0."""
    a = make("a", seed=1, **before)
    b = make("b", seed=2, machine=1.496, **({"reference_kernel_ns": 1.025 * 5e4} | after))
    page = tmp_path / "compare.md"
    assert main(["compare", str(a), str(b), "--markdown", str(page)]) == 0
    output = f": not judged, as {reason}"
    # Lines of 80 columns in a terminal; one line in Markdown.
    for text in (capsys.readouterr().out, page.read_text(encoding="utf-8")):
        words = " ".join(text.split())
        assert words.count(output) == 1
        before = words[: words.index(output)]
        assert "time ratio B/A 1.49" in before[-200:]
    (shared,) = compare(a, b).shared
    assert shared.assessment is None
    assert set(compare(a, b).times["verdict"]) == {"equivalent"}


@pytest.mark.parametrize(("state", "why"), [(STOLEN, "disturbed"), (HIDDEN, "times not judged")])
@pytest.mark.parametrize(("code", "hints"), [(0, 1), (75, 0)])
def test_the_exit_code_of_times_not_judged_is_selected(
    make: Make, capsys: Any, code: int, hints: int, state: dict[str, Any], why: str
) -> None:
    both: dict[str, Any] = {"configurations": ("daqp", "piqp")} | state
    folders = [str(make(name, seed=n, **both)) for n, name in enumerate("ab")]
    assert main(["compare", *folders, "--disturbed-exit", str(code)]) == code
    output = capsys.readouterr().out.splitlines()
    assert output[-1] == f"exit code {code} ({why})"
    assert output.count(f"{HINT} changes it") == hints


HINT = "times not judged give exit code 0; --disturbed-exit CODE"


@pytest.mark.slow
def test_an_interval_without_a_verdict_on_a_disturbed_machine_sets_the_exit_code(
    make: Make, capsys: Any
) -> None:
    """A ratio at the margin, with the kernel untimed so that only the verdicts show the load."""
    a = make("a", seed=1)
    for state, verdict, code in (({}, "no difference shown", 0), (STOLEN, "machine disturbed", 75)):
        b = make(verdict, seed=2, slow={"piqp": 1.05}, reference_kernel_ns=np.nan, **state)
        assert verdicts(compare(a, b).times)["piqp"] == verdict
        assert main(["compare", str(a), str(b), "--disturbed-exit", "75"]) == code


@pytest.mark.slow
def test_a_disturbed_kernel_stands_for_no_machine(make: Make) -> None:
    """Two configurations, both 1.5 times as slow while a disturbed kernel says 1.0."""
    both = ("daqp", "piqp")
    a = make("a", seed=1, configurations=both, **STOLEN)
    found = compare(a, make("b", seed=2, configurations=both, machine=1.5, **STOLEN))
    assert set(found.times["verdict"]) == {"not judged"}
    (table,) = (table for table in found.tables if "machine" in table.heads)
    at = [table.heads.index(head) for head in ("machine", "B/A without machine", "interval")]
    assert [[row[i] for i in at] for row in table.rows] == [["–"] * 3] * 2
    assert "step times: 2 not judged" in found.lines
    assert found.headline == "times not judged on a disturbed machine; no other difference"
    assert "machine's factor is unknown: not judged." in describe_verdict(found.compared[0])
    assert not found.worse
    a = make("c", seed=1, configurations=both)
    quiet = compare(a, make("d", seed=2, configurations=both, machine=1.5))
    assert set(quiet.times["verdict"]) == {"slower"}


@pytest.mark.slow
def test_few_configurations_are_held_against_the_kernel(make: Make) -> None:
    """On a machine twice as slow, as the kernel says, 1.1 hides in it and 2 does not."""
    both: dict[str, Any] = {"configurations": ("daqp", "piqp")}
    loaded = both | {"machine": 2.0, "reference_kernel_ns": 1e5, "seed": 2}
    a = make("a", seed=1, **both)
    times = compare(a, make("b", slow={"piqp": 1.1}, **loaded)).times
    assert set(times["verdict"]) == {"no difference shown"}
    assert times["machine"].tolist() == pytest.approx([2.0, 2.0])
    times = compare(a, make("c", slow={"piqp": 2.0}, **loaded)).times
    assert verdicts(times)["piqp"] == "slower"


def test_changes_in_si_units_are_counted_apart(make: Make) -> None:
    a, b, scaled = (
        make(name, seed=1, configurations=("daqp",), loop={"r_rms_m": r_m, "units": units})
        for name, r_m, units in (("a", 0.3, "si"), ("b", 0.4, "si"), ("c", 0.4, "scaled"))
    )
    reason = "(such runs show the effect of scaling and count towards no solver's verdict)"
    found = compare(a, b)
    assert f"of these in SI units: 1 worse {reason}" in found.lines
    assert f"In SI units: 1 worse {reason}." in make_lead_sentences(found)
    assert not any("SI units" in line for line in compare(scaled, scaled).lines)
    assert found.worse and found.headline == "worse accuracy or control in SI units"
    assert not any(line.startswith("worse: ") for line in found.lines)
    both = [
        make(name, seed=1, configurations=("daqp",), errors={"daqp": error}, loop=loop)
        for name, error, loop in (
            ("d", 1e-6, {"r_rms_m": 0.3, "units": "si"}),
            ("e", 0.5, {"r_rms_m": 0.4, "units": "si"}),
        )
    ]
    found = compare(*both)
    assert found.headline == "worse accuracy or control"
    assert found.lines[0].startswith("worse: 3 metrics, first largest error of the first move")
    assert make_lead_sentences(found)[0].split("Worse: ")[1].startswith("3 of 5 metrics, first ")


@pytest.mark.slow
def test_a_folder_against_itself(make: Make) -> None:
    """No claim, every figure the same, ratios of exactly 1."""
    a = make("a", seed=1, loop={"r_rms_m": 0.3})
    found = compare(a, a)
    assert not found.worse
    assert (found.times["raw"] == 1.0).all()
    assert set(found.answers["change"]) == {"same"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "figures"),
    [
        ({"errors": {"osqp": 0.5}}, {"error_move_max", "error_plan_max", "true_share"}),
        ({"loop": {"r_rms_m": 0.33}}, {"r_rms_m"}),
        ({"loop": {"r_rms_m": 0.31}}, set()),
        ({"loop": {"r_rms_m": 0.3, "closed_loop_cost": 1.06}}, {"closed_loop_cost"}),
        ({"loop": {"r_rms_m": 0.3, "outcome": "crashed"}}, {"outcome"}),
        ({"loop": {"r_rms_m": 0.3, "steps_done": 50}}, {"steps_done"}),
    ],
)
def test_figures_of_accuracy_and_control(make: Make, change: Any, figures: set[str]) -> None:
    """Each is worse beyond 5 %, and better the other way round."""
    usual = {"r_rms_m": 0.3, "closed_loop_cost": 1.0, "total_variation": 2.0}
    a = make("a", seed=1, loop=usual)
    b = make("b", seed=1, **({"loop": usual} | change | {"loop": usual | change.get("loop", {})}))
    for first, second, word in ((a, b, "worse"), (b, a, "better")):
        found = compare(first, second)
        changed = found.answers[found.answers["change"] != "same"]
        assert set(changed["figure"]) == figures
        assert set(changed["change"]) <= {word}
        assert found.worse is (bool(figures) and word == "worse")
        assert any(line.startswith("worse: ") for line in found.lines[:2]) is found.worse


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("timed_out", 60), ("timed_out", 40)),
        (("finished", STEPS), ("timed_out", 90)),
        (("timed_out", 1), ("hung", 0)),
    ],
)
def test_what_a_time_limit_stopped_is_not_comparable(make: Make, before: Any, after: Any) -> None:
    figures = {"r_rms_m": 0.3, "closed_loop_cost": 1.0, "total_variation": 2.0}
    other = {"r_rms_m": 0.6, "closed_loop_cost": 0.1, "total_variation": 9.0}

    def folder(name: str, seen: Any, columns: Mapping[str, float]) -> Path:
        loop = columns | {"outcome": seen[0], "steps_done": seen[1]}
        return make(name, seed=1, loop=loop)

    a, b = folder("a", before, figures), folder("b", after, other)
    for first, second in ((a, b), (b, a)):
        found = compare(first, second)
        assert not found.worse
        loops = found.answers[found.answers["mode"] == "closed_loop"]
        assert set(loops["change"]) == {"not comparable"}
        assert any("not comparable (stopped by a time limit)" in line for line in found.lines)
    assert compare(a, folder("c", ("crashed", 40), other)).worse


@pytest.mark.slow
def test_steps_after_a_solvers_own_time_limit_are_not_comparable(make: Make) -> None:
    """An answer that a clock cut short at step 50 changes those after it, and none before."""
    a = make("a", seed=1)
    for step, worse in ((60, False), (40, True)):
        b = make(f"b{step}", seed=1)
        steps = pd.read_parquet(b / "steps.parquet")
        own = steps["run_id"] == "replay-osqp"
        steps.loc[own & (steps["k"] == 50), "status"] = "TIME_LIMIT"
        steps.loc[own & (steps["k"] == step), ["error_move", "error_plan"]] = 0.5
        steps.to_parquet(b / "steps.parquet", index=False)
        found = compare(a, b)
        assert found.worse is worse
        figures = found.answers[found.answers["solver"] == "osqp"].set_index("figure")["change"]
        assert figures["error_move_max"] == ("worse" if worse else "same")


@pytest.mark.slow
@pytest.mark.parametrize("answered", [0, 1])
def test_a_solver_that_hangs_on_every_step_is_worse(make: Make, answered: int) -> None:
    """With one answer among four steps, the speed of the machine may explain the others."""
    a, b = make("a", seed=1), make("b", seed=1)
    steps, runs = (pd.read_parquet(b / name) for name in ("steps.parquet", "runs.parquet"))
    own = steps["run_id"] == "replay-osqp"
    steps = steps[~own | (steps["k"] < 4)]
    cut = own & (steps["k"] >= answered)
    steps.loc[cut, ["status", "unconverged"]] = "TIME_LIMIT", True
    steps.to_parquet(b / "steps.parquet", index=False)
    run = runs["run_id"] == "replay-osqp"
    runs["failed_steps"] = 0
    runs.to_parquet(a / "runs.parquet", index=False)
    runs.loc[run, ["outcome", "steps_done", "failed_steps"]] = "timed_out", 4, 4 - answered
    runs.to_parquet(b / "runs.parquet", index=False)
    suite = json.loads((b / "suite.json").read_text()) | {"step_rows": len(steps)}
    (b / "suite.json").write_text(json.dumps(suite))
    found = compare(a, b)
    assert found.worse is (answered == 0)
    own_changes = found.answers[found.answers["solver"] == "osqp"].set_index("figure")["change"]
    assert own_changes["failed_steps"] == ("same" if answered else "worse")


@pytest.mark.slow
def test_rounds_are_cut_to_the_fewer(make: Make, tmp_path: Path) -> None:
    a = make("a", seed=1)
    b = make("b", seed=1)
    steps = pd.read_parquet(b / "steps.parquet")
    few = steps[steps["repeat"] <= 2]
    few.to_parquet(b / "steps.parquet", index=False)
    suite = json.loads((b / "suite.json").read_text()) | {"step_rows": len(few)}
    (b / "suite.json").write_text(json.dumps(suite))
    found = compare(a, b).times
    assert (found["rounds"] == 2).all()
    assert (found["raw"] == 1.0).all()


@pytest.mark.slow
def test_a_stretch_of_slow_rounds_hides_nothing(make: Make) -> None:
    """Half of B's rounds take 1.5 times as long: the minimum is that of the others, and counts."""
    a, b = make("a", seed=1), make("b", seed=2, slow={"piqp": 1.15})
    steps = pd.read_parquet(b / "steps.parquet")
    late = steps["repeat"] > ROUNDS // 2
    steps["total_ns"] = steps["total_ns"].where(~late, (1.5 * steps["total_ns"]).round())
    steps.to_parquet(b / "steps.parquet", index=False)
    assert verdicts(compare(a, b).times)["piqp"] == "slower"


@pytest.mark.slow
def test_two_machines_are_compared_by_ratios_to_a_reference(make: Make, capsys: Any) -> None:
    """B's machine takes 3 times as long, and its osqp 6 times as long again: only that is said."""
    a = make("a", seed=1)
    b = make("b", seed=2, machine_id="two", machine=3.0, slow={"osqp": 6.0})
    assert main(["compare", str(a), str(b)]) == 1
    output = " ".join(capsys.readouterr().out.split())
    assert "step times are compared as ratios to daqp (native fresh), whose B/A is 3 on" in output
    assert "another machine: they differ in kernel" in output
    assert main(["compare", str(a), str(b), "--any-machine"]) == 1
    assert "no longer needed" in capsys.readouterr().err
    found = compare(a, b)
    assert verdicts(found.times)["osqp"] == "slower"
    assert "daqp" not in verdicts(found.times)
    row = found.times.set_index("solver").loc["osqp"]
    assert row[["machine", "ratio"]].tolist() == pytest.approx([3, 6], rel=0.02)
    assert not found.shared


@pytest.mark.slow
def test_another_reference_and_one_that_was_not_run(make: Make, capsys: Any) -> None:
    """With osqp as the measure all others take a sixth; a name of nobody is one line, exit 2."""
    a = make("a", seed=1)
    b = make("b", seed=2, slow={"osqp": 6.0})
    ratios = compare(a, b, reference="osqp").times.set_index("solver")["ratio"]
    assert len(ratios) == len(ARMS) - 1
    assert ratios.to_numpy() == pytest.approx(1 / 6, rel=0.03)
    assert main(["compare", str(a), str(b), "--reference", "osqq"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "--reference" in line and "allowed: one of osqp, " in line


@pytest.mark.slow
def test_between_machines_solvers_differ_more_than_between_runs(make: Make) -> None:
    """1.2 times as long is a claim on one machine, and none between two."""
    a = make("a", seed=1)
    slow = {"piqp": 1.2}
    assert verdicts(compare(a, make("b", seed=2, slow=slow)).times)["piqp"] == "slower"
    other = make("c", seed=2, slow=slow, machine_id="two")
    assert verdicts(compare(a, other).times)["piqp"] == "no difference shown"


@pytest.mark.slow
def test_a_folder_without_steps_is_compared_by_its_medians(make: Make, tmp_path: Path) -> None:
    """Its failed steps may include those after a time limit, so they are not compared."""
    a = make("a", seed=1, algo_p50_ns=2e4, failed_steps=12)
    b = make("b", seed=2, algo_p50_ns=3e4, failed_steps=12)
    (b / "steps.parquet").unlink()
    found = compare(a, b)
    remark = "no steps.parquet in B: medians of step times are compared"
    assert f"{remark}, failed steps and verdicts are not" in found.lines
    for one in (found, compare(b, a)):
        assert "failed_steps" not in {figure.measure.column for figure in one.figures}
    assert found.times["raw"].to_numpy() == pytest.approx(1.5)
    (notes, of_steps) = (
        " ".join(table.note for table in one.tables) for one in (found, compare(a, a))
    )
    assert "ratio of the medians" in notes and "geometric mean over the steps" not in notes
    assert "geometric mean over the steps" in of_steps and "medians over" not in of_steps
    page = write_comparison(tmp_path / "compare.html", found).read_text(encoding="utf-8")
    assert "Both runs" in page


@pytest.mark.parametrize(
    ("a", "b", "made"),
    [
        (("1.2", "a", True), ("1.2", "a", True), ""),
        (("1.2", "a", True), ("1.2", "b", True), "made by different commits of dpbench"),
        (("1.2", "", True), ("1.3", "b", True), "made by different versions of dpbench"),
        (("1.2", "", True), ("1.2", "b", True), ""),
        (("1.2", "a", False), ("1.2", "a", False), "made by dpbench with uncommitted changes"),
    ],
)
def test_versions_and_commits_of_both_folders_are_named(
    make: Make, a: tuple[str, str, bool], b: tuple[str, str, bool], made: str
) -> None:
    """A comparison of two solvers by different code of dpbench may show a difference of dpbench."""
    folders = []
    for name, (version, commit, clean) in (("a", a), ("b", b)):
        folder = make(name, seed=1, configurations=("daqp",))
        suite = json.loads((folder / "suite.json").read_text(encoding="utf-8"))
        suite["harness_version"] = version
        suite["revisions"] = [{"commit": commit * 40, "clean": clean}] if commit else []
        (folder / "suite.json").write_text(json.dumps(suite), encoding="utf-8")
        folders.append(folder)
    lines = compare(*folders).lines
    (line,) = (line for line in lines if line.startswith("B: "))
    assert f", dpbench {b[0]} (commit {b[1] * 12}{'' if b[2] else ' with changes'}), " in line
    assert [line for line in lines if line.startswith("made by")] == (
        [line for line in lines if made in line and "may come from dpbench" in line] if made else []
    )
    assert any(made in line for line in lines)


def test_a_description_of_a_scenario_is_not_its_problem() -> None:
    """Other words for a reader leave the runs comparable; another number does not."""
    vessel = {"title": "Ship", "mass": [1.0]}
    scenario = {"shows": "No weather.", "sample_s": 0.3}
    files = {"name": "calm", "scenario": scenario, "vessel": vessel}
    run: Any = SimpleNamespace(files=files, source="", first=0, fallback="", backup="")
    reworded = {"name": "calm", "scenario": {"shows": "Calm water.", "sample_s": 0.3}}
    reworded["vessel"] = vessel | {"title": "The ship"}
    changed = files | {"scenario": scenario | {"sample_s": 0.5}}
    keys = []
    for run.files in (files, reworded, changed):
        keys.append(make_problem_key(run))
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.parametrize("option", ["--margin 0", "--margin nan", "--alpha 0.7", "--alpha much"])
def test_bad_options(make: Make, option: str, capsys: Any) -> None:
    """One line with option and value, exit 2."""
    a = make("a", seed=1)
    try:
        code = main(["compare", str(a), str(a), *option.split()])
    except SystemExit as exit_:
        code = int(exit_.code or 0)
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert code == 2
    assert all(part in line for part in option.split())


def test_folders_without_a_common_cell(make: Make, tmp_path: Path) -> None:
    a, b = make("a", seed=1, configurations=("daqp",)), make("b", seed=1, configurations=("piqp",))
    with pytest.raises(InputError, match="no cell in common with"):
        compare(a, b)
    with pytest.raises(InputError, match="no such folder"):
        compare(a, tmp_path / "none")
    c = make("c", seed=1, configurations=("daqp",), settings="mine")
    with pytest.raises(InputError, match=r"such as default and mine; .* same names of settings"):
        compare(a, c)


@pytest.mark.slow
def test_cells_without_a_partner_are_named(make: Make) -> None:
    a = make("a", seed=1, configurations=("daqp", "osqp"))
    b = make("b", seed=1, configurations=("daqp", "scs"))
    found = compare(a, b)
    assert len(found.pairs.pairs) == 1
    text = "\n".join(found.lines)
    assert "only in A, not compared: osqp" in text
    assert "only in B, not compared: scs" in text
    changed = json.dumps({"scenario": {"name": "paper", "vessel": "another"}})
    with pytest.raises(InputError, match="no cell in common with"):
        compare(a, make("c", seed=1, cell=changed))


@pytest.mark.slow
def test_exit_codes_and_markdown(make: Make, tmp_path: Path, capsys: Any) -> None:
    """0 where nothing is worse, 1 where something is; Markdown to a file or to the screen."""
    a, b = make("a", seed=1), make("b", seed=2, slow={"daqp": 1.4})
    page = tmp_path / "compare.md"
    assert main(["compare", str(b), str(a)]) == 0
    assert main(["compare", str(a), str(b), "--markdown", str(page)]) == 1
    text = page.read_text(encoding="utf-8")
    (row,) = [line for line in text.splitlines() if line.startswith("| daqp (")]
    assert row.endswith("| slower |")
    capsys.readouterr()
    assert main(["compare", str(a), str(b), "--markdown", "-"]) == 1
    assert capsys.readouterr().out == text


def test_a_comparison_that_fails_leaves_no_earlier_one(tmp_path: Path) -> None:
    """Or a script would publish the regressions of the pull request before."""
    page, figures = tmp_path / "compare.md", tmp_path / "compare.html"
    for file in (page, figures):
        file.write_text("of yesterday")
    words = ["--markdown", str(page), "--html", str(figures)]
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), *words]) == 2
    assert not page.exists() and not figures.exists()


@pytest.mark.slow
def test_settings_without_effect_are_one_piece_of_evidence(make: Make) -> None:
    folders = []
    for name, seed in (("a", 1), ("b", 2)):
        folder = make(name, seed=seed)
        runs, steps = (pd.read_parquet(folder / f"{t}.parquet") for t in ("runs", "steps"))
        twin = runs.iloc[:1].assign(run_id="twin", settings="high")
        rows = steps[steps["run_id"] == runs["run_id"][0]].assign(run_id="twin")
        both = pd.concat([runs, twin]), StepsInMemory(pd.concat([steps, rows]))
        suite = {"name": "synthetic"}
        write_results(folder, Results(*both, {"id": "one"}, suite))
        folders.append(folder)
    found = compare(*folders)
    assert len(found.pairs.pairs) == len(found.times) == len(ARMS)
    assert f"{len(ARMS)} cells compared" in found.lines
    assert found.answers["settings"].nunique() == 1


@pytest.mark.slow
def test_a_load_that_the_reference_kernel_does_not_feel_is_the_machine(make: Make) -> None:
    """1.4 in all configurations and in the calibration workload, but not in the other."""
    a = make("a", seed=1, load_kernel_ns=6e4)
    loaded = compare(a, make("b", seed=2, machine=1.4, load_kernel_ns=1.4 * 6e4))
    assert not loaded.worse
    (line,) = [line for line in loaded.lines if line.startswith("`paper`")]
    assert "1.400 (calibration workload)" in line
    assert compare(a, make("c", seed=2, machine=1.4, load_kernel_ns=6e4)).worse


@pytest.mark.slow
def test_a_configuration_that_met_another_neighbour_is_not_blamed_for_it(make: Make) -> None:
    """One configuration 1.1 times as slow whose load kernel is 1.2 times as slow as the others'."""
    plain = compare(make("a", seed=1), make("b", seed=2, slow={"piqp": 1.1}))
    assert verdicts(plain.times)["piqp"] == "slower"
    a = make("c", seed=1, load_kernel_ns=6e4)
    b = make("d", seed=2, slow={"piqp": 1.1}, load_kernel_ns=6e4)
    runs = pd.read_parquet(b / "runs.parquet")
    runs.loc[runs["solver"] == "piqp", "load_kernel_ns"] *= 1.2
    runs.to_parquet(b / "runs.parquet", index=False)
    found = compare(a, b).times.set_index("solver")
    assert found.loc["piqp", "verdict"] == "no difference shown"
    assert found.loc["piqp", "machine"] == pytest.approx(1.2**0.5, rel=0.02)
    assert found.loc["piqp", "raw"] == pytest.approx(1.1, rel=0.02)
    assert "half of this excess is included" in compare(a, b).markdown()


def test_another_build_of_the_same_version_is_said() -> None:
    builds = ("BLASFEO generic", "BLASFEO AVX2 FMA")
    rows = [identity("replay", "hpipm", {"build": build}) for build in builds]
    generic, fast = build_run_records(convert_to_run_columns(pd.DataFrame(rows)))
    assert Pair(generic, generic).configuration_label.startswith("hpipm (")
    output = "hpipm 1.0 BLASFEO generic → 1.0 BLASFEO AVX2 FMA ("
    assert Pair(generic, fast).configuration_label.startswith(output)


@pytest.mark.slow
def test_settings_whose_options_changed_are_compared_by_their_name(make: Make) -> None:
    """Fewer errors with the new options are an improvement, more a regression."""
    mine: dict[str, Any] = {"settings": "mine", "configurations": ("daqp",)}
    a = make("a", seed=1, options='{"primal_tol": 1e-05}', errors={"daqp": 0.5}, **mine)
    b = make("b", seed=1, options='{"dual_tol": 0.1, "primal_tol": 1e-06}', **mine)
    change = "dual_tol not set → 0.1, primal_tol 1e-5 → 1e-6"
    compared = compare(a, b)
    assert not compared.pairs.only_a and not compared.pairs.only_b
    (pair,) = compared.pairs.pairs
    assert pair.configuration_label == f"daqp (native fresh, mine) with {change}"
    assert f"options changed: daqp mine: {change}" in compared.lines
    assert make_lead_sentences(compared)[0] == f"Options changed: daqp mine: {change}."
    assert not compared.worse and "better" in set(compared.answers["change"])
    assert compare(b, a).worse
    assert not any("options changed" in line for line in compare(a, a).lines)


def test_each_folder_has_the_ratios_of_two_settings(tmp_path: Path) -> None:
    """Half the time of default in A; in B, on a machine half as fast, the same."""
    for name, factor in (("a", 1.0), ("b", 2.0)):
        one = MadeRecords()
        for settings, median_us in (("default", 40.0), ("mine", 20.0)):
            options = {"options": '{"rho": 1.6}'} if settings == "mine" else {}
            own = {"settings": settings, "spread": 0.1, **options}
            one.replay("osqp", median_us=factor * median_us, **own)
        write_results(tmp_path / name, one.results())
    compared = compare(tmp_path / "a", tmp_path / "b")
    (table,) = (one for one in compared.tables if "ratio in A" in one.heads)
    (row,) = table.rows
    labels = ("osqp (qpsolvers fresh, mine)", "osqp (qpsolvers fresh)", "30")
    assert row[:3] == labels and row[3:5] == row[5:7]
    assert float(row[3]) == pytest.approx(0.5, rel=0.02)
    low, high = json.loads(row[4])
    assert low < float(row[3]) < high
    assert "Two settings of one solver, within each folder" in compared.markdown()


def test_two_settings_whose_order_depends_on_the_measure_are_marked(tmp_path: Path) -> None:
    """Half the geometric mean of default, and twice its p99: one step in fifty takes five times."""
    one = MadeRecords()
    one.replay("osqp", median_us=40.0, spread=0.1)
    stalls = dict.fromkeys(range(0, 1000, 50), 5.0)
    mine = {"settings": "mine", "options": '{"rho": 1.6}', "slow": stalls}
    one.replay("osqp", median_us=20.0, spread=0.1, **mine)
    folder = one.write(tmp_path / "a")
    (table,) = (t for t in compare(folder, folder).tables if "ratio in A" in t.heads)
    ((*_, interval),) = table.rows
    assert interval.endswith("], unstable")
    assert "Unstable: " in table.note


def test_changed_verdicts_are_listed_and_unchanged_ones_are_not(tmp_path: Path) -> None:
    """5 ms a step in B for one solver of two; the limit of the p99 is 3 ms."""
    for name, median_us in (("a", 20.0), ("b", 5000.0)):
        one = MadeRecords()
        for solver, own_us in (("daqp", median_us), ("piqp", 20.0)):
            one.loop(solver)
            one.replay(solver, median_us=own_us, spread=0.1)
        one.write(tmp_path / name)
    found = compare(tmp_path / "a", tmp_path / "b")
    assert found.lines[0] == "verdicts changed: 1 pass → late"
    assert found.headline == "times not judged; 1 verdict changed"
    judged = [
        replace(one, assessment=replace(one.assessment, verdict=v))
        for one, v in zip(found.compared, ("slower", "equivalent"), strict=True)
    ]
    assert replace(found, compared=judged).headline == "slower, 1 verdict changed"
    assert replace(found, compared=judged[1:]).headline == "1 verdict changed"
    (table,) = (t for t in found.tables if t.title == "Verdicts that changed")
    ((*cells, reason),) = table.rows
    assert cells == ["daqp (qpsolvers fresh)", "pass", "late"]
    assert reason.startswith("B: ") and "`paper`" in reason
    assert "| daqp (qpsolvers fresh) | pass | late |" in found.markdown()
    page = write_comparison(tmp_path / "compare.html", found).read_text(encoding="utf-8")
    assert "Verdicts that changed" in page
    better = compare(tmp_path / "b", tmp_path / "a")
    assert "verdicts changed: 1 late → pass" in better.lines
    for same in (compare(tmp_path / "a", tmp_path / "a"), compare(tmp_path / "b", tmp_path / "b")):
        assert not any(line.startswith("verdicts") for line in same.lines)
        assert "verdict" not in same.headline
        assert not any("Verdicts" in table.title for table in same.tables)


def test_a_configuration_is_judged_on_the_runs_that_both_folders_have(tmp_path: Path) -> None:
    """A scenario that only B ran, and in which it fails, changes no verdict."""
    for name, scenarios in (("a", ["paper"]), ("b", ["paper", "rough"])):
        one = MadeRecords()
        one.replay("daqp", median_us=20.0)
        for scenario in scenarios:
            one.loop("daqp", scenario, error=1e-9 if scenario == "paper" else 0.5)
        one.write(tmp_path / name)
    found = compare(tmp_path / "a", tmp_path / "b")
    assert not any("verdicts changed" in line for line in found.lines)


@pytest.mark.slow
def test_settings_of_another_name_are_not_compared(make: Make) -> None:
    loop = {"outcome": "finished", "settings": "default", "options": ""}
    mine: dict[str, Any] = {"configurations": ("daqp",), "loop": loop, "options": '{"rho": 0.1}'}
    compared = compare(
        make("a", seed=1, settings="mine", **mine), make("b", seed=2, settings="yours", **mine)
    )
    assert [pair.a.mode for pair in compared.pairs.pairs] == ["closed_loop"]
    (only_a,), (only_b,) = compared.pairs.only_a, compared.pairs.only_b
    assert "mine) with rho=0.1, replay" in only_a and "yours) with rho=0.1, replay" in only_b
