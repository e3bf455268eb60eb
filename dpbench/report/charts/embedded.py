"""Instructions per step of solvers' C on embedded cores."""

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts import style

COLUMNS = ("label", "group", "p50", "p99", "worst", "k")


def draw_instructions(table: pd.DataFrame) -> Any:
    """Return a chart of each solver's p50, p99 and maximum in instructions, a row for each.

    With `narrow` names stand above their bars.

    table : columns `COLUMNS`, the first row on top; a colour for each group.
    """
    groups = list(dict.fromkeys(table["group"]))
    hues = [style.PALETTE[i % len(style.PALETTE)] for i in range(len(groups))]
    titles = {"group": "sequence and core", "k": "step k of the maximum"}
    numbers = (("p50", "p50"), ("p99", "p99"), ("worst", "maximum"))
    tips = [
        style.tooltip("label:N", "solver and steps"),
        style.tooltip("group:N", titles["group"]),
        *(alt.Tooltip(f"{name}:Q", title=title, format=",.0f") for name, title in numbers),
        style.tooltip("k:N", titles["k"]),
    ]
    base = alt.Chart(table).encode(
        x=alt.X(
            "p50:Q",
            title="instructions per step, log scale",
            scale=style.log_scale(nice=False, padding=8),
            axis=alt.Axis(format=",.3~r", labelOverlap="greedy"),
        ),
        y=alt.Y("label:N", sort=table["label"].tolist(), title=None, axis=style.row_name_axis()),
        color=style.colour("group", groups, hues, columns=1, labelLimit=320),
        tooltip=tips,
    )
    parts = (
        base.mark_rule(strokeWidth=2, aria=False)
        .encode(x2=alt.X2("worst:Q"))
        .add_params(style.narrow_flag()),
        base.mark_rule(strokeWidth=9, strokeCap="butt", aria=False).encode(x2=alt.X2("p99:Q")),
        style.describe_marks(base, tips).mark_point(
            filled=True, size=70, opacity=1, stroke=style.PAPER
        ),
    )
    return style.set_style(
        alt.layer(*parts, width=560, height=alt.Step(style.ROW_STEP["wide"])),
        "Instructions per step",
        "Instructions per step of each solver's C code: p50, p99 and maximum.",
    )
