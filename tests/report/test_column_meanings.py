"""Every column of a table beside the page has a meaning, of its own table."""

import json
import re
from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

from dpbench.report.report import COLUMNS_OF, Report, describe_columns
from tests.report.conftest import of_seas
from tests.report.page.test_suites import KINDS
from tests.report.test_settings_grids import add
from tests.report.topics.test_embedded import counts
from tests.report.topics.test_paper import DESIGNS


def _thrusters(records: Any) -> None:
    wear = {"thrust_variation": 2.0, "azimuth_travel_deg": 30.0, "at_limit_thrusters": 0.1}
    use = {"window_s": [90.0, 150.0], "thrust": [0.2, 0.6], "thrusters": {"bow": [0.1, 0.2, 0, 0]}}
    stored = {"power_share": 0.3, "exact_thruster_use": json.dumps(use)} | wear
    records.loop("daqp", "thrusters_loss", steps=600, **stored)


def _grid(records: Any) -> None:
    for rho in (1, 2, 10):
        add(records, 1e-9, rho=rho)


FOLDERS: dict[str, Callable[[Any], Any]] = {
    **{kind: fill for kind, (fill, *_) in KINDS.items()},
    "thrusters": _thrusters,
    "study": of_seas,
    "grid": _grid,
}
TABLES = {
    "timed": {"trust"},
    "thrusters": {"thrusters", "thrusters_2"},
    "study": {"study_excess", "study_points", "study_effects"},
    "grid": {"settings_grids"},
    "paper": {"paper", "paper_2", "paper_3"},
}
"""Some tables of these folders."""


def _require_meanings(tables: dict[str, pd.DataFrame]) -> set[str]:
    """Fail for a column without a meaning; return the names of the tables with rows."""
    written = {name: table for name, table in tables.items() if len(table)}
    for name, table in written.items():
        assert list(describe_columns(name, table)) == list(table), name
    return set(written)


def test_every_column_of_a_campaign_has_a_meaning_in_its_own_table(written: Any) -> None:
    found = _require_meanings(dict(written.report.tables))
    legend = (written.folder / "tables" / "README.md").read_text(encoding="utf-8")
    parts = dict(part.split(".csv\n", 1) for part in legend.split("\n## ")[1:])
    assert found == set(parts) > {"experiments", "hard_steps", "paired_ratios", "paper_2"}
    for name in found:
        explained = re.findall(r"^- `(.+?)`: \S", parts[name], re.M)
        assert explained == list(written.report.tables[name]), name


@pytest.mark.parametrize("kind", FOLDERS)
def test_every_column_of_a_suite_of_each_kind_has_a_meaning(records: Any, kind: str) -> None:
    FOLDERS[kind](records)
    report = Report.from_results(records.results(), DESIGNS, counted=counts())
    found = _require_meanings(dict(report.tables))
    of_topics = {re.sub(r"_\d+$", "", name) for name in found}
    assert {topic.id for topic in report.topics if topic.tables} & {*COLUMNS_OF} <= of_topics
    assert found >= TABLES.get(kind, set())


def test_a_value_of_the_machine_is_not_explained_as_a_hard_step() -> None:
    frame = pd.DataFrame(columns=["value"])
    assert describe_columns("trust", frame)["value"] == "value of the property, with its unit"
    assert describe_columns("hard_steps", frame)["value"].startswith("value of that measure")
