"""The README does what it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from dpbench import load_results, run_campaign
from dpbench.cli.main import main
from dpbench.solvers import plugins

README = Path(__file__).parents[1] / "README.md"


def blocks(language: str, containing: str) -> list[str]:
    """The fenced blocks of a language that contain a text."""
    found = re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    return [block for block in found if containing in block]


@pytest.mark.slow
def test_own_ship_scenario_and_suite_run_as_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The three TOML files of the README, saved under the names it gives, make a campaign."""
    monkeypatch.chdir(tmp_path)
    files = {"my_ship.toml": "[limits]", "my_scenario.toml": "[controller]"}
    files["my_suite.toml"] = "[[closed_loop]]"
    for name, mark in files.items():
        (block,) = blocks("toml", mark)
        Path(name).write_text(block, encoding="utf-8")
        assert main(["check", name]) == 0
    out = run_campaign("my_suite.toml", "out")
    runs = load_results(out).runs
    done = runs[runs["outcome"] == "finished"]
    assert set(done["solver"]) == {"daqp", "osqp", "unconstrained_clipped"}
    exact = done[(done["solver"] == "daqp") & (done["mode"] == "closed_loop")]
    assert (exact["error_move_max"] < 1e-9).all()


@pytest.mark.slow
@pytest.mark.alone  # its cells have a limit of some seconds
def test_the_example_of_a_plug_in_runs_as_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The README's own solver, at most 30 lines, saved under its name, steers the ship."""
    monkeypatch.chdir(tmp_path)
    # Another test may have loaded the same name from another file.
    monkeypatch.setattr(plugins, "_LOADED", {})
    (block,) = blocks("python", "RECORD = ")
    assert len(block.splitlines()) <= 30
    Path("admm.py").write_text(block, encoding="utf-8")
    arguments = ["run", "smoke", "--solver", "admm", "--solver-module", "admm.py"]
    assert main(arguments) == 0
    runs = load_results("results/smoke-part").runs
    loop = runs[(runs["mode"] == "closed_loop") & (runs["units"] == "scaled")].iloc[0]
    assert (loop["solver"], loop["outcome"]) == ("admm", "finished")
    assert loop["claimed_share"] == 1.0
    assert np.isfinite(loop["error_move_max"])


def test_every_file_the_readme_links_to_exists() -> None:
    """No link of the README leads nowhere."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README.read_text(encoding="utf-8"))
    assert targets
    missing = [target for target in targets if not (README.parent / target).exists()]
    assert not missing
