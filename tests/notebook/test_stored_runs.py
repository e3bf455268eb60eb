"""Closed loops of this process in a result folder of a campaign, and on its page."""

import json
from pathlib import Path

import pytest

from dpbench import (
    InputError,
    add_runs,
    load_results,
    record_sequence,
    replay,
    run_campaign,
    run_closed_loop,
    save_sequence,
)
from dpbench.report.page.live import _draw_empty_step_charts
from dpbench.report.report import Report
from tests.scenario.plants.test_linear_mpc import GIVEN, Cart, LinearMPC


@pytest.mark.slow
def test_loops_of_an_own_plant_join_the_replays_of_its_qps(tmp_path: Path) -> None:
    mpc = LinearMPC(**GIVEN).truncate(12)
    sequence, out = record_sequence(mpc, plant=Cart), tmp_path / "out"
    save_sequence(tmp_path / "cart.npz", sequence)
    path = str(tmp_path / "cart.npz")
    run_campaign(sequence=path, out=out, solvers=["daqp"], settings=["default"])
    loop = run_closed_loop(mpc, "daqp", plant=Cart)
    assert add_runs(out, [loop]).is_file()
    before = load_results(out)
    assert add_runs(out, [loop]).name == "report.html"
    results = load_results(out)
    assert len(results.runs) == len(before.runs)
    assert results.runs["run_id"].is_unique
    assert sorted(results.runs["mode"].unique()) == ["closed_loop", "replay"]
    row = results.runs[results.runs["mode"] == "closed_loop"].iloc[0]
    assert row["error_move_max"] == loop.summary["error_move_max"]
    assert row["solver_version"] == results.runs["solver_version"].iloc[0] != ""
    steps = results.steps[results.steps["run_id"] == row["run_id"]]
    assert len(steps) == 12
    # The deadline is the sample, and the report speaks of no ship.
    assert results.suite["requirements"]["deadline_ms"] == 100.0
    text = (out / "report.md").read_text(encoding="utf-8")
    assert "Ship: not run" not in text
    assert "no replay has their QPs" not in text
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "The results do not cover other plants, other disturbances" in page
    assert "ships, weather" not in page and "The ship's computer" not in page
    # The page's script shows such a loop without the strip of a ship's forces.
    charts = _draw_empty_step_charts(Report.from_results(results).data)
    assert "moment / limit" not in json.dumps(charts["strips_without_forces"].to_dict())
    short = run_closed_loop(mpc, "daqp", plant=Cart, steps=5)
    with pytest.raises(InputError, match="closed loop cart of 5 steps; allowed: 12 steps"):
        add_runs(out, [short])
    # A campaign would remove the loop without a word, so it names it.
    with pytest.raises(InputError, match=r"1 finished runs .*\(1 of add_runs, to be added again"):
        run_campaign(sequence=path, out=out, solvers=["daqp"], settings=["default"])
    with pytest.raises(InputError, match="a replay, daqp"):
        add_runs(out, [replay(sequence, "daqp", repeats=1)])
