"""What a campaign's solvers need compiled, and whether it was compiled before."""

from pathlib import Path

import numba
import pytest

from dpbench.bench.workers.child import LOOP, OWN, list_kernel_modules, list_uncompiled_modules


def test_kernels_of_own_solvers_are_needed_only_where_one_of_them_runs() -> None:
    assert list_kernel_modules(["daqp", "unconstrained_clipped"]) == [LOOP]
    assert list_kernel_modules(["daqp", "hildreth"]) == [OWN, LOOP]
    assert list_kernel_modules(["paper_active_set"]) == [OWN, LOOP]


def test_an_empty_cache_is_recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert list_uncompiled_modules([OWN, LOOP]) == [OWN, LOOP]
    (tmp_path / "kernel").mkdir()
    (tmp_path / "kernel" / "replay._reference_kernel-26.py311.nbi").touch()
    assert list_uncompiled_modules([OWN, LOOP]) == [OWN]
    (
        tmp_path / "kernel" / "hildreth._compile_entry_point.locals.hildreth_step-177.py311.nbi"
    ).touch()
    assert list_uncompiled_modules([OWN, LOOP]) == []
