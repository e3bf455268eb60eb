"""Continuous integration of a solver: replays under pytest-benchmark, compared with a baseline."""

import argparse
import re
from contextlib import suppress
from typing import Any, NamedTuple

MARGIN = 0.15
"""Largest slowdown of a benchmark that is no verdict, as a share of its time."""


def parse_exit_code(text: str) -> int:
    """Read an exit code of a command line; ArgumentTypeError outside 0 to 255."""
    if not (text.isdecimal() and int(text) <= 255):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: 0 to 255")
    return int(text)


def parse_margin(text: str) -> float:
    """Read a margin of a command line; ArgumentTypeError unless between 0 and 10."""
    with suppress(ValueError):
        if 0.0 < float(text) < 10.0:
            return float(text)
    raise argparse.ArgumentTypeError(f"found {text}; allowed: a share between 0 and 10")


class Allowance(NamedTuple):
    """Measure of a solver that may increase, and by which share at most."""

    measure: str
    solver: str
    largest: float = float("inf")


def parse_allowance(text: str) -> Allowance:
    """Read an allowance, such as `iterations:osqp=10%`; ArgumentTypeError for other text."""
    found = re.fullmatch(r"([^:]+):([^=]+)(?:=(\d+(?:\.\d+)?) ?%)?", text)
    if found is None:
        raise argparse.ArgumentTypeError(
            f"found {text}; allowed: MEASURE:SOLVER[=PERCENT], such as iterations:osqp=10%"
        )
    measure, solver, percent = found.groups()
    return Allowance(measure, solver, float(percent) / 100.0 if percent else float("inf"))


ALLOW: dict[str, Any] = {
    "metavar": "MEASURE:SOLVER[=PERCENT]",
    "type": parse_allowance,
    "action": "append",
    "default": [],
    "help": "accept any increase of this measure of this solver, such as iterations:osqp, or an "
    "increase up to a limit, such as iterations:osqp=10%%; repeatable",
}
"""Option that gate, revisions and pytest have in common."""
MARGIN_SHARE: dict[str, Any] = {
    "metavar": "SHARE",
    "type": parse_margin,
    "default": MARGIN,
    "help": f"largest slowdown that does not count as a regression (default: {MARGIN})",
}
"""Option that gate, revisions and pytest have in common."""
DISTURBED_EXIT: dict[str, Any] = {
    "metavar": "CODE",
    "type": parse_exit_code,
    "default": 0,
    "help": "exit code if times are not judged and no regression is shown (default: 0)",
}
"""Option of revisions, which stores no baseline."""
DISTURBED_OR_STORED_EXIT: dict[str, Any] = DISTURBED_EXIT | {
    "help": "exit code if times are not judged and no regression is shown, or other load disturbs "
    "a stored baseline (default: 0)"
}
"""Option of pytest, which stores a baseline."""
GATE_EXIT: dict[str, Any] = DISTURBED_EXIT | {
    "help": "exit code if times are not judged and no regression is shown, or if this command "
    "stores a baseline that is disturbed or has no times of the reference kernel (default: 0)"
}
"""Option of the gate, which stores a baseline and judges whether it can be compared."""
