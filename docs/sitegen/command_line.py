"""The reference of the command line, from its parser."""

import argparse
import textwrap
from collections import defaultdict
from collections.abc import Mapping

from dpbench.cli.arguments import make_parser
from sitegen.markup import code, prose, table

INTRODUCTION = """# Command line

`dpbench COMMAND --help` prints the same. Bad input ends with exit code 2 and one line
with the place, the value found and the allowed values.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION]
    for name, (command, summary) in commands().items():
        parts += [f"## {code(f'dpbench {name}')}\n", f"{prose(_sentence(summary))}\n"]
        parts += [_usage(command), _arguments(command)]
        if command.description and command.description != f"{summary}.":
            parts.append(f"{prose(command.description)}\n")
        parts.append(f"```text\n{command.epilog}\n```\n")
    return {"reference/command-line.md": "\n".join(parts)}


def commands() -> Mapping[str, tuple[argparse.ArgumentParser, str]]:
    """Every command by name: its parser, and what it does in a line."""
    whole = make_parser(defaultdict(lambda: lambda arguments: 0))
    (subparsers,) = (a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    summaries = {choice.dest: choice.help or "" for choice in subparsers._choices_actions}
    return {name: (subparsers.choices[name], text) for name, text in summaries.items()}


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:].rstrip('.')}."


def _usage(command: argparse.ArgumentParser) -> str:
    words = " ".join(command.format_usage().split()).removeprefix("usage: ")
    lines = textwrap.wrap(words, 88, subsequent_indent="    ", break_on_hyphens=False)
    return "```text\n" + "\n".join(lines) + "\n```\n"


def _arguments(command: argparse.ArgumentParser) -> str:
    rows = [
        (code(_called(action)), prose(action.help))
        for action in command._actions
        if action.help and action.dest != "help" and action.help is not argparse.SUPPRESS
    ]
    return table(("argument", "meaning"), rows) if rows else "It takes no arguments.\n"


def _called(action: argparse.Action) -> str:
    """Format an argument as it is written, with what follows it."""
    value = action.metavar or (action.dest.upper() if action.option_strings else action.dest)
    shown = " ".join(value) if isinstance(value, tuple) else value
    if not action.option_strings:
        return shown
    takes = action.nargs != 0
    return ", ".join(action.option_strings) + (f" {shown}" if takes else "")
