"""A scheduler with TLS is reached with the right files; wrong ones are one line, exit 2."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from dpbench.bench.engines.on_worker import describe_worker
from dpbench.cli.main import main
from dpbench.errors import InputError

WHY = "engine dask needs the extra `cluster`"
dask_cluster = pytest.importorskip("dpbench.bench.engines.dask_cluster", reason=WHY)
distributed = pytest.importorskip("distributed", reason=WHY)
connect_client, Security = dask_cluster.connect_client, dask_cluster.Security
pytestmark = pytest.mark.slow


def written(folder: Path) -> list[str]:
    """The files of a new certificate, which is its own authority, and of its key."""
    made = Security.temporary()
    cert, key = folder / "cert.pem", folder / "key.pem"
    cert.write_text(made.tls_client_cert, encoding="ascii")
    key.write_text(made.tls_client_key, encoding="ascii")
    return [str(cert), str(cert), str(key)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return written(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def scheduler(files: list[str]) -> Iterator[str]:
    words = ["--tls-ca-file", files[0], "--tls-cert", files[1], "--tls-key", files[2]]
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"),
            *("--host", "tls://127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"),
            *words,
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    said = (line.split() for line in process.stderr)
    yield next(words[-1] for words in said if words[-1].startswith("tls://"))
    process.kill()
    process.communicate()


def test_with_its_files_a_scheduler_is_reached(scheduler: str, files: list[str]) -> None:
    with connect_client(scheduler, files) as client:
        answer = client.run_on_scheduler(describe_worker)
    assert answer.harness_version == describe_worker().harness_version


def test_a_scheduler_with_tls_refuses_others(
    scheduler: str, files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, other = scheduler.replace("tls://", "tcp://"), written(tmp_path)
    mixed = [files[0], *other[1:]]
    tries = ((scheduler, None), (scheduler, other), (scheduler, mixed), (plain, None))
    for address, given in tries:
        with pytest.raises(InputError, match="which refuses"), connect_client(address, given):
            pass
    assert capsys.readouterr() == ("", "")


def test_wrong_files_are_one_line(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ca, cert, key = files
    (tmp_path / "other").mkdir()
    other = written(tmp_path / "other")[2]
    junk = tmp_path / "junk"
    junk.write_text("no PEM", encoding="ascii")
    to = ["--scheduler", "tls://127.0.0.1:1"]
    for options, line in (
        ([*to, "--tls", str(tmp_path / "no"), cert, key], "--tls: CA: found"),
        ([*to, "--tls", ca, str(tmp_path), key], "--tls: CERT: found"),
        ([*to, "--tls", ca, cert, "/dev/zero"], "--tls: KEY: found /dev/zero"),
        ([*to, "--tls", str(junk), cert, key], "--tls: CA: found"),
        ([*to, "--tls", ca, str(junk), key], "--tls: CERT and KEY: found"),
        ([*to, "--tls", ca, cert, other], "--tls: CERT and KEY: found"),
        (["--scheduler", "tcp://127.0.0.1:1", "--tls", ca, cert, key], "--tls: found files with"),
        (["--tls", ca, cert, key], "--tls: found files without --scheduler"),
    ):
        out = tmp_path / "out"
        assert main(["run", "smoke", "--out", str(out), "--engine", "dask", *options]) == 2
        (said,) = capsys.readouterr().err.splitlines()
        assert said.startswith(f"dpbench: {line}") and not out.exists()
