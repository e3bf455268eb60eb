"""Scenarios and ships that are written are read again as they were."""

import tomllib
from pathlib import Path

import pytest

from dpbench.scenario.problem_files import list_shipped_problem_names
from dpbench.scenario.scenario import load_scenario
from dpbench.scenario.variation import (
    copy_scenario_with_values,
    format_as_toml,
    write_scenario_and_own_ship_files,
)


@pytest.mark.parametrize("name", list_shipped_problem_names("scenarios"))
def test_a_scenario_is_read_as_it_was(name: str, tmp_path: Path) -> None:
    """Its ship is one of the library's, and stays a name."""
    files = load_scenario(name).files
    assert write_scenario_and_own_ship_files(files, tmp_path / f"{name}.toml", "one\ntwo") == [
        tmp_path / f"{name}.toml"
    ]
    assert load_scenario(tmp_path / f"{name}.toml").files == files


@pytest.mark.parametrize("ship", list_shipped_problem_names("vessels"))
def test_a_ship_that_is_not_shipped_is_written_beside_its_scenario(
    ship: str, tmp_path: Path
) -> None:
    other = copy_scenario_with_values(
        load_scenario(f"calm@{ship}"), {"vessel.title": "Mine"}, "test"
    )
    paths = write_scenario_and_own_ship_files(other.files, tmp_path / "mine.toml")
    assert [path.name for path in paths] == ["mine.toml", "mine_ship.toml"]
    assert load_scenario(tmp_path / "mine.toml").files["vessel"] == other.files["vessel"]


def test_scenarios_of_one_ship_share_its_file(tmp_path: Path) -> None:
    """A file of that name with another ship is kept."""
    plain = load_scenario("calm@osv").files
    mine = {**plain, "vessel_name": "mine", "vessel": plain["vessel"] | {"title": "Mine"}}
    for name in ("one", "two"):
        paths = write_scenario_and_own_ship_files(mine, tmp_path / f"{name}.toml")
        assert [path.name for path in paths] == [f"{name}.toml", "mine.toml"]
    other = {**mine, "vessel": plain["vessel"] | {"title": "Other"}}
    paths = write_scenario_and_own_ship_files(other, tmp_path / "three.toml")
    assert [path.name for path in paths] == ["three.toml", "three_ship.toml"]
    titles = [load_scenario(tmp_path / f"{name}.toml").vessel.title for name in ("one", "three")]
    assert titles == ["Mine", "Other"]


def test_texts_and_keys_are_quoted_where_needed() -> None:
    document = {"a": 'x "y" \\ z\n', "b c": {"d": [{"e": True}, {"e": False}], "é": {}}, "f": []}
    assert tomllib.loads(format_as_toml(document)) == document
