"""The fenced blocks of a page of the documentation, as a reader follows them."""

import re
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
README = DOCS.parent / "README.md"
_BLOCK = re.compile(
    r"(?:^<!-- tested as:\n(?P<instead>.*?)\n-->\n)?"
    r'^```(?P<language>\w+)(?: title="(?P<title>[\w./-]+)")?\n(?P<body>.*?)\n```$',
    re.M | re.S,
)


@dataclass(frozen=True)
class Block:
    """A block: its language, the file it is saved as, its text, what a test runs in its place."""

    language: str
    title: str
    body: str
    instead: str

    @property
    def commands(self) -> list[str]:
        return self.body.splitlines()

    @property
    def tested(self) -> list[str]:
        return (self.instead or self.body).splitlines()


def blocks_of(page: Path) -> list[Block]:
    found = _BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [
        Block(part["language"], part["title"] or "", part["body"], part["instead"] or "")
        for part in found
    ]
