"""Two configurations on the same steps, a dot a step."""

from __future__ import annotations

from typing import Any

import altair as alt

from dpbench.report.charts import style


def pairs(first: str, second: str) -> Any:
    """Scatter of step times on equal axes with the line where both are as fast; the page fills the
    data set `pairs`: k, a_us, b_us, sequence.

    Parameters
    ----------
    first, second : what the axes say.
    """
    data = style.inline(name="pairs")
    scale = style.log_scale(nice=False, padding=6)
    dots = data.mark_circle(size=14, opacity=0.5, color=style.ACCENT).encode(
        x=alt.X("a_us:Q", scale=scale, title=f"{first} [µs]"),
        y=alt.Y("b_us:Q", scale=scale, title=f"{second} [µs]"),
        tooltip=["sequence:N", "k:Q", style.tip("a_us:Q"), style.tip("b_us:Q")],
    )
    ends = (
        data.transform_calculate(
            low="min(datum.a_us, datum.b_us)", high="max(datum.a_us, datum.b_us)"
        )
        .transform_aggregate(low="min(low)", high="max(high)")
        .transform_fold(["low", "high"], as_=["end", "at"])
        .mark_line(color=style.SOFT, strokeDash=[4, 3])
        .encode(x="at:Q", y="at:Q")
    )
    return style.styled(
        alt.layer(dots, ends, width=330, height=330),
        "Two configurations, step by step [µs]",
        "Step times of two configurations against each other; below the line the second is faster.",
    )
