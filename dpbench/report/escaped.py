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
    """Replace line breaks and other characters that are not shown by spaces."""
    return "".join(" " if unicodedata.category(c) in _NOT_SHOWN else c for c in text)


def markdown_text(text: str) -> str:
    """Escape text within a line of Markdown: no HTML, link or picture; marks such as ` stay."""
    return _LINK.sub(r"]\\", _TAG.sub("&lt;", one_line(text)))


def markdown_line(text: str) -> str:
    """Escape a paragraph of Markdown, so that it is no heading, list or block of code."""
    return _BLOCK.sub(r"\\", markdown_text(text).lstrip())


def markdown_cell(text: str) -> str:
    """Escape a cell of a Markdown table."""
    return _PIPE.sub(r"\1\1\\|", markdown_text(text))


def csv_bytes(table: pd.DataFrame) -> bytes:
    """Encode a table as CSV; an apostrophe precedes texts that a spreadsheet takes for formulas."""
    named = table.rename(columns={name: _no_formula(name) for name in table.columns})
    texts = [i for i, dtype in enumerate(named.dtypes) if not pd.api.types.is_numeric_dtype(dtype)]
    for i in texts:
        plain = named.iloc[:, i].map(_no_formula, na_action="ignore")
        named.isetitem(i, plain.to_numpy(dtype=object))
    return bytes(named.to_csv(index=False).encode())


def _no_formula(value: Any) -> Any:
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
