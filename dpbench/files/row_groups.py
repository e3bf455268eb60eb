"""Row groups of Parquet files joined to one file, byte for byte: nothing is decoded.

A row group is a stretch of bytes that the footer describes by offsets. It is copied, and its
description with offsets of the new place. The footer is a struct of Thrift's compact protocol
(https://github.com/apache/thrift, thrift-compact-protocol.md; parquet-format, parquet.thrift).
"""

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

MAGIC = b"PAR1"
_BLOCK = 2**20
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_INTEGERS = (_I16, _I32, _I64)
# Numbers of fields in parquet.thrift.
_SCHEMA, _NUM_ROWS, _GROUPS, _METADATA = 2, 3, 4, 5
_COLUMNS, _GROUP_ROWS, _GROUP_OFFSET, _ORDINAL = 1, 3, 5, 7
_CHUNK_OFFSET, _CHUNK = 2, 3
_SIZE, _DATA, _DICTIONARY = 7, 9, 11
_ELSEWHERE = frozenset({1, 4, 5, 6, 7, 8, 9})
"""Fields of a column chunk about bytes outside of its row group."""

Spec = dict[int, Any]
"""Fields of a struct that are decoded: `int`, a `Spec` of the struct in it, or a list of one for a
list of structs. All others are only found."""
_COLUMN_SPEC: Spec = {_CHUNK_OFFSET: int, _CHUNK: {_SIZE: int, _DATA: int, _DICTIONARY: int}}
_GROUP_SPEC: Spec = {_COLUMNS: [_COLUMN_SPEC], _GROUP_ROWS: int, _GROUP_OFFSET: int}
_FOOTER_SPEC: Spec = {_NUM_ROWS: int, _GROUPS: [_GROUP_SPEC]}


class Field(NamedTuple):
    """A field of a Parquet file's binary footer: byte positions, type and decoded value."""

    head: int
    begin: int
    end: int
    kind: int
    value: Any


Struct = dict[int, Field]  # Fields by their numbers


@dataclass(frozen=True, eq=False)
class Footer:
    """Bytes and decoded fields of a Parquet file's footer."""

    data: bytes
    fields: Struct

    @property
    def row_count(self) -> int:
        """Number of table rows in the Parquet file."""
        return int(self.fields[_NUM_ROWS].value)

    @property
    def row_groups(self) -> list[tuple[int, Struct, int]]:
        """Descriptions of the Parquet file's row groups: first byte, fields and end of each."""
        groups: list[tuple[int, Struct, int]] = self.fields[_GROUPS].value
        return groups

    def raw_field_bytes(self, number: int) -> bytes:
        """Return the undecoded bytes of a field of a Parquet footer, given its number."""
        field = self.fields[number]
        return self.data[field.begin : field.end]


def read_parquet_footer(file: BinaryIO) -> Footer:
    """Read the footer of a Parquet file; ValueError, KeyError or IndexError if damaged."""
    end = file.seek(0, 2)
    file.seek(max(0, end - 8))
    tail = file.read(8)
    size = int.from_bytes(tail[:4], "little")
    if tail[4:] != MAGIC or size > end - 12:
        raise ValueError("not a Parquet file")
    file.seek(end - 8 - size)
    data = file.read(size)
    return Footer(data, _decode_struct_and_end(data, 0, _FOOTER_SPEC)[0])


def _decode_varint_and_end(data: bytes, at: int) -> tuple[int, int]:
    """Decode an unsigned variable-length integer; return it and the position after it."""
    result = shift = 0
    while (byte := data[at]) > 0x7F:
        result |= (byte & 0x7F) << shift
        shift, at = shift + 7, at + 1
    return result | byte << shift, at + 1


def _decode_signed_varint_and_end(data: bytes, at: int) -> tuple[int, int]:
    """Decode a signed variable-length integer; return it and the position after it."""
    number, at = _decode_varint_and_end(data, at)
    return (number >> 1) ^ -(number & 1), at


def _decode_list_size_type_and_start(data: bytes, at: int) -> tuple[int, int, int]:
    """Decode a list header of a Parquet footer: size, item type, position of the first item."""
    size, kind = data[at] >> 4, data[at] & 15
    if size < 15:
        return size, kind, at + 1
    size, at = _decode_varint_and_end(data, at + 1)
    return size, kind, at


def _find_end_of_encoded_value(data: bytes, at: int, kind: int) -> int:
    """Return the position after a value in a Parquet footer, without decoding it."""
    if kind in _INTEGERS:
        while data[at] > 0x7F:
            at += 1
        return at + 1
    if kind == _BINARY:
        size, at = _decode_varint_and_end(data, at)
        return at + size
    if kind == _LIST:
        size, inner, at = _decode_list_size_type_and_start(data, at)
        for _ in range(size):
            at = at + 1 if inner in (_TRUE, _FALSE) else _find_end_of_encoded_value(data, at, inner)
        return at
    if kind == _STRUCT:
        while head := data[at]:
            at = at + 1 if head >> 4 else _decode_varint_and_end(data, at + 1)[1]
            at = _find_end_of_encoded_value(data, at, head & 15)
        return at + 1
    # A flag that is a field of its own has its value in its type.
    sizes = {_TRUE: 0, _FALSE: 0, _BYTE: 1, _DOUBLE: 8}
    return at + sizes[kind]


def _decode_struct_and_end(data: bytes, at: int, spec: Spec) -> tuple[Struct, int]:
    """Decode selected fields of a structure in a Parquet footer; return them and its end."""
    fields: Struct = {}
    number = 0
    while byte := data[at]:
        head = at
        number, at = (
            (number + (byte >> 4), at + 1)
            if byte >> 4
            else _decode_signed_varint_and_end(data, at + 1)
        )
        kind, begin, inner = byte & 15, at, spec.get(number)
        value: Any = None
        if inner is None:
            at = _find_end_of_encoded_value(data, at, kind)
        elif kind in _INTEGERS and inner is int:
            value, at = _decode_signed_varint_and_end(data, at)
        elif kind == _STRUCT and isinstance(inner, dict):
            value, at = _decode_struct_and_end(data, at, inner)
        elif kind == _LIST and isinstance(inner, list):
            value, at = _decode_struct_list_and_end(data, at, inner[0])
        else:
            raise ValueError(f"a footer with field {number} of type {kind}")
        fields[number] = Field(head, begin, at, kind, value)
    return fields, at + 1


def _decode_struct_list_and_end(
    data: bytes, at: int, spec: Spec
) -> tuple[list[tuple[int, Struct, int]], int]:
    """Decode a list of structures in a Parquet footer; return each with its range, and the end."""
    size, kind, at = _decode_list_size_type_and_start(data, at)
    if size and kind != _STRUCT:
        raise ValueError("a footer with a list of another type")
    found = []
    for _ in range(size):
        fields, end = _decode_struct_and_end(data, at, spec)
        found.append((at, fields, end))
        at = end
    return found, at


def _encode_varint(number: int) -> bytes:
    """Encode an unsigned integer in a variable number of bytes, as Parquet footers have it."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def _encode_signed_varint(number: int) -> bytes:
    """Encode a signed integer in a variable number of bytes, as Parquet footers have it."""
    return _encode_varint((number << 1) ^ (number >> 63))


def _encode_row_group_with_shifted_offsets(
    data: bytes, group: tuple[int, Struct, int], by: int
) -> bytes:
    """Return the footer bytes of a Parquet row group with its file offsets shifted."""
    begin, fields, end = group
    changed = [fields[_GROUP_OFFSET]] if _GROUP_OFFSET in fields else []
    for _, chunk, _ in fields[_COLUMNS].value:
        # Some writers leave the offset of the chunk itself 0.
        changed += [chunk[_CHUNK_OFFSET]] if chunk[_CHUNK_OFFSET].value else []
        column = chunk[_CHUNK].value
        changed += [column[number] for number in (_DATA, _DICTIONARY) if number in column]
    out = []
    for field in sorted(changed):
        out += [data[begin : field.begin], _encode_signed_varint(field.value + by)]
        begin = field.end
    if _ORDINAL in fields:
        # The number of the row group in its file, the last field; readers do without it.
        out.append(data[begin : fields[_ORDINAL].head])
        begin = fields[_ORDINAL].end
    return b"".join([*out, data[begin:end]])


def _row_group_byte_range(group: Struct) -> tuple[int, int]:
    """Return the first byte of a row group in its Parquet file, and the one after its last."""
    first, end = 2**63, 0
    for _, chunk, _ in group[_COLUMNS].value:
        if _ELSEWHERE & chunk.keys():
            raise ValueError("a row group with an index")
        column = chunk[_CHUNK].value
        start = min(column[number].value for number in (_DATA, _DICTIONARY) if number in column)
        first, end = min(first, start), max(end, start + column[_SIZE].value)
    return first, end


class RowGroupWriter:
    """Writer of one Parquet file from row groups of others; crc32 : of all bytes written."""

    def __init__(self, path: Path) -> None:
        self._file, self._at, self.crc32 = path.open("wb"), 0, 0
        self._footer: Footer | None = None
        self._groups: list[bytes] = []
        self.rows = 0
        self._append_bytes_to_file(MAGIC)

    def _append_bytes_to_file(self, data: bytes) -> None:
        """Write bytes to the Parquet file; update its checksum and length."""
        self._file.write(data)
        self.crc32 = zlib.crc32(data, self.crc32)
        self._at += len(data)

    def copy_row_group(self, source: BinaryIO, footer: Footer, index: int) -> None:
        """Append another Parquet file's row group undecoded; ValueError or LookupError if bad."""
        first_footer = self._footer or footer
        if footer.raw_field_bytes(_SCHEMA) != first_footer.raw_field_bytes(_SCHEMA):
            raise ValueError("a row group of another schema")
        group = footer.row_groups[index]
        rows = group[1][_GROUP_ROWS].value
        if rows == 0:
            # Arrow writes one without bytes for a table without rows.
            return
        first, end = _row_group_byte_range(group[1])
        if not 0 < first <= end <= source.seek(0, 2):
            raise ValueError("a row group outside of its file")
        moved = _encode_row_group_with_shifted_offsets(footer.data, group, self._at - first)
        source.seek(first)
        while first < end:
            block = source.read(min(_BLOCK, end - first))
            if not block:
                raise ValueError("a file that became shorter")
            self._append_bytes_to_file(block)
            first += len(block)
        self._footer = first_footer
        self._groups.append(moved)
        self.rows += rows

    def write_footer_and_close(self, empty: Footer) -> None:
        """Write the Parquet footer, that of `empty` if no rows were copied, and close the file."""
        if self._file.closed:
            return
        footer, size = self._footer or empty, len(self._groups)
        head = bytes([size << 4 | _STRUCT]) if size < 15 else bytes([0xFC]) + _encode_varint(size)
        values = {
            _NUM_ROWS: _encode_signed_varint(self.rows),
            _GROUPS: b"".join([head, *self._groups]),
        }
        out, last = [], 0
        for number, field in footer.fields.items():
            if number != _METADATA:
                value = values.get(number, footer.raw_field_bytes(number))
                out += [bytes([(number - last) << 4 | field.kind]), value]
                last = number
        data = b"".join([*out, b"\0"])
        self._append_bytes_to_file(data + len(data).to_bytes(4, "little") + MAGIC)
        self._file.close()
