"""Step times compared, as a table of their ratios: what was claimed, and what differs most."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.compare.times import Compared


def claims_first(compared: Sequence[Compared]) -> list[Compared]:
    """What is slower first, the most so in front; then what is faster, then the rest by ratio."""
    rank = {"slower": 0, "faster": 1}
    return sorted(
        compared,
        key=lambda c: (rank.get(c.assessment.verdict, 2), -c.assessment.ratio.value),
    )


def ratio_table(compared: Sequence[Compared]) -> pd.DataFrame:
    """A row for each, the largest ratio first: `id`, its number; name, ratio, low, high, verdict,
    a_us, b_us, the median step in either run, and sequence."""
    rows = [
        {
            "id": str(i),
            "name": f"{one.timing.pair.a.configuration.label}, {one.timing.pair.a.sequence}",
            "ratio": one.assessment.ratio.value,
            "low": one.assessment.ratio.low,
            "high": one.assessment.ratio.high,
            "verdict": one.assessment.verdict,
            "a_us": one.timing.median_ns[0] / 1e3,
            "b_us": one.timing.median_ns[1] / 1e3,
            "sequence": one.timing.pair.a.sequence,
        }
        for i, one in enumerate(compared)
    ]
    return pd.DataFrame(rows).sort_values("ratio", ascending=False, kind="stable")


def furthest(table: pd.DataFrame, ends: int) -> pd.DataFrame:
    """Of a `ratio_table` what is judged to differ, and so many at either end whatever is said."""
    judged = table["verdict"].isin(("slower", "faster"))
    place = pd.Series(range(len(table)), index=table.index)
    return table[judged | (place < ends) | (place >= len(table) - ends)]
