"""Markdown of generated pages: tables, prose that contains signs, docstrings."""

import inspect
import re
from collections.abc import Iterable, Sequence

SIGNS = str.maketrans(
    {"|": "&#124;", "<": "&lt;", "*": r"\*", "_": r"\_", "[": r"\[", "]": r"\]", "#": r"\#"}
)
SECTIONS = ("Parameters", "Returns", "Raises", "Yields", "Attributes")


def prose(text: str) -> str:
    """`text` on one line, its signs taken as they are; what stands in backticks stays code."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(code(p[1:-1]) if p.startswith("`") else p.translate(SIGNS) for p in parts)


def code(text: str) -> str:
    """`text` as code that may stand in a cell of a table; "" for nothing."""
    return f"`{text}`" if text and "|" not in text else text.translate(SIGNS)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; its cells are Markdown of one line."""
    lines = [" | ".join(heads), "|".join("---" for _ in heads)]
    lines += [" | ".join(cell or "–" for cell in row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def docstring(thing: object) -> str:
    """The docstring of `thing`, its sections as lists; "" without one."""
    blocks: list[str] = []
    section = ""
    for block in re.split(r"\n\s*\n", inspect.getdoc(thing) or ""):
        head, _, rest = block.partition("\n")
        if head == "Examples" and rest.startswith("-"):
            section = head
            blocks += [f"*{head}*", _example(rest.partition("\n")[2])]
        elif section == "Examples":
            blocks.append(_example(block))
        elif head in SECTIONS and rest.startswith("-"):
            section = head
            blocks += [f"*{head}*", _entries(rest.partition("\n")[2])]
        elif section:
            blocks.append(_entries(block))
        elif all(line.startswith("    ") for line in block.splitlines()):
            blocks.append(f"```text\n{inspect.cleandoc(block)}\n```")
        else:
            blocks.append(prose(block))
    return "\n\n".join(filter(None, blocks))


def _example(block: str) -> str:
    """A block of examples as code, or the text between them."""
    return f"```pycon\n{block}\n```" if block.startswith(">>> ") else prose(block)


def _entries(block: str) -> str:
    """The entries `name : text` of a section, continued by lines further in."""
    entries: list[str] = []
    for line in block.splitlines():
        if line.startswith(" ") and entries:
            entries[-1] += f" {line.strip()}"
        else:
            entries.append(line.strip())
    return "\n".join(f"- {_entry(entry)}" for entry in entries)


def _entry(text: str) -> str:
    # One line may hold several, "a, b : text; c : text".
    parts = (part.partition(" : ") for part in re.split(r"; (?=[\w, ]+ : )", text))
    return "; ".join(f"{code(n)}: {prose(t)}" if t else prose(n) for n, _, t in parts)
