"""One process for all replays of a configuration: who serves what, and what an end of it costs."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pandas as pd
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.progress import Silent
from dpbench.bench.record.result_folder import Results
from dpbench.bench.workers import child as supervise
from tests.bench.deterministic import deterministic, suite_file, suite_toml
from tests.processes import is_running

pytestmark = pytest.mark.slow

STEPS = 6
SEQUENCES = ("paper", "calm", "rough")
SUITE = suite_toml(
    **{"solvers": ["serving"], "rounds": 2, "warmup_steps": 0},
    replay=[{"scenario": name, "steps": STEPS} for name in SEQUENCES],
)
SERVING = """
import os
import signal
import time
from pathlib import Path

import numpy as np

from dpbench.errors import InputError
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

HERE = Path(__file__).parent
PIDS, FATE = HERE / "pids", HERE / "fate"


def stay(seconds=600.0):
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    time.sleep(seconds)


LEAVE = {
    "exit": lambda: os._exit(0),
    "abort": os.abort,
    "stay": stay,
    "pause": lambda: stay(1.2),
}


def fated(*ways):
    if not FATE.exists():
        return ""
    place, way = FATE.read_text().split()
    if way not in ways or len(PIDS.read_text().splitlines()) != int(place):
        return ""
    FATE.unlink()
    return way


def solve(qp):
    if way := fated(*LEAVE):
        LEAVE[way]()
    z = np.clip(-np.linalg.solve(qp.P, qp.q), qp.lb, qp.ub)
    return Solution(Status.MAX_ITERATIONS, z, np.zeros(qp.m), np.zeros(qp.n))


opened = opener("serving", solve)


def open(policy, options):
    with PIDS.open("a") as file:
        file.write(f"{os.getpid()}\\n")
    print("noise of", len(PIDS.read_text().splitlines()), flush=True)
    if fated("refuse"):
        raise InputError("serving", "policy", policy, "another one today")
    return opened(policy, options)


RECORD = solver_record("serving", method="none", module="quadprog", distribution="quadprog")
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """A suite of three sequences beside the module that brings its solver."""
    (tmp_path / "serving.py").write_text(SERVING, encoding="utf-8")
    return suite_file(tmp_path, SUITE)


def run(suite: Path, fate: str = "") -> Results:
    """A campaign; `fate` is the place of a sequence, from 1, and how its process ends there."""
    if fate:
        suite.with_name("fate").write_text(fate, encoding="utf-8")
    out = run_campaign(suite, suite.with_name("out"), solver_module=suite.with_name("serving.py"))
    assert not suite.with_name("fate").exists()
    return load_results(out)


def pids(suite: Path) -> list[int]:
    return [int(line) for line in suite.with_name("pids").read_text().splitlines()]


def test_one_process_serves_all_sequences_of_a_configuration(suite: Path) -> None:
    results = run(suite)
    assert len(pids(suite)) == len(SEQUENCES)
    assert len(set(pids(suite))) == 1
    assert not is_running(pids(suite)[0])
    assert list(results.runs["sequence"]) == list(SEQUENCES)
    assert set(results.runs["outcome"]) == {"finished"}
    assert set(results.runs["steps_done"]) == {STEPS}
    assert (results.runs["peak_rss_bytes"] > 0.0).all()
    # A later replay does not count what an earlier one left: the same library in all of them.
    assert results.runs["peak_rss_bytes"].max() < results.runs["peak_rss_bytes"].min() + 2**23


@pytest.mark.parametrize("way", ["exit", "abort"])
@pytest.mark.parametrize("place", [1, 2, 3])
def test_an_end_in_one_sequence_costs_no_other(place: int, way: str, suite: Path) -> None:
    results = run(suite, f"{place} {way}")
    wanted = ["finished"] * len(SEQUENCES)
    wanted[place - 1] = "crashed"
    assert list(results.runs["outcome"]) == wanted, list(results.runs["outcome_detail"])
    served = pids(suite)
    assert len(set(served[:place])) == 1
    assert len(set(served[place:])) <= 1
    assert not set(served[:place]) & set(served[place:])
    assert not any(map(is_running, served))


@pytest.mark.alone  # What else runs could use up a limit of one second.
@pytest.mark.parametrize("place", [1, 3])
def test_a_hang_has_a_successor(place: int, suite: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervise, "GRACE_S", 0.5)
    suite.write_text(SUITE.replace("60.0", "1.0"), encoding="utf-8")
    results = run(suite, f"{place} stay")
    assert set(results.runs["outcome"]) == {"finished"}, list(results.runs["outcome_detail"])
    assert set(results.runs["steps_done"]) == {STEPS}
    hung = results.steps[results.steps["status"] == "TIME_LIMIT"]
    assert set(hung["run_id"]) == {results.runs["run_id"].iloc[place - 1]}
    assert hung["k"].nunique() == 1 and set(hung["repeat"]) == {1, 2}
    assert len(set(pids(suite))) == 2 and not any(map(is_running, pids(suite)))


@pytest.mark.alone  # What else runs could use up a limit of one second.
@pytest.mark.parametrize("place", [1, 3])
def test_a_round_beyond_the_limit_ends_its_sequence_alone(place: int, suite: Path) -> None:
    suite.write_text(SUITE.replace("60.0", "1.0"), encoding="utf-8")
    with ended_after(60):
        results = run(suite, f"{place} pause")
    wanted = ["finished"] * len(SEQUENCES)
    wanted[place - 1] = "timed_out"
    assert list(results.runs["outcome"]) == wanted, list(results.runs["outcome_detail"])
    assert (
        "stopped after 1 s (cell_limit_s) in round 1"
        in results.runs["outcome_detail"].iloc[place - 1]
    )
    assert len(set(pids(suite))) == 1 and not is_running(pids(suite)[0])


@contextmanager
def ended_after(seconds: int) -> Iterator[None]:

    def end(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"a campaign of some seconds took {seconds} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_configuration_that_is_refused_once_is_asked_again(suite: Path) -> None:
    results = run(suite, "2 refuse")
    assert list(results.runs["outcome"]) == ["finished", "refused", "finished"]
    assert "another one today" in results.runs["outcome_detail"].iloc[1]
    first, second, third = pids(suite)
    assert first == second != third


def test_answers_do_not_depend_on_what_a_process_served_before(suite: Path, tmp_path: Path) -> None:
    undisturbed = run(suite)
    suite.with_name("out").rename(tmp_path / "undisturbed")
    suite.with_name("pids").unlink()
    crashed = run(suite, "1 exit")
    others = set(undisturbed.runs["run_id"].iloc[1:])
    for found, wanted in zip(deterministic(crashed), deterministic(undisturbed), strict=True):
        one, other = (
            table[table["run_id"].isin(others)].reset_index(drop=True) for table in (found, wanted)
        )
        assert len(one)
        pd.testing.assert_frame_equal(one, other, check_exact=True)


class _Interrupts(Silent):
    """A person who presses Ctrl-C in the midst of the second sequence."""

    def advance(self, work: int, what: str) -> None:
        if what.startswith("replay calm, round 1"):
            raise KeyboardInterrupt


def test_ctrl_c_leaves_no_process(suite: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_campaign(
            suite,
            suite.with_name("out"),
            solver_module=suite.with_name("serving.py"),
            progress=_Interrupts(),
        )
    served = pids(suite)
    assert len(served) == 2
    assert not any(map(is_running, served))
