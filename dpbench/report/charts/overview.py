"""Overview of all solvers: deadline ladder, verdict matrix, accuracy against time."""

import json
from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Any

import altair as alt
import pandas as pd

from dpbench.analysis.verdict.requirements import STATES
from dpbench.report.charts import style
from dpbench.report.formats import drop_shared_options, format_rounded_down

MARKS = ("✓", "≈", "?", "▸", "✕", "–")
MOST_ACROSS = 30
"""Columns of a settings level, and half those of all levels, that leave room for names."""
_ERROR = (
    "isValid(datum.error) ? format(datum.error, "
    "datum.error > 0 && datum.error < 0.01 ? '.1e' : '.2~g') : '–'"
)
"""Text of an error in a tooltip, as by `format_error`."""
TILE, HEAD_LETTER = 30, 8
"""Width of a tile, and about that of a letter above a settings level [px]."""


def shorten_settings(levels: Sequence[str]) -> dict[str, str]:
    """Return short names of settings: those of a grid without the options that they share.

    Examples
    --------
    >>> shorten_settings(["high", "eps_abs=1e-5,rho=0.1", "eps_abs=1e-5,rho=1"])
    {'high': 'high', 'eps_abs=1e-5,rho=0.1': 'rho=0.1', 'eps_abs=1e-5,rho=1': 'rho=1'}
    """
    options = {level: level.split(",") for level in levels if "=" in level}
    shared = set.intersection(*map(set, options.values())) if len(options) > 1 else set[str]()
    kept = {
        level: ",".join(pair for pair in pairs if pair not in shared)
        for level, pairs in options.items()
    }
    return {level: kept.get(level) or level for level in levels}


def draw_verdict_tiles(table: pd.DataFrame, *, stacked: bool = False) -> Any:
    """Return a chart with a verdict tile for each solver, scenario or replay, and settings.

    Clicking sets `pick`. More experiments than `MOST_ACROSS` are rows; then `usermeta` has `tall`.

    table : of `tabulate_experiment_verdicts`, solvers and experiments in their order.
    """
    solvers, experiments = table["solver"].unique().tolist(), table["experiment"].unique().tolist()
    levels = table["settings"].unique().tolist()
    # Worked out in the figure, so that the page can hand it other rows.
    signs = json.dumps(dict(zip(STATES, MARKS, strict=True)), ensure_ascii=False)
    inks = json.dumps(dict(zip(STATES, style.STATE_COLOURS, strict=True)))
    pick = style.pick_selection("id", "experiment_id")
    in_a_row = len(experiments) * (1 if stacked else len(levels))
    tall = len(experiments) > MOST_ACROSS or in_a_row > 2 * MOST_ACROSS
    across, down = ("solver", "experiment") if tall else ("experiment", "solver")
    order = {"solver": solvers, "experiment": experiments}
    above = alt.Axis(orient="top", labelAngle=-90 if stacked else -40)
    x = alt.X(f"{across}:N", sort=order[across], title=None, axis=above)
    y = alt.Y(f"{down}:N", sort=order[down], title=None)
    titles = {"experiment": "scenario or replay", "verdict": "verdict"}
    titles |= {
        "off": style.ERROR,
        "fails": "failed steps",
        "because": "reason",
    }
    titled = (style.tooltip(f"{field}:N", title) for field, title in titles.items())
    tips = style.tooltips(
        "solver:N", style.tooltip("call_mode:N", "call mode"), "settings:N", *titled
    )
    base = (
        alt.Chart()
        .transform_calculate(
            off=f"datum.error === 'inf' ? 'no solution' : {_ERROR}",
            fails="isValid(datum.failed) ? datum.failed : '–'",
            because="datum.detail || '–'",
        )
        .encode(x=x, y=y, tooltip=tips)
    )
    # One below the other the tiles are narrower than three words side by side.
    legend: dict[str, Any] = {
        "symbolType": "square",
        "labelExpr": f"{signs}[datum.label] + ' ' + datum.label",
    }
    legend |= {"columns": 2} if stacked else {}
    tiles = style.describe_marks(base, tips).mark_rect(strokeWidth=1.5, stroke=style.PAPER)
    tiles = tiles.encode(
        color=style.colour("verdict", STATES, style.FILLS, title="verdict", **legend)
    )
    # Above all tiles, or those beside it would cover half of its frame.
    frame: dict[str, Any] = {"filled": False, "strokeWidth": 3, "aria": False}
    chosen = base.transform_filter(pick).mark_rect(stroke=style.ACCENT, **frame)
    signed = base.transform_calculate(sign=f"{signs}[datum.verdict]", ink=f"{inks}[datum.verdict]")
    text = signed.mark_text(fontSize=12, fontWeight=600, aria=False)
    text = text.encode(text=alt.Text("sign:N"), color=alt.Color("ink:N", scale=None))
    size: dict[str, Any] = {"width": alt.Step(TILE), "height": alt.Step(15 if tall else 22)}
    placed = alt.layer(tiles.add_params(pick), text, chosen, data=table, **size)
    heads: dict[str, Any] = {
        "labelFontSize": 13,
        "labelFontWeight": 600,
        "labelAnchor": "start",
        "labelAngle": 0,
    }
    short = shorten_settings(levels)
    lines = {level: text.split(",") for level, text in short.items()}
    heads["labelExpr"] = f"{json.dumps(short if stacked else lines)}[datum.label]"
    header = alt.Header(**heads, labelColor=style.INK, labelOrient="top")
    own: dict[str, Any] = {"sort": levels, "title": None, "header": header}
    if stacked:
        chart = placed.facet(row=alt.Row("settings:N", **own), spacing=14)
        chart = chart.resolve_axis(x="independent")
    else:
        longest = max(len(line) for name in lines.values() for line in name)
        room = HEAD_LETTER * longest - TILE * len(solvers if tall else experiments)
        chart = placed.facet(column=alt.Column("settings:N", **own), spacing=max(14, room))
    chart.usermeta = {"tall": tall}
    states = "pass, borderline, inconclusive, late, fail or not run"
    about = f"Verdict on each solver in each scenario or replay, for each settings name: {states}."
    return style.set_style(chart, "Verdicts by scenario and replay", about)


FULL = {"pass": 0.95, "borderline": 0.6, "inconclusive": 0.3, "late": 0.0, "fail": 0.0}
"""Opacity of a point by verdict."""
VERDICT_FILLS = {
    "pass": style.INK,
    "borderline": style.SOFT,
    "inconclusive": style.LINE,
    "late or fail": style.PAPER,
}
"""Fills of points of colour `INK` in the legend of verdicts."""
_LEGEND_COLUMNS = alt.ExprRef("narrow ? 1 : 3")
"""Three legends are side by side on a phone."""
_FIGURES = (
    style.tooltip("verdict:N", "overall verdict"),
    style.tooltip("off:N", f"{style.ERROR}, in all replays"),
    alt.Tooltip("p50_us:Q", title="p50 [µs]", format=".3r"),
    alt.Tooltip("p99_us:Q", title="p99 [µs]", format=".3r"),
    style.tooltip("timed_on:N", "replay for the times"),
)


def draw_accuracy(table: pd.DataFrame, error_limit: float, *, with_names: bool = False) -> Any:
    """Return a chart of largest error over step time, a line through each solver's settings.

    Points are filled as `FULL` says; clicking sets `pick`; `percentile` is p50 or p99.

    table : of `tabulate_tolerance_levels`; error_limit : drawn as a line; with_names : of solvers,
    each at its most accurate point, which the page places by its script instead.
    """
    table = table.assign(
        shown=table["error"].clip(lower=style.FLOOR),
        full=[FULL.get(state, FULL["inconclusive"]) for state in table["verdict"]],
    )
    percentile = alt.param(name="percentile", value="p50")
    pick = style.pick_selection("id")
    families = {f: hue for f, hue in style.FAMILY_COLOURS.items() if f in set(table["family"])}
    colour = style.colour(
        *("family", families, families.values()),
        columns=_LEGEND_COLUMNS,
        symbolOpacity=1.0,
        labelExpr="narrow ? replace(datum.label, 'augmented', 'aug.') : datum.label",
    )
    decades = alt.Axis(format=".0e")
    call_mode = style.tooltip("call_mode:N", "call mode")
    tips = style.tooltips("solver:N", call_mode, "settings:N", *_FIGURES)
    apart = style.log_scale(padding=12)  # room for the name of a point in the corner
    base = (
        alt.Chart(table)
        .transform_calculate(
            time="percentile == 'p99' ? datum.p99_us : datum.p50_us",
            off=_ERROR,
            call_mode="datum.route + ' ' + datum.policy",
        )
        .transform_filter("isValid(datum.time)")
        .encode(
            x=alt.X("time:Q", title="p50 of the step time [µs], log scale", scale=apart),
            y=alt.Y(
                "shown:Q",
                title=["largest error of the first move in the replays", "[maximum increments]"],
                scale=apart,
                axis=decades,
            ),
            color=colour,
            detail=alt.Detail("solver:N"),
            tooltip=tips,
        )
    )
    lines = base.mark_line(strokeWidth=1, opacity=0.45, aria=False).add_params(
        percentile, style.narrow_flag(), pick
    )
    short = json.dumps(shorten_settings(table["settings"].unique().tolist()))
    filled = style.legend_below(
        columns=_LEGEND_COLUMNS,
        symbolFillColor=style.INK,
        symbolOpacity=1.0,
        labelExpr=f"{short}[datum.label]",
    )
    dots = (
        style.describe_marks(base, tips)
        .mark_point(filled=True, strokeWidth=1.5)
        .encode(
            stroke=alt.Stroke(
                "family:N", scale=style.names_scale(families, families.values()), legend=None
            ),
            fillOpacity=alt.FillOpacity("full:Q", scale=None, legend=None),
            shape=alt.Shape("settings:N", title=None, legend=filled),
            size=style.value_if(pick, 190, 70),
        )
    )
    named = (
        base.transform_window(rank="row_number()", groupby=["solver"], sort=[{"field": "shown"}])
        .transform_filter("datum.rank == 1")
        .properties(name=style.NAMES)
    )
    if with_names:
        named = named.mark_text(align="left", dx=8, dy=-6, aria=False).encode(
            text=alt.Text("solver:N")
        )
    else:
        named = named.mark_point(filled=True, opacity=0, size=110, aria=False)
    return style.set_style(
        alt.layer(
            lines,
            style.draw_limit_rule(error_limit),
            dots,
            named,
            _draw_opacity_legend(),
            width=620,
            height=360,
        ),
        "Accuracy against time",
        "Largest error of the first move against step time, one point per solver and settings.",
    )


def _draw_opacity_legend() -> Any:
    """Return an invisible chart layer whose legend tells the fill of marks by verdict."""
    scale = style.names_scale(VERDICT_FILLS, VERDICT_FILLS.values())
    looks_of: dict[str, Any] = {"symbolType": "circle", "symbolStrokeColor": style.INK}
    legend = style.legend_below(columns=_LEGEND_COLUMNS, symbolStrokeWidth=1.5, **looks_of)
    unseen = style.inline_chart(*({"look": look} for look in VERDICT_FILLS)).mark_point(
        filled=True, size=0, opacity=0, aria=False
    )
    return unseen.encode(fill=alt.Fill("look:N", scale=scale, title="verdict", legend=legend))


LOWEST_MS = 1e-3
"""Left end of the axis."""
ROOM = 300
"""Least width of a figure with the names of the limits in full [px]."""
_JITTER = (
    "slow <= 1 ? '' : 'dashed: ' + (narrow ? '' : 'timings on this machine, ') + 'as measured'"
)
"""Remark on the whiskers on a slower computer."""
_FIGURE = "isValid(datum.{0}) ? format(datum.{0}, '.3r') : '–'"
"""Text of a number in a tooltip, a dash where there is none: the page leaves its line out."""
ALLOWED = "speed margin (factor by which the computer may be slower)"


def draw_deadline_chart(table: pd.DataFrame, deadline_ms: float, p99_ms: float) -> Any:
    """Return a chart of all solvers' p50, p99, longest step, largest timing against the deadline.

    The parameter `slow` scales all but the largest timing, which is this machine's; colours are
    verdicts there. With `narrow` names stand above their bars; clicking sets `pick`.

    table : columns `analysis.times.solver_tables.TIMES`, the first row on top.
    p99_ms : limit of the requirements; both limits are infinite where there is none.
    """
    base = _scale_rows(table)
    x = _time_axis(table, deadline_ms)
    parts = (
        *_draw_click_areas(base),
        *_draw_time_bars(base, x),
        *_draw_limits(deadline_ms, p99_ms),
    )
    return style.set_style(
        alt.layer(*parts, width=560, height=alt.Step(style.ROW_STEP["wide"])),
        "Step times and deadline" if isfinite(deadline_ms) else "Step times",
        "Step times of each solver (p50, limiting p99 and longest step) against the deadline.",
    )


def _scale_rows(table: pd.DataFrame) -> alt.Chart:
    """Return the base of the deadline chart: a row per solver, times scaled by the slowdown."""
    good = " || ".join(f"datum.verdict == '{s}'" for s in ("pass", "borderline", "inconclusive"))
    allowed = [format_rounded_down(margin) for margin in table["margin"]]
    scaled = alt.Chart(table.assign(allowed=allowed)).transform_calculate(
        a="datum.p50_ms * slow",
        c="(isValid(datum.limiting_p99_ms) ? datum.limiting_p99_ms : datum.p50_ms) * slow",
        m="datum.max_ms * slow",
        called="datum.p50_ms * datum.share * slow",
        left=f"{LOWEST_MS}",
        now=f"({good}) && slow > 1 && isValid(datum.margin) && slow > datum.margin"
        " ? 'late' : datum.verdict",
        computer="'× ' + format(slow, '.3~g')",
        timing="format(datum.longest_ms, '.3r') + (slow > 1 ? ', as measured' : '')",
        replayed=_FIGURE.format("replay_p99_ms"),
        single=_FIGURE.format("raw_p99_ms"),
    )
    times = (("a", "p50"), ("c", "limiting p99"), ("m", "longest step"))
    tips = [
        style.tooltip("label:N", "configuration"),
        style.tooltip("computer:N", "slowdown of the computer"),
        style.tooltip("now:N", "verdict at this slowdown"),
        *(alt.Tooltip(f"{name}:Q", title=f"{title} [ms]", format=".3r") for name, title in times),
        style.tooltip("replayed:N", "p99 of the replay, as measured [ms]"),
        style.tooltip("single:N", "p99 of single timings in the replay, as measured [ms]"),
        style.tooltip("timing:N", "largest single timing [ms]"),
        style.tooltip("allowed:N", ALLOWED),
    ]
    short = f"{json.dumps(_shorten_labels(table['label'].tolist()))}[datum.label] || datum.label"
    axis = style.row_name_axis(330, labelExpr=short)
    y = alt.Y("label:N", sort=table["label"].tolist(), title=None, axis=axis)
    return scaled.encode(y=y, tooltip=tips)


def _shorten_labels(labels: list[str]) -> dict[str, str]:
    """Return short labels of configurations with options: those of a solver without shared ones.

    Examples
    --------
    >>> grid = [f"osqp (native warm, alpha=1.6,eps_abs=1e-5,rho={rho})" for rho in (0.1, 1)]
    >>> [*_shorten_labels(["daqp (native warm)", *grid]).values()]
    ['osqp (native warm, rho=0.1)', 'osqp (native warm, rho=1)']
    """
    own = [label for label in labels if "=" in label]
    short: dict[str, str] = {}
    for solver in dict.fromkeys(label.partition(" ")[0] for label in own):
        alike = [label for label in own if label.startswith(f"{solver} ")]
        short |= zip(alike, drop_shared_options(alike), strict=True)
    is_clear = len({short.get(label, label) for label in labels}) == len(labels)
    return short if is_clear else {}


def _time_axis(table: pd.DataFrame, deadline_ms: float) -> alt.X:
    """Return a logarithmic time axis up to ten times the deadline, or beyond the slowest."""
    slowest = float(table[["max_ms", "longest_ms"]].max().max())
    high = max(10.0 * deadline_ms, 1.0) if isfinite(deadline_ms) else 1.0
    highest = alt.ExprRef(f"max({high}, {1.5 * slowest if isfinite(slowest) else 0.0} * slow)")
    scale = style.log_scale(domainMin=LOWEST_MS, domainMax=highest, clamp=True)
    axis = alt.Axis(
        values=[10.0**e for e in range(-3, 8)],
        format=",~g",
        orient="top",
        labelOverlap="greedy",
        labelSeparation=6,
        offset=alt.ExprRef("narrow ? 8 : 0"),  # off the name above the first bar
    )
    return alt.X("a:Q", title="step time [ms], log scale", scale=scale, axis=axis)


def _draw_click_areas(base: alt.Chart) -> Iterator[Any]:
    """Yield layers of the deadline chart: in each row an area to click, a mark if chosen."""
    pick = style.pick_selection("id")
    factor = alt.param(name="slow", value=1.0)
    clicked = style.draw_whole_rows(base, alt.Undefined, opacity=0.0, aria=False)
    yield clicked.add_params(factor, style.narrow_flag(), pick)
    chosen = style.value_if(pick, 0.25, 0.0)
    yield style.draw_whole_rows(base, chosen, color=style.ACCENT, aria=False)


def _draw_time_bars(base: alt.Chart, x: alt.X) -> Iterator[Any]:
    """Yield layers of each solver's call overhead, p50, p99 bar, line to longest step, whisker."""
    columns = alt.ExprRef("width < 200 ? 2 : narrow || width < 400 ? 3 : 5")
    looks: dict[str, Any] = {"columns": columns, "offset": 40}  # below what is said of the limits
    colour = style.colour("now", STATES, style.STATE_COLOURS, title="verdict", **looks)
    yield base.mark_rule(strokeWidth=9, color=style.LINE, aria=False).encode(
        x=alt.X("left:Q"), x2=alt.X2("called:Q"), opacity=alt.value(0.7)
    )
    yield (
        base.transform_filter("datum.longest_ms > datum.m")
        .mark_rule(strokeWidth=1, color=style.SOFT, strokeDash=[2, 2], aria=False)
        .encode(x=alt.X("m:Q"), x2=alt.X2("longest_ms:Q"))
    )
    yield base.mark_rule(strokeWidth=2, aria=False).encode(x=x, x2=alt.X2("m:Q"), color=colour)
    yield base.mark_rule(strokeWidth=9, strokeCap="butt", aria=False).encode(
        x=x, x2=alt.X2("c:Q"), color=colour
    )
    shape = alt.Shape("now:N", scale=style.names_scale(STATES, style.STATE_SHAPES))
    said = style.describe_marks(base, base.encoding.tooltip)
    yield said.mark_point(filled=True, size=70, opacity=1).encode(x=x, color=colour, shape=shape)


def _draw_limits(deadline_ms: float, p99_ms: float) -> Iterator[Any]:
    """Yield chart layers with rules and labels at the limits of p99 and deadline [ms]."""
    words: dict[str, Any] = {"baseline": "top", "fontSize": 12}
    limits = (
        ("p99", p99_ms, f"p99 limit {p99_ms:g} ms", 0.75, style.LATE),
        ("deadline", deadline_ms, f"deadline {deadline_ms:g} ms", 1.5, style.INK),
    )
    for name, at_ms, text, thick, colour in limits if isfinite(deadline_ms) else ():
        # On paper there is room for the first word alone.
        said = f"width < {ROOM} ? '{name}' : '{text}'"
        chart = alt.Chart(pd.DataFrame({name: [at_ms]})).transform_calculate(text=said)
        yield chart.mark_rule(color=colour, strokeWidth=thick, aria=False).encode(x=f"{name}:Q")
        # Left of its line; the deadline's, to keep off that, right of it, or below where it is near
        # the end of the axis.
        right, near = name == "deadline", f"scale('x', {at_ms}) + 110 > width"
        aside: dict[str, Any] = {"align": "right", "dx": -5}
        if right:
            aside["align"] = alt.ExprRef(f"{near} ? 'center' : 'left'")
            aside["dx"] = alt.ExprRef(f"{near} ? 0 : 5")
        yield chart.mark_text(dy=4, color=colour, **aside, **words).encode(
            x=f"{name}:Q",
            y=alt.value("height"),
            text=alt.Text("text:N"),
            description=alt.Description("text:N"),
        )
    looks: dict[str, Any] = {"align": "left", "dy": 20, "color": style.SOFT, "aria": False}
    whiskers = style.inline_chart({}).mark_text(**looks, **words)
    place: dict[str, Any] = {"x": alt.value(0), "y": alt.value("height")}
    yield whiskers.encode(**place, text=alt.Text("said:N")).transform_calculate(said=_JITTER)
