"""Fixed words with numbers put in: templates of text, with the formats of the report as filters."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from dpbench.display import numbers_text
from dpbench.report import formats

FILTERS = {
    "and_list": formats.and_list,
    "count": formats.count_text,
    "error": formats.error_text,
    "numbers": numbers_text,
    "plural": formats.plural,
    "seconds": formats.seconds_text,
    "share": formats.share_text,
    "significant": formats.significant,
    "time": formats.time_text,
}


@cache
def _environment() -> Environment:
    made = Environment(
        loader=PackageLoader("dpbench.report.documents", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= FILTERS
    made.tests["finite"] = math.isfinite
    made.globals["inf"] = math.inf
    return made


def filled(words: str, **values: Any) -> str:
    """Words that are a template themselves, with values."""
    return _environment().from_string(words).render(values)


def document(template: str, **values: Any) -> str:
    """A document out of `documents/templates`; it ends with the end of a line."""
    return _environment().get_template(f"{template}.j2").render(values) + "\n"
