"""Parts of the page: sections that follow the selection, and topics below them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dpbench.bench.record.result_folder import Results
from dpbench.report.formats import Table
from dpbench.report.page.data import PageData


@dataclass(frozen=True)
class Section:
    """Part of the report page that follows the reader's selection: charts, data, text.

    charts : its figures by name; without any it is left out, unless it is shown `always`.
    drawn : those on the page before any script has run; live : filled by its script alone.
    data : further data of its script, by name; in_topic : part of the topic of the same id.
    text : shown; folded_text : shown after a click.
    """

    id: str
    name: str
    charts: Callable[[PageData], dict[str, Any]] = lambda _: {}
    drawn: tuple[str, ...] = ()
    data: Callable[[PageData, Results], dict[str, Any]] = lambda *_: {}
    text: Callable[[PageData], str] = lambda _: ""
    folded_text: Callable[[PageData], str] = lambda _: ""
    always: bool = False
    live: bool = False
    in_topic: bool = False

    @property
    def template(self) -> str:
        """File name of the HTML template of this section of the page."""
        return f"{self.id}.html.j2"


@dataclass(frozen=True)
class Figure:
    """Static figure: its file name, the chart, and a caption."""

    name: str
    chart: Any
    caption: str


@dataclass(frozen=True)
class Topic:
    """Part of the report page on one question: text lines, charts, tables, a text to paste.

    `short` is its name in the line of links, by default its title. The topic that `leads` is the
    question of the suite: its first line is the answer of the page.
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
        """Name of this part of the page in the page's row of links."""
        return self.short or self.title
