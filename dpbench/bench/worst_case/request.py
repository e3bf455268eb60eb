"""What `dpbench worst-case` is asked for, and whether that can be; said before anything runs."""

from __future__ import annotations

from pathlib import Path

from dpbench.bench.worst_case.goal import GOALS, Goal
from dpbench.errors import InputError
from dpbench.scenario.scenario import MAX_STEPS


def check_input(goal: str, budget: int, steps: int, seed: int) -> None:
    """InputError that names the option whose value cannot be."""
    if goal not in GOALS:
        raise InputError("--goal", "", repr(goal), " | ".join(GOALS))
    for option, found, least in (("--budget", budget, 1), ("--seed", seed, 0)):
        if found < least:
            raise InputError(option, "", found, f"a whole number, {least} or more")
    if not 1 <= steps <= MAX_STEPS:
        raise InputError("--steps", "", steps, f"a whole number from 1 to {MAX_STEPS}")


def output_path(out: str | Path | None, solver: str, goal: Goal) -> Path:
    """Where the worst case is saved; InputError for a name of another kind of file."""
    path = Path("worst-cases") / f"{solver}-{goal}.npz" if out is None else Path(out)
    if path.suffix != ".npz":
        raise InputError("--out", "", repr(path.name), "a file name that ends in .npz")
    return path


def make_room(path: Path) -> None:
    """InputError unless the file can be written: before a search of minutes, not after it."""
    trial = path.with_name(path.name + ".part")
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "a folder", str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
    except OSError as error:
        found = f"{path} ({error.strerror or error})"
        raise InputError("--out", "", found, "a file that can be written") from error
