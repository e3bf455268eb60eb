"""Files of a generated controller from their templates."""

from functools import cache
from importlib.metadata import version
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def _make_c_template_environment() -> Environment:
    """Return the Jinja environment of the templates of generated C."""
    made = Environment(
        loader=PackageLoader("dpbench.codegen"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.globals["version"] = version("dpbench")
    return made


def render_c_template(template: str, **values: Any) -> bytes:
    """Return a file of the generated controller in UTF-8, from its template."""
    return _make_c_template_environment().get_template(f"{template}.j2").render(values).encode()
