"""Faults of a recipe, a setting or a source, each in one line."""

import hashlib
import io
import tarfile
from pathlib import Path

import pytest

from dpbench.embedded import recipe
from dpbench.embedded.recipe import Recipe, fetch_sources, find_recipes, select_recipes
from dpbench.errors import InputError, SituationError, UnknownNameError

TEXT = 'solver = "mine"\nlicence = "MIT"\norigin = "here"\nstart = "none"\ntuned = "nothing"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("solver = ", r"recipe.toml: found invalid TOML"),
        ('solver = "mine"', r"recipe.toml: licence: missing; required: text"),
        (f"{TEXT}other = 1\n", r"recipe.toml: other: found an unknown key; allowed: "),
        (
            f'{TEXT}[package]\nname = "x"\nversion = "1"\nsha256 = "0"\n',
            r"recipe.toml: package.sha256: found '0'; allowed: 64 hexadecimal digits",
        ),
        (TEXT, r"shim.c: no such file"),
    ],
)
def test_a_bad_recipe(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "recipe.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        Recipe(tmp_path)


def test_a_recipe_of_a_users_own(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text(TEXT)
    (tmp_path / "shim.c").write_text("")
    assert {"mine", "daqp"} <= set(find_recipes([tmp_path]))
    with pytest.raises(UnknownNameError, match=r"--solver: found 'mine'; allowed: .*, quadprog"):
        select_recipes(["mine"])
    with pytest.raises(
        InputError,
        match=r"osqp: sigma: found an option that its build recipe does not have; .*one of eps_abs",
    ):
        select_recipes(["osqp"])[0].with_settings({"sigma": 1})


def test_a_recipe_whose_generator_is_not_installed(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text(f'{TEXT}requires = ["no_such_package", "numpy"]\n')
    (tmp_path / "shim.c").write_text("")
    (recipe,) = select_recipes(["mine"], [tmp_path])
    assert recipe.missing == "not installed; run `pip install no_such_package`"
    assert recipe.solver not in {other.solver for other in select_recipes([], [tmp_path])}


def test_a_recipe_whose_sources_are_in_a_folder_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text(f'{TEXT}folder = "the sources"\nsources = ["x*.c"]\n')
    (tmp_path / "shim.c").write_text("")
    (recipe,) = select_recipes(["mine"], [tmp_path])
    assert recipe.missing == "add --source mine=DIR, a folder with the sources"
    (given,) = select_recipes(["mine"], [tmp_path], {"mine": tmp_path / "own"})
    assert (given.missing, given.source) == ("", tmp_path / "own")
    with pytest.raises(UnknownNameError, match=r"--source: found 'other'; allowed: "):
        select_recipes([], [], {"other": tmp_path})


def test_unpacked_sources_do_not_serve_another_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recipe, "cache_folder", lambda name: tmp_path)
    archive = tmp_path / "solver-1.0.tar.gz"
    with tarfile.open(archive, "w:gz") as files:
        member = tarfile.TarInfo("solver-1.0/main.c")
        member.size = 4
        files.addfile(member, io.BytesIO(b"int;"))
    pinned = hashlib.sha256(archive.read_bytes()).hexdigest()
    for _ in "12":
        folder = fetch_sources("solver", "1.0", pinned)
        assert (folder / "main.c").read_text() == "int;"
    with pytest.raises(SituationError, match=r"solver-1.0.tar.gz: found hash .*; required: 0000"):
        fetch_sources("solver", "1.0", 64 * "0")


@pytest.mark.slow
def test_a_source_that_cannot_be_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recipe, "cache_folder", lambda name: tmp_path)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(SituationError) as error:
        fetch_sources("no-such-solver", "1.0", 64 * "0")
    assert str(error.value).startswith("no-such-solver: pip cannot fetch its source (")
    assert "\n" not in str(error.value)
    (tmp_path / "solver-1.0.tar.gz").write_bytes(b"other")
    with pytest.raises(SituationError, match=r"solver-1.0.tar.gz: found hash .*; required: 0000"):
        fetch_sources("solver", "1.0", 64 * "0")
