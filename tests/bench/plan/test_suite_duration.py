"""Run times of the shipped suites, apart from their titles."""

import re

import pytest

from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.cli.listing import _list_suites
from dpbench.scenario.problem_files import list_shipped_problem_names


@pytest.mark.parametrize("name", list_shipped_problem_names("suites"))
def test_the_title_of_a_suite_has_no_duration(name: str) -> None:
    """The page of a finished run has the title as its subtitle."""
    _, suite = load_path_and_suite(name)
    assert not re.search(r"\b(second|minute|hour)s?\b", suite.title)


def test_the_list_of_suites_has_their_durations() -> None:
    table, _ = _list_suites().renderables
    listed = list(table.columns[2].cells)
    _, suite = load_path_and_suite("standard")
    assert suite.duration and any(text.endswith(f", {suite.duration}") for text in listed)
