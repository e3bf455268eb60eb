"""Old words in files and commands are still read, with one line that names the new word."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.bench.plan.suite import load_suite
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.record.schema import READABLE, RENAMED, RUN_COLUMNS, STEP_COLUMNS
from dpbench.cli.main import main
from dpbench.errors import RenamedWarning, ResultsError
from dpbench.solvers.plugins import find_plugin, load_file

SUITE = 'title = "Old"\ncontrast = false\n[[closed_loop]]\nscenarios = ["paper"]\n'
NEW_OF = {new: old for old, new in RENAMED.items()}


def _as_written_before(folder: Path, schema: int) -> None:
    """Rewrite the tables of a folder with the column names and schema number of then."""
    for name in ("runs", "steps"):
        path = folder / f"{name}.parquet"
        frame = pd.read_parquet(path).rename(columns=NEW_OF)
        if name == "runs":
            frame["schema"] = schema
        frame.to_parquet(path)


def test_an_old_key_of_a_suite_means_the_new_one(tmp_path: Path) -> None:
    """`contrast` is read as `baseline_law`, and the line names file and both words."""
    path = tmp_path / "old.toml"
    path.write_text(SUITE)
    with pytest.warns(RenamedWarning, match=r"old\.toml: contrast is now called baseline_law"):
        assert load_suite(path)[1].baseline_law is False


def test_both_words_at_once_are_a_mistake(tmp_path: Path, capsys: Any) -> None:
    """With the new key beside it the old one is unknown."""
    path = tmp_path / "both.toml"
    path.write_text("baseline_law = true\n" + SUITE)
    assert main(["check", str(path)]) == 2
    assert "contrast" in capsys.readouterr().err


def test_the_old_name_of_a_suite_is_read() -> None:
    """`ladder` is `levels`."""
    with pytest.warns(RenamedWarning, match="ladder is now called levels"):
        assert load_suite("ladder")[0].name == "levels.toml"


def test_a_folder_of_an_early_schema_is_read_with_its_old_columns(
    records: Any, tmp_path: Path
) -> None:
    """The same tables, but for the number of the schema."""
    records.replay("daqp")
    folder = records.write(tmp_path / "old")
    now = load_results(folder)
    steps = now.steps
    _as_written_before(folder, min(READABLE))
    with pytest.warns(RenamedWarning) as said:
        before = load_results(folder)
    assert {old for old in RENAMED if any(old in str(line.message) for line in said)} == set(
        RENAMED
    )
    pd.testing.assert_frame_equal(before.steps, steps)
    pd.testing.assert_frame_equal(
        before.runs.drop(columns="schema"), now.runs.drop(columns="schema")
    )


def test_an_older_schema_is_refused(records: Any, tmp_path: Path) -> None:
    """What differs in more than names is not read."""
    records.replay("daqp")
    folder = records.write(tmp_path / "older")
    _as_written_before(folder, min(READABLE) - 1)
    with pytest.raises(ResultsError, match="schema"):
        load_results(folder)


def test_new_names_are_columns_and_old_ones_are_none() -> None:
    """No old name hides a column of today."""
    columns = RUN_COLUMNS | STEP_COLUMNS
    assert set(RENAMED.values()) <= set(columns) and not set(RENAMED) & set(columns)


def test_the_old_command_says_the_new_one(capsys: Any) -> None:
    """`dpbench hunt` is `dpbench worst-case`: the same complaint after one line."""
    assert main(["hunt", "nobody"]) == 2
    old = capsys.readouterr().err.splitlines()
    assert main(["worst-case", "nobody"]) == 2
    assert old == [
        "dpbench: command: hunt is now called worst-case",
        *capsys.readouterr().err.splitlines(),
    ]


def test_a_plugin_may_still_say_ladder(tmp_path: Path) -> None:
    """LADDER is read as LEVELS."""
    example = Path(__file__).parents[1] / "solvers" / "example_plugin.py"
    path = tmp_path / "old_plugin.py"
    text = example.read_text().replace("LEVELS =", "LADDER =").replace('"admm"', '"old_admm"')
    path.write_text(text)
    with pytest.warns(RenamedWarning, match="LADDER is now called LEVELS"):
        load_file(path, ())
    plugin = find_plugin("old_admm")
    assert plugin is not None and set(plugin.record.levels) == {"low", "mid", "high"}
