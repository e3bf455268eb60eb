"""What befalls the harness beside its cells: they are lost, and blame nobody."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.record.result_folder import accidents
from dpbench.bench.workers import batch, scratch

pytestmark = pytest.mark.alone

STEPS = 8
HEAD = """
title = "A suite for one test"
solvers = ["quadprog"]
baseline_law = false
cell_limit_s = 60.0
rounds = 1
warmup_steps = 0
"""
LOOPS = f"""
[[closed_loop]]
scenarios = ["paper"]
settings = ["default", "high"]
steps = {STEPS}
"""
REPLAYS = f"""
[[replay]]
scenario = "paper"
steps = {STEPS}
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(HEAD + LOOPS + REPLAYS, encoding="utf-8")
    return path


@pytest.mark.parametrize("suffixes", [("judged",), ("judged", "evaluated.json")])
def test_what_goes_away_between_judging_and_keeping_is_lost(
    suffixes: tuple[str, ...], suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In closed loop and replay alike; no cell is finished without its steps."""
    out, split = tmp_path / "out", batch._Run.split

    def tidied(self: Any) -> Any:
        ended = split(self)
        for suffix in suffixes:
            for path in self.folder.glob(f"*.{suffix}"):
                path.unlink()
        return ended

    with monkeypatch.context() as patch:
        patch.setattr(batch._Run, "split", tidied)
        assert accidents(run_campaign(suite, out, jobs=1))[0] == 3
    runs = load_results(out).runs
    assert set(runs["outcome"]) == {"lost"}
    assert runs["outcome_detail"].str.contains("went away").all()
    assert accidents(run_campaign(suite, out))[0] == 0
    assert set(load_results(out).runs["steps_done"]) == {STEPS}


def test_rows_of_further_names_are_lost_with_their_cell(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With --fresh no name of a cell that was lost keeps what it was at an earlier time."""
    out = run_campaign(suite, tmp_path / "out")
    runs = load_results(out).runs
    assert len(runs) == 3 and set(runs["outcome"]) == {"finished"}
    monkeypatch.setattr(scratch, "free_bytes", lambda place: 1000)
    run_campaign(suite, out, fresh=True)
    assert load_results(out).runs["outcome"].tolist() == ["lost"] * 3
