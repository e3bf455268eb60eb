"""`dpbench embedded`: its tables, its JSON, a recipe of a user's own, and what it refuses."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from dpbench.cli.main import main
from dpbench.embedded.toolchain import has_extra

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not has_extra(), reason="the extra `embedded` is not installed"),
]
RECIPE = """
solver = "zero"
licence = "none"
origin = "this test"
start = "nothing"
tuned = "nothing"
[settings]
answer = 0.0
"""
SHIM = """
#include "embedded.h"
#include "problem.h"
int embedded_set_up(embedded_qp *qp) { return qp->n != N; }
int embedded_step(embedded_qp *qp) {
    for (int i = 0; i < N; i++) qp->z[i] = SETTING_ANSWER;
    qp->status = 0;
    return 0;
}
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """A folder with a solver that answers the same number to every QP."""
    folder = tmp_path / "zero"
    folder.mkdir()
    (folder / "recipe.toml").write_text(RECIPE)
    (folder / "shim.c").write_text(SHIM)
    return folder


def test_json_and_steps_of_a_users_own_solver(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["--recipe", str(recipe), "--solver", "zero", "--settings", "zero.answer=0.5"]
    out = ["--steps", "3", "--out", str(tmp_path / "out"), "--json"]
    assert main(["embedded", "paper-30-5", *own, *out]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert (run["solver"], run["steps"], run["settings"]) == ("zero", 3, {"answer": 0.5})
    assert run["error_move"] > 0.1
    steps = pd.read_parquet(tmp_path / "out" / "embedded.parquet")
    assert steps["k"].tolist() == [0, 1, 2]
    assert steps["instructions"].nunique() == 1


def test_tables(recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = ["--recipe", str(recipe), "--solver", "zero", "--steps", "2", "--float"]
    (recipe / "recipe.toml").write_text("float_defines = []\n" + RECIPE)
    assert main(["embedded", "--target", "a53", *own, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "on Cortex-A53, float: instructions per step" in " ".join(printed.split())
    assert "\nSettings of zero: answer=" in printed
    assert max(len(line) for line in printed.splitlines() if str(tmp_path) not in line) <= 80


def test_the_largest_horizon_that_fits(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A static array of N·1000 bytes: 16 kB hold 5 control increments of three variables."""
    array = "\nstatic volatile char array[N * 1000];\n"
    shim = SHIM.replace("int embedded_set_up", f"{array}int embedded_set_up")
    (recipe / "shim.c").write_text(shim.replace("qp->status = 0;", "qp->status = array[0];"))
    words = ["embedded", "paper", "--recipe", str(recipe), "--solver", "zero", "--fit", "16"]
    out = ["--fit", "1", "--steps", "2", "--out", str(tmp_path / "out")]
    assert main([*words, *out, "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["fits"]
    assert (first["control_horizon"], first["variables"]) == (5, 15)
    assert 15_000 < first["memory_bytes"] <= 16_384 < first["next_memory_bytes"]
    assert (second["control_horizon"], second["next_control_horizon"]) == (None, 1)
    steps = pd.read_parquet(tmp_path / "out" / "embedded.parquet")
    assert set(steps["sequence"]) >= {"paper-30-5", "paper-36-6", "paper-6-1"}
    assert main([*words, *out]) == 0
    printed = capsys.readouterr().out
    assert "largest control horizon" in printed
    assert max(map(len, printed.split("Compiled")[0].splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--fit", "small"], "--fit: found 'small'; allowed: a whole number of kB above 0"),
        (["--target", "m8"], "--target: found 'm8'; allowed: one of m7, a53, riscv, x86"),
        (["--solver", "zero", "--float"], "zero: --float: found single precision; allowed: double"),
        (["--solver", "zero", "--settings", "zero=1"], "--settings: found 'zero=1'; allowed: "),
        (["--solver", "zero", "--settings", "zero.answer=x"], "found 'x'; allowed: a number"),
        (["no-such-sequence"], "no-such-sequence"),
    ],
)
def test_bad_input(
    recipe: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["embedded", "--recipe", str(recipe), *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_a_random_mpc_problem_by_its_name(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["--recipe", str(recipe), "--solver", "zero", "--solver", "hildreth", "--steps", "2"]
    out = ["--out", str(tmp_path / "out"), "--json"]
    assert main(["embedded", "random_mpc-3-2-4", *own, *out]) == 0
    zero, hildreth = json.loads(capsys.readouterr().out)["runs"]
    assert hildreth["sequence"] == "random_mpc-3-2-4-s123[:2:1]"
    assert hildreth["error_move"] < 1e-6 < zero["error_move"]
    assert main(["embedded", "random_mpc-3-2", *own]) == 2
    assert "random_mpc-STATES-INPUTS-HORIZON" in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
def test_a_second_opinion(capsys: pytest.CaptureFixture[str]) -> None:
    own = ["--solver", "hildreth", "--steps", "1", "--target", "x86"]
    assert main(["embedded", *own, "--second-opinion"]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("hildreth")]
    unicorn, other = (part.strip() for part in row.split("│")[2:4])
    assert unicorn == other
