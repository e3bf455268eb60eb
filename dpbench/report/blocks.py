"""What a page is made of: sections of paragraphs, lists, cards, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from matplotlib.figure import Figure

from dpbench.report.table import Mark, Table


@dataclass(frozen=True)
class Paragraph:
    """Running text; `code` and **bold** are its only markup."""

    kind: ClassVar[str] = "paragraph"
    text: str
    lead: bool = False


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]


@dataclass(frozen=True)
class Card:
    """One figure of the verdict: what, how much, and the words below it."""

    title: str
    value: str
    text: str
    mark: Mark = ""


@dataclass(frozen=True)
class Cards:
    """A row of cards."""

    kind: ClassVar[str] = "cards"
    cards: tuple[Card, ...]


@dataclass(frozen=True)
class Tabular:
    """A table on a page."""

    kind: ClassVar[str] = "table"
    table: Table


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its caption; it becomes `figures/<name>.svg`."""

    kind: ClassVar[str] = "picture"
    name: str
    title: str
    caption: str
    figure: Figure

    @property
    def file(self) -> str:
        """Where it goes, relative to the page."""
        return f"figures/{self.name}.svg"


Block = Paragraph | Bullets | Cards | Tabular | Picture


@dataclass(frozen=True)
class Section:
    """A section of the page; `key` is its anchor."""

    key: str
    title: str
    blocks: list[Block] = field(default_factory=list)

    def add(self, *blocks: Block) -> None:
        """Append blocks."""
        self.blocks.extend(blocks)


@dataclass(frozen=True)
class Page:
    """The whole report."""

    title: str
    subtitle: str
    sections: list[Section]
    facts: list[tuple[str, str]]

    @property
    def pictures(self) -> list[Picture]:
        """All its figures."""
        return [b for s in self.sections for b in s.blocks if isinstance(b, Picture)]


def missing(what: str) -> Paragraph:
    """The sentence that stands where the records hold nothing to show."""
    return Paragraph(f"Missing: {what}")
