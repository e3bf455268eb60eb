"""The estimate of a campaign equals the times of its last runs, or what stated rates give."""

import json
import os
import re
import tempfile
import tomllib
from pathlib import Path

import pytest

from dpbench import load_results
from dpbench.bench import estimate
from dpbench.bench.estimate import (
    COMPILE_S,
    JUDGE_STEP_S,
    LONG_CERTIFICATES,
    REPORT_CELL_S,
    REPORT_S,
    SMALL,
    SOURCE_STEP_S,
    START_S,
    STATED_RATES,
    TIMED_CELL_S,
    USUAL_SIZE,
    Rates,
    _estimate_sources_s,
    describe_what_is_not_forecast,
    estimate_step_s,
    estimate_time_and_size,
    measure_qp_size,
    read_measured_rates,
)
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.record.cell import (
    CONFIGURATION_COLUMNS,
    CapabilitySource,
    Cell,
    ConsequenceSource,
    HardestSource,
    RandomSource,
    RecordedSource,
)
from dpbench.bench.workers.jobs import CELL_S
from dpbench.cli.main import main
from dpbench.locks import find_safe_lock_folder
from dpbench.qp.random_sequence import RandomRecipe
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.table import find_solver_record
from tests.bench.deterministic import suite_file, suite_toml


def cell(solver: str, steps: int, **more: object) -> PlannedCell:
    of_cell = {"mode": "closed_loop", "scenario": {}, "formulation": "condensed_box"}
    way = {"route": "native", "policy": "fresh", "settings": "default", "solver": solver}
    return PlannedCell(Cell(**{**of_cell, **way, "steps": steps, **more}))  # type: ignore[arg-type] # mypy cannot type ** of mixed values


@pytest.mark.parametrize("slots", [1, 2])
def test_time_goes_by_cells_steps_and_configurations(slots: int) -> None:
    """Loops share the slots, interleaved replays do not; each more solver costs its own steps."""
    kind = ("closed_loop", "daqp", "native", "fresh", "default", "", "condensed_box", "scaled")
    rates = Rates("a test", {kind: 0.004, ("replay", *kind[1:]): 0.002})
    source = RandomSource("q", recipe=RandomRecipe("plain", 40, 20, 1, 50))
    loops = [cell("daqp", 400, source=source)] * 90
    replays = [cell("daqp", 50, mode="replay", rounds=4, warmup_steps=5)] * 3
    alone, both = (
        estimate_time_and_size(cells, slots, rates) for cells in (loops, [*loops, *replays])
    )
    judged = 400 * JUDGE_STEP_S
    assert alone.time_s == pytest.approx(
        START_S
        + (400 * SOURCE_STEP_S + 90 * (CELL_S + 400 * 0.004 + judged)) / slots
        + REPORT_S
        + 90 * REPORT_CELL_S
    )
    assert alone.report_s == pytest.approx(REPORT_S + 90 * REPORT_CELL_S)
    assert both.time_s - alone.time_s >= 3 * (205 * 0.002 + TIMED_CELL_S)
    assert (both.cells, both.steps) == (93, 36_000 + 3 * 205)
    assert both.size_bytes == pytest.approx(93 * 500 + 90 * both.steps)


def test_a_reference_loop_is_solved_once_whatever_is_made_of_it() -> None:
    """Closed loops, a replay, hardest steps, a consequence analysis; of SI units too."""
    files = load_scenario("paper").files
    uses: list[dict[str, object]] = [
        {"mode": "closed_loop"},
        {"mode": "closed_loop", "units": "si"},
        {"mode": "replay", "first": 20},
        {"mode": "replay", "source": HardestSource("paper hardest 5", 180)},
        {"mode": "replay", "source": ConsequenceSource("paper, A lost", "A", 1.25)},
    ]
    cells = [cell("daqp", 100, scenario=files, **use).cell for use in uses]
    step_s = SOURCE_STEP_S * measure_qp_size(cells[0]) / USUAL_SIZE
    assert _estimate_sources_s(cells) == pytest.approx(180 * step_s)
    other = cell("daqp", 100, scenario=load_scenario("calm").files).cell
    assert _estimate_sources_s([*cells, other]) == pytest.approx(280 * step_s)


def test_a_budget_and_a_limit_bound_the_time_of_a_run() -> None:
    """A replay whose budget is used up still has three rounds; nothing is longer than its limit."""
    kind = ("replay", "daqp", "native", "fresh", "default", "", "condensed_box", "scaled")
    rates = Rates("a test", {kind: 0.01})

    def time_s(**more: object) -> float:
        replay = {"mode": "replay", "scenario": {}, "rounds": 9, "limit_s": 99.0}
        return estimate_time_and_size([cell("daqp", 100, **{**replay, **more})], 1, rates).time_s

    whole = time_s()
    assert whole - time_s(budget_s=0.5) == pytest.approx(6.0)
    assert whole - time_s(budget_s=4.5) == pytest.approx(4.0)
    assert whole - time_s(limit_s=2.0) == pytest.approx(7.0)


@pytest.mark.parametrize("route", ["native", "qpsolvers"])
def test_a_stated_step_takes_longer_in_a_larger_qp(route: str) -> None:
    for solver in ("osqp", "daqp", "a solver of a plug-in"):
        times = [estimate_step_s(solver, route, size) for size in (10, 30, 60, 150, 340, 900)]
        assert times[0] == times[1] and times[1:] == sorted(set(times))


def test_the_stated_table_holds_solvers_that_exist() -> None:
    path = Path(estimate.__file__).with_name("stated_rates.toml")
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    for name, times in table["times"].items():
        solver, route = name.split(" ")
        assert route in find_solver_record(solver).routes and len(times) == len(table["sizes"])
    assert estimate_step_s("osqp", "native", 60) == pytest.approx(
        1e-6 * table["times"]["osqp native"][1]
    )


@pytest.mark.parametrize(("name", "size"), [("paper", 30), ("rough", 60), ("thrusters", 340)])
def test_the_size_is_that_of_the_scenario(name: str, size: int) -> None:
    files = load_scenario(name).files
    assert measure_qp_size(cell("daqp", 5, scenario=files).cell) == size
    allocation = {"mode": "replay", "source": ConsequenceSource("x", "A")}
    assert measure_qp_size(cell("daqp", 5, scenario=files, **allocation).cell) == SMALL
    stored = RecordedSource("x", "paper-30-5")
    assert measure_qp_size(cell("daqp", 5, mode="replay", scenario={}, source=stored).cell) == 30


@pytest.mark.parametrize(
    ("name", "bound"), [("paper", ""), ("thrusters", "at least "), ("three_forces", "")]
)
def test_with_commanded_thrusters_the_time_is_a_lower_bound(name: str, bound: str) -> None:
    """The certificates of some steps are long there; of a run that is finished none is made."""
    cells = [cell("daqp", 5, scenario=load_scenario(name).files)]
    lines = estimate_time_and_size(cells, 1, STATED_RATES).lines
    assert re.match(rf"Estimated time: {bound}\d", lines[1])
    assert (LONG_CERTIFICATES in lines) is (bound == "at least ")
    done = estimate_time_and_size(cells, 1, STATED_RATES, finished={0}).lines
    assert re.match(r"Estimated time: \d", done[1])


def test_what_does_not_run_takes_nothing() -> None:
    edge = {"mode": "replay", "scenario": {}, "source": CapabilitySource("x")}
    random = {"scenario": {}, "source": RandomSource("q", recipe=RandomRecipe("plain", 9, 9, 1, 5))}
    refused = PlannedCell(cell("osqp", 400).cell, "no such policy")
    cells = [cell("daqp", 20, **random), refused, cell("daqp", 9, **edge)]
    found = estimate_time_and_size(cells, 1, STATED_RATES)
    assert (found.cells, found.refused, found.unmeasured) == (2, 1, 1)
    assert found.refusal_lines == ["1 refused (osqp): no such policy"]
    of_first = estimate_time_and_size(cells[:1], 1, STATED_RATES)
    assert found.time_s - found.report_s == pytest.approx(of_first.time_s - of_first.report_s)
    assert of_first.time_s - of_first.report_s > START_S
    alone = estimate_time_and_size([refused], 1, STATED_RATES)
    assert alone.time_s == alone.report_s == REPORT_S + REPORT_CELL_S


def test_refused_cells_are_grouped_by_reason() -> None:
    reasons = [("osqp", "b"), ("daqp", "a"), ("osqp", "a"), ("osqp", "a"), ("scs", "")]
    cells = [PlannedCell(cell(solver, 400).cell, reason) for solver, reason in reasons]
    found = estimate_time_and_size(cells, 1, STATED_RATES)
    assert found.refusal_lines == ["3 refused (daqp, osqp): a", "1 refused (osqp): b"]
    assert found.refusals == {"b": {"osqp": 1}, "a": {"daqp": 1, "osqp": 2}}


def test_finished_cells_take_nothing_but_have_rows() -> None:
    loops = [cell("daqp", 400), cell("osqp", 200)]
    one, both = (
        estimate_time_and_size(loops, 1, STATED_RATES, finished=done) for done in ({0}, {0, 1})
    )
    assert (one.cells, one.finished, one.steps) == (1, 1, 200)
    assert one.lines[0] == "1 cells to run and 1 finished; 200 steps to record"
    assert (both.cells, both.time_s) == (0, both.report_s)
    assert one.size_bytes == estimate_time_and_size(loops, 1, STATED_RATES).size_bytes


def test_kernels_are_compiled_once() -> None:
    """Their time is in the forecast of a run where none is in the cache, and named."""
    loops = [cell("daqp", 400)]
    usual, first = (
        estimate_time_and_size(loops, 1, STATED_RATES, is_compiled=there) for there in (True, False)
    )
    assert first.time_s - usual.time_s == pytest.approx(COMPILE_S)
    assert "to compile kernels once" in first.lines[1] and "compile" not in usual.lines[1]
    done = estimate_time_and_size(loops, 1, STATED_RATES, finished={0}, is_compiled=False)
    assert done.time_s == done.report_s


@pytest.mark.parametrize(("load", "factor"), [(0.1, ""), (4.0, "up to 3 times as long")])
def test_load_and_waits_are_named(
    load: float, factor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    first, *others = describe_what_is_not_forecast(2)
    assert first.startswith("not included: waits for other dpbench commands")
    assert [line.endswith(factor) for line in others] == [True] * bool(factor)
    other = json.dumps({"work": "dpbench run seas", "since": 0.0, "pid": os.getppid()})
    (find_safe_lock_folder() / "machine").write_text(f"{other}\n")
    assert "(dpbench run seas, since" in describe_what_is_not_forecast(2)[1]


SUITE = suite_toml(
    **{"solvers": ["daqp", "quadprog"], "rounds": 2, "warmup_steps": 3},
    study=[{"base": "weather", "steps": 12, "replicates": {"count": 40}}],
    replay=[{"scenario": "paper", "steps": 20, "policies": ["fresh", "warm"]}],
)


@pytest.mark.slow
def test_a_dry_run_reads_the_last_folder_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    suite_file(tmp_path, SUITE)
    assert main(["run", "tiny.toml", "--dry-run"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    cells, cost, rates, *others, remark, refusal = said.out.splitlines()
    assert refusal.startswith("1 refused (quadprog): policy warm: ")
    assert cells == "83 cells to run and 1 refused; 1 089 steps to record"
    assert "s on this machine" in cost and "Tables: " in cost
    assert (
        rates.startswith("estimated from step times of another machine") and "for a p99" in remark
    )
    assert others[0].startswith("not included: waits")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny.toml"]
    assert main(["run", "tiny.toml", "--quiet", "--solver", "daqp", "--out", "mine"]) == 0
    assert main(["run", "tiny.toml", "--dry-run", "--out", "mine"]) == 0
    found_lines = capsys.readouterr().out.splitlines()
    assert found_lines[1] == "41 cells to run, 42 finished and 1 refused; 523 steps to record"
    assert "estimated from the runs in mine" in found_lines
    before = {path: path.stat().st_mtime_ns for path in Path("mine").rglob("*")}
    assert main(["run", "tiny.toml", "--dry-run", "--solver", "daqp", "--out", "mine"]) == 0
    done, cost = capsys.readouterr().out.splitlines()[:2]
    assert done == "0 cells to run and 42 finished; 0 steps to record"
    assert cost.startswith("Estimated time: 4.3 s on this machine")
    assert before == {path: path.stat().st_mtime_ns for path in Path("mine").rglob("*")}
    command = ["run", "tiny.toml", "--dry-run", "--fresh", "--solver", "daqp", "--out", "mine"]
    assert main(command) == 0
    assert capsys.readouterr().out.startswith("42 cells to run; ")
    runs, found = load_results("mine").runs, read_measured_rates(Path("mine"))
    # 40 loops of 12 steps; the replays take 2 rounds of 20 and 3 steps to warm up.
    assert len(found.steps_s) == 3
    took_s = runs[runs["mode"] == "closed_loop"]["replay_s"].sum()
    (kind,) = (kind for kind in found.steps_s if kind[0] == "closed_loop")
    assert kind == tuple(
        runs.loc[runs["mode"] == "closed_loop", ["mode", *CONFIGURATION_COLUMNS]].iloc[0]
    )
    assert found.steps_s[kind] == pytest.approx(took_s / (40 * 12))
    size = Path("mine/steps.parquet").stat().st_size
    assert found.step_bytes == pytest.approx(size / len(load_results("mine").steps))


def test_without_a_folder_rates_are_stated(tmp_path: Path) -> None:
    assert read_measured_rates(tmp_path) == read_measured_rates(tmp_path / "none") == STATED_RATES
    (tmp_path / "runs.parquet").write_bytes(b"no table")
    assert read_measured_rates(tmp_path) == STATED_RATES
