"""Solvers over their releases: versions in order, times, errors, what is no change."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.bench.record.result_folder import Results
from dpbench.bench.record.schema import convert_to_run_columns, convert_to_step_columns
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.report.compare.releases import releases, write_releases
from dpbench.report.ship.ship_text import BANNER
from tests.report.conftest import run_row
from tests.result_folder import StepsInMemory, write_results

Make = Callable[..., Path]
OLD, NEW = {"piqp": "0.6.4"}, {"piqp": "0.10.0"}


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Makes a result folder without steps: daqp, osqp and piqp on a replay."""

    def folder(
        name: str,
        versions: dict[str, str],
        times_us: dict[str, float],
        *,
        machine: str = "one",
        errors: Mapping[str, float] = {},
        scenario: str = "paper",
        **columns: float,
    ) -> Path:
        rows = [
            run_row(
                *(f"{name}-{solver}", "replay", solver, 1000),
                scenario=scenario,
                solver_version=versions.get(solver, "1.0"),
                error_move_max=errors.get(solver, 1e-6),
                failed_steps=0,
                **{"algo_p50_ns": 1e3 * time, "algo_p99_ns": 2e3 * time, "algo_max_ns": 3e3 * time},
                **columns,
            )
            for solver, time in times_us.items()
        ]
        folder = tmp_path / name
        runs, steps = (
            convert_to_run_columns(pd.DataFrame(rows)),
            convert_to_step_columns(pd.DataFrame()),
        )
        machine_json = {"id": machine, "cpu_model": f"CPU {machine}"}
        results = Results(runs, StepsInMemory(steps), machine_json, {"name": "releases"})
        write_results(folder, results)
        (folder / "steps.parquet").unlink()
        return folder

    return folder


@pytest.mark.slow
def test_versions_stand_in_their_order_with_what_changed(make: Make, tmp_path: Path) -> None:
    """0.10.0 comes after 0.6.4; half the time, a smaller error; daqp says what is no change."""
    new = make("new", NEW, {"daqp": 11.0, "piqp": 40.0}, errors={"piqp": 1e-9})
    old = make("old", OLD, {"daqp": 10.0, "piqp": 80.0}, errors={"piqp": 1e-4})
    found = releases([new, old])
    assert found.lead == [
        "piqp 0.6.4 → 0.10.0: p50 0.500 times as long, native fresh on paper; largest error "
        "1.0e-04 → 1.0e-09, failed steps 0 → 0."
    ]
    assert any("by a factor of up to 1.10 between two folders" in line for line in found.lines)
    first, rest = found.tables
    cells = [(row[2], row[4], row[5], row[7], row[9]) for row in first.rows]
    assert cells == [
        ("0.6.4", "80.0 µs", "–", "160 µs", "1.0e-04"),
        ("0.10.0", "40.0 µs", "0.500", "80.0 µs", "1.0e-09"),
    ]
    ((solver, _, _, _, folders, p50, *_),) = rest.rows
    assert (solver, folders, p50) == ("daqp", "all", "10.5 µs")
    page = write_releases(tmp_path / "page.html", found)
    text = page.read_text(encoding="utf-8")
    assert "<script" not in text and page.stat().st_size < 200_000
    assert text.count("<svg") == 2 and "piqp 0.10.0" in text


@pytest.mark.slow
def test_folders_of_two_machines_are_ratios_to_the_reference(make: Make) -> None:
    here = make("here", OLD, {"daqp": 10.0, "piqp": 80.0})
    there = make("there", NEW, {"daqp": 20.0, "piqp": 160.0}, machine="two")
    found = releases([here, there])
    assert any(line.startswith("times are multiples of the p50 of daqp") for line in found.lines)
    assert [row[4:6] for row in found.tables[0].rows] == [("8.00", "–"), ("8.00", "1.00")]
    assert "p50 [× daqp]" in found.tables[0].heads
    with pytest.raises(InputError, match=r"`reference`: found 'osqp'; allowed: one of daqp, piqp"):
        releases([here, there], reference="osqp")


def test_a_busier_machine_is_said_beside_the_change(make: Make) -> None:
    old = make("old", OLD, {"piqp": 10.0}, load_kernel_ns=1e5, rounds=2, claimed_not_true=6)
    new = make("new", NEW, {"piqp": 20.0}, load_kernel_ns=2e5, rounds=4, claimed_not_true=12)
    found = releases([old, new])
    assert "p50 2.00 times as long on a busier machine (calibration workload 2.00)" in found.lead[0]
    ((*_, before, _, _), (*_, after, _, _)) = found.tables[0].rows
    assert (before, after) == ("3", "3"), "counts are of one round"


@pytest.mark.parametrize("count", [1, 2])
def test_one_folder_is_none_to_compare(make: Make, capsys: Any, count: int) -> None:
    folder = str(make("a", OLD, {"daqp": 10.0}))
    assert main(["compare", *[folder] * count, "--releases"]) == 2
    assert "two or more result folders, each once" in capsys.readouterr().err
    assert main(["compare", folder, folder, folder]) == 2
    allowed = "two, from before and after a change, or two or more with --releases"
    assert f"compare: found 3 folders; allowed: {allowed}" in capsys.readouterr().err


def test_folders_of_other_problems_have_no_releases(make: Make) -> None:
    folders = [make("a", OLD, {"piqp": 1.0}), make("b", NEW, {"piqp": 1.0}, scenario="rough")]
    with pytest.raises(InputError, match="no cell that two of the folders share"):
        releases(folders)


@pytest.mark.slow
def test_the_ship_comes_before_any_release(make: Make, tmp_path: Path, capsys: Any) -> None:
    """A warning of one folder names it; what all folders show is said once, on every surface."""
    loop = {"exact_steps": 1000.0, "exact_offset_max_m": 37.0, "exact_offset_end_m": 36.0}
    times, lost = {"daqp": 10.0, "piqp": 80.0}, {"exact_left_s": 9.0}
    old, new = (
        make("old", OLD, times, **loop, **lost),
        make("new", NEW, times, **loop, **lost),
    )
    found = releases([old, new])
    (warning,) = found.warnings
    assert warning.startswith(f"{BANNER}, whatever the solver: in `paper` it leaves its station")
    page, text = tmp_path / "page.html", tmp_path / "page.md"
    words = ["--releases", "--html", str(page), "--markdown", str(text)]
    assert main(["compare", str(old), str(new), *words]) == 0
    written = page.read_text(encoding="utf-8").partition("<main>")[2]
    for surface in (written, text.read_text("utf-8"), " ".join(capsys.readouterr().out.split())):
        assert 0 <= surface.index(BANNER) < surface.index("0.6.4 → 0.10.0")
        assert surface.count(BANNER) == 1
    assert 'class="lead warning"' in written
    kept = make("kept", {}, times, **loop)
    assert releases([kept, new]).warnings == [f"new: {warning}"]


@pytest.mark.slow
def test_the_command_writes_page_and_markdown(make: Make, tmp_path: Path, capsys: Any) -> None:
    """Three folders, one of them without the solver; exit 0 though a release is slower."""
    folders = [
        make("a", OLD, {"daqp": 10.0, "piqp": 80.0}),
        make("b", NEW, {"daqp": 10.0, "piqp": 99.0}),
        make("c", {}, {"daqp": 10.0}),
    ]
    page, text = tmp_path / "page.html", tmp_path / "page.md"
    words = ["--releases", "--html", str(page), "--markdown", str(text)]
    assert main(["compare", *map(str, folders), *words]) == 0
    assert "piqp 0.6.4 → 0.10.0: p50 1.24 times" in " ".join(capsys.readouterr().out.split())
    assert "## piqp over its releases" in text.read_text(encoding="utf-8")
    assert "piqp 0.10.0" in page.read_text(encoding="utf-8")
    assert np.isclose(releases(folders).histories.spread, 1.0)
