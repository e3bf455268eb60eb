"""Imports at the start of a campaign, and those that do not happen."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import dpbench
from tests.bench.deterministic import suite_file, suite_toml

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(dpbench.__file__).parents[1])}
NEEDLESS = (
    "altair",
    "dask",
    "distributed",
    "jinja2",
    "matplotlib",
    "qpsolvers",
    "rich",
    "scipy.io",
    "scipy.signal",
    "scipy.stats",
)
"""Libraries that no campaign needs before it is known what it runs; scipy.stats alone takes half a
second and 40 MB."""
SCRIPT = """
with open("begun", "a") as file:
    file.write("x")
from dpbench import load_results, run_campaign
out = run_campaign("tiny.toml", "out", engine="ENGINE")
print(*load_results(out).runs["outcome"])
"""
SUITE = suite_toml(closed_loop=[{"scenarios": ["paper"], "steps": 3}])


@pytest.mark.slow
def test_a_campaign_starts_without_what_it_does_not_need() -> None:
    from dpbench.solvers.table import TABLE

    solvers = [row.module for row in TABLE.values() if row.module]
    program = f"""
import sys
import dpbench.bench.campaign, dpbench.bench.workers.template
print(*sorted({{*{NEEDLESS!r}, *{solvers!r}}} & set(sys.modules)))
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "dask"])
def test_a_script_is_not_run_again_by_its_processes(tmp_path: Path, engine: str) -> None:
    if engine == "dask":
        pytest.importorskip("distributed", reason="engine dask needs the extra `cluster`")
    suite_file(tmp_path, SUITE)
    (tmp_path / "script.py").write_text(SCRIPT.replace("ENGINE", engine), encoding="utf-8")
    command = [sys.executable, "script.py"]
    done = subprocess.run(
        command, cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["finished"]
    assert (tmp_path / "begun").read_text(encoding="utf-8") == "x"
