"""Parquet files that are small and unpack to gigabytes are refused by their metadata."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpbench.bench.record.result_folder import load_results
from dpbench.errors import InputError, ResultsError
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table

ROWS = 4_000_000


def _written(path: Path, table: pa.Table) -> Path:
    pq.write_table(table, path, compression="zstd", store_schema=False)
    assert path.stat().st_size < 300_000
    return path


def test_rows_that_are_all_the_same(tmp_path: Path) -> None:
    table = pa.table({f"c{i}": np.zeros(ROWS) for i in range(4)})
    path = _written(tmp_path / "runs.parquet", table)
    found = r"unpack to 128\d{6} bytes; allowed: at most \d+ unpacked bytes"
    with pytest.raises(InputError, match=found), open_untrusted_parquet_table(path):
        raise AssertionError("it was read")
    with pytest.raises(ResultsError, match=r"runs\.parquet: found \d+ bytes that unpack to"):
        load_results(tmp_path)


def test_a_long_word_in_each_row(tmp_path: Path) -> None:
    codes = pa.array(np.zeros(ROWS, dtype=np.int32))
    words = pa.DictionaryArray.from_arrays(codes, pa.array(["x" * 10_000]))
    path = _written(tmp_path / "runs.parquet", pa.table({"cell": words}))
    with (
        open_untrusted_parquet_table(path) as file,
        pytest.raises(InputError, match=f"to {10_000 * ROWS}"),
    ):
        decode_dictionary_columns_to_text(file.read(), path)


@pytest.mark.slow
def test_a_damaged_entry_of_a_column_ends_no_process(tmp_path: Path) -> None:
    path = tmp_path / "runs.parquet"
    pq.write_table(pa.table({"a": ["x", None, "y"], "b": [1.0, 2.0, None]}), path)
    whole = path.read_bytes()
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    for at in range(len(whole) - footer, len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 3]) + whole[at + 1 :])
        with (
            suppress(OSError, ValueError, pa.ArrowException),
            open_untrusted_parquet_table(path) as file,
        ):
            decode_dictionary_columns_to_text(file.read(), path)


def test_other_types_than_numbers_and_words_are_refused(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.parquet", pa.table({"c": pa.array([[1.0] * 1000] * 100)}))
    found = r"c: found type list.*; allowed: numbers or text"
    with pytest.raises(InputError, match=found), open_untrusted_parquet_table(path):
        raise AssertionError("it was read")


def test_words_and_numbers_come_back(tmp_path: Path) -> None:
    table = pa.table(
        {
            "word": pa.array(["a", None, "bb", "a"]),
            "long": pa.array(["x", "y", None, "x"], pa.large_string()),
            "number": pa.array([1.5, None, 2.5, -0.0]),
            "whole": pa.array([1, 2, None, 4]),
            "flag": pa.array([True, False, None, True]),
            "none": pa.array([None] * 4),
        }
    )
    path = tmp_path / "a.parquet"
    for store_schema in (True, False):
        pq.write_table(table, path, store_schema=store_schema)
        with open_untrusted_parquet_table(path) as file:
            found = decode_dictionary_columns_to_text(file.read(), path)
        assert found.to_pydict() == table.to_pydict()
        assert not any(pa.types.is_dictionary(field.type) for field in found.schema)
