"""Folders of a process: gone with it, and of one that was killed with the next."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dpbench.temporary_folders import PREFIX, make_temporary_folder_for_block

HOLD = """
import sys, time
from pathlib import Path
from dpbench.temporary_folders import make_temporary_folder_for_block
with make_temporary_folder_for_block(Path(sys.argv[1])) as folder:
    (folder / "log").write_bytes(b"a log")
    print(folder, flush=True)
    time.sleep(600)
"""


def _names(place: Path) -> list[str]:
    return [path.name for path in place.iterdir()]


def test_a_folder_goes_with_its_campaign(tmp_path: Path) -> None:
    """With what is in it; after an error too."""
    with pytest.raises(KeyError), make_temporary_folder_for_block(tmp_path) as folder:
        (folder / "log").write_bytes(b"a log")
        assert _names(tmp_path) == [folder.name] and folder.name.startswith(PREFIX)
        raise KeyError
    assert _names(tmp_path) == []


@pytest.mark.slow
def test_what_a_killed_campaign_left_goes_with_the_next(tmp_path: Path) -> None:
    """Not before its process is dead; what else lies there stays."""
    (tmp_path / "dpbench-notes").mkdir()
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        left = Path(holder.stdout.readline().strip())
        with make_temporary_folder_for_block(tmp_path):
            assert (left / "log").is_file()
        os.kill(holder.pid, signal.SIGKILL)
    assert (left / "log").is_file(), "nobody tidied up"
    with make_temporary_folder_for_block(tmp_path) as folder:
        assert sorted(_names(tmp_path)) == sorted(["dpbench-notes", folder.name])


FORK = """
import multiprocessing, sys, tempfile, time
from dpbench.temporary_folders import process_temporary_folder
tempfile.tempdir = sys.argv[1]
folder = process_temporary_folder()
child = multiprocessing.get_context("fork").Process(target=print)
child.start()
child.join()
print(folder.is_dir())
"""


@pytest.mark.slow
def test_a_fork_does_not_take_the_folder_of_its_parent(tmp_path: Path) -> None:
    """`multiprocessing` clears in it what would run at the end of the parent."""
    command = [sys.executable, "-c", FORK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"]
    assert _names(tmp_path) == [], "it goes with the parent"
