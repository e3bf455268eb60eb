"""JSON, CSV and nesting: the bounds within which a document that others wrote is parsed."""

import csv
import io
import json
from pathlib import Path
from typing import Any

from dpbench.errors import InputError
from dpbench.files.opening import MOST_TEXT_BYTES, read_bytes

MOST_JSON_BYTES = 2**22  # Of a JSON document; empty objects take 24 times as much memory
MOST_DEPTH = 32
"""Levels of nested tables and arrays, and parts of a dotted key. dpbench itself has at most 8."""

_MOST_INTEGER = 2**1023


def read_json_object(
    path: Path, what: str, *, error: type[InputError] = InputError
) -> dict[str, Any]:
    """Read a JSON object from an untrusted file; raise `error` if it is damaged or too large."""
    data = read_bytes(path, "a JSON file", most_bytes=MOST_JSON_BYTES, error=error)
    try:
        document = parse_json(data.decode("utf-8"))
    except ValueError as failure:
        raise error(str(path), "", f"no JSON ({failure})", what) from failure
    if not isinstance(document, dict):
        raise error(str(path), "", type(document).__name__, "a JSON object")
    return document


def read_csv_rows(path: Path) -> list[list[str]]:
    """Read the rows of an untrusted CSV file but empty ones and comments; InputError if bad."""
    what = "a readable CSV file in UTF-8"
    content = read_bytes(path, what, most_bytes=MOST_TEXT_BYTES)
    try:
        lines = io.StringIO(content.decode("utf-8-sig"), newline="")
        rows = [row for row in csv.reader(lines) if row and not row[0].startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), "", str(error), what) from error
    return rows


def parse_json(text: str) -> Any:
    """Parse untrusted JSON; ValueError if damaged, too large, too deep or not valid Unicode."""
    if len(text) > MOST_JSON_BYTES:
        raise ValueError(f"{len(text)} characters where {MOST_JSON_BYTES} are allowed")
    try:
        document = json.loads(text)
    except RecursionError as failure:
        raise ValueError("nested too deep") from failure
    refuse_deep_or_huge_values(document)
    if "\\ud" in text.lower():
        # An escape of half a surrogate pair gives a text that can be neither printed nor written.
        json.dumps(document, ensure_ascii=False).encode()
    return document


def refuse_deep_or_huge_values(document: object) -> None:
    """Raise ValueError for parsed JSON nested too deep, or with an integer beyond all floats."""
    depth = 0
    level: list[Any] = [document]
    while level:
        if any(isinstance(one, int) and abs(one) >= _MOST_INTEGER for one in level):
            raise ValueError("an integer of more than 300 digits")
        level = [one for one in level if isinstance(one, dict | list)]
        depth += bool(level)
        if depth > MOST_DEPTH:
            raise ValueError(f"more than {MOST_DEPTH} nested levels")
        level = [
            inner for one in level for inner in (one.values() if isinstance(one, dict) else one)
        ]
