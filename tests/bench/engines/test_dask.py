"""A Dask cluster gives the same results as one machine, whatever of it dies."""

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from dpbench import load_results, run_campaign
from dpbench.analysis.records.records import Records
from dpbench.bench.progress import Silent
from dpbench.bench.record.result_folder import read_lost_count_and_remarks
from dpbench.bench.workers import jobs
from dpbench.cli.main import main
from tests.bench.deterministic import assert_same, run_suite, suite_file, suite_toml

WHY = "engine dask needs the extra `cluster`"
distributed = pytest.importorskip("distributed", reason=WHY)
dask = pytest.importorskip("dask", reason=WHY)
dask_engine = pytest.importorskip("dpbench.bench.engines.dask_engine", reason=WHY)
dask_cluster = pytest.importorskip("dpbench.bench.engines.dask_cluster", reason=WHY)
DaskEngine, AHEAD = dask_engine.DaskEngine, dask_engine.BATCHES_AHEAD
# Its clusters have a worker on each core, which meets limits of real time.
pytestmark = pytest.mark.alone

PLUGIN = Path(__file__).parents[2] / "solvers" / "example_plugin.py"
KILLER = """
import os
import pathlib
import psutil

opened = open


def open(policy, options):
    always = options.get("tolerance", 1e-4) <= 1e-6
    if always or not os.path.exists(MARKER):
        pathlib.Path(MARKER).touch()
        process = psutil.Process()
        while "spawn_main" not in " ".join(process.cmdline()):
            process = process.parent()
        process.kill()
    return opened(policy, options)
"""
"""A solver that takes its worker along: at a tight tolerance always, at a loose one if none was
taken yet, as Dask may start either first."""


class Watching(Silent):
    """A progress that keeps what was said, and calls something once, at a cell."""

    def __init__(self, at: int, call: object) -> None:
        self.said: list[str] = []
        self._left, self._call = at, call

    def advance(self, work: int, what: str) -> None:
        self._left -= 1
        if self._left == 0 and callable(self._call):
            self._call()

    def remark(self, text: str) -> None:
        self.said.append(text)


def started(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """A process of Dask: a scheduler, or a worker of one thread."""
    plain = ["--no-dashboard", "--dashboard-address", ":0"]
    environment = os.environ | {"DASK_DISTRIBUTED__WORKER__DAEMON": "False"}
    return subprocess.Popen(
        [sys.executable, "-m", *words, "--scheduler-file", str(folder / FILE), *plain],
        env=environment,
        cwd=folder,
        stderr=subprocess.DEVNULL,
    )


FILE = "scheduler.json"
SCHEDULER = ("distributed.cli.dask_scheduler", "--port", "0")
WORKER = ("distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1")
Cluster = tuple[str, subprocess.Popen[bytes]]
"""The address of a scheduler with a worker, and its process."""


@contextmanager
def cluster_in(folder: Path) -> Iterator[Cluster]:
    processes = [started(folder, *SCHEDULER), started(folder, *WORKER)]
    try:
        while not (folder / FILE).exists():
            time.sleep(0.05)
        document = json.loads((folder / FILE).read_text(encoding="utf-8"))
        yield document["address"], processes[0]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scheduler")


@pytest.fixture(scope="module")
def scheduler(place: Path) -> Iterator[Cluster]:
    """The one of most tests here; the last of them kills it."""
    with cluster_in(place) as cluster:
        yield cluster


def test_a_cluster_of_this_machine_gives_the_same(
    suite: Path, undisturbed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = run_campaign(suite, tmp_path / "out", engine="dask", jobs=2)
    assert capfd.readouterr() == ("", "")
    assert_same(out, undisturbed)
    runs = load_results(out).runs
    timed = (runs["mode"] == "replay") & (runs["scenario"] != "")
    assert (runs.loc[timed, "concurrency"] == 1).all()
    assert runs.loc[~timed, "concurrency"].isna().all()
    assert sorted(path.name for path in (out / "cells").iterdir()) == [".lock"]


def test_a_worker_reports_the_step_it_is_at(scheduler: Cluster) -> None:
    """To the client of its campaign, while the task goes on."""
    events: SimpleQueue[tuple[float, str]] = SimpleQueue()
    with dask_cluster.connect_client(scheduler[0]) as client:
        client.subscribe_topic("steps", events.put)
        client.submit(
            dask_cluster.StepEvents("steps").advance, 0, "step 7 of 450", pure=False
        ).result()
        assert events.get(timeout=60.0)[1] == "step 7 of 450"


def test_a_killed_worker_costs_only_its_killer(suite: Path, tmp_path: Path) -> None:
    module = tmp_path / "killing.py"
    killer = KILLER.replace("MARKER", repr(str(tmp_path / "marker")))
    module.write_text(PLUGIN.read_text(encoding="utf-8") + killer, encoding="utf-8")
    loops = suite.read_text(encoding="utf-8").split("[[replay]]")[0]
    loops = loops.replace(', "rough"', "")
    given = {"solver_module": module, "solvers": ["admm", "quadprog"], "engine": "dask", "jobs": 1}
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        runs = load_results(run_suite(tmp_path, loops, **given)).runs
    assert runs["run_id"].is_unique
    runs = runs.set_index(["solver", "settings"])
    others = runs.loc[runs["outcome"] != "finished", ["outcome", "outcome_detail"]]
    died = ["lost", "every worker that ran it died"]
    assert others.T.to_dict("list") == {("admm", "high"): died}


def test_shared_replays_are_not_ranked(suite: Path, tmp_path: Path, scheduler: Cluster) -> None:
    watching = Watching(0, None)
    given = {"engine": "dask", "scheduler": scheduler[0], "solvers": ["daqp"]}
    out = run_campaign(suite, tmp_path / "out", progress=watching, **given)
    (line,) = [text for text in watching.said if "exclusive" in text]
    assert "not ranked" in line
    results = load_results(out)
    records = Records(results)
    replays = records.select_runs(mode="replay")
    assert replays and all(run.concurrency == 2.0 for run in replays)
    assert (results.runs.loc[results.runs["mode"] == "replay", "raw_max_ns"] > 0).all()
    assert all(records.get_step_times(run) is None for run in replays)
    assert all(math.isnan(run.raw_max_ns) for run in replays)


def test_workers_that_join_late_are_given_tasks(
    suite: Path,
    undisturbed: Path,
    place: Path,
    tmp_path: Path,
    scheduler: Cluster,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dask_engine, "REFRESH_S", 0.0)
    monkeypatch.setattr(jobs, "LONGEST_S", 0.0)
    submit, results, away = DaskEngine.submit, DaskEngine._read_results, [0, 0]

    def counted(self: Any, batch: Any) -> Any:
        away[0] += 1
        away[1] = max(away)
        return submit(self, batch)

    def counted_back(self: Any, *given: Any) -> Any:
        away[0] -= 1
        return results(self, *given)

    def join() -> None:
        assert away[1] <= AHEAD
        late.append(started(place, *WORKER))
        with distributed.Client(scheduler[0], set_as_default=False) as client:
            client.wait_for_workers(2)

    late: list[subprocess.Popen[bytes]] = []
    monkeypatch.setattr(DaskEngine, "submit", counted)
    monkeypatch.setattr(DaskEngine, "_read_results", counted_back)
    try:
        given = {"engine": "dask", "scheduler": scheduler[0], "progress": Watching(1, join)}
        out = run_campaign(suite, tmp_path / "out", **given)
    finally:
        for process in late:
            process.kill()
            process.wait()
    assert away == [0, 2 * AHEAD]
    assert set(load_results(out).runs["outcome"]) == {"finished"}


def _break_connection() -> None:
    """Break a client's connection as a network does: the scheduler forgets what it asked for."""
    for client in list(distributed.Client._instances):
        client.loop.add_callback(client.scheduler_comm.comm.abort)


def test_a_connection_that_breaks_and_comes_back_loses_nothing(
    suite: Path,
    tmp_path: Path,
    scheduler: Cluster,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(jobs, "LONGEST_S", 0.0)
    out = tmp_path / "out"
    watching = Watching(3, _break_connection)
    run_campaign(suite, out, engine="dask", scheduler=scheduler[0], progress=watching)
    assert set(load_results(out).runs["outcome"]) == {"finished"}
    assert read_lost_count_and_remarks(out)[0] == 0


def test_without_its_scheduler_cells_are_lost_until_there_is_one(
    suite: Path,
    undisturbed: Path,
    tmp_path: Path,
    scheduler: Cluster,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dask_cluster, "RETURN_S", 1.0)
    monkeypatch.setattr(jobs, "LONGEST_S", 0.0)
    out = tmp_path / "out"
    address, process = scheduler
    watching = Watching(3, process.kill)
    run_campaign(suite, out, engine="dask", scheduler=address, progress=watching)
    lost, remarks = read_lost_count_and_remarks(out)
    runs = load_results(out).runs
    assert set(runs["outcome"]) == {"finished", "lost"}
    assert lost == (runs["outcome"] == "lost").sum()
    assert any(
        "connection to the scheduler" in line and "same command" in line for line in remarks
    ), remarks
    run_campaign(suite, out)
    assert_same(out, undisturbed)


DESIGN = suite_toml(
    design={"controllers": ["paper"], "vessels": ["supply_fs99"]},
    closed_loop=[{"scenarios": ["calm"], "steps": 6}],
)
CAPABILITY = suite_toml(capability=[{"vessel": "osv", "sides": 4}])


def _kill_with_files(
    kill: Callable[[], None], patch: pytest.MonkeyPatch, *, gone_before: bool
) -> None:
    """Kill the scheduler once it has been given what makes a file, or so long before that the
    client has given up."""
    submit = DaskEngine.submit

    def submitted(self: Any, batch: Any) -> None:
        are_files = isinstance(batch, jobs.FileBatch) and not batch.are_sources
        if are_files and gone_before:
            kill()
            while self.cluster.client.status != "closed":
                time.sleep(0.05)
        submit(self, batch)
        if are_files and not gone_before:
            kill()

    patch.setattr(DaskEngine, "submit", submitted)


@pytest.mark.parametrize(("text", "gone_before"), [(DESIGN, False), (CAPABILITY, True)])
def test_a_scheduler_that_dies_as_files_are_made_is_one_line(
    gone_before: bool,
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(dask_cluster, "RETURN_S", 1.0)
    path, out = suite_file(tmp_path, text), tmp_path / "out"
    words = ["run", str(path), "--out", str(out), "--quiet"]
    with cluster_in(tmp_path) as (address, process), monkeypatch.context() as patch:
        _kill_with_files(process.kill, patch, gone_before=gone_before)
        assert main([*words, "--engine", "dask", "--scheduler", address]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "connection to the scheduler" in line and "same command" in line
    became = "finished" if text == DESIGN else "lost"
    assert set(load_results(out).runs["outcome"]) == {became}
    assert main(words) == 0
    assert set(load_results(out).runs["outcome"]) == {"finished"}
    assert (out / ("design.json" if text == DESIGN else "capability.parquet")).is_file()


def test_a_silent_scheduler_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    words = ["run", "smoke", "--out", str(out), "--engine", "dask", "--scheduler"]
    for address in ("tcp://127.0.0.1:1", "nowhere://x"):
        assert main([*words, address]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"dpbench: --scheduler: found {address}")
    assert not out.exists()
