"""The harness's own configurations through a whole campaign, and the doctor; no time is
asserted."""

import gc
import json
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, record_sequence
from dpbench.bench.campaign import run_campaign
from dpbench.bench.judge.calibration import (
    compute_excess_over_wait_ns,
    is_within_tolerance,
    time_dummy_solvers,
)
from dpbench.bench.record.disturbance import compute_disturbance_metrics
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.record.result_folder import Results, load_results
from dpbench.bench.record.schema import ACCURACY_COLUMNS
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.bench.sequences.sequence_file import save_sequence
from dpbench.cli.main import main
from dpbench.qp.program import QPSequence
from dpbench.report.write import write_report, write_report_with_summary
from dpbench.solvers import releases
from dpbench.solvers.calibration import CALIBRATION, NO_OP, open_calibration_solver
from tests.bench.deterministic import run_suite, suite_toml

# Waits of 5 to 1000 µs are measured.
pytestmark = pytest.mark.alone

STEPS, ROUNDS = 12, 2
SUITE = suite_toml(
    **{"calibration": True, "rounds": ROUNDS, "warmup_steps": 3},
    recorded=[{"sequence": "short.npz", "routes": ["native"], "policies": ["warm"]}],
)


@pytest.fixture(scope="module")
def sequence() -> QPSequence:
    return record_sequence(load_scenario("paper").truncate(STEPS))


@pytest.fixture(scope="module")
def folder(sequence: QPSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("calibrating")
    save_sequence(base / "short.npz", sequence)
    return run_suite(base, SUITE)


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return load_results(folder)


def test_own_configurations_run_like_any_other_and_are_judged_by_nobody(results: Results) -> None:
    runs = results.runs.set_index("solver")
    own = runs.loc[list(CALIBRATION)]
    assert (own["outcome"] == "finished").all()
    assert own[list(ACCURACY_COLUMNS)].isna().all().all()
    assert runs.loc["daqp", "true_share"] == 1.0
    rows = results.steps[results.steps["run_id"].isin(own["run_id"])]
    assert len(rows) == len(CALIBRATION) * (3 + ROUNDS * STEPS)
    assert rows["error_move"].isna().all() and not rows["true"].any()
    assert (rows["certificate"] == "none").all()
    assert rows[["update_ns", "solve_ns", "read_ns"]].notna().all().all()


def test_no_wait_is_shorter_than_it_says(results: Results) -> None:
    for run in results.runs[results.runs["solver"].str.startswith("busy_wait")].itertuples():
        rows = results.steps[results.steps["run_id"] == run.run_id]
        waits_ns = 1000 * int(str(run.solver).removeprefix("busy_wait_").removesuffix("us"))
        assert rows["solve_ns"].min() >= 0.999 * waits_ns


def test_what_disturbed_and_what_it_took_are_columns(results: Results) -> None:
    runs = results.runs
    assert (runs["replay_s"] > 0).all()
    counts = runs[["voluntary_switches", "involuntary_switches", "rerun_rounds"]]
    assert counts.notna().all().all() and (counts >= 0).all().all()
    assert (runs["bit_identical_share"] == 1.0).all()
    daqp = runs.set_index("solver").loc["daqp"]
    assert (daqp["iterations_identical_share"], daqp["iterations_spread"]) == (1.0, 0)
    assert (runs[["os_threads", "pool_threads"]] >= 1).all().all()
    memory = runs.set_index("solver")["peak_rss_bytes"]
    assert memory["daqp"] > memory[NO_OP] > 0, "a library takes memory that nothing does not"
    assert runs.set_index("solver").loc[NO_OP, "python_blocks_per_step"] == 0.0


def test_the_report_and_the_last_lines_speak_of_them(folder: Path) -> None:
    page, lines = write_report_with_summary(folder)
    text = page.with_suffix(".md").read_text(encoding="utf-8")
    assert "Measurement quality: In these results, a difference in step time is " in text
    assert (folder / "figures" / "calibration.svg").is_file()
    assert [what for what, _ in lines[-2:]] == ["machine", "timing"]


def test_a_round_begun_twice_was_run_again(sequence: QPSequence) -> None:
    log = RawLog.in_memory(make_replay_layout(3, STEPS, sequence.base.n, sequence.base.m))
    made, formulated = formulate_sequence("condensed_box", sequence)
    clock = time.perf_counter_ns
    timed_solver = TimedSolver(open_calibration_solver(NO_OP), formulated, clock)
    configuration = ReplayRun(made, timed_solver, log, warmup_steps=2, limit_ns=10**12, clock=clock)
    for r in (0, 1, 1, 2):
        configuration.run_round(r)
    assert log.attempts.tolist() == [1, 2, 1]
    found = compute_disturbance_metrics(log)
    assert found["rerun_rounds"] == 1
    assert found["replay_s"] == pytest.approx(log.counters[1:, 0].sum())


def test_the_bar_of_each_configuration() -> None:
    assert is_within_tolerance("busy_wait_50us", 50_999.0) and not is_within_tolerance(
        "busy_wait_50us", 51_001.0
    )
    assert is_within_tolerance("busy_wait_1000us", 1_009_999.0)
    assert not is_within_tolerance("busy_wait_1000us", 989_000.0)
    assert is_within_tolerance(NO_OP, 1000.0) and not is_within_tolerance(NO_OP, 1001.0)
    assert is_within_tolerance("copy_only", 1e9) is None
    assert compute_excess_over_wait_ns("busy_wait_20us", 20_300.0) == 300.0


def test_a_quick_calibration_leaves_the_process_as_it_was() -> None:
    before = os.sched_getaffinity(0), gc.isenabled()
    found = time_dummy_solvers()
    assert (os.sched_getaffinity(0), gc.isenabled()) == before
    assert list(found.p50_ns) == list(CALIBRATION)
    assert found.p50_ns["busy_wait_1000us"] >= 0.999e6
    assert found.disturbance.rounds == 5 * len(CALIBRATION)
    assert np.isfinite(found.disturbance.switches_per_s)


def test_the_doctor_says_what_there_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    newer = {"name": "daqp", "version": "99.0"}
    report = json.dumps({"install": [{"metadata": newer}]})
    monkeypatch.setattr(releases, "_resolve_newest_with_pip", lambda names, timeout_s: report)
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "newer releases                  daqp 99.0 (installed: " in said
    words = (
        "processor",
        "governor",
        "BLAS",
        "solver builds",
        "read the clock",
        "context switches",
        "stolen",
    )
    for word in (
        *words,
        "throttle",
        "This machine is ",
        "for a quiet machine: ",
        "Timing: ",
        *CALIBRATION,
    ):
        assert word in said


def test_a_part_of_a_suite_may_be_an_own_configuration(folder: Path, tmp_path: Path) -> None:
    out = run_campaign(folder.parent / "tiny.toml", tmp_path / "part", solvers=[NO_OP])
    runs: pd.DataFrame = load_results(out).runs
    assert runs["solver"].tolist() == [NO_OP]
    text = write_report(out).with_suffix(".md").read_text(encoding="utf-8")
    assert (
        "\n\nOver all replays, the machine was quiet" in text
        or "\n\nOther load disturbed the machine" in text
    )
    assert "recommended" not in text and "requirements" not in text.lower()
