"""Numbers, tables and filled texts as the report prints them."""

import tomllib
from collections.abc import Callable, Iterator
from math import inf, isnan, nan
from pathlib import Path
from typing import Any

import pytest
from jinja2 import Environment, UndefinedError, nodes
from jinja2.defaults import DEFAULT_FILTERS

import dpbench.report
from dpbench.report import formats
from dpbench.report.formats import make_markdown_table
from dpbench.report.words import FILTERS, fill_template

REPORT = Path(dpbench.report.__file__).parent
FILES = sorted(file for file in REPORT.rglob("*.toml") if file.with_suffix(".py").exists())
PRINTED: list[tuple[Callable[[Any], str], dict[Any, str]]] = [
    (
        formats.format_time,
        {7.0: "7.00 ns", 999.9: "1.00 µs", 28_449.0: "28.4 µs", 999_960.0: "1.00 ms"}
        | {3e6: "3.00 ms", 5e9: "5.00 s", nan: "–"},
    ),
    (
        formats.format_error,
        {
            1.23e-9: "1.2e-09",
            0.43: "0.43",
            0.0: "0",
            inf: "no solution",
            nan: "–",
            4.2e3: "4.2e+03",
        },
    ),
    (
        formats.format_share,
        {1.0: "100 %", 0.99999: "99.9 %", 1e-5: "0.1 %", 0.0: "0 %", 0.1234: "12.3 %"},
    ),
    (
        formats.significant,
        {0.0: "0", 1234.5: "1\u202f230", 123456.0: "123\u202f000", 9.996: "10.0", 1e-6: "1.00e-06"},
    ),
    (formats.format_count, {None: "–", nan: "–", 12: "12"}),
    (lambda words: formats.join_with_and(list(words)), {"": "", "a": "a", "abc": "a, b and c"}),
]


@pytest.mark.parametrize(("text", "printed"), PRINTED)
def test_numbers_and_lists(text: Callable[[Any], str], printed: dict[Any, str]) -> None:
    assert {value: text(value) for value in printed} == printed
    assert isnan(formats.as_float(None))


def test_pipes_do_not_break_markdown() -> None:
    text = make_markdown_table(("a", "b"), (("x | y", "1"),))
    assert text.splitlines() == ["| a | b |", "| :-- | --: |", "| x \\| y | 1 |"]


def _texts(found: Any) -> Iterator[str]:
    if isinstance(found, str):
        yield found
    elif isinstance(found, dict | list):
        for each in found.values() if isinstance(found, dict) else found:
            yield from _texts(each)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_templates_have_closed_tags_and_known_filters(file: Path) -> None:
    texts = list(_texts(tomllib.loads(file.read_text(encoding="utf-8"))))
    assert texts
    used = {f.name for text in texts for f in Environment().parse(text).find_all(nodes.Filter)}
    assert used <= {*FILTERS, *DEFAULT_FILTERS}


def test_formats_are_filters_and_a_missing_value_is_an_error() -> None:
    output = fill_template("{{ n | plural('step') }} in {{ t | time }}", n=2, t=1500.0)
    assert output == "2 steps in 1.50 µs"
    assert fill_template("{% if x == inf %}never{% endif %}, {{ x | share }}", x=inf) == "never, –"
    with pytest.raises(UndefinedError):
        fill_template("{{ nobody }}")
