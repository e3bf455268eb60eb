"""Parquet tables that others wrote: what they unpack to is bounded before it is unpacked.

Run-length and dictionary encoding make gigabytes of a few kilobytes, which neither the size of the
file nor what its metadata call the uncompressed size tells: the numbers of values do, and the
lengths of words once they are read, each word once.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from dpbench.errors import InputError
from dpbench.files.regular_files import open_regular_file, refuse_implausible_unpacked_size

WHAT = "a table written by `run_campaign()`"
MOST_ENTRIES = 100_000
"""Longest list that a Parquet footer may have, of columns or of row groups: 10¹⁰ steps have as
many."""
_CODE, _NUMBER = 4, 8  # Bytes of a value in memory: of the code of a word, and of any number
_IS_TEXT = (pa.types.is_string, pa.types.is_large_string)
_IS_NUMBER = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_null)


@contextmanager
def open_untrusted_parquet_table(
    path: Path, *, error: type[InputError] = InputError
) -> Iterator[pq.ParquetFile]:
    """Open an untrusted Parquet table of numbers and texts, its unpacked size bounded; yield it.

    Raises InputError : it is no regular file, has columns of other types, or unpacks to too much.
    OSError, ValueError, ArrowException : it is damaged.
    """
    with open_regular_file(path, WHAT, error=error) as file:
        size = os.fstat(file.fileno()).st_size
        metadata = pq.ParquetFile(file, thrift_container_size_limit=MOST_ENTRIES).metadata
        schema = metadata.schema.to_arrow_schema()
        for field in schema:
            kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
            if not any(fits(kind) for fits in (*_IS_NUMBER, *_IS_TEXT)):
                raise error(str(path), field.name[:80], f"type {kind}", "numbers or text")
        words = [f.name for f in schema if any(fits(f.type) for fits in _IS_TEXT)]
        refuse_implausible_unpacked_size(
            path, _estimate_unpacked_table_bytes(metadata, len(words)), size, error=error
        )
    with pq.ParquetFile(
        path, metadata=metadata, read_dictionary=words, page_checksum_verification=True
    ) as table:
        yield table


def _estimate_unpacked_table_bytes(metadata: pq.FileMetaData, words: int) -> int:
    """Return a Parquet table's size in memory [bytes], each distinct text counted once."""
    a_row = _CODE * words + _NUMBER * (metadata.num_columns - words)
    # Of row groups as a whole: where the entry of a column is damaged, asking for it aborts Python.
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    return sum(a_row * group.num_rows + group.total_byte_size for group in groups)


def decode_dictionary_columns_to_text(
    table: pa.Table, path: Path, *, error: type[InputError] = InputError
) -> pa.Table:
    """Return a table with dictionary-encoded columns as plain text; raise `error` if too large."""
    coded = {f.name: table[f.name] for f in table.schema if pa.types.is_dictionary(f.type)}
    refuse_implausible_unpacked_size(
        path,
        sum(map(_count_bytes_of_decoded_texts, coded.values())),
        os.path.getsize(path),
        error=error,
    )
    for name, column in coded.items():
        at = table.schema.get_field_index(name)
        table = table.set_column(at, name, column.cast(column.type.value_type))
    return table


def _count_bytes_of_decoded_texts(column: pa.ChunkedArray) -> int:
    """Return the bytes of a column's texts, each as often as it occurs."""
    total = 0
    for chunk in column.chunks:
        lengths = pc.binary_length(chunk.dictionary).fill_null(0).to_numpy()
        codes = chunk.indices.drop_null().to_numpy()
        counts = np.bincount(codes, minlength=len(lengths))
        total += int((counts * lengths.astype(np.int64)).sum())
    return total
