"""The glossary: every term that is printed, out of one file, as pages and tooltips need it."""

import tomllib
from functools import cache
from pathlib import Path

_FILE = Path(__file__).with_name("glossary.toml")
_HEAD = "# Glossary\n\nEvery term that dpbench prints. Columns stand in the reference of columns.\n"


@cache
def topics() -> dict[str, dict[str, str]]:
    """Return the glossary as a dictionary: for each topic title, the meanings by term."""
    tables = tomllib.loads(_FILE.read_text(encoding="utf-8"))
    return {table.pop("title"): table for table in tables.values()}


@cache
def term_meanings() -> dict[str, str]:
    """Return the meaning of each term of the glossary."""
    return {term: text for terms in topics().values() for term, text in terms.items()}


def format_glossary_as_markdown() -> str:
    """Return the glossary as Markdown, the text of `docs/glossary.md`."""
    parts = [_HEAD]
    for title, terms in topics().items():
        rows = "\n".join(
            f"| {term} | {text.replace('|', '&#124;')} |" for term, text in terms.items()
        )
        parts.append(f"## {title}\n\n| term | meaning |\n|---|---|\n{rows}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    print(format_glossary_as_markdown(), end="")
