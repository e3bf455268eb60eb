"""The ways out of a figure: Vega for a page, SVG, PDF and PNG, without a browser."""

import io
import json
import math
import re
import resource
import subprocess
import sys
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import altair as alt
import psutil
import vl_convert as vlc

from dpbench.errors import SituationError
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.charts.style import FONT, NAMES

FORMATS = ("svg", "pdf", "png")
# The renderer aborts the process on an SVG that is no XML.
_NOT_IN_XML = re.compile(r"(?<!\\)((?:\\\\)*)\\(?:[bf]|u00[01][0-9a-f]|ufff[ef])")
"""Characters that XML does not have, as JSON writes them, behind an even number of backslashes."""


class _ChartKey:
    """Cache key by which two charts are equal only if they are the same object."""

    def __init__(self, chart: Any) -> None:
        self.chart = chart

    def __hash__(self) -> int:
        return id(self.chart)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ChartKey) and other.chart is self.chart


def compile_vega(chart: Any) -> dict[str, Any]:
    """Return the Vega specification of an Altair chart, without its title."""
    compiled: dict[str, Any] = json.loads(_compile_chart(_ChartKey(chart)))
    return {name: value for name, value in compiled.items() if name != "title"}


def render_svg(chart: Any, *, titled: bool = True) -> str:
    """Return a chart as SVG, with text as text instead of outlines."""
    return _svg_of(_compile_chart(_ChartKey(chart)) if titled else json.dumps(compile_vega(chart)))


PROBE = """
import resource, sys
import vl_convert
_, hard = resource.getrlimit(resource.RLIMIT_AS)
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]), hard))
vl_convert.vega_to_svg({"width": 1, "height": 1, "marks": []})
"""
NOT_DRAWN = "not drawn: their renderer needs more address space than the limit (ulimit -v) leaves"


@cache
def can_draw() -> bool:
    """Return whether the process may use enough memory (address space) to render charts."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return True
    rest = max(0, limit - psutil.Process().memory_info().vms)
    command = [sys.executable, "-c", PROBE, str(rest)]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


_svg_of = lru_cache(maxsize=64)(vlc.vega_to_svg)


@lru_cache(maxsize=64)
def _compile_chart(chart: _ChartKey) -> str:
    """Return an Altair chart as Vega JSON, with labels that avoid each other."""
    if not can_draw():
        raise SituationError("figures", f"{NOT_DRAWN}; remove the limit or set it to 80 GB")
    # The tests validate every figure against the grammar, which takes longer than drawing it.
    with alt.data_transformers.enable("default", max_rows=None):
        plain = chart.chart.to_dict(validate=False)
    try:
        text = json.dumps(plain, allow_nan=False)
    except ValueError:
        text = json.dumps(_replace_not_finite_by_none(plain))
    simple = _NOT_IN_XML.sub(r"\1 ", text)
    specification: dict[str, Any] = vlc.vegalite_to_vega(simple, vl_version=_newest_grammar())
    marks = specification["marks"]
    if any(mark.get("name") == f"{NAMES}_marks" for mark in marks):
        marks.append(_label_mark())
    return json.dumps(specification)


def _replace_not_finite_by_none(value: Any) -> Any:
    """Return a chart's JSON value with None for NaN and infinity, which JSON does not have.

    Altair does so in columns of numbers, but not where a column also has texts, such as "inf".
    """
    if isinstance(value, dict):
        return {name: _replace_not_finite_by_none(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_replace_not_finite_by_none(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _label_mark() -> dict[str, Any]:
    """Return the Vega mark of solver names beside points, where there is room."""
    place = {
        "type": "label",
        "size": {"signal": "[width, height]"},
        "anchor": ["right", "left", "top", "bottom"],
        "offset": [3],
        # Keeping off the points takes a canvas, which only a browser has.
        "avoidBaseMark": False,
        "sort": {"field": "datum.datum.time"},  # the fastest has its name first
    }
    look = {
        "text": {"field": "datum.solver"},
        "fill": {"field": "fill"},
        "font": {"value": FONT},
        "fontSize": {"value": 12},
    }
    return {
        "type": "text",
        "from": {"data": f"{NAMES}_marks"},
        "encode": {"update": look},
        "interactive": False,
        "transform": [place],
    }


def encode_figure(chart: Any, kind: str) -> bytes:
    """Return a chart encoded as SVG, PDF, PNG or self-contained HTML."""
    if kind == "html":
        page = io.StringIO()
        chart.save(page, format="html", inline=True)
        return page.getvalue().encode()
    if kind == "svg":
        return render_svg(chart).encode()
    drawn = _compile_chart(_ChartKey(chart))
    made: bytes = vlc.vega_to_pdf(drawn) if kind == "pdf" else vlc.vega_to_png(drawn, scale=2)
    return made


def save_figure(chart: Any, path: Path) -> Path:
    """Write a chart to a file, in the format of the name's ending; return the path."""
    write_bytes_to_file_or_pipe(path, encode_figure(chart, path.suffix.lstrip(".")))
    return path


@cache
def _newest_grammar() -> str:
    """Return the newest Vega-Lite version that compiler and charts both have."""
    wanted = ".".join(alt.SCHEMA_VERSION.lstrip("v").split(".")[:2])
    known = list(vlc.get_vegalite_versions())
    return wanted if wanted in known else max(known, key=lambda v: [int(x) for x in v.split(".")])
