"""Old words in files and commands are still read, with one line that names the new word."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.cli.main import main
from dpbench.errors import RenamedWarning, ResultsError
from tests.cli.conftest import Say

SUITE = 'title = "Old"\ncontrast = false\n[[closed_loop]]\nscenarios = ["paper"]\n'


def test_an_old_key_of_a_suite_means_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text(SUITE)
    with pytest.warns(RenamedWarning, match=r"old\.toml: contrast is now called baseline_law"):
        assert load_path_and_suite(path)[1].baseline_law is False


def test_both_words_at_once_are_a_mistake(tmp_path: Path, refuse: Say) -> None:
    path = tmp_path / "both.toml"
    path.write_text("baseline_law = true\n" + SUITE)
    assert "contrast" in refuse("check", str(path))


def test_the_old_name_of_a_suite_is_read() -> None:
    with pytest.warns(RenamedWarning, match="ladder is now called levels"):
        assert load_path_and_suite("ladder")[0].name == "levels.toml"


@pytest.mark.parametrize("schema", [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1])
def test_another_schema_is_refused(schema: int, records: Any, tmp_path: Path) -> None:
    records.replay("daqp")
    path = records.write(tmp_path / "other") / "runs.parquet"
    pd.read_parquet(path).assign(schema=schema).to_parquet(path)
    with pytest.raises(ResultsError, match=rf"schema: found {schema}; allowed: "):
        load_results(path.parent)


def test_the_old_command_says_the_new_one(capsys: Any) -> None:
    assert main(["hunt", "nobody"]) == 2
    old = capsys.readouterr().err.splitlines()
    assert main(["worst-case", "nobody"]) == 2
    assert old == [
        "dpbench: command: hunt is now called worst-case",
        *capsys.readouterr().err.splitlines(),
    ]


def test_a_refused_key_of_a_suite_names_the_new_one(tmp_path: Path, refuse: Say) -> None:
    path = tmp_path / "old.toml"
    path.write_text('title = "Old"\n[demand]\np99_ms = 2.0\n[[replay]]\nscenario = "paper"\n')
    line = refuse("check", str(path))
    assert "demand" in line and "requirements" in line
