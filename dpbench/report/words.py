"""Fixed words with numbers put in: templates of text, with the formats of the report as filters."""

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
    """Compile a text to a Jinja template; cached by text."""
    return _template_environment().from_string(words)


def fill_template(words: str, **values: Any) -> str:
    """Fill values into a text that is itself a Jinja template."""
    return _compile_template(words).render(values)


def render_document(template: str, **values: Any) -> str:
    """Render a document from a template in `documents/templates`."""
    return _template_environment().get_template(f"{template}.j2").render(values)


@cache
def read_words(module: str) -> dict[str, Any]:
    """Read a module's texts from the TOML file of the same name beside it."""
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))
