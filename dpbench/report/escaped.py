"""Words of a result folder that others may have written, made harmless for what displays them."""

from __future__ import annotations

import re
import unicodedata
from typing import Any

import pandas as pd

_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_LINK = re.compile(r"\](?=[(\[:])")
_PIPE = re.compile(r"(\\*)\|")
_BLOCK = re.compile(r"^(?=#{1,6}(\s|$)|>|```|~~~|[-+*]\s|[-_*=]{3})")
_NOT_SHOWN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of characters that end a line, turn its direction or cannot be written."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""What a spreadsheet takes for the beginning of a formula."""


def one_line(text: str) -> str:
    """The text without line breaks and other characters that are not shown."""
    return "".join(" " if unicodedata.category(c) in _NOT_SHOWN else c for c in text)


def markdown_text(text: str) -> str:
    """Text within a line of Markdown: no HTML, link or picture; marks such as ` stay."""
    return _LINK.sub(r"]\\", _TAG.sub("&lt;", one_line(text)))


def markdown_line(text: str) -> str:
    """A paragraph of Markdown: as `markdown_text`, and no heading, list or block of code."""
    return _BLOCK.sub(r"\\", markdown_text(text).lstrip())


def markdown_cell(text: str) -> str:
    """A cell of a table of Markdown."""
    return _PIPE.sub(r"\1\1\\|", markdown_text(text))


def csv_bytes(table: pd.DataFrame) -> bytes:
    """The table as CSV; texts that a spreadsheet would take for formulas begin with an apostrophe.

    Numbers stay as they are, those in columns of text too.
    """
    named = table.rename(columns={name: _no_formula(name) for name in table.columns})
    texts = [i for i, dtype in enumerate(named.dtypes) if not pd.api.types.is_numeric_dtype(dtype)]
    for i in texts:
        plain = named.iloc[:, i].map(_no_formula, na_action="ignore")
        named.isetitem(i, plain.to_numpy(dtype=object))
    return bytes(named.to_csv(index=False).encode())


def _no_formula(value: Any) -> Any:
    """The value; a text that begins like a formula, and is no number, behind an apostrophe."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
