"""Closed loops of this process in a result folder of a campaign, and on its page."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench import (
    InputError,
    QuadraticProgram,
    Solution,
    Status,
    add_runs,
    load_results,
    opener,
    record_sequence,
    replay,
    run_campaign,
    run_closed_loop,
    save_sequence,
)
from dpbench.report.page.live import _draw_empty_step_charts
from dpbench.report.report import Report
from tests.scenario.plants.test_linear_mpc import GIVEN, Cart, LinearMPC


def _solve_without_limits(qp: QuadraticProgram, scale: float = 1.0) -> Solution:
    z = -scale * np.linalg.solve(qp.P, qp.q)
    return Solution(Status.SOLVED, z, np.full(qp.m, np.nan), np.full(qp.n, np.nan))


def test_of_equal_runs_the_last_is_added(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=4)
    out = records.write(tmp_path / "out")
    first, last = (run_closed_loop("paper", "quadprog", steps=4) for _ in range(2))
    add_runs(out, [first, last])
    results = load_results(out)
    (row,) = results.runs[results.runs["solver"] == "quadprog"].to_dict("records")
    steps = results.steps[results.steps["run_id"] == row["run_id"]]
    assert steps["total_ns"].tolist() == last.steps["total_ns"].tolist()
    assert "twice" not in (out / "report.md").read_text(encoding="utf-8")


def test_the_report_names_the_options_of_a_function(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=4, campaign_utc="2026-11-28T08:00:00+00:00", judged_utc="2026-11-29")
    out, open_own = records.write(tmp_path / "out"), opener("own", _solve_without_limits)
    options: list[dict[str, object]] = [{}, {"scale": 0.5}, {"scale": 0.9}]
    runs = [run_closed_loop("paper", open_own("fresh", given), steps=4) for given in options]
    add_runs(out, runs)
    results = load_results(out)
    rows = results.verdict().query("solver == 'own'")
    assert sorted(rows["settings"]) == ["default", "scale=0.5", "scale=0.9"]
    text = (out / "report.md").read_text(encoding="utf-8")
    assert "| own | native fresh |" in text and "| own | native fresh, scale=0.5 |" in text
    assert "Settings: `default`, `scale=0.5`, `scale=0.9`. Solvers: `daqp` 1.0, `own`. " in text
    assert "UTC; when other runs were made is not recorded. It has 4 runs" in text


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
