"""Files of arrays (`.npz`) that hold no Python objects, and the same bytes for the same arrays.

What a campaign keeps for itself, it keeps in one piece: a zip file of ten small arrays takes
milliseconds to write or read, as much as a hundred steps of a loop.

    mark, length of the header, CRC-32 of all behind it; the header, {name: [type, shape]} as JSON;
    the arrays in this order, each from a multiple of `_ALIGN` bytes on
"""

from __future__ import annotations

import io
import json
import math
import struct
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
from dpbench.files.writing import replaced, write_bytes

Arrays = dict[str, NDArray[Any]]
FIXED_DATE = (1980, 1, 1, 0, 0, 0)
"""The date of every member, the earliest a zip file knows; a real one would change the bytes."""
_HEAD = struct.Struct("<8sQI")
_MARK, _ALIGN = b"dpbench\1", 64
LEVEL = 9
"""Of the deflate compression. The same zlib makes the same bytes of the same array at it."""
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
)
"""What reading a damaged file raises, be it a zip file inside or not."""


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays to `path` in their order, compressed, whole or not at all."""
    with replaced(path) as part, zipfile.ZipFile(part, "w") as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", FIXED_DATE)
            archive.writestr(info, member.getvalue(), zipfile.ZIP_DEFLATED, LEVEL)


def keep(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays into a result folder, in one piece: whole or not at all."""
    layout = {name: (array.dtype.str, array.shape) for name, array in arrays.items()}
    parts = [json.dumps(layout).encode(), *(array.tobytes() for array in arrays.values())]
    size = -(-(_HEAD.size + len(parts[0])) // _ALIGN) * _ALIGN - _HEAD.size
    body = parts[0].ljust(size) + b"".join(_padded(array) for array in parts[1:])
    write_bytes(path, _HEAD.pack(_MARK, size, zlib.crc32(body)) + body)


def _padded(array: bytes) -> bytes:
    return array.ljust(-(-len(array) // _ALIGN) * _ALIGN, b"\0")


def _in_one_piece(data: NDArray[np.uint8]) -> Arrays:
    """The arrays of a file that `keep` wrote, as parts of `data`."""
    _, size, check = _HEAD.unpack_from(data.data)
    if zlib.crc32(data[_HEAD.size :].data) != check:
        raise ValueError("another check sum than it was written with")
    at = _HEAD.size + size
    arrays: Arrays = {}
    for name, (dtype, shape) in json.loads(data[_HEAD.size : at].tobytes()).items():
        length = math.prod(shape) * np.dtype(dtype).itemsize
        arrays[name] = data[at : at + length].view(dtype).reshape(shape)
        at += -(-length // _ALIGN) * _ALIGN
    return arrays


@contextmanager
def kept(path: Path) -> Iterator[Mapping[str, NDArray[Any]]]:
    """The arrays that `keep` wrote, or those of a zip file, each read when it is asked for.

    Raises
    ------
    ResultsError : the file is damaged, or gone; also for what the block misses in it.
    """
    try:
        with path.open("rb") as file:
            is_own = file.read(len(_MARK)) == _MARK
            file.seek(0)
            if is_own:
                yield _in_one_piece(np.fromfile(file, np.uint8))
                return
            with np.load(file, allow_pickle=False) as arrays:
                yield arrays
    except (*DAMAGE, OSError, KeyError, IndexError) as error:
        words = f"a damaged file ({type(error).__name__}: {str(error)[:120]})"
        allowed = "what the campaign wrote there; run again"
        raise ResultsError(str(path), "", words, allowed) from error


def read_npz(path: Path, what: str) -> tuple[Arrays, dict[str, bytes]]:
    """The arrays of `path`, and the bytes of members that hold Python objects, which stay packed.

    Parameters
    ----------
    what : what the file should be, for the error's words.

    Raises
    ------
    InputError : when it cannot be read or is damaged.
    """
    where = str(path)
    arrays: Arrays = {}
    objects: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                with archive.open(name) as member:
                    header = _header(member)
                key = name.removesuffix(".npy")
                if header.hasobject:
                    objects[key] = archive.read(name)
                    continue
                with archive.open(name) as member:
                    # An array read from the stream itself: its check sum is compared at the end.
                    arrays[key] = np.lib.format.read_array(member, allow_pickle=False)
                    if member.read(1):
                        raise ValueError(f"{name} goes on after its array")
    except DAMAGE as error:
        found = f"a damaged file ({str(error)[:120]})"
        raise InputError(where, "", found, what) from error
    except OSError as error:
        raise InputError(where, "", error.strerror or "unreadable", what) from error
    return arrays, objects


def _header(member: Any) -> np.dtype[Any]:
    """The type of the array in an open member."""
    version = np.lib.format.read_magic(member)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"array format {version}")
    dtype: np.dtype[Any] = read(member)[2]
    return dtype


def float_array(
    arrays: Arrays,
    where: str,
    name: str,
    shape: tuple[int, ...],
    *,
    infinite: str = "",
    nan: bool = False,
) -> Floats:
    """The array `name` as float64.

    Parameters
    ----------
    where : the file it is from; shape : what it must have.
    infinite : which infinities it may hold: "+", "-", "+-" or none.
    nan : whether it may hold NaN.

    Raises
    ------
    InputError : naming file, array, what was found and what is allowed.
    """
    if name not in arrays:
        raise InputError(where, name, "nothing", "this array is required")
    array = arrays[name]
    if array.dtype.kind not in "fiu":
        raise InputError(where, name, f"type {array.dtype}", "real numbers")
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


def text_of(arrays: Arrays, where: str, name: str) -> str:
    """The text `name`; InputError when it is missing or none."""
    array = arrays.get(name)
    if array is None:
        others = ", ".join(list(arrays)[:8]) or "none"
        raise InputError(where, name, f"nothing (arrays: {others})", "this text is required")
    if array.dtype.kind != "U" or array.shape:
        raise InputError(where, name, f"type {array.dtype}, shape {array.shape}", "one text")
    return str(array)


def count_of(arrays: Arrays, where: str, name: str) -> int:
    """The whole number `name`, 0 or more; InputError when it is missing or none."""
    array = arrays.get(name)
    if array is None or array.dtype.kind not in "iu" or array.shape or array < 0:
        found = "nothing" if array is None else np.array2string(array, threshold=4)
        raise InputError(where, name, found, "one whole number, 0 or more")
    return int(array)
