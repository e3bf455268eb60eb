"""A small container: 64 MB of shared memory, one core, 2 GB of memory, a read-only root, no home.

Made of namespaces of Linux where they are allowed, without a container engine.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
