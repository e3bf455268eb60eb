"""The paper from nothing: files, numbers and claims, as the page of the same runs has them."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario
from dpbench.bench.record.result_folder import load_results
from dpbench.cli.main import main
from dpbench.report.reproduce import Reproduction, write_reproduction
from dpbench.report.write import write_report

NAMES = ("figure4_path", "figure5_errors", "figure6_forces", "figure7_increments")


def _made(records: Any, folder: Path) -> Reproduction:
    return write_reproduction(records.write(folder / "runs"), folder)


def _check_figures(folder: Path) -> None:
    """Each figure is there as a picture in both formats, and as the numbers behind it."""
    for name in NAMES:
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert ET.parse(folder / f"{name}.svg").getroot().tag.endswith("svg")
        assert len(pd.read_csv(folder / f"{name}.csv")) > 0


@pytest.mark.slow
def test_the_data_are_those_of_the_steps(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=1000)
    records.loop("unconstrained_clipped", steps=1000, formulation="none", error=1.0)
    _made(records, tmp_path)
    _check_figures(tmp_path)
    steps = load_results(tmp_path / "runs").steps
    for name in NAMES:
        data = pd.read_csv(tmp_path / f"{name}.csv")
        assert data["law"].unique().tolist() == ["constrained (daqp)", "baseline law"]
        np.testing.assert_array_equal(data["t_s"], steps["t_s"])
        for column in set(data.columns) & set(steps.columns):
            np.testing.assert_array_equal(data[column], steps[column], err_msg=column)
    errors = pd.read_csv(tmp_path / "figure5_errors.csv")
    np.testing.assert_allclose(errors["radial_m"], np.hypot(steps["n_m"], steps["e_m"]))
    vessel = load_scenario("paper").vessel
    forces = pd.read_csv(tmp_path / "figure6_forces.csv")
    assert forces["tau_min_x_N"].unique() == [vessel.tau_min[0]]
    assert forces["tau_max_n_Nm"].unique() == [vessel.tau_max[2]]


@pytest.mark.slow
def test_claims_that_fail_are_named_and_the_rest_is_counted(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=1000, tail_m=2.0, limit_violations=3, overshoot_e=5.0)
    found = _made(records, tmp_path)
    assert found.complete and len(found.lines) <= 10
    claims = pd.read_csv(tmp_path / "claims.csv")
    others = claims[claims["state"] != "reproduced"]
    named = [line for line in found.lines if line.startswith(("not reproduced:", "not simulated:"))]
    (more,) = (line for line in found.lines if line.startswith("and "))
    assert len(others) == len(named) + int(more.split()[1])
    text = (tmp_path / "claims.md").read_text(encoding="utf-8")
    assert all(f"| {claim} |" in text for claim in claims["claim"])
    assert "@misc{dpbench," in text and "@misc{xia_dp_mpc," in text


def test_without_the_papers_loops_nothing_is_claimed(records: Any, tmp_path: Path) -> None:
    records.loop("daqp", steps=1000, outcome="crashed")
    found = _made(records, tmp_path)
    assert not found.complete
    assert found.lines[0].startswith("nothing is reproduced")
    assert not list(tmp_path.glob("figure*")) and not list(tmp_path.glob("claims*"))


def test_a_folder_of_other_things_is_refused(tmp_path: Path, capsys: Any) -> None:
    """Exit code 2 and one line, before anything runs."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "letter.txt").write_text("keep me")
    assert main(["paper", "--out", str(tmp_path)]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1 and "--out" in output.err


@pytest.mark.slow
def test_the_paper_is_reproduced_from_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)  # a short path, which is printed without a break
    assert main(["paper", "--out", "."]) == 0
    output = capsys.readouterr()
    lines = output.out.splitlines()
    progress = re.compile(r"dpbench: (compiling kernels|(\d+ %|all steps done) after \d+ s)")
    assert all(map(progress.match, output.err.splitlines())) and 5 <= len(lines) <= 15
    assert max(map(len, lines)) <= 80
    _check_figures(tmp_path)
    write_report(tmp_path / "runs")
    page = pd.read_csv(tmp_path / "runs" / "tables" / "paper.csv")
    claims = pd.read_csv(tmp_path / "claims.csv")
    pd.testing.assert_frame_equal(claims, page)
    held = (claims["state"] == "reproduced").sum()
    assert lines[0].startswith(f"{held} of {len(claims)} claims")
    assert any("largest |λ| 0.9" in line for line in lines)
    # Whoever publishes the reference run has the same answers to the paper, by another machine.
    reference = Path(__file__).parents[2] / "results" / "reference" / "tables" / "paper.csv"
    published = pd.read_csv(reference)
    assert claims[["claim", "state"]].equals(published[["claim", "state"]])
