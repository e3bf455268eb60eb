"""What a section below the selection is made of: lines, static figures and small tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dpbench.report.table import Table


@dataclass(frozen=True)
class Figure:
    """A static figure: the name of its file, the chart, and a line below it."""

    name: str
    chart: Any
    caption: str


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
    tables: tuple[Table, ...] = ()
    paste: str = ""
    leads: bool = False
    short: str = ""
