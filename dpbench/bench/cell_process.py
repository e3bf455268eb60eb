"""Where the processes of cells leave their files, and what each does of itself: keep quiet, stay on
its core, leave a verdict.
"""

from __future__ import annotations

import gc
import json
import os
import tempfile
import warnings
from pathlib import Path
from typing import Any


def scratch_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for what cells leave behind until it is kept, in memory where that can be."""
    shared = Path("/dev/shm")
    return tempfile.TemporaryDirectory(
        # A worker that was interrupted as well may write its last file while the folder goes.
        ignore_cleanup_errors=True,
        prefix="dpbench-",
        dir=shared if os.access(shared, os.W_OK) else None,
    )


def settle(noise: Path) -> None:
    """Send what libraries print to a file, ignore warnings and stop the garbage collector."""
    try:
        sink = os.open(noise, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    except FileNotFoundError:
        # Ctrl-C while this process was on its way took its folder along: nobody waits for it.
        raise SystemExit from None
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    warnings.simplefilter("ignore")
    gc.collect()
    gc.freeze()
    gc.disable()


def pin(core: int) -> None:
    """Stay on one core from now on."""
    os.sched_setaffinity(0, {core})


def write_verdict(path: Path, verdict: dict[str, Any]) -> None:
    """Leave a JSON verdict at `path`, whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(verdict), encoding="utf-8")
    part.replace(path)


def verdict_of(
    outcome: str, detail: str, form: str = "", size: tuple[int, int] | None = None
) -> dict[str, Any]:
    """A verdict in the words that the supervisor reads; `size` is n and m of the solver's QP."""
    n, m = size or (None, None)
    return {"outcome": outcome, "detail": detail, "form": form, "n": n, "m": m}
