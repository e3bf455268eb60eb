"""Default and explicit budgets, time limits and deadlines of cells."""

import json
from dataclasses import replace
from typing import Any, cast

import pandas as pd
import pytest

from dpbench import load_scenario
from dpbench.bench.judge.rows import make_run_row
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import ClosedLoopTable, RandomTable, ReplayTable, SuiteFile
from dpbench.bench.record.cell import Cell, HardestSource, Outcome
from dpbench.bench.run.slow_computer import make_delay_of_cell
from dpbench.bench.workers.interleaved import FEWEST_ROUNDS, ReplayWorker
from dpbench.errors import InputError
from dpbench.solvers.table import Availability


def cells_of(**tables: Any) -> list[Cell]:
    suite = SuiteFile(title="x", solvers=["daqp"], baseline_law=False, **tables)
    return [planned.cell for planned in plan_suite(suite)]


def loop(scenario: str = "calm", **fields: Any) -> Cell:
    files = load_scenario(scenario).files
    return Cell("closed_loop", files, "daqp", "native", "warm", "high", 3, **fields)


REPLAY = ReplayTable(scenario="calm", steps=4)


def test_a_replay_of_a_suite_that_names_no_budget() -> None:
    (cell,) = cells_of(replay=[REPLAY])
    assert (cell.budget_s, cell.repeat_budget_s, cell.limit_s) == (0.0, 0.25, 5.0)
    # The warm-up of 50 steps is no longer than the sequence.
    assert (cell.rounds, cell.warmup_steps) == (5, 4)


def test_the_budgets_of_a_suite_are_those_of_its_replays() -> None:
    own = {"replay_budget_s": 2.0, "repeat_budget_s": 0.75, "cell_limit_s": 9.0}
    random = RandomTable(families=["no_rows"], sizes=[[3, 0]], steps=4)
    loops = ClosedLoopTable(scenarios=["calm"], steps=3)
    found = cells_of(replay=[REPLAY], closed_loop=[loops], random=[random], **own)
    budgets = {cell.sequence: (cell.budget_s, cell.repeat_budget_s, cell.limit_s) for cell in found}
    assert budgets[""] == (0.0, 0.0, 9.0)
    assert budgets["calm[0:4]" if "calm[0:4]" in budgets else "calm"] == (2.0, 0.75, 9.0)
    (untimed,) = budgets.keys() - {"", "calm", "calm[0:4]"}
    assert budgets[untimed] == (0.0, 0.0, 9.0)


def test_the_limit_of_a_table_replaces_that_of_the_suite() -> None:
    tables = [
        ClosedLoopTable(scenarios=["calm"], steps=3, limit_s=1.5),
        ClosedLoopTable(scenarios=["paper"], steps=3),
    ]
    cells = cells_of(closed_loop=tables, cell_limit_s=7.0)
    assert [cell.limit_s for cell in cells] == [1.5, 7.0]
    # Other cells than those of the table are not run again.
    longer = [tables[0].model_copy(update={"limit_s": 3.0}), tables[1]]
    others = cells_of(closed_loop=longer, cell_limit_s=7.0)
    assert [a.key == b.key for a, b in zip(cells, others, strict=True)] == [False, True]


def test_a_cell_that_names_no_budget_has_the_fallback_values() -> None:
    cell = loop()
    assert (cell.budget_s, cell.repeat_budget_s, cell.slowdown) == (0.0, 0.0, 0.0)
    assert (cell.deadline_s, cell.limit_s, cell.fallback) == (0.0, 5.0, "shifted_plan")
    written = json.loads(cell.to_json())
    assert not {"budget_s", "repeat_budget_s", "deadline_s", "slowdown"} & written.keys()
    assert Cell.from_json(cell.to_json()) == cell
    assert loop(deadline_s=0.1).key != cell.key


def worker(spent_s: float, clean_rounds: int, budget_s: float) -> ReplayWorker:
    cell = Cell("replay", {}, "daqp", "native", "warm", "high", 4, budget_s=budget_s)
    found = ReplayWorker("run", cell, cast(Any, None))
    found.spent_s, found.clean_rounds = spent_s, clean_rounds
    return found


@pytest.mark.parametrize(
    ("spent_s", "clean_rounds", "budget_s", "is_budget_exhausted"),
    [
        (2.0, FEWEST_ROUNDS, 2.0, True),
        (1.99, FEWEST_ROUNDS, 2.0, False),
        (9.0, FEWEST_ROUNDS - 1, 2.0, False),
        # A budget of zero is none
        (1e9, 99, 0.0, False),
        (0.0, FEWEST_ROUNDS, 0.0, False),
    ],
)
def test_a_spent_budget_ends_a_replay_after_three_rounds(
    spent_s: float, clean_rounds: int, budget_s: float, is_budget_exhausted: bool
) -> None:
    assert worker(spent_s, clean_rounds, budget_s).is_budget_exhausted is is_budget_exhausted
    assert FEWEST_ROUNDS == 3


@pytest.mark.parametrize(("clean_rounds", "is_budget_exhausted"), [(1, False), (2, True)])
def test_a_spent_budget_ends_a_window(clean_rounds: int, is_budget_exhausted: bool) -> None:
    found = worker(9.0, clean_rounds, 2.0)
    found.cell = replace(found.cell, source=HardestSource("x", 450))
    assert found.is_budget_exhausted is is_budget_exhausted


@pytest.mark.parametrize(
    ("deadline_s", "budget_ns"), [(0.0, 300_000_000), (0.1, 100_000_000), (0.3, 300_000_000)]
)
def test_without_a_deadline_a_step_has_its_sample(deadline_s: float, budget_ns: int) -> None:
    cell = loop(slowdown=2.0, deadline_s=deadline_s)
    delay = make_delay_of_cell(cell, 0.3)
    assert (delay.budget_ns, delay.sample_ns, delay.slowdown) == (budget_ns, 300_000_000, 2.0)
    assert recorded_deadline_s(cell) == pytest.approx(budget_ns / 1e9)


def recorded_deadline_s(cell: Cell) -> float:
    row = make_run_row("run", cell, Outcome("refused", ""), Availability(True), "", None, None)
    return float(row["deadline_s"])


def test_the_deadline_of_a_model_ship_is_its_shorter_sample() -> None:
    assert recorded_deadline_s(loop("calm@cybership2")) == pytest.approx(0.03585685828003181)
    (replay,) = cells_of(replay=[REPLAY])
    assert pd.isna(recorded_deadline_s(replay))


@pytest.mark.parametrize("deadline_s", [-0.001, 0.3001])
def test_a_deadline_beyond_the_sample_is_refused(deadline_s: float) -> None:
    with pytest.raises(
        InputError, match=r"deadline_s: found .*; allowed: .* sample time of 0\.3 s"
    ):
        make_delay_of_cell(loop(deadline_s=deadline_s), 0.3)


@pytest.mark.parametrize(
    ("latency_ns", "samples"),
    [(100, 0), (101, 1), (300, 1), (301, 2), (600, 2), (601, 3), (0, 0)],
)
def test_a_late_answer_arrives_at_the_next_sample(latency_ns: int, samples: int) -> None:
    delay = make_delay_of_cell(loop(slowdown=3.0, deadline_s=100e-9), 300e-9)
    assert delay.count_samples_late(latency_ns) == samples
    assert delay.simulate_latency_ns(50) == 150
