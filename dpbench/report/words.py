"""Fixed words with numbers put in, and the glossary of every term that is printed.

Words are templates of text, with the formats of the report as filters.
"""

import math
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from dpbench.display import format_numbers_with_units
from dpbench.report import formats

FILTERS = {
    "and_list": formats.join_with_and,
    "count": formats.format_count,
    "error": formats.format_error,
    "numbers": format_numbers_with_units,
    "plural": formats.plural,
    "seconds": formats.format_seconds,
    "share": formats.format_share,
    "significant": formats.significant,
    "time": formats.format_time,
    "toml": formats.format_as_toml,
}
_FILE = Path(__file__).with_name("glossary.toml")
_HEAD = """# Glossary

The [column reference](../dpbench/bench/record/schema.toml) describes the columns of the
result tables and their values.
"""


@cache
def _template_environment() -> Environment:
    """Return the Jinja environment of the report's documents."""
    made = Environment(
        loader=PackageLoader("dpbench.report.documents", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= FILTERS
    made.tests["finite"] = math.isfinite
    made.globals["inf"] = math.inf
    return made


@cache
def _compile_template(words: str) -> Template:
    """Return a text compiled to a Jinja template; cached by text."""
    return _template_environment().from_string(words)


def fill_template(words: str, **values: Any) -> str:
    """Return a text that is itself a Jinja template, filled with given values."""
    return _compile_template(words).render(values)


def render_document(template: str, **values: Any) -> str:
    """Return a document rendered from a template in `documents/templates`."""
    return _template_environment().get_template(f"{template}.j2").render(values)


@cache
def read_words(module: str) -> dict[str, Any]:
    """Return a module's texts from the TOML file of the same name beside it."""
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))


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
