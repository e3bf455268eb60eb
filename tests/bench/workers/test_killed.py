"""A campaign that is killed with SIGKILL, at whatever moment, is the same once it has gone on."""

import subprocess
import sys
from pathlib import Path

import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.record.cell_store import CellStore
from tests.bench.deterministic import assert_same, suite_file, suite_toml

pytestmark = pytest.mark.slow

SUITE = suite_toml(
    **{"solvers": ["quadprog", "daqp"], "rounds": 1, "warmup_steps": 0},
    closed_loop=[{"scenarios": ["paper", "rough"], "settings": ["default", "high"], "steps": 6}],
    random=[{"families": ["no_rows"], "sizes": [[3, 0], [4, 0]], "steps": 5}],
)
CELLS, ROWS = 10, 12
"""quadprog has no settings: its two loops and two random problems are cells, and its loops rows
under two names; daqp has four loops."""
KILLED = """
import os, signal, sys
from dpbench.bench.record import cell_store
from dpbench.cli.main import main

def dying(method, left):
    def call(*given):
        answer = method(*given)
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)
        return answer
    return call

name, moment = sys.argv[1].split(":")
owner, _, method = name.rpartition(".")
owner = getattr(cell_store, owner) if owner else cell_store
setattr(owner, method, dying(getattr(owner, method), [int(moment)]))
raise SystemExit(main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return suite_file(tmp_path_factory.mktemp("killed"), SUITE)


@pytest.fixture(scope="module")
def undisturbed(suite: Path) -> Path:
    return run_campaign(suite, suite.parent / "undisturbed")


@pytest.mark.parametrize(
    ("moment", "finished"),
    [
        ("CellStore.write_part_file:1", 1),
        ("CellStore.write_part_file:5", 5),
        # The public steps are written, and in no place yet; the parts are.
        ("StepFile.close:1", CELLS),
        # The public steps are in their place, without their runs.
        ("rename_durably:1", CELLS),
        # All is written, and the parts are still there.
        ("write_runs:1", ROWS),
    ],
)
def test_what_was_killed_goes_on_as_if_nothing_was(
    moment: str, finished: int, suite: Path, undisturbed: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", KILLED, moment, "run", str(suite), "--out", str(out)]
    done = subprocess.run([*command, "--quiet"], capture_output=True, text=True, check=False)
    assert done.returncode == -9, done.stderr
    before = CellStore(out)
    # The last batch that was stored may have had two cells.
    assert finished <= len(before.finished) <= finished + 1
    times = before.read_finished_runs()["raw_max_ns"].to_dict()
    run_campaign(suite, out)
    results = load_results(out)
    assert_same(out, undisturbed)
    after = results.runs.set_index("run_id")["raw_max_ns"]
    assert {name: after[name] for name in times} == times
    assert sorted(path.name for path in (out / "cells").iterdir()) == [".lock"]
