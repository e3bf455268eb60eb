"""Mutations of files: bytes, tokens of texts, values of JSON, arrays, columns of tables."""

import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

EXTREMES = (0, -1, 1, 2**31, 2**63, -(2**63), 10**30, 10**400, 1e308, 1e-320, 1.5, True, False)
STRANGE = ("", "x" * 3000, "../../x", "\x00", "nan", "ä\u202e\U0001f6a2", "=1+1", "<script>")
SWAPS: tuple[Any, ...] = (*EXTREMES, *STRANGE, None, [], {}, [[]], [1, "a"], {"a": {}})
TOML_VALUES = (
    *("0", "-1", "1e308", "1e400", "nan", "inf", "-inf", "9" * 30, "9" * 5000, "0x" + "f" * 3000),
    *("true", '""', "[]", "{}", "[[]]", "{a = 1}", "1979-05-27", '"' + "x" * 3000 + '"', "1e-320"),
    *('"\\u0000"', '"../x"', "[" * 40 + "]" * 40, "a" + ".a" * 60 + " = 1", "1_000_000_000_000"),
)
_TOKEN = re.compile(r'"[^"\n]*"|[\w.+-]+|\n|[^\w\s]')
_INTEGERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1)


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """Some bytes flipped, overwritten, cut, repeated or put in."""
    # Nothing can be flipped in an empty file: something is put in.
    kind, size = rng.randrange(7) if data else 5, max(len(data), 1)
    at = rng.randrange(size)
    length = min(size - at, int(rng.expovariate(1 / 16)) + 1)
    changed = bytearray(data)
    if kind == 0:
        for _ in range(rng.randint(1, 8)):
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    elif kind == 1:
        changed[at : at + length] = bytes([rng.choice((0, 0xFF, 0x80, 0x20))]) * length
    elif kind == 2:
        del changed[at:]
    elif kind == 3:
        del changed[at : at + length]
    elif kind == 4:
        changed[at:at] = changed[at : at + length] * rng.randint(1, 4)
    elif kind == 5:
        changed[at:at] = rng.randbytes(length)
    else:
        packed = struct.pack("<I", rng.choice(_INTEGERS))
        changed[at : at + 4] = packed if rng.random() < 0.5 else packed[::-1]
    return bytes(changed)


def of_text(data: bytes, rng: random.Random, values: tuple[str, ...] = TOML_VALUES) -> bytes:
    """A token left out, repeated, exchanged with another, or replaced by a strange value."""
    if rng.random() < 0.15:
        return of_bytes(data, rng)
    text = data.decode("utf-8", errors="replace")
    spans = [match.span() for match in _TOKEN.finditer(text)]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if not spans:
            break
        (a, b), (c, d) = rng.choice(spans), rng.choice(spans)
        kind = rng.randrange(5)
        new = ("", text[a:b] * 2, text[c:d], rng.choice(values), rng.choice(values))[kind]
        text = text[:a] + new + text[b:]
        spans = [match.span() for match in _TOKEN.finditer(text)]
    return text.encode("utf-8", errors="replace")


def of_json(data: bytes, rng: random.Random) -> bytes:
    """A value of another type, an extreme one, a key left out or put in; or damaged text."""
    if rng.random() < 0.2:
        return of_text(data, rng)
    document = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        place, key = rng.choice(_places(document))
        kind = rng.randrange(8)
        if kind == 0:
            del place[key]
        elif kind == 1 and isinstance(place, dict):
            place[str(rng.choice(STRANGE))] = deepcopy(rng.choice(SWAPS))
        elif kind == 2:
            place[key] = [place[key]] * rng.randint(1, 5)
        else:
            # A copy, which later mutations of the document may change.
            place[key] = deepcopy(rng.choice(SWAPS))
        if not _places(document):
            break
    return json.dumps(document).encode()


def _places(document: Any) -> list[tuple[Any, Any]]:
    """Every value of a document as the container that holds it, and its key there."""
    inner = document.items() if isinstance(document, dict) else enumerate(document)
    found: list[tuple[Any, Any]] = []
    for key, value in list(inner):
        found.append((document, key))
        if isinstance(value, dict | list):
            found += _places(value)
    return found


def of_archive(data: bytes, rng: random.Random) -> bytes:
    """Bytes of the zip file; or, with a right check sum, those of a member, or another array."""
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(members))
    kind = rng.randrange(6)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = of_bytes(members[name], rng)
    elif kind == 2:
        members[name] = _other_header(members[name], rng)
    elif kind == 3:
        members[rng.choice((name + "x", "q.npy", "format.npy"))] = members[name]
    else:
        members[name] = _other_array(members[name], rng)
    method = rng.choices(
        (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2),
        (10, 5, 1, 1),
    )[0]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for key, content in members.items():
            archive.writestr(zipfile.ZipInfo(key), content, method)
    return packed.getvalue()


def _other_header(member: bytes, rng: random.Random) -> bytes:
    """An .npy file whose header says something else."""
    size = 10 + struct.unpack_from("<H", member, 8)[0]
    values = (
        "True",
        "(",
        "9" * 12,
        "-1",
        "'|O'",
        "'<U0'",
        "'<f2'",
        "(1, 2)",
        "None",
        "[('a','<f8')]",
    )
    header = of_text(member[10:size], rng, values)
    return member[:8] + struct.pack("<H", len(header) & 0xFFFF) + header + member[size:]


def _other_array(member: bytes, rng: random.Random) -> bytes:
    """An .npy file with an array of another type, shape or content."""
    array = np.load(io.BytesIO(member), allow_pickle=False)
    kind = rng.randrange(6)
    if kind == 0 and array.dtype.kind in "fiu" and array.size:
        array = array.copy()
        values = (np.nan, np.inf, -np.inf, 1e308, 1e-320, -1.0, 0.0, 9e15)
        with np.errstate(all="ignore"):
            array.flat[rng.randrange(array.size)] = np.array(rng.choice(values)).astype(array.dtype)
    elif kind == 1:
        array = array.reshape(rng.choice(((-1,), (1, -1), (-1, 1), (1, *array.shape))))
    elif kind == 2 and array.ndim:
        array = array[: rng.randrange(len(array) + 1)]
    elif kind == 3 and array.dtype.kind != "U":
        with np.errstate(all="ignore"):
            array = array.astype(rng.choice(("<f4", ">f8", "<i8", "<c16", "<U3", "?", "<u1")))
    elif kind == 4 and array.dtype.kind == "U" and not array.ndim:
        text = of_text(str(array).encode(), rng).decode(errors="replace")
        array = np.array(text.rstrip("\0") or "x")
    else:
        array = np.zeros(rng.choice(((), (0,), (0, 3), (3, 0), (2, 2, 2), (1000,))))
    packed = io.BytesIO()
    np.lib.format.write_array(packed, array, allow_pickle=False)
    return packed.getvalue()


def of_part(data: bytes, rng: random.Random) -> bytes:
    """Bytes of a part of cells, or values of its rows."""
    if rng.random() < 0.5:
        return of_bytes(data, rng)
    table = pq.read_table(io.BytesIO(data), use_threads=False)
    metadata = pq.read_metadata(io.BytesIO(data)).metadata
    packed = io.BytesIO()
    rows = of_json(metadata[b"runs"], rng).decode("utf-8", errors="replace")
    pq.write_table(table.replace_schema_metadata({"runs": rows}), packed, compression="zstd")
    return packed.getvalue()


def of_table(data: bytes, rng: random.Random) -> bytes:
    """Bytes of a Parquet file; or values of a column, its type or name, rows left out or twice."""
    if rng.random() < 0.5:
        return of_bytes(data, rng)
    table = pq.read_table(io.BytesIO(data), use_threads=False)
    at = rng.randrange(table.num_columns)
    name, column = table.column_names[at], table.column(at)
    change: Callable[[], pa.Table] = rng.choice(
        (
            lambda: table.remove_column(at),
            lambda: table.set_column(at, name + "x", column),
            lambda: table.slice(0, rng.randrange(table.num_rows + 1)),
            lambda: pa.concat_tables([table, table]),
            lambda: table.set_column(at, name, _other_type(column, rng)),
            *3 * (lambda: table.set_column(at, name, _other_values(column, rng)),),
        )
    )
    packed = io.BytesIO()
    pq.write_table(change(), packed, compression="zstd")
    return packed.getvalue()


def _other_type(column: pa.ChunkedArray, rng: random.Random) -> pa.Array:
    kind = rng.choice((pa.string(), pa.float64(), pa.int64(), pa.bool_(), pa.list_(pa.int8())))
    if pa.types.is_list(kind):
        return pa.array([[1]] * len(column), kind)
    flags = [bool(i % 2) for i in range(len(column))]
    return pa.array(map(str, flags), kind) if kind == pa.string() else pa.array(flags).cast(kind)


def _other_values(column: pa.ChunkedArray, rng: random.Random) -> pa.Array:
    """The same column with one value, or all, replaced."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    values = column.to_pylist()
    numbers = (0, -1, 1, 2**31, 2**62, None)
    new: Any = None
    if pa.types.is_floating(kind):
        new = rng.choice((0.0, -1.0, 1e308, float("nan"), float("inf"), -float("inf"), None))
    elif pa.types.is_integer(kind):
        new = rng.choice(numbers[:3] if kind.bit_width < 64 else numbers)
    elif pa.types.is_boolean(kind):
        new = rng.choice((True, False, None))
    elif values:
        old = str(rng.choice(values))
        new = rng.choice((*STRANGE, "{}", "[]", "null", None, *3 * (_damaged(old, rng),)))
    where = range(len(values)) if rng.random() < 0.5 else [rng.randrange(max(len(values), 1))]
    for i in where:
        if i < len(values):
            values[i] = new
    return pa.array(values, kind)


def _damaged(text: str, rng: random.Random) -> str:
    """A description of a cell with other values; any other text with other letters."""
    if text.startswith("{"):
        return of_json(text.encode(), rng).decode(errors="replace")
    return of_text(text.encode(), rng).decode(errors="replace")
