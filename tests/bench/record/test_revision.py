"""Commit of a run: of a checkout, of an installation, of neither."""

import importlib.metadata
import json
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from dpbench.bench.record.git_commit import (
    read_built_commit,
    read_commit,
    write_built_commit,
)
from dpbench.bench.record.machine import (
    append_revision,
    describe_machine,
    describe_revisions,
    describe_version,
    read_installed_commit,
)


def _git(folder: Path, *words: str) -> None:
    named = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", "-C", str(folder), *named, *words], check=True, capture_output=True)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "__init__.py").write_text("x = 1\n", encoding="utf-8")
    _git(tmp_path, "init", "-q")
    _git(tmp_path, "add", ".")
    _git(tmp_path, "commit", "-q", "-m", "first")
    return folder


def test_a_checkout_tells_its_commit_and_whether_it_is_clean(package: Path) -> None:
    clean = read_commit(package)
    assert clean is not None and len(clean[0]) == 40 and clean[1] is True
    (package.parent / "notes.txt").write_text("beside", encoding="utf-8")
    assert read_commit(package) == clean
    (package / "__init__.py").write_text("x = 2\n", encoding="utf-8")
    assert read_commit(package) == (clean[0], False)


def test_a_package_inside_the_checkout_of_another_is_not_of_its_commit(package: Path) -> None:
    other = package.parent / "environment"
    other.mkdir()
    (other / "__init__.py").write_text("", encoding="utf-8")
    assert read_commit(other) is None


def test_an_installer_tells_the_commit_it_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    noted: dict[str, str | None] = {"text": json.dumps({"vcs_info": {"commit_id": "ab" * 20}})}
    there = SimpleNamespace(read_text=lambda name: noted["text"])
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: there)
    assert read_installed_commit() == ("ab" * 20, True)
    noted["text"] = None
    assert read_installed_commit() is None


def test_a_folder_that_was_taken_up_again_names_all_commits() -> None:
    old, new = {"commit": "a" * 40, "clean": True}, {"commit": "b" * 40, "clean": False}
    both = append_revision([new, old], new)
    assert both == [old, new] and append_revision([], None) == []
    assert describe_revisions({"revisions": both}) == f"commit {'a' * 12}, {'b' * 12} with changes"
    assert describe_revisions({}) == ""
    assert describe_version({"harness_version": "1.2"}) == "dpbench 1.2 (commit not known)"


def test_a_wheel_keeps_the_commit_it_was_built_from(tmp_path: Path) -> None:
    assert read_built_commit(tmp_path) is None
    write_built_commit(tmp_path, "c" * 40, is_clean=False)
    assert read_built_commit(tmp_path) == ("c" * 40, False)


def test_a_machine_has_the_facts_that_libraries_choose_their_code_by() -> None:
    """Every x86 core of the last ten years has SSE 4.2, every 64-bit ARM core Advanced SIMD."""
    machine = describe_machine()
    assert {"sse4_2", "asimd"} & {*machine["vector_instructions"]}
    assert machine["cpu_family"]
