"""Windows of the hardest steps: the rule by hand, their place in a plan, and the QPs they hold."""

from pathlib import Path

import numpy as np
import pytest

from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.run_request import reduce_suite
from dpbench.bench.plan.suite import ReplayTable, SuiteFile
from dpbench.bench.record.cell import Cell, HardestSource
from dpbench.bench.run.exact_loop import ExactLoop, compute_station_metrics, solve_loop_exactly
from dpbench.bench.sequences.loop_sequences import (
    find_active_limits,
    find_hardest_window,
    find_window_start,
    measure_hardness,
)
from dpbench.bench.sequences.source import choose_source_file, read_replay
from dpbench.errors import InputError
from dpbench.qp.referee.optimum import Optimum
from dpbench.scenario.scenario import load_scenario

NO_OPTIMUM = np.inf


def optimum(y: list[float], y_box: list[float], bound: float = 0.0) -> Optimum:
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
    active = find_active_limits(TABLE)
    np.testing.assert_array_equal(active, ACTIVE)
    feasible = np.array([True, True, True, True, False, True])
    np.testing.assert_array_equal(measure_hardness(active, feasible), HARDNESS)


def test_before_the_first_step_no_limit_is_active() -> None:
    active = np.array([[1, 1, -1], [1, 1, -1]])
    np.testing.assert_array_equal(measure_hardness(active, np.array([True, True])), [6, 3])


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
def test_the_window_holds_the_hardest_step(hard: list[int], steps: int, first: int) -> None:
    assert find_window_start(np.array(hard, dtype=float), steps) == first


def test_the_window_is_chosen_within_its_stretch() -> None:
    assert find_hardest_window(TABLE, 0, 6, 2) == 3
    assert find_hardest_window(TABLE, 0, 4, 2) == 2
    assert find_hardest_window(TABLE, 5, 1, 1) == 5
    assert find_hardest_window(TABLE[:4], 0, 4, 2) == find_hardest_window(TABLE, 0, 4, 2)


def suite_of(**table: object) -> SuiteFile:
    replay = ReplayTable.model_validate({"scenario": "turn"} | table)
    return SuiteFile(title="one", solvers=["daqp"], baseline_law=False, replay=[replay])


def cell(**table: object) -> Cell:
    (planned,) = plan_suite(suite_of(**table))
    return planned.cell


def test_a_window_is_a_timed_replay_of_its_scenario() -> None:
    window, whole = cell(steps=450, hardest=50), cell(steps=450)
    assert (window.mode, window.scenario_name, window.steps) == ("replay", "turn", 50)
    assert window.sequence == "turn hardest 50"
    assert window.is_timed
    assert window.source_key("") == whole.source_key("")
    assert window.steps_needed_in_file == whole.steps_needed_in_file == 450
    assert Cell.from_json(window.to_json()) == window
    assert cell(first=100, steps=200, hardest=20).sequence == "turn[100:300] hardest 20"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"steps": 40, "hardest": 50}, "at most 40, the number of steps to choose from"),
        ({"hardest": 50, "horizons": ["30/5"]}, "0 with horizons"),
        ({"scenario": "thrusters", "hardest": 50, "consequence": True}, "0 with consequence"),
    ],
)
def test_a_window_that_cannot_be_is_refused(table: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=f"replay of .*hardest.*{words}") as caught:
        plan_suite(suite_of(**table))
    assert "\n" not in str(caught.value)


def test_fewer_steps_cut_the_window_and_its_stretch() -> None:
    """`--steps` is the most of every replay; a custom scenario may be shorter too."""
    cut = reduce_suite(suite_of(steps=450, hardest=50), steps=20)
    assert [p.cell.steps for p in plan_suite(cut)] == [20]
    wide = reduce_suite(suite_of(steps=450, hardest=50), steps=100)
    assert [(p.cell.steps, p.cell.steps_needed_in_file) for p in plan_suite(wide)] == [(50, 100)]
    other = reduce_suite(suite_of(first=100, steps=450, hardest=5000), scenarios=["paper"])
    assert [(p.cell.steps, p.cell.steps_needed_in_file) for p in plan_suite(other)] == [
        (1000, 1000)
    ]


@pytest.mark.slow
def test_its_qps_are_those_of_the_whole_replay(tmp_path: Path) -> None:
    whole, path, short = cell(), tmp_path / "whole.npz", tmp_path / "short.npz"
    choose_source_file(whole).make_file(path)
    window = cell(steps=200, hardest=30)
    choose_source_file(window).make_file(short)
    all_of, found = read_replay(whole, path), read_replay(window, path)
    first = found.sequence.meta["first"]
    again = read_replay(window, short)
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
    choose_source_file(window).make_file(tmp_path / "loop.npz")
    kinds = [o.kind for o in read_replay(window, tmp_path / "loop.npz").optima or []]
    assert kinds.count("infeasible") >= 1
    assert read_replay(window, tmp_path / "loop.npz").sequence.meta["first"] >= 400


def test_a_replay_carries_the_ship_of_its_loop_up_to_its_end(tmp_path: Path) -> None:
    scenario = load_scenario("squall")
    path, exact = tmp_path / "loop.npz", solve_loop_exactly(scenario)
    exact.save(path)
    for first, steps, left in ((0, 300, False), (200, 200, True)):
        replayed = Cell(
            "replay", scenario.files, "daqp", "native", "fresh", "default", steps, first=first
        )
        found = read_replay(replayed, path).station
        np.testing.assert_equal(found, compute_station_metrics(scenario, exact, first + steps))
        assert np.isfinite(found["exact_left_s"]) == left


def test_a_window_has_its_share_of_the_budgets_and_a_short_warm_up() -> None:
    suite = suite_of(steps=300, hardest=30).model_copy(
        update={"replay_budget_s": 0.6, "repeat_budget_s": 0.2}
    )
    (planned,) = plan_suite(suite)
    assert planned.cell.budget_s == pytest.approx(0.06)
    assert planned.cell.repeat_budget_s == pytest.approx(0.02)
    assert planned.cell.warmup_steps == 5
    assert cell(steps=300).warmup_steps == 50
