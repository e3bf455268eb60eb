"""Two configurations on the same steps, a dot a step."""

from __future__ import annotations

from typing import Any

import altair as alt
import pandas as pd

from dpbench.report.charts.style import ACCENT, SOFT, log_scale, styled, tip

COLUMNS = ("k", "a_us", "b_us", "sequence")


def pairs(table: pd.DataFrame, first: str, second: str) -> Any:
    """Scatter of step times on equal axes with the line where both are as fast.

    Parameters
    ----------
    table : columns `COLUMNS`.
    first, second : what the axes say.
    """
    data = alt.InlineData(
        name="pairs",
        values=[dict(zip(COLUMNS, row, strict=True)) for row in table[list(COLUMNS)].to_numpy()],
    )
    scale = log_scale(nice=False, padding=6)
    dots = (
        alt.Chart(data)
        .mark_circle(size=14, opacity=0.5, color=ACCENT)
        .encode(
            x=alt.X("a_us:Q", scale=scale, title=f"{first} [µs]"),
            y=alt.Y("b_us:Q", scale=scale, title=f"{second} [µs]"),
            tooltip=[
                alt.Tooltip("sequence:N"),
                alt.Tooltip("k:Q"),
                tip("a_us:Q"),
                tip("b_us:Q"),
            ],
        )
    )
    ends = (
        alt.Chart(data)
        .transform_calculate(low="min(datum.a_us, datum.b_us)", high="max(datum.a_us, datum.b_us)")
        .transform_aggregate(low="min(low)", high="max(high)")
        .transform_fold(["low", "high"], as_=["end", "at"])
        .mark_line(color=SOFT, strokeDash=[4, 3])
        .encode(x="at:Q", y="at:Q")
    )
    return styled(
        alt.layer(dots, ends, width=330, height=330),
        "Two configurations, step by step [µs]",
        "Step times of two configurations against each other; below the line the second is faster.",
    )
