"""A result folder has one writer at a time, and is claimed through no link."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from dpbench.bench.record.result_folder import lock_for_writing, lock_result_folder
from dpbench.errors import InputError
from dpbench.locks import WaitLimit


class _Said:
    """A stream that tells when something is written to it."""

    def __init__(self) -> None:
        self.text, self.something = "", threading.Event()

    def write(self, text: str) -> None:
        self.text += text
        self.something.set()

    def flush(self) -> None:
        """Nothing is kept back."""


@pytest.mark.parametrize("first", ["campaign", "report"])
def test_writers_take_turns(tmp_path: Path, first: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said, order = _Said(), list[str]()
    monkeypatch.setattr(sys, "stderr", said)
    folder = tmp_path / "out"
    folder.mkdir()
    campaign, report = lambda: lock_result_folder(folder, "smoke"), lambda: lock_for_writing(folder)
    one, other = (campaign, report) if first == "campaign" else (report, campaign)

    def second() -> None:
        with other():
            order.append("second")

    thread = threading.Thread(target=second)
    with one():
        thread.start()
        assert said.something.wait(60.0)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
    (line,) = said.text.splitlines()
    assert line.startswith("dpbench: waiting for") and str(folder) in line


HOLD = """
import sys
from pathlib import Path
from dpbench.bench.record.result_folder import lock_result_folder, lock_for_writing
folder = Path(sys.argv[2])
with lock_result_folder(folder, "smoke") if sys.argv[1] == "campaign" else lock_for_writing(folder):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
@pytest.mark.parametrize("first", ["campaign", "report"])
def test_the_holder_of_a_folder_is_named(tmp_path: Path, first: str) -> None:
    (tmp_path / "out").mkdir()
    command = [sys.executable, "-c", HOLD, first, str(tmp_path / "out")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        name = rf"process {other.pid} \(.*since"
        impatient = lock_result_folder(tmp_path / "out", "smoke", WaitLimit(0.0))
        with pytest.raises(InputError, match=name), impatient:
            pass
        other.communicate("")


def test_two_campaigns_do_not_wait(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with (
        lock_result_folder(out, "smoke"),
        pytest.raises(InputError, match="in use"),
        lock_result_folder(out, "smoke"),
    ):
        pass
    with lock_result_folder(out, "smoke"):
        pass


def test_a_folder_that_is_not_there_is_not_held(tmp_path: Path) -> None:
    with lock_for_writing(tmp_path / "out"):
        assert not (tmp_path / "out").exists()


def test_nothing_is_made_through_a_link(tmp_path: Path) -> None:
    mine, elsewhere, out = tmp_path / "thesis.txt", tmp_path / "elsewhere", tmp_path / "out"
    mine.write_text("mine", encoding="utf-8")
    elsewhere.mkdir()
    out.mkdir()
    (out / "cells").symlink_to(elsewhere)
    with pytest.raises(InputError, match="cells: found a link"), lock_result_folder(out, "smoke"):
        pass
    assert not list(elsewhere.iterdir())
    (out / "cells").unlink()
    (out / "cells").mkdir()
    (out / "cells" / ".lock").symlink_to(mine)
    with (
        pytest.raises(InputError, match="a folder that can be written"),
        lock_result_folder(out, "smoke"),
    ):
        pass
    (out / "cells" / ".lock").unlink()
    os.link(mine, out / "cells" / ".lock")
    with lock_result_folder(out, "smoke"):
        assert mine.read_text("utf-8") == "mine"
