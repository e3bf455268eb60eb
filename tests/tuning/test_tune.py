"""`dpbench tune-solver` from its arguments to the settings it writes."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results
from dpbench.cli.main import main
from dpbench.errors import InputError, SettingsError
from dpbench.tuning.tune import tune_solver


@pytest.mark.parametrize(
    ("solver", "arguments", "message"),
    [
        ("osqp", {"training": ["paper"], "test": ["paper-60-10"]}, "--test: .*same loop"),
        ("osqp", {"trials": 0}, "--trials: found 0"),
        ("osqp", {"error_move": 0.0}, "--error: found 0"),
        ("osqp", {"name": "high"}, "--name: found 'high'"),
        ("osqp", {"name": "../x"}, "--name: found '../x'; allowed: letters, digits"),
        ("osqp", {"ranges": ["rhoo=[1,2]"]}, "settings of osqp: rhoo: found an unknown key"),
        ("osqp", {"route": "c"}, "route: found 'c'"),
        ("clarabel", {"policy": "warm"}, "policy: found 'warm'; allowed: .*no interface"),
        ("nobody", {}, "found 'nobody'"),
        ("osqp[rhoo=1]", {}, "settings of osqp: rhoo: found an unknown key"),
        ("osqp[rho=[1,2]]", {}, r"found osqp\[rho=\[1,2\]\]; allowed: one value an option"),
    ],
)
def test_a_mistake_is_found_before_anything_runs(
    solver: str, arguments: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises((InputError, SettingsError), match=message):
        tune_solver(solver, out=tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_settings_are_found_measured_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """OSQP with few iterations is wrong; the settings written are accurate, and run in a suite."""
    monkeypatch.chdir(tmp_path)
    words = "--train calm-60-10 --test move-60-10 --trials 16 --range max_iter=[1,4000] --out out"
    command = ["tune-solver", "osqp", *words.split(), "--range", "eps_abs=[1e-8,1e-3]"]
    assert main(command) == 0
    said = capsys.readouterr().out
    (options,) = tomllib.loads(Path("out/tuned.toml").read_text())["settings"]["tuned"].values()
    assert set(options) == {"max_iter", "eps_abs"}
    assert f"max_iter={options['max_iter']}" in said
    assert "training sequences: accurate; " in said
    assert "test sequences: " in said
    runs = load_results(Path("out/final")).runs
    assert set(runs["sequence"]) == {"calm-60-10[:300:8]", "move-60-10[:300:8]"}
    assert set(runs["settings"]) > {"default", "high"} and len(runs) == 6
    searched = [load_results(folder).runs for folder in sorted(Path("out").glob("batch-??"))]
    assert {name for batch in searched for name in batch["sequence"]} == {"calm-60-10[:300:8]"}
    wrong = {name for batch in searched for name in batch["settings"][batch["failed_steps"] > 0]}
    assert wrong and f"max_iter={options['max_iter']}" not in wrong
    # The same command goes on where it ended: nothing is run again.
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("runs.parquet")}
    assert main(command) == 0
    assert before == {path: path.stat().st_mtime_ns for path in Path("out").rglob("runs.parquet")}


@pytest.mark.slow
def test_own_settings_are_measured_beside_the_best(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search keeps an option that it does not vary; yours, at the edge, get a wider range."""
    words = "--train calm-60-10 --test move-60-10 --trials 16 --policy warm"
    choice, ranges = "osqp[rho=100,max_iter=3000]", ["--range", "rho=[50,100]"]
    assert main(["tune-solver", choice, *ranges, *words.split(), "--out", str(tmp_path)]) in (0, 1)
    said = capsys.readouterr()
    notes = " ".join((said.out + said.err).split())
    assert "warm starts on calm-60-10[:300:8] (one step of 8) and move-60-10[:300:8]" in notes
    assert "your settings lie at the edge of the searched range, rho = 100: widen" in notes
    first = load_results(tmp_path / "batch-01").runs["settings"]
    assert first.iloc[1] == "max_iter=3000,rho=100"
    assert all("max_iter=3000" in name for name in first if name != "default")
    tables = [row for row in said.out.splitlines() if "│ yours" in row]
    assert [row.split("│")[1].strip() for row in tables] == [
        "calm-60-10[:300:8]",
        "move-60-10[:300:8]",
    ]


@pytest.mark.slow
def test_a_search_without_accurate_settings_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1 and no file."""
    words = "--train calm-60-10 --test move-60-10 --trials 16 --range max_iter=[1,2]"
    command = ["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]
    assert main(command) == 1
    assert "settings is accurate on every training sequence" in " ".join(
        capsys.readouterr().out.split()
    )
    assert not (tmp_path / "tuned.toml").exists()
