"""Writing into a folder of others stays in it, and leaves there what was not written."""

import json
import os
from pathlib import Path

import pytest

from dpbench.errors import InputError
from dpbench.files.regular_files import (
    build_path_of_written_file_list,
    create_empty_file,
    is_plain_file_name,
    make_folder_if_missing,
    rename_durably,
    write_bytes_to_file_or_pipe,
    write_file_atomically,
    write_file_set_into_folder,
    write_text_atomically,
)


def _linked(tmp_path: Path, kind: str, place: Path) -> Path:
    """A file of somebody, to which `place` is a link of that kind."""
    other = tmp_path / "thesis.txt"
    other.write_text("mine", encoding="utf-8")
    if kind == "hard":
        os.link(other, place)
    else:
        place.symlink_to(other)
    return other


@pytest.mark.parametrize("kind", ["hard", "soft"])
@pytest.mark.parametrize("linked", ["report.md", "report.md.part"])
def test_a_link_is_replaced_and_not_followed(tmp_path: Path, kind: str, linked: str) -> None:
    other = _linked(tmp_path, kind, tmp_path / linked)
    write_text_atomically(tmp_path / "report.md", "new")
    assert other.read_text("utf-8") == "mine"
    assert (tmp_path / "report.md").read_text("utf-8") == "new"
    assert not (tmp_path / "report.md").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.md", "thesis.txt"]


def test_a_link_to_nothing_makes_no_file_there(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "elsewhere")
    assert create_empty_file(tmp_path / "a").read_bytes() == b""
    assert not (tmp_path / "elsewhere").exists()


def test_a_folder_that_is_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    (tmp_path / "figures").symlink_to(tmp_path / "pictures")
    with pytest.raises(InputError, match="figures: found a link"):
        make_folder_if_missing(tmp_path / "figures")


def test_what_fails_leaves_the_old_file(tmp_path: Path) -> None:
    write_text_atomically(tmp_path / "a", "old")
    with pytest.raises(ZeroDivisionError), write_file_atomically(tmp_path / "a"):
        raise ZeroDivisionError
    (tmp_path / "folder").mkdir()
    with pytest.raises(IsADirectoryError):
        write_text_atomically(tmp_path / "folder", "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "folder"]
    assert (tmp_path / "a").read_text("utf-8") == "old"


def test_only_files_that_were_written_before_are_removed(tmp_path: Path) -> None:
    folder = tmp_path / "tables"
    write_file_set_into_folder(folder, {name: lambda: b"1" for name in ("a.csv", "b.csv", "c.csv")})
    (folder / "mine.csv").write_bytes(b"2")
    (folder / "c.csv").unlink()
    (folder / "c.csv").symlink_to(folder / "mine.csv")
    write_file_set_into_folder(folder, {"a.csv": lambda: b"3"})
    found = {path.name: path.read_bytes() for path in folder.glob("*.csv")}
    assert found == {"a.csv": b"3", "c.csv": b"2", "mine.csv": b"2"}


@pytest.mark.parametrize(
    "names", [["../thesis.txt"], ["/etc/passwd"], [1, None], {"a": 1}, ["tables"], ["x" * 9999]]
)
def test_a_list_that_others_wrote_removes_nothing_elsewhere(tmp_path: Path, names: object) -> None:
    folder = make_folder_if_missing(tmp_path / "out")
    (folder / "tables").mkdir()
    (tmp_path / "thesis.txt").write_text("mine", encoding="utf-8")
    build_path_of_written_file_list(folder).write_text(json.dumps(names), encoding="utf-8")
    write_file_set_into_folder(folder, {"a.csv": lambda: b""})
    assert (tmp_path / "thesis.txt").exists() and (folder / "tables").is_dir()
    assert json.loads(build_path_of_written_file_list(folder).read_text("utf-8")) == ["a.csv"]


@pytest.mark.parametrize(
    "name", ["../x", "a/b", "a\\b", "", ".x", "..", "a\nb", "\x1b[2J", "x" * 999]
)
def test_what_is_no_name_of_a_file(tmp_path: Path, name: str) -> None:
    assert not is_plain_file_name(name)
    with pytest.raises(InputError, match="a name without a path"):
        write_file_set_into_folder(tmp_path / "out", {"a": lambda: b"", name: lambda: b""})
    assert not (tmp_path / "out").exists()


def test_usual_names_are_names_of_files() -> None:
    for name in ("paper_active_set", "qpax-0.1", "rough (hold)", "thrusters[350:550]", "schöner"):
        assert is_plain_file_name(name)


def test_a_device_that_a_person_names_is_written_to(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes_to_file_or_pipe(pipe, b"text")
    read.append(os.read(end, 9))
    os.close(end)
    assert read == [b"text"] and pipe.is_fifo()
    other = _linked(tmp_path, "soft", tmp_path / "comparison.md")
    write_bytes_to_file_or_pipe(tmp_path / "comparison.md", b"new")
    assert other.read_text("utf-8") == "mine"


def test_what_is_put_in_its_place_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part, synced = tmp_path / "a.part", []
    part.write_bytes(b"1")
    fsync = os.fsync

    def watched(number: int) -> None:
        synced.append((os.readlink(f"/proc/self/fd/{number}"), (tmp_path / "a").exists()))
        fsync(number)

    monkeypatch.setattr(os, "fsync", watched)
    rename_durably(part, tmp_path / "a")
    assert synced == [(str(part), False), (str(tmp_path), True)]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("table.csv", "file exists"),
        ("table.csv/inside", "not a directory"),
        ("missing/inside", "no such file or directory"),
    ],
)
def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, name: str, fault: str) -> None:
    (tmp_path / "table.csv").touch()
    with pytest.raises(InputError, match=f"{name}: {fault}; required: a folder"):
        make_folder_if_missing(tmp_path / name)
