"""A small suite with all kinds of cells, and its result on the engine of one machine."""

from pathlib import Path

import pytest

from dpbench import run_campaign
from tests.bench.deterministic import suite_file, suite_toml

SUITE = suite_toml(
    **{"solvers": ["quadprog", "daqp"], "rounds": 2, "warmup_steps": 0},
    closed_loop=[
        {"scenarios": ["paper", "rough"], "settings": ["default", "high"], "steps": 6},
        {"scenarios": ["calm"], "solvers": ["daqp"], "steps": 6},
    ],
    replay=[{"scenario": "paper", "steps": 6}],
    random=[{"families": ["no_rows"], "sizes": [[3, 0], [4, 0]], "steps": 5}],
)


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return suite_file(tmp_path_factory.mktemp("engines"), SUITE)


@pytest.fixture(scope="session")
def undisturbed(suite: Path) -> Path:
    return run_campaign(suite, suite.parent / "undisturbed")
