"""A table of the report: heads, cells of text, and the note that states its population."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dpbench.display import table_html


@dataclass(frozen=True)
class Table:
    """A table of the report.

    Parameters
    ----------
    title : its heading; note : population, route, machine, and what a failure counted as.
    heads : column heads with units; `text_columns` leading ones are left-aligned.
    rows : cells, one tuple a row.
    """

    title: str
    note: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text_columns: int = 1


def head_and_rows(
    rows: Sequence[Mapping[str, str]],
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """The head of a table and its cells, from rows with the head beside each cell."""
    return tuple(rows[0]), tuple(tuple(row.values()) for row in rows)


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """A pipe table of Markdown; columns after the first `text_columns` are right-aligned."""
    align = [":--" if i < text_columns else "--:" for i in range(len(heads))]
    return "\n".join(map(_line, [heads, align, *rows]))


def document(title: str, lines: Sequence[str], tables: Sequence[Table]) -> str:
    """A Markdown document: the lines as a list, then every table under its title and note."""
    parts = [f"# {title}", "\n".join(f"- {line}" for line in lines)]
    parts += [
        f"## {t.title}\n\n{t.note}\n\n{markdown(t.heads, t.rows, t.text_columns)}" for t in tables
    ]
    return "\n\n".join(parts) + "\n"


def html(table: Table) -> str:
    """The table as plain HTML, for a notebook."""
    return table_html(table.heads, table.rows, title=table.title, note=table.note)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
