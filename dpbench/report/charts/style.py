"""Style of all figures: colours, shapes, fonts, axes, legends, tooltips."""

import json
from collections.abc import Iterable, Sequence
from typing import Any

import altair as alt

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
INK, SOFT, LINE, GRID, ACCENT = "#1d2733", "#5b6876", "#c9d1d9", "#e7ebef", "#0b6e99"
PAPER = "#ffffff"
PASS, FAIL, INCONCLUSIVE, NOT_RUN = "#1b7f5c", "#c2410c", "#b7791f", "#9aa5b1"
LATE, BORDERLINE = "#6b4fa3", "#4d7c0f"
STATE_COLOURS = (PASS, BORDERLINE, INCONCLUSIVE, LATE, FAIL, NOT_RUN)
"""Colours of the verdicts, in the order of `analysis.verdict.findings.STATES`."""
FILLS = ("#d7efe6", "#e9f2cf", "#faeccc", "#e6dff5", "#f9d8c4", "#eef1f4")
STATE_SHAPES = ("circle", "triangle-up", "diamond", "triangle-right", "cross", "square")
"""Shapes repeat the colours, so that either suffices to read a figure."""
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
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f", "#8c510a")
FLOOR = 1e-16
"""Smaller errors are drawn here."""
ERROR = "largest error of the first move [maximum increments]"
"""Title of an axis or a tooltip's entry."""
NAMES = "names"
"""Layer with labels of the field `solver`, left out where there is no room."""


def names_scale(names: Iterable[str], looks: Iterable[Any]) -> alt.Scale:
    """Return a chart scale that maps names to colours, shapes or dashes."""
    return alt.Scale(domain=list(names), range=list(looks))


def colour(
    field: str, names: Iterable[str], colours: Iterable[str], *, title: Any = None, **legend: Any
) -> alt.Color:
    """Return a chart's colour encoding by name, with a legend below."""
    scale = names_scale(names, colours)
    return alt.Color(f"{field}:N", scale=scale, title=title, legend=legend_below(**legend))


def pick_selection(*fields: str) -> alt.Parameter:
    """Return the chart selection named `pick`, set by a click to the clicked mark's fields."""
    return alt.selection_point(name="pick", fields=list(fields), on="click", empty=False)


def narrow_flag() -> alt.Parameter:
    """Return the chart parameter `narrow`, which the page sets on small screens."""
    return alt.param(name="narrow", value=False)


ROW_STEP = {"wide": 22, "narrow": 36}
"""Height of a row, with its name beside or above the marks [px]."""


def row_name_axis(limit: int = 260, **options: Any) -> alt.Axis:
    """Return an axis with row names beside the chart, or above each row on a small screen.

    limit : of their length beside the figure [px].
    """

    def at(narrow: object, wide: object) -> alt.ExprRef:
        return alt.ExprRef(f"narrow ? {narrow} : {wide}")

    return alt.Axis(
        labelLimit=at(340, limit),
        labelAlign=at("'left'", "'right'"),
        labelOffset=at(-12, 0),
        labelPadding=at(-4, 3),
        tickSize=at(0, 5),
        zindex=1,  # a name above its bar is written on what marks the row
        **options,
    )


def log_scale(**options: Any) -> alt.Scale:
    """Return a logarithmic chart scale."""
    return alt.Scale(type="log", **options)


def legend_below(**options: Any) -> alt.Legend:
    """Return a chart legend placed below its chart."""
    return alt.Legend(orient="bottom", **options)


def tooltip(field: str, title: Any = alt.Undefined, digits: int = 4) -> Any:
    """Return a chart's tooltip entry: a text, or a number with so many significant digits."""
    form = alt.Undefined if field.endswith(":N") else f".{digits}~g"
    return alt.Tooltip(field, title=title, format=form)


def tooltips(*entries: Any) -> list[Any]:
    """Return a chart's tooltip of entries and of fields, which are titled by their names."""
    # Altair takes 2 ms for each plain string: it hashes all classes of its schema.
    return [alt.Tooltip(entry) if isinstance(entry, str) else entry for entry in entries]


def describe_marks(chart: Any, tips: Sequence[Any]) -> Any:
    """Return a chart with its tooltip's labels and values as the text that screen readers read.

    As in the page's tooltips, a value that is missing or "–" is left out, with its label.
    """
    parts: list[str] = []
    for tip in tips:
        known = tip.to_dict()
        value = f"datum.{known['field']}"
        shown = f"format({value}, '{known['format']}')" if "format" in known else value
        label = known.get("title", known["field"])
        said = f"{json.dumps(('. ' if parts else '') + f'{label}: ')} + {shown}"
        parts.append(f"(isValid({value}) && {value} !== '–' ? {said} : '')")
    return chart.transform_calculate(said=" + ".join(parts)).encode(
        description=alt.Description("said:N")
    )


def value_if(test: Any, yes: object, no: object) -> Any:
    """Return a chart encoding with one value where a test holds, and another elsewhere."""
    return alt.condition(test, alt.value(yes), alt.value(no))


def named_rows(field: str, names: Sequence[str] | None, **axis: Any) -> alt.Y:
    """Return a chart's y axis with a row for each name, in this order; None: in data order."""
    return alt.Y(f"{field}:N", title=None, sort=names, axis=alt.Axis(**axis))


def inline_chart(*values: dict[str, Any], name: Any = alt.Undefined) -> alt.Chart:
    """Return a chart of a few given rows, or of a named table that the page fills."""
    return alt.Chart(alt.InlineData(values=list(values), name=name))


def draw_limit_rule(limit: float, across: str = "y") -> Any:
    """Return a chart layer with a dashed line at a limit on time or error."""
    rule = inline_chart({"limit": limit}).mark_rule(color=FAIL, strokeDash=[4, 3])
    return rule.encode(**{across: "limit:Q"})


def draw_whole_rows(base: alt.Chart, shown: Any, wide: int = ROW_STEP["wide"], **look: Any) -> Any:
    """Return a chart layer with a bar over the whole width and height of each row."""
    height = alt.ExprRef(f"narrow ? {ROW_STEP['narrow']} : {wide}")
    ends: dict[str, Any] = {"x": alt.value(0), "x2": alt.value("width")}
    return base.mark_rule(strokeWidth=height, **look).encode(**ends, opacity=shown)


def draw_equality_line(low: float, high: float, x: alt.X, y: alt.Y) -> Any:
    """Return a chart layer with the line x = y, for a chart that compares two quantities."""
    fields = [str(axis.shorthand).removesuffix(":Q") for axis in (x, y)]
    ends = [dict.fromkeys(fields, end) for end in (low, high)]
    return inline_chart(*ends).mark_line(color=SOFT, strokeDash=[4, 3]).encode(x=x, y=y)


_WORDS: dict[str, Any] = {
    "labelFontSize": 12,
    "titleFontSize": 12,
    "titleFontWeight": "normal",
    "labelColor": INK,
    "titleColor": SOFT,
}


_NUMBERS = {
    "decimal": ".",
    "thousands": "\u202f",
    "grouping": [3],
    "currency": ["", ""],
    "percent": " %",
}
"""Format of numbers: thin spaces between thousands and a space before %, as in texts."""


def set_style(chart: Any, title: str, description: str) -> Any:
    """Set title, description and common style of a chart in place; return the chart."""
    # Altair's own methods would copy all of its parts.
    chart.title = alt.Title(title, anchor="start", fontSize=13, fontWeight=600, color=INK, offset=8)
    chart.description = description
    chart.background = "transparent"
    chart.config = alt.Config(
        font=FONT,
        axis=alt.AxisConfig(**_WORDS, gridColor=GRID, domainColor=LINE, tickColor=LINE),
        legend=alt.LegendConfig(**_WORDS, symbolType="circle"),
        view=alt.ViewConfig(stroke=None),
        text=alt.MarkConfig(color=INK),
        locale={"number": _NUMBERS},
    )
    return chart
