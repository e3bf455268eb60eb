"""What the process of a cell does of itself: keep quiet, stay on its core, leave a verdict."""

from __future__ import annotations

import gc
import os
import warnings
from pathlib import Path

from dpbench.bench.record.cell import Outcome
from dpbench.bench.record.result_folder import write_json


def settle(noise: Path) -> None:
    """Send what libraries print to a file, ignore warnings and stop the garbage collector."""
    try:
        sink = os.open(noise, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    except FileNotFoundError:
        # Ctrl-C while this process was on its way took its folder along, and nobody waits for it;
        # or somebody else removed the folder, which the supervisor sees for itself.
        raise SystemExit from None
    os.dup2(sink, 1)
    os.dup2(sink, 2)
    if sink > 2:
        os.close(sink)
    warnings.simplefilter("ignore")
    gc.collect()
    gc.freeze()
    gc.disable()


def pin(core: int) -> None:
    """Stay on one core from now on."""
    os.sched_setaffinity(0, {core})


def leave_verdict(path: Path, outcome: Outcome) -> None:
    """Leave at `path` what became of a cell, for the supervisor to read."""
    write_json(path, vars(outcome))
