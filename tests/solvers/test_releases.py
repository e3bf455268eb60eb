"""Newer releases of solvers, by a package index that is made up: no test asks the real one."""

import json
import subprocess
from importlib import metadata

import pytest

from dpbench.solvers import releases
from dpbench.solvers.releases import Release, find_newer_releases
from tests import outdated


def answer(*found: tuple[str, str]) -> str:
    """A report of pip with what it would install."""
    items = [{"metadata": {"name": name, "version": version}} for name, version in found]
    return json.dumps({"version": "1", "install": items})


def fake_index(monkeypatch: pytest.MonkeyPatch, text: str) -> list[list[str]]:
    """Let pip answer with a text; return the names that it is asked for, call by call."""
    asked: list[list[str]] = []

    def resolve(names: list[str], timeout_s: float) -> str:
        asked.append(names)
        return text

    monkeypatch.setattr(releases, "_resolve_newest_with_pip", resolve)
    return asked


def test_newer_releases_come_with_their_solvers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names are compared as an index does: the metadata of `superadmm` call it superADMM."""
    asked = fake_index(monkeypatch, answer(("PIQP", "99.1"), ("numpy", "99.0")))
    (found,) = find_newer_releases(1.0) or []
    installed = metadata.version("piqp")
    assert found == Release("piqp", installed, "99.1", ("piqp", "piqp_multistage", "piqp_sparse"))
    assert str(found) == f"piqp 99.1 (installed: {installed})"
    assert "piqp" in asked[0] and "numpy" not in asked[0] and "" not in asked[0]


def test_nothing_newer_is_an_empty_list(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_index(monkeypatch, answer())
    assert find_newer_releases(1.0) == []


def test_an_index_that_does_not_answer_is_not_nothing_newer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Installed packages satisfy pip without an index; missing ones do not."""

    def run(command: list[str], **options: object) -> subprocess.CompletedProcess[str]:
        if "--ignore-installed" in command:
            raise subprocess.CalledProcessError(1, command)
        return subprocess.CompletedProcess(command, 0, answer(), "")

    monkeypatch.setattr(subprocess, "run", run)
    assert find_newer_releases(1.0) is None


@pytest.mark.parametrize("text", ["", "no JSON", "[]", "{}", '{"install": [{}]}', '{"install": 1}'])
def test_an_answer_that_is_none_is_passed_over(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    fake_index(monkeypatch, text)
    assert find_newer_releases(1.0) is None


@pytest.mark.parametrize(
    "error",
    [
        subprocess.TimeoutExpired("pip", 1.0),
        subprocess.CalledProcessError(1, "pip"),
        FileNotFoundError("python"),
    ],
)
def test_an_index_that_cannot_be_asked_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def run(*arguments: object, **options: object) -> None:
        assert options["timeout"] == 1.0
        raise error

    monkeypatch.setattr(subprocess, "run", run)
    assert find_newer_releases(1.0) is None


@pytest.mark.parametrize(
    ("found", "result", "code", "words"),
    [
        (None, "", 2, "does not answer"),
        ([], "", 0, "no solver has a newer release"),
        ([Release("daqp", "1", "2", ("daqp",))], "9 passed in 1 s", 0, "daqp 2 (installed: 1): 9"),
        ([Release("daqp", "1", "2", ("daqp",))], "1 failed, 9 passed in 1 s", 1, "1 failed"),
        ([Release("daqp", "1", "2", ("daqp",))], "ERROR: no matching distribution", 1, "ERROR"),
    ],
)
def test_outdated_says_what_the_tests_say(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    found: list[Release] | None,
    result: str,
    code: int,
    words: str,
) -> None:
    monkeypatch.setattr(outdated, "find_newer_releases", lambda timeout_s: found)
    monkeypatch.setattr(outdated, "run_conformance_tests", lambda release: result)
    assert outdated.main([]) == code
    assert words in capsys.readouterr().out
