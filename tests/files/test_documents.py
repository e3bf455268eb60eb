"""JSON that others wrote: how deep and how large it may be."""

import json
from pathlib import Path

import pytest

from dpbench.bench.record.result_folder import read_json
from dpbench.errors import ResultsError
from dpbench.files.regular_files import MOST_DEPTH, MOST_JSON_BYTES, parse_json


def test_deep_large_and_half_documents_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "suite.json"
    for text, found in (
        ("[" * 100_000, "nested too deeply"),
        (
            '{"a":' * (MOST_DEPTH + 1) + "1" + "}" * (MOST_DEPTH + 1),
            f"more than {MOST_DEPTH} nested",
        ),
        ("9" * 5000, "digits"),
        ('{"a": [1' + "0" * 400 + "]}", "more than 300 digits"),
        (r'{"title": "\ud800"}', "surrogates not allowed"),
        ("[" + " " * MOST_JSON_BYTES + "]", "bytes"),
        ("\udcff", "decode"),
    ):
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
        with pytest.raises(ResultsError, match=found) as caught:
            read_json(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_whole_characters_and_the_deepest_document_are_read() -> None:
    assert parse_json(r'{"title": "\ud83d\ude00"}') == {"title": "\U0001f600"}
    deepest = "[" * MOST_DEPTH + "]" * MOST_DEPTH
    assert parse_json(deepest) == json.loads(deepest)
