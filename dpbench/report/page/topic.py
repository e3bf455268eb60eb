"""What a section below the selection is made of: lines, static figures and small tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from dpbench.report.formats import unmarked


@dataclass(frozen=True)
class Figure:
    """A static figure: the name of its file, the chart, and a line below it."""

    name: str
    chart: Any
    caption: str


@dataclass(frozen=True)
class SmallTable:
    """A table of a topic, of text alone.

    Its file has all rows, the page the first `shown`: by default all, with 0 no table. One that is
    `folded` opens with a click.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    shown: int | None = None
    folded: bool = False

    @property
    def on_page(self) -> SmallTable:
        """What is shown, without the marks of Markdown, which a page would show too."""
        rows = self.rows[: self.shown]
        return replace(self, rows=tuple(tuple(unmarked(c) for c in r) for r in rows))


@dataclass(frozen=True)
class Topic:
    """A section made of lines, figures, tables and a text to paste elsewhere.

    `short` is what a line of links calls it, by default its title. The one that `leads` is what the
    suite asks: it stands in the answer, its first line the answer.
    """

    id: str
    title: str
    lines: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    tables: tuple[SmallTable, ...] = ()
    paste: str = ""
    leads: bool = False
    short: str = ""
