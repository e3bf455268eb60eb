"""A cluster of this machine is reached by nobody else."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.progress import Silent

WHY = "engine dask needs the extra `cluster`"
pytest.importorskip("dpbench.bench.engines.dask_engine", reason=WHY)
# Its clusters have a worker on each core, which meets limits of real time.
pytestmark = pytest.mark.alone

STRANGER = """
import json, os, socket, sys
from distributed import Client
from distributed.security import Security

def reached(address, security):
    try:
        with Client(address, security=security, timeout=5) as client:
            return client.run_on_scheduler(os.getpid)
    except OSError as error:
        return type(error).__name__

def page(host, port):
    with socket.create_connection((host, port), timeout=5) as plain:
        plain.sendall(b"GET /health HTTP/1.0\\r\\n\\r\\n")
        try:
            return plain.recv(100).decode(errors="replace")
        except ConnectionResetError:
            return ""

said = {}
for place in sys.argv[1:]:
    plain = reached(f"tcp://{place}", None)
    said[place] = plain, reached(f"tls://{place}", Security.temporary()), page(*place.split(":"))
print(json.dumps(said))
"""
"""A client of somebody who knows all addresses: without and with a certificate of its own, and a
browser."""


class Visited(Silent):
    """A progress at whose first finished cell a stranger comes."""

    def __init__(self) -> None:
        self.listening: list[tuple[str, int]] = []
        self.answers: dict[str, tuple[int | str, int | str, str]] = {}

    def advance(self, work: int, what: str) -> None:
        if self.listening:
            return
        this = psutil.Process()
        for process in [this, *this.children(recursive=True)]:
            # Processes of cells come and go.
            with suppress(psutil.NoSuchProcess):
                self.listening += [
                    (socket.laddr.ip, socket.laddr.port)
                    for socket in process.net_connections("inet")
                    if socket.status == psutil.CONN_LISTEN
                ]
        assert {host for host, _ in self.listening} == {"127.0.0.1"}
        places = [f"{host}:{port}" for host, port in self.listening]
        words = [sys.executable, "-c", STRANGER, *places]
        done = subprocess.run(words, check=True, capture_output=True, text=True)
        self.answers = json.loads(done.stdout)


def test_only_we_reach_it(suite: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    visited, path = Visited(), tmp_path / "loops.toml"
    path.write_text(suite.read_text(encoding="utf-8").split("[[replay]]")[0], encoding="utf-8")
    given = {"engine": "dask", "jobs": 2, "solvers": ["daqp"], "progress": visited}
    out = run_campaign(path, tmp_path / "out", **given)
    # One socket each: nobody asked for a page.
    assert len(visited.listening) == 5
    for plain, other, page in visited.answers.values():
        # The name of an error in place of the scheduler's process id.
        assert isinstance(plain, str) and isinstance(other, str) and page == ""
    assert set(load_results(out).runs["outcome"]) == {"finished"}
    assert capfd.readouterr() == ("", "")


PRESSED_TWICE = """
import os, signal, sys
from distributed import Nanny, SpecCluster
from dpbench.bench.record.cell_store import CellStore
from dpbench.cli.main import main

def pressed_before(owner, name):
    call = getattr(owner, name)
    def pressing(*given, **more):
        os.killpg(0, signal.SIGINT)
        return call(*given, **more)
    setattr(owner, name, pressing)

if __name__ == "__main__":
    # A shell that runs the tests in the background has it ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    moments = {"starting": (Nanny, "instantiate"), "running": (CellStore, "write_part_file")}
    pressed_before(*moments[sys.argv[1]])
    pressed_before(SpecCluster, "close")
    raise SystemExit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("when", ["starting", "running"])
def test_ctrl_c_twice_leaves_nothing(suite: Path, tmp_path: Path, when: str) -> None:
    script, place = tmp_path / "pressed.py", tmp_path / "t"
    script.write_text(PRESSED_TWICE, encoding="utf-8")
    place.mkdir()
    words = ["run", str(suite), "--out", str(tmp_path / "out"), "--quiet"]
    process = subprocess.Popen(
        [sys.executable, str(script), when, *words, "--engine", "dask", "--jobs", "2"],
        env=os.environ | {"TMPDIR": str(place)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    _, said = process.communicate()
    (line,) = said.splitlines()
    assert line.startswith("dpbench: interrupted") and process.returncode == 130
    left = [other for other in psutil.process_iter() if _session(other) == process.pid]
    # That of Python which counts what is shared ends a moment after the others.
    _, alive = psutil.wait_procs(left, timeout=30)
    assert alive == []
    assert {path.name for path in place.iterdir()} <= {f"dpbench-leases-{os.getuid()}"}


def _session(process: psutil.Process) -> int:
    with suppress(ProcessLookupError):
        return os.getsid(process.pid)
    return 0
