"""Words of the report: all of them can be filled, and a number that is not given is an error."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from math import inf
from pathlib import Path
from typing import Any

import pytest
from jinja2 import Environment, UndefinedError, nodes
from jinja2.defaults import DEFAULT_FILTERS

import dpbench.report
from dpbench.report.words import FILTERS, filled

REPORT = Path(dpbench.report.__file__).parent
FILES = sorted(file for file in REPORT.rglob("*.toml") if file.with_suffix(".py").exists())


def _texts(found: Any) -> Iterator[str]:
    if isinstance(found, str):
        yield found
    elif isinstance(found, dict | list):
        for each in found.values() if isinstance(found, dict) else found:
            yield from _texts(each)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_template_is_one(file: Path) -> None:
    """Its tags are closed and its filters are known, in branches that no other test writes too."""
    texts = list(_texts(tomllib.loads(file.read_text(encoding="utf-8"))))
    assert texts
    used = {f.name for text in texts for f in Environment().parse(text).find_all(nodes.Filter)}
    assert used <= {*FILTERS, *DEFAULT_FILTERS}


def test_numbers_stand_as_the_report_writes_them() -> None:
    """The formats are filters, and infinity has a name."""
    said = filled("{{ n | plural('step') }} in {{ t | time }}", n=2, t=1500.0)
    assert said == "2 steps in 1.50 µs"
    assert filled("{% if x == inf %}never{% endif %}, {{ x | share }}", x=inf) == "never, –"


def test_a_value_that_is_not_given_is_an_error() -> None:
    """Nothing is left out in silence."""
    with pytest.raises(UndefinedError):
        filled("{{ nobody }}")
