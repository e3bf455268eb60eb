"""The script behind docs/guide/scale.md, with few cells."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from dpbench import load_results

SCALE = Path(__file__).parents[1] / "benchmarks" / "scale.py"


@pytest.fixture(scope="module")
def scale() -> ModuleType:
    """The script as a module; `benchmarks` is no package."""
    spec = importlib.util.spec_from_file_location("bench_scale", SCALE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Its dataclass looks itself up there.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _printed(*arguments: object) -> dict[str, str]:
    """The rows of its tables with two columns."""
    command = [sys.executable, str(SCALE), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = (line.strip("| ").split(" | ") for line in done.stdout.splitlines())
    return {row[0]: row[1] for row in rows if len(row) == 2}


@pytest.mark.slow
def test_empty_cells_go_through_the_campaign(tmp_path: Path) -> None:
    """Twelve configurations in two seas: a row each, and the second time nothing is run again."""
    said = _printed(tmp_path, "--cells", 20, "--only", "campaign")
    assert said["cells"] == "24"
    folder = tmp_path / "campaign" / "results"
    runs = load_results(folder).runs
    assert set(runs["solver"]) == {"empty"} and set(runs["outcome"]) == {"finished"}
    assert (runs["steps_done"] == 1).all() and runs["run_id"].is_unique
    assert runs.groupby("replicate")["run_id"].count().tolist() == [12, 12]
    assert not list((folder / "cells").glob("*.parquet"))


@pytest.mark.slow
def test_a_made_up_folder_is_one_of_a_campaign(tmp_path: Path) -> None:
    """Its runs are those of the suite, its steps are of its runs, and its report is written."""
    said = _printed(tmp_path, "--cells", 80, "--steps", 15, "--only", "report")
    assert said["runs, steps"] == "80, 1200"
    folder = tmp_path / "report" / "results"
    results = load_results(folder)
    assert results.steps["run_id"].value_counts().to_dict() == dict.fromkeys(
        results.runs["run_id"], 15
    )
    assert results.steps["total_ns"].nunique() > 900
    assert pd.read_parquet(folder / "runs.parquet")["study_point"].notna().all()
    assert (folder / "report.html").exists() and said["report.html"].endswith("MB")


def test_what_a_cell_costs_is_told_from_what_a_sea_costs(
    scale: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The campaigns take 3 s, 20 µs a step of each cell and 50 µs a step of each sea."""

    def campaign(suite: Path, out: Path) -> object:
        text = suite.read_text(encoding="utf-8")
        steps, seas = (int(re.findall(rf"{n} = (\d+)", text)[0]) for n in ("steps", "count"))
        settings = re.findall(r"settings = \[(.*)\]", text)[0].count(",") + 1
        out.mkdir()
        (out / "steps.parquet").write_bytes(bytes(30 * steps * seas * settings))
        return scale.Cost(3.0 + 1e-6 * steps * seas * (20 * settings + 50), 0.0, 0.0)

    monkeypatch.setattr(scale, "campaign", campaign)
    rows = list(scale.cell_costs(tmp_path, 10_000))
    assert [row[:2] for row in rows] == [
        ("1000", "30"),
        ("10000", "30"),
        ("10000", "15"),
        ("10000", "60"),
        ("10000", "120"),
    ]
    assert [row[2:] for row in rows] == [
        ("20", "50", "20", "30"),
        *[("200", "500", "20", "30")] * 4,
    ]
