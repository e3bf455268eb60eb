"""Numbers as the report prints them."""

import math

import pytest

from dpbench.report.formats import (
    and_list,
    as_float,
    count_text,
    error_text,
    share_text,
    significant,
    time_text,
)


@pytest.mark.parametrize(
    ("nanoseconds", "text"),
    [
        (7.0, "7.00 ns"),
        (999.9, "1.00 µs"),
        (28_449.0, "28.4 µs"),
        (999_960.0, "1.00 ms"),
        (3e6, "3.00 ms"),
        (5e9, "5.00 s"),
        (math.nan, "–"),
    ],
)
def test_durations(nanoseconds: float, text: str) -> None:
    """A duration has three significant digits, in the unit that keeps it below a thousand."""
    assert time_text(nanoseconds) == text


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (1.23e-9, "1.2e-09"),
        (0.43, "0.43"),
        (0.0, "0"),
        (math.inf, "no answer"),
        (math.nan, "–"),
        (4.2e3, "4.2e+03"),
    ],
)
def test_errors(error: float, text: str) -> None:
    """An error has two significant digits, an infinite one means that there was no answer."""
    assert error_text(error) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [(1.0, "100 %"), (0.99999, "99.9 %"), (1e-5, "0.1 %"), (0.0, "0 %"), (0.1234, "12.3 %")],
)
def test_shares(share: float, text: str) -> None:
    """A share is 100 % or 0 % in print only when it is so exactly."""
    assert share_text(share) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1230"), (123456.0, "123\u202f000"), (9.996, "10.0"), (1e-6, "1.00e-06")],
)
def test_significant_digits(value: float, text: str) -> None:
    """Digits that are not significant are not printed."""
    assert significant(value) == text


def test_missing_numbers_are_dashes() -> None:
    """What is missing in a record is a dash, whatever kind of missing it is."""
    assert [count_text(value) for value in (None, math.nan, 12)] == ["–", "–", "12"]
    assert math.isnan(as_float(None))


def test_lists_read_as_english() -> None:
    """Names are joined by commas and a final 'and'."""
    assert [and_list(words) for words in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == [
        "",
        "a",
        "a and b",
        "a, b and c",
    ]
