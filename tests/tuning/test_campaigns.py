"""Scores from runs, and the suites that make them."""

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.analysis.records.run_record import RunRecord, build_run_records
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.bench.plan.suite import SuiteFile
from dpbench.bench.progress import Silent
from dpbench.bench.record.schema import convert_to_run_columns
from dpbench.solvers.own_settings import parse_options_of_choice
from dpbench.tuning.campaigns import (
    FAILED,
    MeasuredRuns,
    TunedProblem,
    TunedSolver,
    format_suite_as_toml,
    measure_settings,
    plan_settings,
    score_runs,
    score_settings,
)

LIMIT = Requirements(error_move=1e-2)
SOLVER = TunedSolver("hpipm", "native", "warm", LIMIT)
PROBLEMS = [
    TunedProblem("a[:30]", {"kind": "recorded", "sequence": 'C:\\"a"é.npz'}),
    TunedProblem("paper", {"kind": "replay", "scenario": "paper", "steps": 9}),
]


def _run(settings: str, sequence: str, time_ns: float, **columns: Any) -> RunRecord:
    usual = {"run_id": f"{settings} {sequence}", "mode": "replay", "outcome": "finished"}
    counts = {"steps_planned": 30, "steps_done": 30, "failed_steps": 0, "error_move_max": 1e-6}
    row = usual | counts | {"settings": settings, "sequence": sequence, "algo_max_ns": time_ns}
    (record,) = build_run_records(convert_to_run_columns(pd.DataFrame([row | columns])))
    return record


def _score(*runs: RunRecord) -> Any:
    by_settings = {"default": [_run("default", "a", 100.0), _run("default", "b", 400.0)]}
    by_settings["rho=2"] = list(runs)
    measured = MeasuredRuns([run for own in by_settings.values() for run in own])
    problems = [TunedProblem(name, {}) for name in ("a", "b")]
    (score,) = score_settings(SOLVER, [{"rho": 2}], measured, problems)
    return score


def test_the_time_is_the_geometric_mean_of_ratios_to_the_default() -> None:
    score = _score(_run("rho=2", "a", 200.0), _run("rho=2", "b", 50.0))
    assert score.is_right
    assert score.ratio == pytest.approx(math.sqrt(2.0 * 0.125))


@pytest.mark.parametrize("known", [("p50",), ("p50", "p95"), ("p50", "p95", "p99")])
def test_the_largest_step_does_not_rank_settings(known: Sequence[str]) -> None:
    """The highest percentile that both runs have does, and an interrupted step is above it."""
    names = [f"algo_{name}_ns" for name in known]
    default = _run("default", "a", 300.0, **dict.fromkeys(names, 200.0))
    times = dict.fromkeys(names, 1.0) | {names[-1]: 100.0}
    score = score_runs([_run("rho=2", "a", 1e9, **times)], [default], LIMIT)
    assert score.ratio == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("columns", "excess"),
    [
        ({"error_move_max": 1.0}, 2.0),
        ({"failed_steps": 1}, 0.0),
        ({"error_move_max": math.inf}, FAILED),
        ({"outcome": "crashed", "steps_done": 3, "error_move_max": 1e-9}, FAILED),
    ],
)
def test_one_wrong_run_is_enough(columns: dict[str, Any], excess: float) -> None:
    score = _score(_run("rho=2", "a", 1.0), _run("rho=2", "b", 1.0, **columns))
    assert (score.wrong, score.is_right) == (1, False)
    assert score.excess == pytest.approx(excess) and math.isnan(score.ratio)


@pytest.mark.slow
def test_settings_timed_in_two_commands_are_timed_again_together(tmp_path: Path) -> None:
    """As after an interruption; finished runs are kept where one command timed them all."""
    solver = TunedSolver("daqp", "native", "warm", LIMIT)
    problem = TunedProblem("paper", {"kind": "replay", "scenario": "paper", "steps": 3})
    own = {"strict": {"primal_tol": 1e-9}}
    first = measure_settings(solver, [problem], {}, tmp_path / "a", Silent()).runs
    both = measure_settings(solver, [problem], own, tmp_path / "a", Silent()).runs
    assert {run.settings for run in both} == {"default", "strict"}
    assert len({run.campaign_utc for run in both}) == len({run.turns for run in both}) == 1
    assert both[0].campaign_utc != first[0].campaign_utc
    again = measure_settings(solver, [problem], own, tmp_path / "a", Silent()).runs
    assert {run.campaign_utc for run in again} == {both[0].campaign_utc}


def test_what_was_not_run_is_no_success() -> None:
    assert _score(_run("rho=2", "a", 1.0)).wrong == 1
    assert _score().wrong == 2


def test_the_suite_has_all_settings_on_all_sequences() -> None:
    """Names of any kind stay the same in TOML."""
    options = {"mode": "ROBUST", "mu0": 1e-5}
    text = format_suite_as_toml(SOLVER, PROBLEMS, [options], ["default", "high"])
    suite = SuiteFile.model_validate(tomllib.loads(text))
    assert suite.solvers[0] == "hpipm" and parse_options_of_choice(suite.solvers[1]) == options
    assert suite.recorded[0].sequence == 'C:\\"a"é.npz'
    assert (suite.replay[0].steps, suite.replay[0].policies) == (9, ["warm"])
    assert suite.replay[0].settings == ["default", "high"]


def test_named_settings_have_their_names_in_the_results() -> None:
    """The table of a search and the page of its last comparison name the same settings alike."""
    named = {"yours": {"mu0": 1e-5}, "best": {"mode": "ROBUST"}}
    planned = plan_settings(SOLVER, PROBLEMS[1:], named)
    assert {one.cell.settings for one in planned} == {"default", "yours", "best"}
