"""Finding and reading problem files: names, paths, and files that cannot be read."""

from pathlib import Path

import pytest

from dpbench.errors import InputError, UnknownNameError
from dpbench.scenario.problem_files import (
    FileModel,
    find_folder_of_shipped_problems,
    find_problem_path,
    list_shipped_problem_names,
    read_toml_as_dict,
    resolve_sequence_path,
    validate_settings_as_model,
)


class Inner(FileModel):
    """A table."""

    depth_m: float
    draught_m: float = 6.0


class Outer(FileModel):
    """A document with tables, one of them optional."""

    title: str
    inner: Inner
    other: Inner | None = None


GOOD = {"title": "t", "inner": {"depth_m": 3.0}}


@pytest.mark.parametrize("kind", ["vessels", "scenarios", "suites"])
def test_every_shipped_name_leads_to_its_file(kind: str) -> None:
    names = list_shipped_problem_names(kind)
    assert names
    assert names == sorted(names)
    for name in names:
        path = find_problem_path(kind, name)
        assert path == find_folder_of_shipped_problems() / kind / f"{name}.toml"
        assert read_toml_as_dict(path)["title"]


def test_a_path_is_taken_beside_the_file_that_names_it_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside, here = tmp_path / "beside", tmp_path / "here"
    for folder in (beside, here):
        folder.mkdir()
        (folder / "ship.toml").write_text("", encoding="utf-8")
    (here / "only.toml").write_text("", encoding="utf-8")
    monkeypatch.chdir(here)
    assert find_problem_path("vessels", "ship.toml", beside) == beside / "ship.toml"
    assert find_problem_path("vessels", "ship.toml").resolve() == here / "ship.toml"
    assert find_problem_path("vessels", "only.toml", beside).resolve() == here / "only.toml"
    assert find_problem_path("vessels", beside / "ship.toml", here) == beside / "ship.toml"


def test_a_name_never_means_a_file_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "paper").write_text("x = 1", encoding="utf-8")
    (tmp_path / "paper.toml").write_text("x = 1", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert (
        find_problem_path("scenarios", "paper")
        == find_folder_of_shipped_problems() / "scenarios" / "paper.toml"
    )


@pytest.mark.parametrize("content", ["nothing", "folder"])
def test_a_path_without_a_file_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "ship.toml"
    if content == "folder":
        path.mkdir()
    found = "found a folder" if content == "folder" else "no such file"
    with pytest.raises(InputError, match=f"{path}: {found}; .* vessel file in TOML"):
        find_problem_path("vessels", path)


def test_a_folder_of_the_right_name_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_toml_as_dict(tmp_path)
    assert caught.value.where == str(tmp_path)
    assert caught.value.found
    assert caught.value.allowed == "a readable file"


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"a = = 1", "line 1, column 5"),
        (b"a = 1\na = 2\n", "overwrite a value"),
        (b'title = "\xff\xfe"', "0xff"),
        ('title = "é"'.encode("latin-1"), "0xe9"),
        (b"\x00", "line 1"),
        (b"PAR1\x15\x04", "line 1"),
    ],
    ids=["syntax", "key twice", "not UTF-8", "Latin-1", "zero byte", "another format"],
)
def test_a_file_that_is_no_toml_is_told_with_the_place(
    tmp_path: Path, content: bytes, found: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml_as_dict(path)
    assert caught.value.where == str(path)
    assert found in str(caught.value.found)
    assert caught.value.allowed == "a TOML document in UTF-8"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("document", "key", "found", "allowed"),
    [
        ({**GOOD, "titel": "t"}, "titel", "an unknown key", "one of title, inner, other"),
        ({"titel": "t", "inner": {"depth_m": 3.0}}, "titel", "an unknown key", "title"),
        ({**GOOD, "other": {"depth_m": 3.0, "x": 5}}, "other.x", "unknown", "depth_m, draught_m"),
        ({**GOOD, "inner": {}}, "inner.depth_m", "nothing", "a number"),
        ({**GOOD, "inner": 3}, "inner", "3", "a table"),
        ({**GOOD, "inner": {"depth_m": float("nan")}}, "inner.depth_m", "nan", "finite number"),
        ({**GOOD, "title": 3}, "title", "3", "text"),
    ],
)
def test_a_document_that_does_not_fit_names_key_found_and_allowed(
    document: dict[str, object], key: str, found: str, allowed: str
) -> None:
    with pytest.raises(InputError) as caught:
        validate_settings_as_model(document, Outer, "file.toml")
    error = caught.value
    assert (error.where, error.key) == ("file.toml", key)
    assert found in str(error.found)
    assert allowed in error.allowed


def test_a_whole_number_may_stand_for_a_real_one() -> None:
    """TOML's 3 and 3.0 are the same length."""
    assert (
        validate_settings_as_model(
            {"title": "t", "inner": {"depth_m": 3}}, Outer, "f"
        ).inner.depth_m
        == 3.0
    )


@pytest.mark.parametrize("name", ["supplyfs99", "nothing like it"])
def test_an_unknown_name_lists_what_there_is(name: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        find_problem_path("vessels", name)
    assert (
        caught.value.allowed
        == f"one of {', '.join(list_shipped_problem_names('vessels'))}; or a .toml path"
    )


def test_a_sequence_is_a_stored_name_or_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside, here = tmp_path / "beside", tmp_path / "here"
    for folder in (beside / "robot", here / "robot", here / "paper-30-5", here / "mine"):
        folder.mkdir(parents=True)
    monkeypatch.chdir(here)
    stored = find_folder_of_shipped_problems() / "sequences" / "paper-30-5.npz"
    assert (
        resolve_sequence_path("paper-30-5") == resolve_sequence_path("paper-30-5", beside) == stored
    )
    assert resolve_sequence_path("robot", beside) == beside / "robot"
    assert resolve_sequence_path("mine", beside).resolve() == here / "mine"
    assert resolve_sequence_path("no/such") == Path("no/such")
    listing = r"more: `list_sequences\(\)`; or a \.npz, \.json or \.mat path"
    for name, near in (("paper-30-6", "allowed: paper-30-5, .*"), ("x" * 300, "")):
        with pytest.raises(UnknownNameError, match=near + listing):
            resolve_sequence_path(name)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a" + ".a" * 50_000 + " = 1", "line 1: found a key of more than 32 parts"),
        ('\n\n["a"' + ' . "b"' * 50_000 + "]", "line 3: found a key of more than 32 parts"),
        ("x = {a" + ".'a'" * 50_000 + " = 1}", "line 1: found a key"),
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "[" * 50 + "]" * 50, "nested too deeply; allowed: at most 32 levels"),
        ("a = " + "9" * 5000, "invalid TOML"),
        ("[[a]]\nb = [0x" + "f" * 5000 + "]", "an integer of more than 300 digits"),
        ("a = 1\n" * 300_000, "1800000 bytes; allowed: a readable file of at most 1048576 bytes"),
    ],
    ids=["key", "header", "inline", "brackets", "levels", "digits", "hexadecimal", "size"],
)
def test_what_a_parser_would_choke_on_is_refused(text: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "ship.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_toml_as_dict(path)
    assert found in str(caught.value) and "\n" not in str(caught.value)


def test_dots_that_join_no_key_are_read(tmp_path: Path) -> None:
    key = ".".join("a" * 31)
    numbers = ", ".join(["0.1"] * 100)
    text = f'remark = "{"Yes. No. " * 10}"\nrow = [{numbers}]\n{key} = 1\n# {"... " * 99}\n'
    path = tmp_path / "ship.toml"
    path.write_text(text, encoding="utf-8")
    document = read_toml_as_dict(path)
    assert document["row"] == [0.1] * 100 and document["remark"].count("Yes") == 10
