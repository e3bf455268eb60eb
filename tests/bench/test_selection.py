"""A finished result is replaced on request alone: another selection into its folder is refused."""

from pathlib import Path

import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.gather import join_result_folders
from dpbench.cli.main import main
from dpbench.errors import InputError
from tests.bench.deterministic import suite_file, suite_toml

pytestmark = pytest.mark.slow

SUITE = suite_toml(
    **{"solvers": ["quadprog", "daqp"], "baseline_law": True, "rounds": 1, "warmup_steps": 0},
    closed_loop=[{"scenarios": ["paper", "calm"], "settings": ["default", "high"], "steps": 4}],
    replay=[{"scenario": "paper", "steps": 4}],
    study=[
        {
            **{"base": "weather", "name": "seas", "steps": 4},
            **{"replicates": {"count": 2}, "product": {"start.east_m": [0.0]}},
        }
    ],
)


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return suite_file(tmp_path_factory.mktemp("selection"), SUITE)


@pytest.fixture(scope="module")
def whole(suite: Path) -> Path:
    return run_campaign(suite, suite.parent / "whole")


@pytest.mark.parametrize(
    "words",
    [
        *(["--solver", "daqp"], ["--scenario", "calm"], ["--settings", "high"], ["--steps", "3"]),
        ["--solver", "daqp", "--solver", "piqp"],
    ],
    ids=" ".join,
)
def test_another_selection_is_refused(
    suite: Path, whole: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    files = {path: path.read_bytes() for path in whole.glob("*.*")}
    assert main(["run", str(suite), "--out", str(whole), "--quiet", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "finished runs that were not requested" in line
    assert "--fresh" in line and "another --out" in line
    assert {path: path.read_bytes() for path in whole.glob("*.*")} == files


def test_the_same_selection_and_a_larger_one_go_on(suite: Path, tmp_path: Path) -> None:
    out = run_campaign(suite, tmp_path / "out", solvers=["daqp"], scenarios=["paper"])
    before = load_results(out).runs.set_index("run_id")
    first = before["raw_max_ns"]
    run_campaign(suite, out, scenarios=["paper"], solvers=["daqp"])
    run_campaign(suite, out)
    runs = load_results(out).runs.set_index("run_id")
    assert set(runs["study"]) == {"", "seas"} and len(runs) > len(first)
    assert (runs.loc[first.index, "raw_max_ns"] == first).all()
    assert (runs.loc[first.index, "campaign_utc"] == before["campaign_utc"]).all()
    # What an earlier command timed took no turns with what was added.
    turns = {s: {*own} for s, own in runs[runs["turns"] != ""].groupby("solver")["turns"]}
    assert len(turns["daqp"]) == len(turns["quadprog"]) == 1 and turns["daqp"] != turns["quadprog"]
    run_campaign(suite, out)
    run_campaign(suite, out, solvers=["daqp"], fresh=True)
    assert set(load_results(out).runs["solver"]) == {"daqp"}


def test_replays_of_one_command_take_turns(whole: Path) -> None:
    runs = load_results(whole).runs
    done = runs[runs["steps_done"] > 0]
    assert done["campaign_utc"].nunique() == 1
    assert (done["judged_utc"] > done["campaign_utc"]).all()
    replays = done[done["mode"] == "replay"]
    assert len(replays) == 2 and replays["turns"].nunique() == 1 and replays["turns"].all()
    assert not done.loc[done["mode"] == "closed_loop", "turns"].any()


def test_an_unfinished_folder_takes_another_selection(suite: Path, tmp_path: Path) -> None:
    out = run_campaign(suite, tmp_path / "out", solvers=["daqp"], scenarios=["calm"])
    for name in ("suite.json", "machine.json"):
        (out / name).unlink()
    for name in ("runs", "steps"):
        (out / f"{name}.parquet").rename(out / "cells" / f"{name}-00001.parquet")
    run_campaign(suite, out, solvers=["quadprog"], scenarios=["calm"])
    assert set(load_results(out).runs["solver"]) == {"quadprog"}


def test_shards_are_not_gathered_into_another_result(suite: Path, tmp_path: Path) -> None:
    shard = run_campaign(suite, tmp_path / "shard", solvers=["daqp"], shard="1/1")
    half = run_campaign(suite, tmp_path / "half", solvers=["daqp"], shard="1/2")
    with pytest.raises(InputError, match="not requested"):
        run_campaign(suite, half, solvers=["daqp"], shard="2/2")
    out = run_campaign(suite, tmp_path / "out", solvers=["quadprog"], scenarios=["calm"])
    with pytest.raises(InputError, match=r"not requested.*another folder"):
        join_result_folders([shard], out)
