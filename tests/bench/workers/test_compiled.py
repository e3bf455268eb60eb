"""Whether the kernels were compiled before."""

from pathlib import Path

import pytest

from dpbench.bench.workers.child import is_compiled


def test_an_empty_cache_is_told_from_one_with_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the index files that Numba leaves."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not is_compiled()
    (tmp_path / "kernel").mkdir()
    (tmp_path / "kernel" / "advance-69.py311.nbi").touch()
    assert is_compiled()
