"""Files of a generated controller from their templates; numbers that read back to the same bits."""

import textwrap
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from dpbench.arrays import Vector

_WIDTH = 96


@dataclass(frozen=True)
class Table:
    """A constant array of C: name, meaning, shape as text, type and bytes of an entry."""

    name: str
    meaning: str
    kind: str
    shape: str
    body: str
    bytes: int


def format_number_for_c(x: float) -> str:
    """Return a floating-point number as C text, exact.

    Examples
    --------
    >>> format_number_for_c(0.1), format_number_for_c(3.0), format_number_for_c(1e300)
    ('0.1', '3.0', '1e+300')
    """
    return repr(float(x))


def make_c_table(name: str, values: object, meaning: str) -> Table:
    """Return an array of numbers, of one dimension or two, as a C table; whole numbers as int."""
    array = np.asarray(values)
    whole = array.dtype.kind in "iu"
    if not whole and not np.isfinite(array).all():
        raise ValueError(f"{name}: an entry of a table is not finite")
    shape = "".join(f"[{size}]" for size in array.shape)
    body = (
        _format_vector_for_c(array, whole)
        if array.ndim == 1
        else ",\n".join(f"    {{\n{_format_vector_for_c(row, whole)}}}" for row in array)
    )
    size = array.size * (4 if whole else 8)
    return Table(name, meaning, "int" if whole else "double", shape, body, size)


def _format_vector_for_c(row: Vector, whole: bool) -> str:
    """Format a vector as wrapped lines of a C array."""
    text = ", ".join(str(int(x)) if whole else format_number_for_c(x) for x in row)
    return textwrap.fill(text, _WIDTH, initial_indent="    ", subsequent_indent="    ")


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
