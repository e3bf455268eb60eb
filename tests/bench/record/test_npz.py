"""Arrays that are kept in one piece come back as they were, and damage is seen."""

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dpbench.bench.record.npz import (
    open_arrays,
    read_arrays_and_pickles,
    write_arrays_uncompressed,
    write_npz,
)
from dpbench.errors import InputError, ResultsError

ARRAYS = {
    "numbers": np.array([[1.5, -0.0, np.nan], [np.inf, 1e-320, 2.0]]),
    "none": np.zeros((4, 0)),
    "words": np.array(["linear", "gap", ""]),
    "flags": np.array([True, False]),
    "turned": np.arange(6.0).reshape(2, 3).T,
}


@pytest.mark.parametrize("write", [write_arrays_uncompressed, write_npz])
def test_arrays_come_back_bit_for_bit(write: Callable[..., None], tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write(path, ARRAYS)
    with open_arrays(path) as stored:
        assert list(stored) == list(ARRAYS)
        for name, array in ARRAYS.items():
            assert (stored[name].dtype, stored[name].shape) == (array.dtype, array.shape)
            assert stored[name].tobytes() == array.tobytes()
            # Kernels are compiled for arrays that can be written to.
            assert stored[name].flags.writeable
    assert [found.name for found in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.slow
def test_every_changed_byte_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_arrays_uncompressed(path, ARRAYS)
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(ResultsError), open_arrays(path):
            raise AssertionError(f"byte {at} is no damage")
        path.write_bytes(whole[:at])
        with pytest.raises(ResultsError), open_arrays(path):
            raise AssertionError(f"{at} bytes are no damage")


def npy(shape: str, data: bytes, dtype: str = "<f8") -> bytes:
    """An array as NumPy writes it, with whatever shape and type in its header."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + data


def zipped(path: Path, member: bytes, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("q.npy", member)
    return path


@pytest.mark.parametrize(
    ("member", "method", "found"),
    [
        (npy("(True, 15)", bytes(120)), zipfile.ZIP_DEFLATED, r"shape \(True, 15\)"),
        (npy("(1000000000,)", bytes(120)), zipfile.ZIP_DEFLATED, "120 bytes and declares"),
        (npy("(1000000000000,)", b"", "<U0"), zipfile.ZIP_DEFLATED, "0 bytes and declares"),
        (npy("(15,)", bytes(120)), zipfile.ZIP_LZMA, "compression method 14"),
        (npy("(15,)", bytes(120)), zipfile.ZIP_BZIP2, "compression method 12"),
        (npy("(12500000,)", bytes(10**8)), zipfile.ZIP_DEFLATED, r"unpack to 1000000\d\d"),
        (npy("(1,)", b"\xff\xff\xff\x7f", "<U1"), zipfile.ZIP_STORED, "not characters"),
        (npy("(1,)", b"\x00\xd8\x00\x00", "<U1"), zipfile.ZIP_STORED, "not characters"),
        (npy("(" * 4000, b""), zipfile.ZIP_DEFLATED, "a damaged file"),
        (npy("(1,)", bytes(8), "(,)f8"), zipfile.ZIP_DEFLATED, "a damaged file"),
    ],
)
def test_strange_arrays_are_refused(member: bytes, method: int, found: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=found) as caught:
        read_arrays_and_pickles(zipped(tmp_path / "a.npz", member, method), "a sequence")
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_member_that_unpacks_to_more_than_it_declares(tmp_path: Path) -> None:
    path = zipped(tmp_path / "a.npz", npy("(15,)", bytes(10**8)))
    head = len(npy("(15,)", b""))
    declared, less = (struct.pack("<I", head + length) for length in (10**8, 120))
    data = path.read_bytes()
    assert declared in data
    path.write_bytes(data.replace(declared, less))
    with pytest.raises(InputError, match="CRC"):
        read_arrays_and_pickles(path, "a sequence")
