"""Windows of the hardest steps: the rule by hand, their place in a plan, and the QPs they hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dpbench import load_results, run_campaign
from dpbench.analysis.records.records import Records
from dpbench.bench.plan.plan import plan
from dpbench.bench.plan.run_request import with_choices
from dpbench.bench.plan.suite import ReplayTable, SuiteFile
from dpbench.bench.record.cell import Cell, HardestSource
from dpbench.bench.run.exact_loop import ExactLoop
from dpbench.bench.sequences.hardest import (
    active_limits,
    first_of_hardest,
    hardest_window,
    hardness,
)
from dpbench.bench.sequences.source import (
    replayed,
    source_file,
)
from dpbench.errors import InputError
from dpbench.qp.referee.optimum import Optimum
from dpbench.scenario.scenario import load_scenario

NO_OPTIMUM = np.inf


def optimum(y: list[float], y_box: list[float], bound: float = 0.0) -> Optimum:
    """An optimum of which only the multipliers matter."""
    kind = "linear" if np.isfinite(bound) else "infeasible"
    return Optimum(np.zeros(len(y_box)), np.array(y), np.array(y_box), bound, kind)


TABLE = [
    optimum([0.0], [0.0, 0.0]),
    optimum([2.0], [0.0, 0.0]),
    optimum([2.0], [-1.0, 1e-12]),
    optimum([-2.0], [-1.0, 3.0]),
    optimum([1.0], [0.5, 0.5], NO_OPTIMUM),
    optimum([0.0], [-1.0, 0.0]),
]
ACTIVE = [[0, 0, 0], [1, 0, 0], [1, -1, 0], [-1, -1, 1], [0, 0, 0], [0, -1, 0]]
HARDNESS = [0, 1 + 1, 2 + 1, 3 + 2, 6, 1 + 1]
"""Active limits plus changes; 1 more than all others where there is no optimum."""


def test_hardness_counts_active_limits_and_their_changes() -> None:
    """A limit that changes its side has changed; a multiplier of 1e-12 is none; an infeasible step
    has no active limits, and is the hardest."""
    active = active_limits(TABLE)
    np.testing.assert_array_equal(active, ACTIVE)
    feasible = np.array([True, True, True, True, False, True])
    np.testing.assert_array_equal(hardness(active, feasible), HARDNESS)


def test_before_the_first_step_no_limit_is_active() -> None:
    """A loop that begins at its limits begins hard."""
    active = np.array([[1, 1, -1], [1, 1, -1]])
    np.testing.assert_array_equal(hardness(active, np.array([True, True])), [6, 3])


@pytest.mark.parametrize(
    ("hard", "steps", "first"),
    [
        ([0, 1, 5, 1, 0, 0], 3, 1),
        ([0, 1, 5, 2, 0, 0], 3, 1),
        ([0, 1, 5, 2, 3, 0], 3, 2),
        ([0, 0, 0, 0, 0, 9], 3, 3),
        ([9, 0, 0, 4, 4, 4], 3, 0),
        ([2, 0, 0, 0, 0, 2], 2, 0),
        ([0, 0, 3, 0, 0], 3, 0),
        ([0, 7, 0], 1, 1),
        ([1, 2, 3], 3, 0),
    ],
)
def test_the_window_holds_the_hardest_step_and_most_hardness(
    hard: list[int], steps: int, first: int
) -> None:
    """It stays within the stretch; of equals the earliest."""
    assert hardest_window(np.array(hard, dtype=float), steps) == first


def test_the_window_is_chosen_within_its_stretch() -> None:
    """Steps before the stretch count for changes only, steps behind it not at all."""
    assert first_of_hardest(TABLE, 0, 6, 2) == 3
    assert first_of_hardest(TABLE, 0, 4, 2) == 2
    assert first_of_hardest(TABLE, 5, 1, 1) == 5
    assert first_of_hardest(TABLE[:4], 0, 4, 2) == first_of_hardest(TABLE, 0, 4, 2)


def suite_of(**table: object) -> SuiteFile:
    """A suite with one replay."""
    replay = ReplayTable.model_validate({"scenario": "turn"} | table)
    return SuiteFile(title="one", solvers=["daqp"], baseline_law=False, replay=[replay])


def cell(**table: object) -> Cell:
    """The one cell of such a suite."""
    (planned,) = plan(suite_of(**table))
    return planned.cell


def test_a_window_is_a_timed_replay_of_its_scenario() -> None:
    """It shares the file of the loop, of which it needs the whole stretch."""
    window, whole = cell(steps=450, hardest=50), cell(steps=450)
    assert (window.mode, window.scenario_name, window.steps) == ("replay", "turn", 50)
    assert window.sequence == "turn hardest 50"
    assert window.is_timed
    assert window.source_key("") == whole.source_key("")
    assert window.last_step == whole.last_step == 450
    assert Cell.from_json(window.to_json()) == window
    assert cell(first=100, steps=200, hardest=20).sequence == "turn[100:300] hardest 20"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"steps": 40, "hardest": 50}, "at most 40, the steps it is chosen from"),
        ({"hardest": 50, "horizons": ["30/5"]}, "0 with horizons"),
        ({"scenario": "thrusters", "hardest": 50, "consequence": True}, "0 with consequence"),
    ],
)
def test_a_window_that_cannot_be_is_refused(table: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=f"replay of .*hardest.*{words}") as caught:
        plan(suite_of(**table))
    assert "\n" not in str(caught.value)


def test_fewer_steps_cut_the_window_and_its_stretch() -> None:
    """`--steps` is the most of every replay; a scenario of one's own may be shorter too."""
    cut = with_choices(suite_of(steps=450, hardest=50), steps=20)
    assert [p.cell.steps for p in plan(cut)] == [20]
    wide = with_choices(suite_of(steps=450, hardest=50), steps=100)
    assert [(p.cell.steps, p.cell.last_step) for p in plan(wide)] == [(50, 100)]
    other = with_choices(suite_of(first=100, steps=450, hardest=5000), scenarios=["paper"])
    assert [(p.cell.steps, p.cell.last_step) for p in plan(other)] == [(1000, 1000)]


def test_its_qps_are_those_of_the_whole_replay(tmp_path: Path) -> None:
    """Bit for bit, with the same certified optima, whatever else of the loop is in the file."""
    whole, path, short = cell(), tmp_path / "whole.npz", tmp_path / "short.npz"
    source_file(whole).make(path)
    window = cell(steps=200, hardest=30)
    source_file(window).make(short)
    all_of, found = replayed(whole, path), replayed(window, path)
    first = found.sequence.meta["first"]
    again = replayed(window, short)
    assert again.sequence.meta["first"] == first
    assert 0 <= first <= 170
    assert found.optima is not None
    assert all_of.optima is not None
    for k, optimum_k in enumerate(found.optima):
        one, other = found.sequence.problem(k), all_of.sequence.problem(first + k)
        for name in ("P", "q", "A", "l", "u", "lb", "ub"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(optimum_k.z, all_of.optima[first + k].z)
        np.testing.assert_array_equal(optimum_k.z, ExactLoop.load(short).optima[first + k].z)


def test_an_infeasible_step_is_in_the_window(tmp_path: Path) -> None:
    """`thruster_loss_hard` has no feasible point after the loss at 121 s."""
    scenario = load_scenario("thruster_loss_hard")
    source = HardestSource(scenario.name, 450)
    window = Cell("replay", scenario.files, "daqp", "native", "fresh", "default", 10, source=source)
    source_file(window).make(tmp_path / "loop.npz")
    kinds = [o.kind for o in replayed(window, tmp_path / "loop.npz").optima or []]
    assert kinds.count("infeasible") >= 1
    assert replayed(window, tmp_path / "loop.npz").sequence.meta["first"] >= 400


SUITE = """
title = "Windows"
solvers = ["daqp"]
baseline_law = false
cell_limit_s = 60.0
rounds = 1
warmup_steps = 0

[[replay]]
scenario = "rough"
first = 100
steps = 40

[[replay]]
scenario = "rough"
first = 100
steps = 40
hardest = 8
"""


@pytest.mark.slow
def test_a_campaign_records_where_the_window_begins(tmp_path: Path) -> None:
    """Its steps are those of the whole replay from `first_sample` on, certified."""
    suite = tmp_path / "windows.toml"
    suite.write_text(SUITE, encoding="utf-8")
    records = Records(load_results(run_campaign(suite, tmp_path / "out")))
    whole, window = records.select(mode="replay")
    assert (whole.window_of, whole.first_step) == (0, 100)
    assert window.window_of == 40
    assert window.scenario == "rough"
    assert window.horizons == whole.horizons
    assert window.steps_done == 8
    assert window.uncertified == 0
    at = window.first_step - 100
    assert window.first_sample == window.first_step
    columns = ("t_s", "n_active", "iterations", "error_move")
    one, all_of = (records.counting_steps(run, columns) for run in (window, whole))
    for name in ("t_s", "n_active"):
        np.testing.assert_array_equal(one[name], all_of[name][at : at + 8])


def test_a_window_has_its_share_of_the_budgets_and_a_short_warm_up() -> None:
    """A tenth of the stretch may take a tenth of its budgets."""
    suite = suite_of(steps=300, hardest=30).model_copy(
        update={"replay_budget_s": 0.6, "repeat_budget_s": 0.2}
    )
    (planned,) = plan(suite)
    assert planned.cell.budget_s == pytest.approx(0.06)
    assert planned.cell.repeat_budget_s == pytest.approx(0.02)
    assert planned.cell.warmup_steps == 5
    assert cell(steps=300).warmup_steps == 50
