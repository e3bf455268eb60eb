"""What all figures share: colours, shapes, fonts, and the ways out of a specification."""

from __future__ import annotations

import json
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import altair as alt
import vl_convert as vlc

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
INK, SOFT, LINE, ACCENT = "#1d2733", "#5b6876", "#c9d1d9", "#0b6e99"
MEETS, MISSES, OPEN, NOT_RUN = "#1b7f5c", "#c2410c", "#b7791f", "#9aa5b1"
OUTCOMES = ("meets", "open", "misses", "not run")
OUTCOME_COLOURS = (MEETS, OPEN, MISSES, NOT_RUN)
OUTCOME_SHAPES = ("circle", "diamond", "cross", "square")
"""Colour and shape say the same, so that neither is needed to read a figure."""
FAMILY_COLOURS = {
    "active set": "#0072b2",
    "interior point": "#d55e00",
    "first order": "#009e73",
    "augmented Lagrangian": "#cc79a7",
    "baseline law": "#7f7f7f",
    "harness": "#9aa5b1",
    "not stated": "#525252",
}
"""Colour-blind safe (Okabe and Ito, Color Universal Design, 2008)."""
NAMES = "names"
"""A layer of points so called has names: the field `solver`, beside its point where it covers no
other name and left out where there is no room."""
FORMATS = ("svg", "pdf", "png")


def outcome_colour() -> alt.Scale:
    """Colours of the outcomes."""
    return alt.Scale(domain=list(OUTCOMES), range=list(OUTCOME_COLOURS))


def outcome_shape() -> alt.Scale:
    """Shapes of the outcomes."""
    return alt.Scale(domain=list(OUTCOMES), range=list(OUTCOME_SHAPES))


def styled(chart: Any, title: str, description: str) -> Any:
    """`chart` in the common style; the description is what a screen reader says."""
    return chart.properties(
        title=alt.Title(title, anchor="start", fontSize=13, fontWeight=600, color=INK, offset=8),
        description=description,
        background="transparent",
    ).configure(
        font=FONT,
        axis=alt.AxisConfig(
            labelFontSize=12,
            titleFontSize=12,
            titleFontWeight="normal",
            labelColor=INK,
            titleColor=SOFT,
            gridColor="#e7ebef",
            domainColor=LINE,
            tickColor=LINE,
        ),
        legend=alt.LegendConfig(
            labelFontSize=12,
            titleFontSize=12,
            titleFontWeight="normal",
            labelColor=INK,
            titleColor=SOFT,
            symbolType="circle",
        ),
        view=alt.ViewConfig(stroke=None),
        text=alt.MarkConfig(color=INK),
    )


def vega(chart: Any) -> dict[str, Any]:
    """The specification compiled to Vega, which a page needs the smaller library for; without the
    title, which stands above it there."""
    return _compiled(chart, titled=False)


def svg(chart: Any, *, titled: bool = True) -> str:
    """The figure as SVG with real text."""
    return _drawn(json.dumps(_compiled(chart, titled=titled)))


def _compiled(chart: Any, *, titled: bool = True) -> dict[str, Any]:
    """The specification as Vega, where names keep clear of each other: Vega-Lite cannot say so."""
    simple = _json(chart) | ({} if titled else {"title": None})
    specification: dict[str, Any] = json.loads(_in_vega(json.dumps(simple)))
    marks = specification["marks"]
    if any(mark.get("name") == f"{NAMES}_marks" for mark in marks):
        marks.append(_names())
    return specification


@lru_cache(maxsize=32)
def _in_vega(simple: str) -> str:
    """Kept, since a figure is asked for as a file, as a picture on the page and for the browser."""
    return json.dumps(vlc.vegalite_to_vega(simple, vl_version=_version()))


@lru_cache(maxsize=32)
def _drawn(specification: str) -> str:
    return vlc.vega_to_svg(specification)


def _names() -> dict[str, Any]:
    """Names of the points of the layer `NAMES`."""
    place = {
        "type": "label",
        "size": {"signal": "[width, height]"},
        "anchor": ["right", "left", "top", "bottom"],
        "offset": [3],
        # Keeping off the points takes a canvas, which only a browser has.
        "avoidBaseMark": False,
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


def save(chart: Any, path: Path) -> Path:
    """Write the figure in the format that the name of the file ends with."""
    kind = path.suffix.lstrip(".")
    if kind == "svg":
        path.write_text(svg(chart), encoding="utf-8")
    elif kind == "pdf":
        path.write_bytes(vlc.vega_to_pdf(_compiled(chart)))
    else:
        path.write_bytes(vlc.vega_to_png(_compiled(chart), scale=2))
    return path


def _json(chart: Any) -> dict[str, Any]:
    # The tests validate every figure against the grammar, which takes longer than drawing it.
    with alt.data_transformers.enable("default", max_rows=None):
        specification: dict[str, Any] = chart.to_dict(validate=False)
    return specification


@cache
def _version() -> str:
    """The newest version of the grammar that the compiler has, up to that of the charts."""
    wanted = ".".join(alt.SCHEMA_VERSION.lstrip("v").split(".")[:2])
    known = list(vlc.get_vegalite_versions())
    return wanted if wanted in known else max(known, key=lambda v: [int(x) for x in v.split(".")])
