"""A core of this machine for whoever works here beside others who know nothing of each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path


@contextmanager
def leased_core() -> Iterator[int]:
    """A core that this process may use and that nobody else leases as long as the block lasts.

    Where all are leased, the first of them: more work was given to the machine than it has cores.
    """
    cores = sorted(os.sched_getaffinity(0))
    folder = Path(tempfile.gettempdir()) / f"dpbench-cores-{os.getuid()}"
    folder.mkdir(0o700, exist_ok=True)
    with ExitStack() as lease:
        for core in cores:
            # The lock ends with the process, however that ends.
            lock = lease.enter_context((folder / str(core)).open("w"))
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield core
            return
        yield cores[0]
