"""A table of the report: heads, cells of text, and the note that states its population."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import pandas as pd

from dpbench.display import table_html
from dpbench.report.escaped import markdown_cell, markdown_line, markdown_text
from dpbench.report.formats import unmarked


@dataclass(frozen=True)
class Table:
    """Table of text.

    Parameters
    ----------
    heads : with units; note : population, route, machine, and what a failure counted as.
    text_columns : so many leading ones are left-aligned.
    shown : number of rows on the page, by default all, with 0 no table; a file has all of them.
    folded : whether it opens there with a click.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    note: str = ""
    text_columns: int = 1
    shown: int | None = None
    folded: bool = False

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, str]], title: str = "", **more: Any) -> Self:
        """Build the table of one row or more, each cell under its head."""
        return cls(tuple(rows[0]), tuple(tuple(row.values()) for row in rows), title, **more)

    @property
    def page_rows(self) -> list[list[str]]:
        """What a page shows, without the marks of Markdown, which it would show too."""
        return [[unmarked(cell) for cell in row] for row in self.rows[: self.shown]]

    @property
    def frame(self) -> pd.DataFrame:
        """All of it, as its file has it."""
        return pd.DataFrame(self.rows, columns=list(self.heads))

    @property
    def cut(self) -> int:
        """How many rows that leaves out."""
        return len(self.rows[self.shown :]) if self.shown is not None else 0


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """Return a Markdown table; columns after the first `text_columns` are right-aligned."""
    align = [":--" if i < text_columns else "--:" for i in range(len(heads))]
    return "\n".join(map(_line, [heads, align, *rows]))


def document(title: str, lines: Sequence[str], tables: Sequence[Table]) -> str:
    """Return a Markdown document: the lines as a list, then the tables with titles and notes."""
    parts = [f"# {markdown_text(title)}", "\n".join(f"- {markdown_text(line)}" for line in lines)]
    parts += [
        f"## {markdown_text(t.title)}\n\n{markdown_line(t.note)}\n\n"
        f"{markdown(t.heads, t.rows, t.text_columns)}"
        for t in tables
    ]
    return "\n\n".join(parts) + "\n"


def html(table: Table) -> str:
    """Return the table as plain HTML, for a notebook."""
    return table_html(table.heads, table.rows, title=table.title, note=table.note)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(markdown_cell, cells))} |"
