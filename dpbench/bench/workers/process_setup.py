"""What the process of a cell does of itself: keep quiet, stay on its core, leave a verdict."""

from __future__ import annotations

import gc
import json
import os
import warnings
from pathlib import Path
from typing import Any


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
