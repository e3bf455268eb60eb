"""Fetch the source distributions of solvers: pinned by hash, kept in the user's cache folder."""

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path, PurePosixPath

from dpbench.embedded.toolchain import cache_folder
from dpbench.errors import SituationError


def fetch_sources(name: str, version: str, sha256: str) -> Path:
    """Return the unpacked source distribution of a package, fetched by pip if it is not there.

    SituationError with the reason where it cannot be fetched or has another hash.
    """
    store = cache_folder("sources")
    folder, archive = store / f"{name}-{version}", store / f"{name}-{version}.tar.gz"
    if folder.is_dir():
        return folder
    if not archive.is_file():
        _download(name, version, sha256, store)
    if not archive.is_file():
        raise SituationError(name, f"pip fetched no {archive.name}")
    found = hashlib.sha256(archive.read_bytes()).hexdigest()
    if found != sha256:
        raise SituationError(str(archive), f"its hash is {found}, not {sha256}: remove it")
    _unpack(archive, folder)
    return folder


def _download(name: str, version: str, sha256: str, store: Path) -> None:
    """Have pip fetch one source distribution from the index that it is configured for."""
    remedy = f"put {name}-{version}.tar.gz into {store}, or leave this solver out"
    if importlib.util.find_spec("pip") is None:
        raise SituationError(name, f"its source cannot be fetched without pip: {remedy}")
    with tempfile.TemporaryDirectory() as folder:
        pinned = Path(folder, "pinned.txt")
        pinned.write_text(f"{name}=={version} --hash=sha256:{sha256}\n")
        options = ["--no-deps", "--no-binary", name, "--require-hashes", "--quiet"]
        command = [sys.executable, "-m", "pip", "download", *options]
        done = subprocess.run(
            [*command, "--dest", str(store), "--requirement", str(pinned)],
            check=False,
            capture_output=True,
            text=True,
        )
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR:")]
        reason = (errors or ["no message"])[-1].removeprefix("ERROR: ").rstrip(".")
        raise SituationError(name, f"pip cannot fetch its source ({reason}): {remedy}")


def _unpack(archive: Path, folder: Path) -> None:
    """Write the regular files of an archive to `folder`, without its outermost folder."""
    partial = Path(tempfile.mkdtemp(dir=folder.parent))
    with tarfile.open(archive) as files:
        for member in files:
            parts = PurePosixPath(member.name).parts[1:]
            if not member.isreg() or not parts or ".." in parts:
                continue
            stream = files.extractfile(member)
            assert stream is not None
            path = partial.joinpath(*parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(stream.read())
    try:
        partial.rename(folder)
    except OSError:  # another process has put it there meanwhile
        shutil.rmtree(partial)
        if not folder.is_dir():
            raise
