"""Instructions of a generated controller's steps: the right steps, counted each time alike."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpbench.codegen import counted_replay, generate
from dpbench.codegen.controller_data import (
    read_controller_data_of_scenario,
    record_closed_loop_trajectory,
)
from dpbench.codegen.counted_replay import StepCost
from dpbench.codegen.generate import count_steps, generate_controller, list_constant_tables
from dpbench.codegen.solver_sources import make_c_sources_of_active_set
from dpbench.embedded.toolchain import has_extra
from dpbench.errors import SituationError
from dpbench.scenario.scenario import load_scenario

needs_extra = pytest.mark.skipif(not has_extra(), reason="needs the extra embedded")
STEPS = 6


@needs_extra
@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "thrusters_loss"])
def test_every_step_is_counted_and_does_more_than_its_solve(name: str) -> None:
    """θ and q alone take a product of `gradient` with θ: a multiplication for each entry."""
    data = read_controller_data_of_scenario(load_scenario(name))
    sources = make_c_sources_of_active_set(data.qp)
    trajectory = record_closed_loop_trajectory(data, "paper_active_set", STEPS)
    first, again = (
        count_steps(data, sources, list_constant_tables(data), trajectory) for _ in range(2)
    )
    for cost, same in zip(first, again, strict=True):
        assert cost.instructions.tolist() == same.instructions.tolist()
        assert len(cost.instructions) == STEPS
        assert cost.instructions.min() > data.gradient.size
    assert [cost.core for cost in first] == ["Cortex-M7", "Cortex-A53"]


@needs_extra
@pytest.mark.slow
def test_steps_after_a_loss_are_counted_where_the_limit_allows_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The loss of `thrusters_loss` is at 90 s, step 300; the whole loop exceeds this limit."""
    monkeypatch.setattr(counted_replay, "MOST_INSTRUCTIONS", 3_000_000)
    data = read_controller_data_of_scenario(load_scenario("thrusters_loss"))
    sources = make_c_sources_of_active_set(data.qp)
    trajectory = record_closed_loop_trajectory(data, "paper_active_set", 330)
    assert trajectory.changes == (300,)
    for cost in count_steps(data, sources, list_constant_tables(data), trajectory):
        first = [k for k in cost.samples if k < 300]
        assert first == list(range(len(first))) and 0 < len(first) < 290
        after = [k for k in cost.samples if k >= 300]
        assert after[0] == 300 and after == list(range(300, 300 + len(after)))
        assert f"of 330 (0 to {first[-1]} and 300 to {after[-1]})" in cost.steps
        assert 0.8 * 3_000_000 < cost.instructions.sum() < 1.2 * 3_000_000


@pytest.mark.parametrize(
    ("samples", "steps", "ending"),
    [
        (range(1000), "1\u202f000", "(1\u202f000 steps)"),
        (range(442), "442 of 1\u202f000 (0 to 441)", "(counted on steps 0 to 441 of 1\u202f000)"),
        (
            [*range(3), *range(600, 602)],
            "5 of 1\u202f000 (0 to 2 and 600 to 601)",
            "(counted on steps 0 to 2 and 600 to 601 of 1\u202f000)",
        ),
    ],
)
def test_steps_that_were_not_counted_are_named(
    samples: Sequence[int], steps: str, ending: str
) -> None:
    cost = StepCost("Core", np.ones(len(samples)), tuple(samples), 1000, stack=8, code=8)
    assert cost.row["steps"] == steps and cost.summary.endswith(f" at most {ending}")


@needs_extra
@pytest.mark.slow
def test_other_commands_than_recorded_are_refused() -> None:
    data = read_controller_data_of_scenario(load_scenario("paper"))
    sources = make_c_sources_of_active_set(data.qp)
    recorded = record_closed_loop_trajectory(data, "paper_active_set", STEPS)
    shifted = replace(recorded, commands=recorded.commands + 0.01 * data.du_max)
    with pytest.raises(
        SituationError,
        match=r"a command on .* recorded one by 0\.01; allowed: at most",
    ):
        count_steps(data, sources, list_constant_tables(data), shifted)


@needs_extra
@pytest.mark.slow
def test_the_readme_names_the_counts(tmp_path: Path) -> None:
    lines = generate_controller("paper", out=tmp_path, steps=STEPS)
    readme = (tmp_path / "README.md").read_text()
    (row,) = re.findall(r"\| Cortex-M7 \| 6 \| ([\d\u202f]+) \|", readme)
    assert any(f"On Cortex-M7, a step takes {row} instructions" in line for line in lines)
    assert "count_step.c" not in {path.name for path in tmp_path.iterdir()}


def test_without_the_extra_the_readme_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generate, "has_extra", lambda: False)
    lines = generate_controller("paper", out=tmp_path, steps=2)
    remedy = "pip install 'dpbench[embedded]'"
    assert lines[-1] == f"Instructions were not counted: run `{remedy}`, then generate again."
    readme = (tmp_path / "README.md").read_text()
    assert f"Instructions were not counted: run `{remedy}`, then generate again." in readme
