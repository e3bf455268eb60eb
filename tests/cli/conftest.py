"""Commands that are run: what they print, or the one line with which they refuse."""

from collections.abc import Callable

import pytest

from dpbench.cli.main import main

Say = Callable[..., str]


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Run a command that succeeds; return its standard output."""

    def run(*words: str) -> str:
        assert main(words) == 0
        return capsys.readouterr().out

    return run


@pytest.fixture
def refuse(capsys: pytest.CaptureFixture[str]) -> Say:
    """Run a command that exits with 2; return the one line of its complaint."""

    def run(*words: str) -> str:
        assert main(words) == 2
        captured = capsys.readouterr()
        (line,) = captured.err.splitlines()
        assert not captured.out
        return line

    return run
