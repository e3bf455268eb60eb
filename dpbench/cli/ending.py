"""How a run ends on a terminal: a table of a few lines and the page, or JSON for scripts."""

from __future__ import annotations

import argparse
import json
import webbrowser
from pathlib import Path

STYLES = {"answer": "bold green", "solver": "bold green", "next": "cyan", "page": "bold"}


def say_ending(page: Path, rows: list[tuple[str, str]], arguments: argparse.Namespace) -> None:
    """Print what a run or report ends with.

    Parameters
    ----------
    rows : what each line is about, and the line.
    arguments : with `json`, `quiet` and `open`.
    """
    if arguments.json:
        print(json.dumps({"page": str(page)} | dict(rows), ensure_ascii=False, indent=2))
    elif arguments.quiet:
        print(page)
    else:
        _print_table([*rows, ("page", str(page))])
    if arguments.open:
        webbrowser.open(page.resolve().as_uri())


def _print_table(rows: list[tuple[str, str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    from dpbench.cli.terminal import WIDTH, console

    screen = console()
    screen.width = min(screen.width, WIDTH)
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for what, said in rows:
        table.add_row(Text(what, "dim"), Text(said, STYLES.get(what, "")))
    screen.print(table)
