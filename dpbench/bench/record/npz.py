"""Files of arrays without Python objects, with the same bytes for the same arrays.

Arrays of a result folder are stored in one piece: ten small arrays as a zip file take milliseconds
to write or read, as much as a hundred steps of a loop.

    mark, length of the header, CRC-32 of the rest; the header, {name: [type, shape]} as JSON; the
    arrays in this order, each at a multiple of `_ALIGN` bytes
"""

import io
import json
import math
import os
import struct
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Floats
from dpbench.errors import InputError, ResultsError
from dpbench.files.regular_files import (
    open_regular_file,
    refuse_implausible_unpacked_size,
    write_bytes_atomically,
    write_file_atomically,
)

Arrays = dict[str, NDArray[Any]]
FIXED_DATE = (1980, 1, 1, 0, 0, 0)
"""The date of every member, the earliest a zip file knows; a real one would change the bytes."""
_HEAD = struct.Struct("<8sQI")
_MARK, _ALIGN = b"dpbench\1", 64
_SURROGATES = 0xD800 >> 11
LEVEL = 9
"""Level of the deflate compression. The same zlib makes the same bytes of the same array at it."""
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
    SyntaxError,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    EOFError,
    RuntimeError,
    MemoryError,
)
"""Exceptions that reading a damaged file raises, be it a zip file inside or not."""


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to a `.npz` file with reproducible bytes, whole or not at all."""
    with write_file_atomically(path) as part, zipfile.ZipFile(part, "w") as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", FIXED_DATE)
            archive.writestr(info, member.getvalue(), zipfile.ZIP_DEFLATED, LEVEL)


def write_arrays_uncompressed(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays to a file in dpbench's own uncompressed format, whole or not at all."""
    layout = {name: (array.dtype.str, array.shape) for name, array in arrays.items()}
    parts = [json.dumps(layout).encode(), *(array.tobytes() for array in arrays.values())]
    size = -(-(_HEAD.size + len(parts[0])) // _ALIGN) * _ALIGN - _HEAD.size
    padded = (array.ljust(-(-len(array) // _ALIGN) * _ALIGN, b"\0") for array in parts[1:])
    body = parts[0].ljust(size) + b"".join(padded)
    write_bytes_atomically(path, _HEAD.pack(_MARK, size, zlib.crc32(body)) + body)


def _parse_arrays(data: NDArray[np.uint8]) -> Arrays:
    """Return the arrays in the bytes of a file in dpbench's own array format, without copying."""
    _, size, check = _HEAD.unpack_from(data.data)
    if zlib.crc32(data[_HEAD.size :].data) != check:
        raise ValueError("a checksum that differs from the stored one")
    at = _HEAD.size + size
    arrays: Arrays = {}
    for name, (dtype, shape) in json.loads(data[_HEAD.size : at].tobytes()).items():
        length = math.prod(shape) * np.dtype(dtype).itemsize
        arrays[name] = data[at : at + length].view(dtype).reshape(shape)
        at += -(-length // _ALIGN) * _ALIGN
    return arrays


@contextmanager
def open_arrays(path: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """Open a file of arrays, dpbench's own or `.npz`; yield its arrays. ResultsError if damaged."""
    try:
        with open_regular_file(path, error=ResultsError) as file:
            is_own = file.read(len(_MARK)) == _MARK
            file.seek(0)
            if is_own:
                yield _parse_arrays(np.fromfile(file, np.uint8))
                return
            with zipfile.ZipFile(file) as archive:
                _list_safe_members(archive, path)
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                yield arrays
    except ResultsError:
        raise
    except (*DAMAGE, OSError) as error:
        words = f"a damaged file ({type(error).__name__}: {str(error)[:120]})"
        allowed = "the unchanged file of the run; run the suite again"
        raise ResultsError(str(path), "", words, allowed) from error


def read_arrays_and_pickles(path: Path, what: str) -> tuple[Arrays, dict[str, bytes]]:
    """Return the arrays of a `.npz` file, and its pickled objects unread; InputError if damaged."""
    arrays: Arrays = {}
    objects: dict[str, bytes] = {}
    with open_regular_file(path, what) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                for member in _list_safe_members(archive, path):
                    key = member.filename.removesuffix(".npy")
                    if _read_dtype_of_member(archive, member).hasobject:
                        objects[key] = archive.read(member)
                    else:
                        arrays[key] = _read_array_of_member(archive, member)
        except DAMAGE as error:
            if isinstance(error, InputError):
                raise
            found = f"a damaged file ({str(error)[:120]})"
            raise InputError(str(path), "", found, what) from error
        except OSError as error:
            raise InputError(str(path), "", error.strerror or "an unreadable file", what) from error
    return arrays, objects


def _list_safe_members(archive: zipfile.ZipFile, path: Path) -> list[zipfile.ZipInfo]:
    """Return the members of a zip file; InputError for unsafe sizes or compression."""
    members = archive.infolist()
    for member in members:
        # Of these alone zipfile unpacks no more than a member declares, and NumPy writes no other.
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            found = f"compression method {member.compress_type}"
            raise InputError(str(path), member.filename[:80], found, "deflate, or none")
    refuse_implausible_unpacked_size(
        path, sum(member.file_size for member in members), os.path.getsize(path)
    )
    return members


def _read_array_of_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return the array in a zip member; ValueError for trailing bytes or invalid characters."""
    with archive.open(member) as stream:
        # An array read from the stream itself: its check sum is compared at the end.
        array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        if stream.read(1):
            raise ValueError(f"{member.filename} has data after its array")
    if array.dtype.kind == "U":
        codes = array.reshape(-1).view(np.dtype("u4").newbyteorder(array.dtype.byteorder))
        # Python builds a broken text of such, and crashes when that is used.
        if ((codes > sys.maxunicode) | (codes >> 11 == _SURROGATES)).any():
            raise ValueError(f"{member.filename} has codes that are not characters")
    return array


def _read_dtype_of_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.dtype[Any]:
    """Return the type of the array in a zip member; ValueError for an untrue size."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if read is None:
            raise ValueError(f"array format {version}")
        shape, _, dtype = read(stream)
        length = member.file_size - stream.tell()
    # True is an integer for NumPy's own check, and no length of an array.
    if any(type(axis) is not int or axis < 0 for axis in shape):
        raise ValueError(f"{member.filename} of shape {shape}")
    count = math.prod(shape)
    # Texts without a character take no bytes, however many they are.
    if not dtype.hasobject and (count * dtype.itemsize != length or count > max(length, 1)):
        declared = f"{dtype} of shape {shape}"
        raise ValueError(f"{member.filename} has {length} bytes and declares {declared}")
    return dtype


def read_float_array(
    arrays: Arrays,
    where: str,
    name: str,
    shape: tuple[int, ...],
    *,
    infinite: str = "",
    nan: bool = False,
) -> Floats:
    """Return an array of `shape` as float64; InputError, naming file and array, where it is not.

    `infinite` has the signs of allowed infinities: "+", "-", "+-" or none; `nan` allows NaN.
    """
    if name not in arrays:
        raise InputError(where, name, "nothing", "an array")
    array = arrays[name]
    if array.dtype.kind not in "fiu":
        found = "text" if array.dtype.kind == "U" else f"type {array.dtype}"
        raise InputError(where, name, found, "real numbers")
    if array.shape != shape:
        raise InputError(where, name, f"shape {array.shape}", f"shape {shape}")
    numbers = np.ascontiguousarray(array, dtype=np.float64)
    bad = np.isnan(numbers) if not nan else np.zeros(shape, dtype=np.bool_)
    for sign, value in (("+", np.inf), ("-", -np.inf)):
        if sign not in infinite:
            bad |= numbers == value
    if bad.any():
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        allowed = " or ".join(["finite numbers", *(f"{sign}inf" for sign in infinite)])
        raise InputError(where, f"{name}{list(at)}", numbers[at], allowed)
    return numbers


def read_stored_text(arrays: Arrays, where: str, name: str) -> str:
    """Return the text stored as the array `name`; InputError where there is none."""
    array = arrays.get(name)
    if array is None:
        others = ", ".join(list(arrays)[:8]) or "none"
        raise InputError(
            where, name, "nothing", f"a string array of this name (the file has {others})"
        )
    if array.dtype.kind != "U" or array.shape:
        raise InputError(where, name, f"type {array.dtype}, shape {array.shape}", "a single string")
    return str(array)


def read_stored_count(
    arrays: Arrays, where: str, name: str, allowed: str = "one whole number, 0 or more"
) -> int:
    """Return the whole number (≥ 0) stored as the array `name`; InputError without one."""
    array = arrays.get(name)
    if array is None or array.dtype.kind not in "iu" or array.shape or array < 0:
        found = "nothing" if array is None else np.array2string(array, threshold=4)
        found = f"the text {found}" if found[0] in "'\"" else found
        raise InputError(where, name, found, allowed)
    return int(array)
