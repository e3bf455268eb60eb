"""Figures where the process may have less address space than their renderer takes."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import dpbench
from tests.conftest import MadeRecords

pytestmark = pytest.mark.slow


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (2_000_000 * 1024,) * 2)


def test_a_report_is_written_without_its_figures(records: MadeRecords, tmp_path: Path) -> None:
    for solver in ("daqp", "quadprog"):
        records.loop(solver, steps=30)
        records.replay(solver, steps=30)
    campaign = records.write(tmp_path / "results")
    run = [sys.executable, "-m", "dpbench", "report", str(campaign), "--json"]
    env = {**os.environ, "PYTHONPATH": str(Path(dpbench.__file__).parents[1])}
    for limit in (_limited, None):
        done = subprocess.run(run, env=env, preexec_fn=limit, capture_output=True, text=True)  # noqa: PLW1510 - asserted below, with what it said
        assert (done.returncode, done.stderr) == (0, "")
        drawn = limit is None
        page = (campaign / "report.html").read_text(encoding="utf-8")
        assert ("figures" in json.loads(done.stdout)) != drawn
        assert ("<script" in page and "<svg" in page) == drawn
        assert "daqp" in page
        assert any((campaign / "figures").glob("*.svg")) == drawn
