"""Row groups that are joined byte for byte, read again by Arrow."""

import io
import random
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st

from dpbench.files.row_groups import RowGroupWriter, read_parquet_footer

ROWS = st.lists(
    st.tuples(
        st.none() | st.text(max_size=4),
        st.none() | st.integers(-(2**63), 2**63 - 1),
        st.floats(width=64),
        st.booleans(),
    ),
    max_size=40,
)
SCHEMA = pa.schema({"name": pa.string(), "n": pa.int64(), "x": pa.float64(), "yes": pa.bool_()})


def encoded(rows: list[tuple[object, ...]], codec: str, group: int) -> bytes:
    """A Parquet file of these rows, in row groups of so many, with what a campaign's files have."""
    columns = zip(*rows, strict=True) if rows else [()] * len(SCHEMA)
    arrays = [pa.array(list(c), f.type) for c, f in zip(columns, SCHEMA, strict=True)]
    file = io.BytesIO()
    pq.write_table(
        pa.table(arrays, SCHEMA),
        file,
        compression=codec,
        row_group_size=group,
        use_dictionary=["name"],
        column_encoding={"n": "BYTE_STREAM_SPLIT", "x": "BYTE_STREAM_SPLIT"},
        write_page_checksum=True,
        store_schema=False,
    )
    return file.getvalue()


def join(files: list[bytes], path: Path) -> int:
    """Join all row groups of files into one; how many rows it says that it has."""
    writer = RowGroupWriter(path)
    for data in files:
        source = io.BytesIO(data)
        footer = read_parquet_footer(source)
        for index in range(len(footer.row_groups)):
            writer.copy_row_group(source, footer, index)
    writer.write_footer_and_close(read_parquet_footer(io.BytesIO(encoded([], "zstd", 1))))
    return writer.rows


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    parts=st.lists(st.tuples(ROWS, st.sampled_from(["zstd", "none", "snappy"])), max_size=20),
    group=st.integers(1, 30),
)
def test_joined_files_are_the_concatenated_tables(
    parts: list[tuple[list[tuple[object, ...]], str]],
    group: int,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.mktemp("joined") / "all.parquet"
    files = [encoded(rows, codec, group) for rows, codec in parts]
    rows = join(files, path)
    tables = [pq.read_table(io.BytesIO(data)) for data in files]
    expected = pa.concat_tables([SCHEMA.empty_table(), *tables])
    joined = pq.read_table(path, page_checksum_verification=True)
    assert rows == expected.num_rows
    assert joined.schema.equals(expected.schema)
    # NaN equals NaN in bytes alone.
    assert [c.combine_chunks().to_pylist().__repr__() for c in joined.columns] == [
        c.combine_chunks().to_pylist().__repr__() for c in expected.columns
    ]


def test_a_group_of_another_schema_is_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    pq.write_table(pa.table({"other": [1]}), file)
    writer = RowGroupWriter(tmp_path / "all.parquet")
    first = io.BytesIO(encoded([("a", 1, 1.0, True)], "zstd", 1))
    writer.copy_row_group(first, read_parquet_footer(first), 0)
    with pytest.raises(ValueError, match="another schema"):
        writer.copy_row_group(file, read_parquet_footer(file), 0)
    writer.write_footer_and_close(read_parquet_footer(first))
    assert pq.read_table(tmp_path / "all.parquet").num_rows == 1


@pytest.mark.slow
def test_damaged_footers_raise_what_is_documented(tmp_path: Path) -> None:
    whole = encoded([(str(i), i, float(i), True) for i in range(20)], "zstd", 5)
    rng, refused = random.Random(1), 0
    for i in range(3000):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 3)):
            data[rng.randrange(len(data) - 600, len(data))] = rng.randrange(256)
        source = io.BytesIO(bytes(data[: rng.randint(0, len(data))]) if i % 5 == 0 else bytes(data))
        # To truncate a file that has content makes ext4 flush it: seconds in all.
        (tmp_path / "all.parquet").unlink(missing_ok=True)
        writer = RowGroupWriter(tmp_path / "all.parquet")
        try:
            footer = read_parquet_footer(source)
            for index in range(len(footer.row_groups)):
                writer.copy_row_group(source, footer, index)
        except (ValueError, KeyError, IndexError):
            refused += 1
        with suppress(ValueError):
            writer.write_footer_and_close(read_parquet_footer(io.BytesIO(whole)))
    assert refused > 1000
