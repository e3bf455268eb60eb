"""What the page is made of: sections that follow the selection, and topics below them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dpbench.bench.record.result_folder import Results
from dpbench.report.page.data import PageData
from dpbench.report.table import Table


def _nothing(*_: object) -> dict[str, Any]:
    return {}


@dataclass(frozen=True)
class Section:
    """A section that follows the selection: `templates/ID.html.j2` lays it out, `scripts/ID.js`
    draws it.

    Parameters
    ----------
    id, name : its anchor, and its name in the line of links.
    charts : its figures by name; without any it is left out, unless it is shown `always`.
    drawn : those of them that are on the page before any script has run.
    data : what its script needs beside configurations, experiments and cells, by name.
    text : what its template says of this page.
    live : whether its script alone fills it, so that a page without scripts leaves it out.
    in_topic : whether it is a part of the topic of the same id.
    """

    id: str
    name: str
    charts: Callable[[PageData], dict[str, Any]] = _nothing
    drawn: tuple[str, ...] = ()
    data: Callable[[PageData, Results], dict[str, Any]] = _nothing
    text: Callable[[PageData], str] = lambda _: ""
    always: bool = False
    live: bool = False
    in_topic: bool = False

    @property
    def template(self) -> str:
        """Its template, of `templates/`."""
        return f"{self.id}.html.j2"


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
    template = "topic.html.j2"

    @property
    def name(self) -> str:
        """Its name in the line of links."""
        return self.short or self.title
