"""A table of the report: heads, cells of text, and the note that states its population."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Mark = Literal["", "good", "bad", "warn", "quiet"]


@dataclass(frozen=True)
class Cell:
    """A cell of a table; `mark` is how it is tinted in HTML."""

    text: str
    mark: Mark = ""


@dataclass(frozen=True)
class Table:
    """A table of the report.

    Parameters
    ----------
    title : its heading; note : population, route, machine, and what a failure counted as.
    heads : column heads with units; `text_columns` leading ones are left-aligned.
    rows : cells, one tuple a row.
    folded : shown as an unfolding block in HTML.
    """

    title: str
    note: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    text_columns: int = 1
    folded: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.heads):
                raise ValueError(
                    f"table {self.title!r}: expected {len(self.heads)} cells, found {len(row)}"
                )


def row_of(*cells: str | Cell) -> tuple[Cell, ...]:
    """A row of cells; a string is a cell without a mark."""
    return tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in cells)


def markdown(table: Table) -> str:
    """The table as a Markdown pipe table, without title and note."""
    align = [":--" if i < table.text_columns else "--:" for i in range(len(table.heads))]
    lines = [_line(table.heads), _line(align)]
    lines += [_line([cell.text for cell in row]) for row in table.rows]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
