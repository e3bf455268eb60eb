"""Other things in the place of a file: every reader refuses them in one line, and never waits."""

import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.capability.edge_qps import CAPABILITY_FILE, load_capability_plots
from dpbench.bench.design import load_stability_records
from dpbench.bench.engines.shards import ShardRecord
from dpbench.bench.record.npz import open_arrays
from dpbench.bench.record.recorded_steps import StepsOnDisk
from dpbench.bench.record.result_folder import load_machine_and_suite, load_results, read_json
from dpbench.bench.sequences.foreign_qps import read_acados_qp, read_maros_meszaros_problem
from dpbench.bench.sequences.sequence_file import load_recorded, read_problem
from dpbench.bench.sequences.source import hash_sequence_files
from dpbench.embedded.table import EMBEDDED_FILE, load_counted_steps_of_folder
from dpbench.errors import InputError
from dpbench.files.regular_files import open_regular_file, read_bytes
from dpbench.scenario.hull_files import read_hull_from_csv_table, read_hull_from_mss_file
from dpbench.scenario.problem_files import read_toml_as_dict


def _kept(path: Path) -> None:
    with open_arrays(path):
        pass


READERS: dict[str, Callable[[Path], Any]] = {
    "ship.toml": read_toml_as_dict,
    "hull.csv": read_hull_from_csv_table,
    "hull.mat": read_hull_from_mss_file,
    "sequence.npz": load_recorded,
    "problem.npz": read_problem,
    "problem.json": read_acados_qp,
    "problem.mat": read_maros_meszaros_problem,
    "digest.npz": hash_sequence_files,
    "kept.npz": _kept,
    "suite.json": read_json,
    "machine.json": lambda path: load_machine_and_suite(path.parent),
    "shard.json": lambda path: ShardRecord.read(path.parent),
    "design.json": lambda path: load_stability_records(path.parent),
    CAPABILITY_FILE: lambda path: load_capability_plots(path.parent),
    EMBEDDED_FILE: lambda path: load_counted_steps_of_folder(path.parent),
    "runs.parquet": lambda path: load_results(path.parent),
    "steps.parquet": lambda path: StepsOnDisk(path.parent),
}
"""Readers of foreign files, by the name of the file."""


@pytest.fixture
def impatient() -> Iterator[None]:
    """A reader that waits for ever fails its test instead."""

    def give_up(*_: object) -> None:
        raise TimeoutError("a reader that waits")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("kind", ["FIFO", "device", "socket", "folder", "nothing"])
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_one_line(name: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    if kind == "FIFO":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        here = os.open(tmp_path, os.O_RDONLY)
        with socket.socket(socket.AF_UNIX) as bound:
            # The path of a socket may have a hundred characters.
            bound.bind(f"/proc/self/fd/{here}/{name}")
        os.close(here)
    if kind == "nothing" and name in ("design.json", CAPABILITY_FILE, EMBEDDED_FILE):
        assert READERS[name](path) is None
        return
    with pytest.raises(InputError) as caught:
        READERS[name](path)
    assert "\n" not in str(caught.value) and tmp_path.name in str(caught.value)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(10**12)
    with pytest.raises(InputError, match="allowed: a file of at most 1000 bytes"):
        read_bytes(path, "a file", most_bytes=1000)
    for read in (read_toml_as_dict, read_hull_from_csv_table, read_hull_from_mss_file, read_json):
        with pytest.raises(InputError, match="1000000000000 bytes"):
            read(path)


def test_nothing_stays_open(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abc")
    os.mkfifo(tmp_path / "fifo")
    before = os.listdir("/proc/self/fd")
    with open_regular_file(tmp_path / "file") as file:
        assert file.read() == b"abc"
    with pytest.raises(InputError, match="a FIFO"), open_regular_file(tmp_path / "fifo"):
        raise AssertionError
    assert os.listdir("/proc/self/fd") == before
