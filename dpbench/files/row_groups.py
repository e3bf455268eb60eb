"""Row groups of Parquet files joined to one file, byte for byte: nothing is decoded.

A row group is a stretch of bytes that the footer describes by offsets. It is copied, and its
description with offsets of the new place. The footer is a struct of Thrift's compact protocol
(https://github.com/apache/thrift, thrift-compact-protocol.md; parquet-format, parquet.thrift).
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any, BinaryIO

Struct = dict[int, tuple[int, Any]]
"""Type and value of each field by its number."""

MAGIC = b"PAR1"
_BLOCK = 2**20
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
# Numbers of fields in parquet.thrift.
_SCHEMA, NUM_ROWS, _GROUPS, _METADATA = 2, 3, 4, 5
_COLUMNS, _GROUP_ROWS, _GROUP_OFFSET, _ORDINAL = 1, 3, 5, 7
_CHUNK_OFFSET, _CHUNK = 2, 3
_DATA, _DICTIONARY, _CHUNK_BYTES = 9, 11, 7
_ELSEWHERE = frozenset({1, 4, 5, 6, 7, 8, 9})
"""Fields of a column chunk about bytes outside of its row group."""


class _Reader:
    """Decodes values from the front of `data`; ValueError or IndexError where it is damaged."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def _varint(self) -> int:
        result = shift = 0
        while True:
            byte = self._data[self._at]
            self._at += 1
            result |= (byte & 0x7F) << shift
            if byte < 0x80:
                return result
            shift += 7

    def _integer(self) -> int:
        number = self._varint()
        return (number >> 1) ^ -(number & 1)

    def _bytes(self, size: int) -> bytes:
        found = self._data[self._at : self._at + size]
        self._at += size
        if len(found) < size:
            raise ValueError("a footer that is cut off")
        return found

    def _value(self, kind: int) -> Any:
        if kind in (_I16, _I32, _I64):
            return self._integer()
        if kind == _BINARY:
            return self._bytes(self._varint())
        if kind == _STRUCT:
            return self.struct()
        if kind == _LIST:
            head = self._data[self._at]
            self._at += 1
            size = head >> 4 if head >> 4 < 15 else self._varint()
            return head & 15, [self._value(head & 15) for _ in range(size)]
        if kind in (_TRUE, _FALSE, _BYTE):
            # A flag that is a field of its own has its value in its type.
            return self._bytes(1)
        raise ValueError(f"a footer with a value of type {kind}")

    def struct(self) -> Struct:
        """Decode the fields of a struct."""
        fields: Struct = {}
        number = 0
        while head := self._data[self._at]:
            self._at += 1
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind, None if kind in (_TRUE, _FALSE) else self._value(kind)
        self._at += 1
        return fields


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _integer(number: int) -> bytes:
    return _varint((number << 1) ^ (number >> 63))


def _encoded(kind: int, value: Any) -> bytes:
    """Encode a value of that type."""
    if kind in (_I16, _I32, _I64):
        return _integer(value)
    if kind == _BINARY:
        return _varint(len(value)) + bytes(value)
    if kind == _LIST:
        inner, values = value
        size = len(values)
        head = bytes([size << 4 | inner]) if size < 15 else bytes([0xF0 | inner]) + _varint(size)
        return head + b"".join([_encoded(inner, one) for one in values])
    if kind == _STRUCT:
        return _encoded_struct(value)
    return b"" if value is None else bytes(value)


def _encoded_struct(fields: Struct) -> bytes:
    """Encode the fields of a struct, in the order of their numbers."""
    out, last = [], 0
    for number in sorted(fields):
        kind, value = fields[number]
        step = number - last
        out.append(bytes([step << 4 | kind]) if step < 16 else bytes([kind]) + _integer(number))
        out.append(_encoded(kind, value))
        last = number
    return b"".join([*out, b"\0"])


def read_footer(file: BinaryIO) -> Struct:
    """Return the footer of a Parquet file; ValueError or IndexError where it has none."""
    end = file.seek(0, 2)
    file.seek(max(0, end - 8))
    tail = file.read(8)
    size = int.from_bytes(tail[:4], "little")
    if tail[4:] != MAGIC or size > end - 12:
        raise ValueError("no Parquet file")
    file.seek(end - 8 - size)
    return _Reader(file.read(size)).struct()


class RowGroupWriter:
    """Writes a Parquet file of row groups of others, all of one schema.

    Attributes
    ----------
    rows : how many are written; crc32 : of all bytes that are written.
    """

    def __init__(self, path: Path) -> None:
        self._file, self._at, self.crc32 = path.open("wb"), 0, 0
        self._footer: Struct | None = None
        self._groups: list[Struct] = []
        self.rows = 0
        self._write(MAGIC)

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self.crc32 = zlib.crc32(data, self.crc32)
        self._at += len(data)

    def copy(self, source: BinaryIO, footer: Struct, group: int) -> None:
        """Copy a row group of another file, with its footer.

        Raises
        ------
        ValueError, KeyError, IndexError, TypeError : the footer is damaged or of another schema,
            or the row group needs bytes outside of it; the file is as it was then.
        """
        if self._footer is not None and footer[_SCHEMA] != self._footer[_SCHEMA]:
            raise ValueError("a row group of another schema")
        found: Struct = footer[_GROUPS][1][1][group]
        first, end = _extent(found)
        if not 0 < first <= end <= source.seek(0, 2):
            raise ValueError("a row group outside of its file")
        moved = _moved(found, self._at - first)
        source.seek(first)
        while first < end:
            block = source.read(min(_BLOCK, end - first))
            if not block:
                raise ValueError("a file that became shorter")
            self._write(block)
            first += len(block)
        self._footer = self._footer or {n: v for n, v in footer.items() if n != _METADATA}
        self._groups.append(moved)
        self.rows += found[_GROUP_ROWS][1]

    def close(self, empty: Struct) -> None:
        """Write the footer; nothing the second time.

        Parameters
        ----------
        empty : the footer of a file without rows, in case there is no row group.
        """
        if self._file.closed:
            return
        footer = dict(self._footer or empty)
        footer[NUM_ROWS] = _I64, self.rows
        footer[_GROUPS] = _LIST, (_STRUCT, self._groups)
        data = _encoded_struct(footer)
        self._write(data + len(data).to_bytes(4, "little") + MAGIC)
        self._file.close()


def _extent(group: Struct) -> tuple[int, int]:
    """Return the first byte of a row group and the one behind its last."""
    first, end = 2**63, 0
    for chunk in group[_COLUMNS][1][1]:
        column = chunk[_CHUNK][1]
        start = min(column[n][1] for n in (_DATA, _DICTIONARY) if n in column)
        first, end = min(first, start), max(end, start + column[_CHUNK_BYTES][1])
    return first, end


def _moved(group: Struct, by: int) -> Struct:
    """Return the description of a row group whose bytes are elsewhere."""

    def shifted(fields: Struct, *numbers: int) -> Struct:
        there = {n: (fields[n][0], fields[n][1] + by) for n in numbers if n in fields}
        return fields | there

    columns = []
    for chunk in group[_COLUMNS][1][1]:
        if _ELSEWHERE & chunk.keys():
            raise ValueError("a row group with an index")
        column = shifted(chunk[_CHUNK][1], _DATA, _DICTIONARY)
        offset = chunk[_CHUNK_OFFSET][1]
        columns.append(
            {_CHUNK_OFFSET: (_I64, offset + by if offset else 0), _CHUNK: (_STRUCT, column)}
        )
    moved = {n: value for n, value in group.items() if n != _ORDINAL}
    return shifted(moved, _GROUP_OFFSET) | {_COLUMNS: (_LIST, (_STRUCT, columns))}
