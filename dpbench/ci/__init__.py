"""Continuous integration of a solver: replays under pytest-benchmark, compared with a baseline."""

import argparse
from typing import Any

MARGIN = 0.15
"""Largest slowdown of a benchmark that is no verdict, as a share of its time."""


def parse_exit_code(text: str) -> int:
    """Read an exit code of a command line; ArgumentTypeError outside 0 to 255."""
    if not (text.isdecimal() and int(text) <= 255):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: 0 to 255")
    return int(text)


def parse_allowance(text: str) -> tuple[str, str]:
    """Read a measure and a solver, such as `iterations:osqp`; ArgumentTypeError for other text."""
    measure, _, solver = text.partition(":")
    if not (measure and solver):
        raise argparse.ArgumentTypeError(
            f"found {text}; allowed: MEASURE:SOLVER, such as iterations:osqp"
        )
    return measure, solver


ALLOW: dict[str, Any] = {
    "metavar": "MEASURE:SOLVER",
    "type": parse_allowance,
    "action": "append",
    "default": [],
    "help": "accept an increase of a measure of a solver, such as iterations:osqp or errors:osqp; "
    "repeatable",
}
"""Option that gate, revisions and pytest have in common."""
DISTURBED_EXIT: dict[str, Any] = {
    "metavar": "CODE",
    "type": parse_exit_code,
    "default": 0,
    "help": "exit code if other load prevents a verdict and no regression is shown (default: 0)",
}
"""Option that gate, revisions and pytest have in common."""
