"""Terminal output: prose and tables in 80 columns, a progress bar, the end of a run."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import textwrap
import webbrowser
from collections.abc import Iterable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from dpbench.bench.progress import ProgressLines

if TYPE_CHECKING:
    from dpbench.report.formats import Table as ReportTable

WIDTH = 80  # Columns of a file or a pipe, and the most of prose on a terminal
STYLES = {"slower": "bold red", "worse": "bold red", "faster": "green", "better": "green"}
"""Colours of words in a comparison."""
ENDING_STYLES = {
    "warning": "bold red",
    "ship": "bold",
    "caution": "bold yellow",
    "answer": "bold green",
    "solver": "bold green",
    "next": "cyan",
    "page": "bold",
}
"""Styles of the lines that a run ends with."""
_INDENT = 4 * " "
_BETWEEN = " │ "  # Of two columns of a table


def make_console() -> Console:
    """Return a console on standard output: terminal width, or 80 columns to a file or pipe."""
    return Console() if sys.stdout.isatty() else Console(width=WIDTH)


def wrap_paragraph(text: str, *, first: str = "", others: str = "") -> str:
    """Return a paragraph wrapped at 80 columns with indents, without breaking long words."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def print_wrapped(lines: Iterable[str]) -> None:
    """Print lines of text, all but commands wrapped at 80 columns with a hanging indent of two."""
    for line in lines:
        is_whole = len(line) <= WIDTH or line.lstrip().startswith("dpbench run ")
        print(line if is_whole else wrap_paragraph(line, others="  "))


def format_heading_and_paragraphs(head: str, paragraphs: Iterable[str]) -> str:
    """Return a heading with paragraphs below it, indented by four columns."""
    return "\n".join(
        [head, *(wrap_paragraph(p, first=_INDENT, others=_INDENT) for p in paragraphs)]
    )


def make_unstyled_text(text: str) -> Text:
    """Return a text for the terminal as it is, without markup, colour or wrapping."""
    return Text(text, no_wrap=True, overflow="ignore")


def make_small_table(*columns: str) -> Table:
    """Return an empty terminal table with these columns, the first never broken."""
    table = Table(show_edge=False, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=i == 0)
    return table


def make_report_table(table: ReportTable, screen: Console) -> RenderableType:
    """Return a report's table for the terminal; text in paragraphs if it is too wide.

    Thousands are not separated where this makes the table fit.
    """
    shown = Table(
        title=table.title,
        title_justify="left",
        caption=table.note,
        caption_justify="left",
        show_edge=False,
        pad_edge=False,
    )
    widths = _fit_columns(table, screen.width)
    if widths is None:
        rows = tuple(tuple(cell.replace("\u202f", "") for cell in row) for row in table.rows)
        narrow = replace(table, rows=rows)
        widths = _fit_columns(narrow, screen.width)
        if widths is None:
            return _format_rows_as_text(table)
        table = narrow
    for i, (head, width) in enumerate(zip(table.heads, widths, strict=True)):
        side: Literal["left", "right"] = "left" if i < table.text_columns else "right"
        shown.add_column(escape(head), justify=side, width=width)
    for row in table.rows:
        shown.add_row(*(Text(cell, style=STYLES.get(cell, "")) for cell in row))
    return shown


def _fit_columns(table: ReportTable, width: int) -> list[int] | None:
    """Return the widths of a table's columns within `width`; None if a word would be broken.

    Rich shortens the widest column below its longest word, so that rows lose what differs in them.
    """
    columns = list(zip(table.heads, *table.rows, strict=True))
    widest = [max(map(cell_len, column)) for column in columns]
    least = [
        max(cell_len(word) for text in column for word in re.split("[ \n]", text))
        for column in columns
    ]
    spare = width - len(_BETWEEN) * (len(columns) - 1) - sum(least)
    if spare < 0:
        return None
    wanted = [most - own for most, own in zip(widest, least, strict=True)]
    share = min(1.0, spare / max(1, sum(wanted)))
    return [own + int(share * more) for own, more in zip(least, wanted, strict=True)]


def _format_rows_as_text(table: ReportTable) -> Text:
    """Return the rows of a report's table as paragraphs of text."""
    named = table.text_columns
    rows = [
        format_heading_and_paragraphs(
            ", ".join(row[:named]),
            ["; ".join(f"{h} {c}" for h, c in zip(table.heads[named:], row[named:], strict=True))],
        )
        for row in table.rows
    ]
    text = make_unstyled_text("\n".join([table.title, *rows, wrap_paragraph(table.note)]))
    for word, style in STYLES.items():
        text.highlight_words([f" {word}"], style)
    return text


def print_ending(page: Path, rows: list[tuple[str, str]], arguments: argparse.Namespace) -> int:
    """Print a report's results as table or JSON, or its page's path; return the exit code.

    Returns the exit code: 1 with `--strict` if a ship does not stay on station.
    """
    if arguments.json:
        texts = {"page": str(page)}
        for head, text in rows:
            texts[head] = f"{texts[head]}\n{text}" if head in texts else text
        print(json.dumps(texts, ensure_ascii=False, indent=2))
    elif arguments.quiet:
        print(page)
    else:
        screen = make_console()
        screen.width = min(screen.width, WIDTH)
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for head, text in [*rows, ("page", str(page))]:
            table.add_row(Text(head, "dim"), Text(text, ENDING_STYLES.get(head, "")))
        screen.print(table)
    if arguments.open:
        webbrowser.open(page.resolve().as_uri())
    warning = dict(rows).get("warning", "")
    if arguments.strict and warning:
        print(f"dpbench: {warning}", file=sys.stderr)
    return int(bool(arguments.strict and warning))


RATE_S = 5.0
"""Time after which the rate of finished work is known: before, one batch would set it [s]."""


class _TimeLeftColumn(ProgressColumn):
    """Time left at the mean rate since the start; empty before a rate is known.

    Rich takes the rate between the last reports: two results of one batch are microseconds apart.
    """

    max_refresh = 0.5

    def render(self, task: Task) -> Text:
        """Return `left` and the time as hours, minutes and seconds."""
        elapsed_s = task.elapsed or 0.0
        if not task.total or task.completed <= 0.0 or elapsed_s < RATE_S:
            return Text("")
        left_s = elapsed_s * max(task.total - task.completed, 0.0) / task.completed
        return Text(f"left {timedelta(seconds=math.ceil(left_s))}", style="progress.remaining")


class _ShareColumn(TextColumn):
    """Share of finished work; empty where the work is not counted."""

    def render(self, task: Task) -> Text:
        """Return the share as text."""
        return super().render(task) if task.total else Text("")


class ProgressBar:
    """A progress bar with the time left on a terminal, which may vanish at the end or be hidden.

    Without a terminal there are lines on standard error instead.
    """

    def __init__(self, *, transient: bool = False, quiet: bool = False) -> None:
        self._quiet, self._is_shown = quiet, _can_erase()
        self._progress = Progress(
            TextColumn("{task.description:<44}", markup=False),
            BarColumn(),
            _ShareColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            _TimeLeftColumn(),
            transient=transient,
            disable=quiet or not self._is_shown,
        )
        self._task = self._progress.add_task("starting", total=None)
        self._lines = ProgressLines()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *error: object) -> None:
        if self._progress.live.is_started:
            self._progress.stop()

    def start(self, work: int) -> None:
        """Show the progress bar with the total amount of work; 0 where it is not counted."""
        self._progress.start()
        self._progress.update(self._task, total=work or None)
        self._lines.start(work)

    def remark(self, text: str) -> None:
        """Print a line above the progress bar, or on standard error without a bar, unless quiet."""
        if not self._progress.disable:
            self._progress.console.print(f"dpbench: {text}", highlight=False, markup=False)
        elif not self._quiet:
            self._lines.remark(text)

    def waiting(self, text: str) -> None:
        """Print why the program waits on standard error, even if the progress bar is quiet."""
        self._lines.waiting(text)

    def advance(self, work: int, what: str) -> None:
        """Add finished work to the progress bar and show what it was."""
        self._progress.update(self._task, advance=work, description=what[:44])
        if not (self._quiet or self._is_shown):
            self._lines.advance(work, what)


def _can_erase() -> bool:
    """Return whether standard output is a terminal that can erase a line."""
    console = Console()
    return console.is_terminal and not console.is_dumb_terminal
