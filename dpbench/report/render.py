"""Turn a page into Markdown and into one self-contained HTML file."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from dpbench.report.blocks import Page
from dpbench.report.table import markdown

_MARKUP = (
    (re.compile(r"`([^`]+)`"), r"<code>\1</code>"),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<strong>\1</strong>"),
    (re.compile(r"\*([^*]+)\*"), r"<em>\1</em>"),
)


def inline(text: str) -> Markup:
    """`code`, **bold** and *emphasis* as HTML; everything else escaped."""
    found = str(escape(text))
    for pattern, replacement in _MARKUP:
        found = pattern.sub(replacement, found)
    return Markup(found)  # escaped above; only the three tags are added


def render_markdown(page: Page) -> str:
    """The page as Markdown; pictures are referenced by relative path."""
    environment = _environment(autoescape=False)
    environment.filters["table"] = markdown
    text = environment.get_template("report.md.j2").render(page=page)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def render_html(page: Page, pictures: Mapping[str, bytes]) -> str:
    """The page as HTML with style and pictures (SVG bytes by name) inside."""
    environment = _environment(autoescape=True)
    environment.filters["inline"] = inline
    data = {
        name: f"data:image/svg+xml;base64,{base64.b64encode(svg).decode('ascii')}"
        for name, svg in pictures.items()
    }
    return environment.get_template("report.html.j2").render(page=page, data=data) + "\n"


def _environment(*, autoescape: bool) -> Environment:
    return Environment(
        loader=PackageLoader("dpbench.report"),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
