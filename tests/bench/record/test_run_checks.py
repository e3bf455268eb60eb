"""Rows of `runs.parquet` and descriptions beside them that no campaign writes: one line each."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.record.result_folder import load_results
from dpbench.cli.main import main
from dpbench.errors import ResultsError
from tests.conftest import MadeRecords


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    records = MadeRecords()
    records.loop("daqp", steps=5)
    records.replay("osqp", steps=8)
    return records.write(tmp_path_factory.mktemp("made") / "out")


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "out"))


@pytest.mark.parametrize(
    ("column", "value", "found"),
    [
        ("policy", "x", "policy[0]: found x; allowed: fresh, reuse, warm"),
        ("mode", "", "mode[0]: found ''; allowed: closed_loop, replay"),
        ("outcome", "done", "outcome[0]: found done"),
        ("rounds", 0, "rounds[1]: found 0; allowed: 1 or more, as it finished"),
        ("steps_done", -1, "steps_done[0]: found -1; allowed: 0 or more"),
        ("replay_s", 0.0, "replay_s[0]: found 0.0"),
        ("N_p", None, "N_p[0]: missing; required: a number, as N_c is one"),
        ("study", "seas", "study_point[0]: missing"),
        ("schema", 1, "schema: found 1; allowed: "),
    ],
)
def test_impossible_rows_are_refused(copy: Path, column: str, value: object, found: str) -> None:
    path = copy / "runs.parquet"
    runs = pd.read_parquet(path).assign(**{"N_p": 30, "N_c": 5, column: value})
    runs.to_parquet(path, index=False)
    with pytest.raises(ResultsError) as caught:
        load_results(copy)
    assert f"{path}: {found}" in str(caught.value)


def test_what_a_campaign_writes_is_read(copy: Path) -> None:
    path = copy / "runs.parquet"
    runs = pd.read_parquet(path).assign(rounds=0, outcome="timed_out", replay_s=np.nan)
    runs.to_parquet(path, index=False)
    assert len(load_results(copy).runs) == 2


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        ("{", "cell: found invalid JSON"),
        ('{"scenario": 5}', "cell.scenario: found"),
        ('{"scenario": {"scenario": 1}}', "cell.scenario.scenario: found"),
        ('{"scenario": {"scenario": {"controller": []}}}', "cell.scenario.scenario.controller"),
        ('{"source": []}', "cell.source: found"),
        ('{"source": {"kind": "random", "recipe": 1}}', "cell.source.recipe: found"),
        ('{"study": {"x": 1}}', "cell.study.x: found"),
        ('{"a":' * 5000, "cell: found JSON nested too deeply; allowed: at most 32 levels"),
    ],
)
def test_a_damaged_description_of_a_cell_is_one_line(
    copy: Path, cell: str, found: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copy / "runs.parquet"
    pd.read_parquet(path).assign(cell=cell).to_parquet(path, index=False)
    assert main(["report", str(copy), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert found in line, line


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("machine.json", "id", 5),
        ("machine.json", "versions", []),
        ("machine.json", "blas", "openblas"),
        ("machine.json", "affinity", {"a": 1}),
        ("suite.json", "title", None),
        ("suite.json", "started_utc", 2026),
        ("suite.json", "run_rows", True),
        ("suite.json", "requirements", {"p99_ms": "3"}),
        ("suite.json", "requirements", {"p99_ms": 0}),
        ("suite.json", "requirements", {"failed_steps": -1}),
        ("suite.json", "requirements", []),
        ("suite.json", "report", 1),
        ("suite.json", "report", {"step": "x"}),
        ("suite.json", "revisions", [1]),
        ("suite.json", "revisions", [{"commit": 1, "clean": True}]),
        ("suite.json", "remarks", "none"),
        ("suite.json", "lost_cells", "0"),
        ("suite.json", "study", {"name": 1}),
        ("suite.json", "study", [{"name": "a"}]),
    ],
)
def test_a_description_of_other_types_is_one_line(
    copy: Path, name: str, key: str, value: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copy / name
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {key: value}), "utf-8")
    assert main(["report", str(copy), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"dpbench: {path}: {key}"), line
