"""Containers: a small one made of namespaces, without an engine, and the image of the Dockerfile.

The small one has 64 MB of shared memory, one core, 2 GB of memory, a read-only root and no home.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.markdown_blocks import DOCS, blocks_of

ROOT = Path(__file__).parents[1]
MEMORY_KB = 2 * 1024**2
# Folders that are looked for again below what is mounted over them are kept at /mnt.
BOX = """
set -e
mount -t tmpfs tmpfs /mnt
number=0
for folder in "$@"; do
    number=$((number + 1)); mkdir /mnt/$number; mount --bind "$folder" /mnt/$number
done
for hidden in /root /home; do [ -d $hidden ] && mount -t tmpfs -o mode=755 tmpfs $hidden; done
mount -t tmpfs -o mode=1777 tmpfs /tmp
mount -t tmpfs -o mode=1777,size=64m tmpfs /dev/shm
number=0
for folder in "$@"; do
    number=$((number + 1)); mkdir -p "$folder"; mount --bind /mnt/$number "$folder"
    mount -o remount,bind,ro "$folder"
done
mount -o remount,bind,ro /
mkdir -m 777 /tmp/results
cd /tmp/results
ulimit -d $MEMORY_KB
exec taskset -c $CORE setpriv --reuid=65534 --regid=65534 --clear-groups --no-new-privs \\
    env -i PATH=/usr/bin:/bin HOME=/nonexistent PYTHONPATH="$SITE" PYTHON="$PYTHON" sh -c "$RUN"
"""
RUN = """
touch "$PYTHONPATH/dpbench/written" 2>/dev/null && echo writable
"$PYTHON" -m dpbench run smoke --out smoke --quiet || exit 1
nproc
grep lost_cells smoke/suite.json
ls -A /dev/shm /tmp
"""


def _namespaces() -> bool:
    """True where this user may make namespaces."""
    tools = all(map(shutil.which, ("unshare", "setpriv", "taskset", "mount")))
    command = ["unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
    return tools and subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.skipif(os.getuid() != 0 or not _namespaces(), reason="needs root and namespaces")
def test_a_small_container_runs_a_suite_and_writes_its_page() -> None:
    """All cells finish, and what is left is the results and the folder of locks."""
    folders = dict.fromkeys([sys.base_prefix, sys.prefix, str(ROOT)])
    given = {
        "CORE": str(min(os.sched_getaffinity(0))),
        "MEMORY_KB": str(MEMORY_KB),
        "PYTHON": sys.executable,
        "RUN": RUN,
        "SITE": str(ROOT),
    }
    done = subprocess.run(
        ["unshare", "--mount", "--propagation", "private", "bash", "-c", BOX, "box", *folders],
        env={"PATH": os.environ["PATH"], **given},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = done.stdout.split("\n")
    assert done.returncode == 0, done.stderr
    assert lines[:2] == ["smoke/report.html", "1"] and lines[2].split() == ['"lost_cells":', "0,"]
    assert "writable" not in lines
    left = {line for line in lines[3:] if line and not line.endswith(":")}
    nested = {str(ROOT).split("/")[2]} if str(ROOT).startswith("/tmp/") else set()
    assert left == {"results", "dpbench-leases-65534"} | nested


def _run(command: list[str], folder: Path) -> str:
    """The output of a command that must succeed."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def engine() -> str:
    """Docker or Podman, running, with the base image of the Dockerfile."""
    base = re.search(r"^ARG PYTHON=(.*)$", (ROOT / "Dockerfile").read_text("utf-8"), re.M)
    assert base is not None
    for name in filter(shutil.which, ("docker", "podman")):
        if any(
            subprocess.run([name, *words, base[1]], capture_output=True, check=False).returncode
            == 0
            for words in (("image", "inspect"), ("pull",))
        ):
            return name
    pytest.skip("needs Docker or Podman, and the base image")


@pytest.mark.slow
def test_the_image_runs_a_suite_for_the_user_who_asks(engine: str, tmp_path: Path) -> None:
    """The commands of the guide; the image has no compiler, and its own user is not root."""
    (block,) = (
        one
        for one in blocks_of(DOCS / "guide" / "containers.md")
        if one.body.startswith("docker build")
    )
    build, run = (f"{engine} {line.removeprefix('docker ')}" for line in block.commands)
    _run(["bash", "-c", build], ROOT)
    _run(["bash", "-c", run], tmp_path)
    report = tmp_path / "results" / "smoke" / "report.html"
    assert report.stat().st_size > 0 and report.owner() == tmp_path.owner()
    look = "id -u; command -v cc gcc clang zig; python -c 'import ziglang' 2>/dev/null && echo zig"
    shell = [engine, "run", "--rm", "--entrypoint", "sh", "dpbench"]
    assert _run([*shell, "-c", f"{look}; true"], tmp_path) == "1000\n"


def test_a_base_image_is_pinned_and_the_command_does_not_run_as_root() -> None:
    """Each stage starts from one base, by tag and digest; the last steps run as the user."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    (base,) = (line for line in lines if line.startswith("ARG "))
    assert re.search(r"python:3\.\d+\.\d+-slim-\w+@sha256:[0-9a-f]{64}$", base)
    assert {line.split()[1] for line in lines if line.startswith("FROM ")} == {"${PYTHON}"}
    user = lines.index("USER dpbench")
    assert not [line for line in lines[user:] if line.startswith(("RUN", "COPY", "ADD"))]
    assert 'ENTRYPOINT ["dpbench"]' in lines[user:]
