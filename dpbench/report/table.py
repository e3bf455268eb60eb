"""Tables of text in Markdown, with words of others made harmless there."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from dpbench.display import make_html_table
from dpbench.report.formats import strip_markdown

_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_LINK = re.compile(r"\](?=[(\[:])")
_PIPE = re.compile(r"(\\*)\|")
_BLOCK = re.compile(r"^(?=#{1,6}(\s|$)|>|```|~~~|[-+*]\s|[-_*=]{3})")
_NOT_SHOWN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of characters that end a line, turn its direction or cannot be written."""


def one_line(text: str) -> str:
    """Replace line breaks and other characters that are not shown by spaces."""
    return "".join(" " if unicodedata.category(c) in _NOT_SHOWN else c for c in text)


def escape_markdown(text: str) -> str:
    """Escape text within a line of Markdown: no HTML, link or picture; marks such as ` stay."""
    return _LINK.sub(r"]\\", _TAG.sub("&lt;", one_line(text)))


def escape_markdown_paragraph(text: str) -> str:
    """Escape a paragraph of Markdown, so that it is no heading, list or block of code."""
    return _BLOCK.sub(r"\\", escape_markdown(text).lstrip())


def escape_markdown_cell(text: str) -> str:
    """Escape a text for a cell of a Markdown table."""
    return _PIPE.sub(r"\1\1\\|", escape_markdown(text))


@dataclass(frozen=True)
class Table:
    """Table of text with heads, a title and a note, for page, file and Markdown.

    heads : with units; text_columns : so many leading ones are left-aligned.
    shown : rows on the page, by default all, with 0 no table; folded : opens there with a click.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    note: str = ""
    text_columns: int = 1
    shown: int | None = None
    folded: bool = False

    @classmethod
    def from_rows(cls, rows: Sequence[Mapping[str, str]], title: str = "", **more: Any) -> Self:
        """Build a table from rows that map column heads to text cells."""
        return cls(tuple(rows[0]), tuple(tuple(row.values()) for row in rows), title, **more)

    @property
    def page_rows(self) -> list[list[str]]:
        """Rows of the table that the page shows, without Markdown marks."""
        return [[strip_markdown(cell) for cell in row] for row in self.rows[: self.shown]]

    @property
    def cut(self) -> int:
        """Number of the table's rows that the page leaves out."""
        return len(self.rows[self.shown :]) if self.shown is not None else 0


def make_markdown_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1
) -> str:
    """Return a Markdown table; columns after the first `text_columns` are right-aligned."""
    align = [":--" if i < text_columns else "--:" for i in range(len(heads))]
    lines = (" | ".join(map(escape_markdown_cell, cells)) for cells in [heads, align, *rows])
    return "\n".join(f"| {line} |" for line in lines)


def make_markdown_document(title: str, lines: Sequence[str], tables: Sequence[Table]) -> str:
    """Return a Markdown document: the lines as a list, then the tables with titles and notes."""
    parts = [
        f"# {escape_markdown(title)}",
        "\n".join(f"- {escape_markdown(line)}" for line in lines),
    ]
    parts += [
        f"## {escape_markdown(t.title)}\n\n{escape_markdown_paragraph(t.note)}\n\n"
        f"{make_markdown_table(t.heads, t.rows, t.text_columns)}"
        for t in tables
    ]
    return "\n\n".join(parts) + "\n"


def format_table_as_html(table: Table) -> str:
    """Return the table as plain HTML, which a notebook displays."""
    return make_html_table(table.heads, table.rows, title=table.title, note=table.note)
