"""Completion in a shell (bash, zsh, fish): names of suites, scenarios, solvers and sequences.

`dpbench completion bash` prints what a shell is to read; the shell then asks the program itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

NAMES = {
    "suite": "suites",
    "scenario": "scenarios",
    "scenarios": "scenarios",
    "sequence": "sequences",
    "what": "scenarios",
    "file": "scenarios",
    "vessel": "vessels",
}
"""Arguments whose values are names of stored files, with their kind."""


def complete(whole: argparse.ArgumentParser) -> None:
    """Answer the shell, which asked by the environment, and leave the process."""
    import argcomplete

    commands: Any = next(a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            completer = _names_of(action.dest)
            if completer is not None and action.choices is None:
                action.completer = completer
    argcomplete.autocomplete(whole)


def _names_of(argument: str) -> Callable[..., list[str]] | None:
    """Who knows the values of an argument; None for files and numbers."""
    if argument in ("solver", "solvers"):
        return _solvers
    kind = NAMES.get(argument)
    return None if kind is None else lambda **_: _stored(kind)


def _stored(kind: str) -> list[str]:
    from dpbench.scenario.problem_files import problem_names

    return list(problem_names(kind))


def _solvers(**_: object) -> list[str]:
    from dpbench.solvers.table import solver_names

    return list(solver_names())
