"""Arrays that are kept in one piece come back as they were, and damage is seen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dpbench.bench.record.npz import keep, kept, write_npz
from dpbench.errors import ResultsError

ARRAYS = {
    "numbers": np.array([[1.5, -0.0, np.nan], [np.inf, 1e-320, 2.0]]),
    "none": np.zeros((4, 0)),
    "words": np.array(["linear", "gap", ""]),
    "flags": np.array([True, False]),
    "turned": np.arange(6.0).reshape(2, 3).T,
}


@pytest.mark.parametrize("write", [keep, write_npz])
def test_arrays_come_back_bit_for_bit(write: Callable[..., None], tmp_path: Path) -> None:
    """Of every type and shape, in one piece or in a zip file, and nothing else is left."""
    path = tmp_path / "a.npz"
    write(path, ARRAYS)
    with kept(path) as stored:
        assert list(stored) == list(ARRAYS)
        for name, array in ARRAYS.items():
            assert (stored[name].dtype, stored[name].shape) == (array.dtype, array.shape)
            assert stored[name].tobytes() == array.tobytes()
            # Kernels are compiled for arrays that can be written to.
            assert stored[name].flags.writeable
    assert [found.name for found in tmp_path.iterdir()] == ["a.npz"]


def test_every_changed_byte_is_seen(tmp_path: Path) -> None:
    """Wherever it is, and wherever the file ends."""
    path = tmp_path / "a.npz"
    keep(path, ARRAYS)
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(ResultsError), kept(path):
            raise AssertionError(f"byte {at} is no damage")
        path.write_bytes(whole[:at])
        with pytest.raises(ResultsError), kept(path):
            raise AssertionError(f"{at} bytes are no damage")
