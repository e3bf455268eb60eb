"""What a campaign will take is what it took where every cell costs the same, and in its units."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from dpbench.bench import estimate
from dpbench.bench.estimate import estimated, recorded_steps
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.qp_source import CapabilitySource
from dpbench.bench.record.recorded_steps import StepsInMemory
from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.cli.main import main
from tests.result_folder import write_results

OF_CELL_S, OF_STEP_S, SOLVER_S = 0.5, 0.004, {"daqp": 1e-5, "osqp": 3e-5}


def cell(solver: str, steps: int, **more: object) -> PlannedCell:
    of_cell = {"mode": "closed_loop", "scenario": {"name": "x"}, "formulation": "condensed_box"}
    way = {"route": "native", "policy": "fresh", "settings": "default", "solver": solver}
    return PlannedCell(Cell(**{**of_cell, **way, "steps": steps, **more}))  # type: ignore[arg-type] # mypy cannot type ** of mixed values


class Machine:
    """A campaign that takes exactly so much a cell and a step, on so many slots."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, slots: int) -> None:
        self.now, self._slots, self.ran = 0.0, slots, list[PlannedCell]()
        monkeypatch.setattr(estimate.time, "monotonic", lambda: self.now)

    def run(self, cells: Sequence[PlannedCell], folder: Path) -> None:
        """Let time pass, and leave the tables."""
        self.ran += cells
        slots = 1 if cells[0].cell.mode == "replay" else self._slots
        runs, steps = [], []
        for i, planned in enumerate(cells):
            cell, n = planned.cell, recorded_steps(planned.cell)
            solver_s = SOLVER_S[cell.solver]
            self.now += (OF_CELL_S + n * (OF_STEP_S + solver_s)) / slots
            way = {name: getattr(cell, name) for name in estimate._KIND}
            runs.append({"run_id": f"{i}", "schema": SCHEMA_VERSION, **way})
            times = pd.DataFrame({"k": range(n), "total_ns": round(1e9 * solver_s)})
            steps.append(times.assign(run_id=f"{i}"))
        write_results(folder, Results(pd.DataFrame(runs), StepsInMemory(pd.concat(steps)), {}, {}))


@pytest.mark.parametrize("slots", [1, 2])
def test_time_goes_by_cells_steps_and_solvers(slots: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a machine on which it does exactly, the estimate is exact, whatever was sampled of it."""
    machine = Machine(monkeypatch, slots)
    loops = [cell("daqp", 400)] * 90 + [cell("osqp", 1000)] * 30
    replays = [cell("osqp", 50, mode="replay", rounds=4, warmup_steps=5)] * 3
    found = estimated([*loops, *replays], slots, machine.run)
    of_loops = 120 * OF_CELL_S + 66_000 * OF_STEP_S + 36_000 * 1e-5 + 30_000 * 3e-5
    of_replays = 3 * (OF_CELL_S + 205 * (OF_STEP_S + 3e-5))
    assert found.time_s == pytest.approx(of_loops / slots + of_replays)
    assert (found.cells, found.steps, found.sampled) == (123, 66_000 + 3 * 205, 5 + 2 + 1)
    assert found.took_s == pytest.approx(machine.now)
    assert max(planned.cell.steps for planned in machine.ran) == estimate.MANY


def test_what_does_not_run_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused cells are counted apart, and so are those that take too long to be tried."""
    edge = {"mode": "replay", "scenario": {}, "source": CapabilitySource("x")}
    refused = PlannedCell(cell("osqp", 400).cell, "no such policy")
    machine = Machine(monkeypatch, 1)
    found = estimated([cell("daqp", 20), refused, cell("daqp", 9, **edge)], 1, machine.run)
    assert (found.cells, found.refused, found.unmeasured, found.sampled) == (2, 1, 1, 1)
    assert found.time_s == pytest.approx(OF_CELL_S + 20 * (OF_STEP_S + 1e-5))


SUITE = """
title = "A suite for one test"
solvers = ["daqp", "quadprog"]
baseline_law = false
cell_limit_s = 60.0
rounds = 2
warmup_steps = 3

[[study]]
base = "weather"
steps = 12
replicates = { key = "environment.seed", count = 40 }

[[replay]]
scenario = "paper"
steps = 20
policies = ["fresh", "warm"]
"""


@pytest.mark.slow
def test_a_dry_run_says_what_a_run_would_take_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The count of cells and steps is that of the plan; no folder, and nothing but three lines."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(SUITE, encoding="utf-8")
    assert main(["run", "tiny.toml", "--dry-run"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    cells, cost, measured = said.out.splitlines()
    assert cells == "83 cells to run and 1 refused: 1 089 recorded steps"
    assert "s on this machine" in cost and "MB of tables" in cost
    assert "7 of the cells" in measured, "two of each 40, and each of three replays"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny.toml"]


def test_the_sample_is_taken_from_all_of_a_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of a study's points may be its cheapest: one of every twenty is taken."""
    machine = Machine(monkeypatch, 2)
    estimated([cell("daqp", 50, scenario={"name": str(i)}) for i in range(60)], 2, machine.run)
    assert {p.cell.scenario["name"] for p in machine.ran if p.cell.scenario} == {"0", "20", "40"}


def test_nothing_to_run_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where every cell is refused there is nothing to measure."""
    machine = Machine(monkeypatch, 2)
    found = estimated([PlannedCell(cell("daqp", 5).cell, refused="no such route")], 2, machine.run)
    assert (found.time_s, found.size_bytes, machine.ran) == (0.0, 0.0, [])
