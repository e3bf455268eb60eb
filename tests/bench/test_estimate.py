"""The estimate of a campaign equals the times of its last runs, or what stated rates give."""

from pathlib import Path

import pytest

from dpbench import load_results
from dpbench.bench.estimate import (
    JUDGE_STEP_S,
    STATED_RATES,
    Rates,
    estimate_time_and_size,
    read_measured_rates,
)
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.record.cell import CapabilitySource, Cell
from dpbench.bench.record.configuration import CONFIGURATION_COLUMNS
from dpbench.bench.workers.jobs import CELL_S, STEP_S
from dpbench.cli.main import main
from tests.bench.deterministic import suite_file, suite_toml


def cell(solver: str, steps: int, **more: object) -> PlannedCell:
    of_cell = {"mode": "closed_loop", "scenario": {"name": "x"}, "formulation": "condensed_box"}
    way = {"route": "native", "policy": "fresh", "settings": "default", "solver": solver}
    return PlannedCell(Cell(**{**of_cell, **way, "steps": steps, **more}))  # type: ignore[arg-type] # mypy cannot type ** of mixed values


@pytest.mark.parametrize("slots", [1, 2])
def test_time_goes_by_cells_steps_and_configurations(slots: int) -> None:
    kind = ("closed_loop", "daqp", "native", "fresh", "default", "", "condensed_box", "scaled")
    rates = Rates("a test", {kind: 0.004})
    loops = [cell("daqp", 400)] * 90 + [cell("osqp", 1000)] * 30
    replays = [cell("osqp", 50, mode="replay", rounds=4, warmup_steps=5)] * 3
    found = estimate_time_and_size([*loops, *replays], slots, rates)
    of_loops = 120 * CELL_S + 36_000 * (0.004 + JUDGE_STEP_S) + 30_000 * STEP_S
    of_replays = 3 * (CELL_S + 205 * STEP_S)
    assert found.time_s == pytest.approx(of_loops / slots + of_replays)
    assert (found.cells, found.steps) == (123, 66_000 + 3 * 205)
    assert found.size_bytes == pytest.approx(123 * 500 + 90 * found.steps)


def test_what_does_not_run_takes_nothing() -> None:
    edge = {"mode": "replay", "scenario": {}, "source": CapabilitySource("x")}
    refused = PlannedCell(cell("osqp", 400).cell, "no such policy")
    found = estimate_time_and_size(
        [cell("daqp", 20), refused, cell("daqp", 9, **edge)], 1, STATED_RATES
    )
    assert (found.cells, found.refused, found.unmeasured) == (2, 1, 1)
    assert found.time_s == pytest.approx(CELL_S + 20 * STEP_S)


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
    cells, cost, rates = said.out.splitlines()
    assert cells == "83 cells to run and 1 refused: 1 089 recorded steps"
    assert "s on this machine" in cost and "MB of tables" in cost
    assert rates.startswith("by stated rates")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny.toml"]
    assert main(["run", "tiny.toml", "--quiet", "--solver", "daqp", "--out", "mine"]) == 0
    assert main(["run", "tiny.toml", "--dry-run", "--out", "mine"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "by the runs in mine"
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
