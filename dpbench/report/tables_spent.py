"""Where the wall time of a campaign went: timed phases, the referee, and everything else."""

from __future__ import annotations

from typing import Any

from dpbench.analysis.records import as_float
from dpbench.report.formats import count_text, plural, share_text, time_text
from dpbench.report.table import Table, row_of


def spent_table(suite: dict[str, Any]) -> Table | None:
    """The stages of the last sitting; None where none was recorded."""
    stages = suite.get("spent") or []
    wall_s = as_float(suite.get("wall_s"))
    if not stages or not wall_s > 0.0:
        return None
    rows = [
        row_of(
            f"`{stage['stage']}`" if stage["stage"].startswith("replay") else str(stage["stage"]),
            count_text(stage["cells"]),
            _seconds(stage["wall_s"]),
            _seconds(stage["timed_s"]),
            _seconds(stage["referee_s"]),
            share_text(_inside_s(stage) / as_float(stage["wall_s"])),
        )
        for stage in stages
    ]
    rest_s = wall_s - sum(as_float(stage["wall_s"]) for stage in stages)
    rows.append(row_of("sources, designs", "–", _seconds(rest_s), "–", "–", share_text(0.0)))
    inside = sum(map(_inside_s, stages)) / wall_s
    rows.append(row_of("all", "", _seconds(wall_s), "", "", share_text(inside)))
    earlier = int(suite.get("earlier_cells", 0))
    before = (
        f" {plural(earlier, 'cell')} had been finished in an earlier sitting." if earlier else ""
    )
    return Table(
        title="Where the time went",
        note=(
            f"{share_text(inside)} of the wall time was inside timed phases or the referee. Timed: "
            "emit, set-up, update, solve and read of all recorded steps, of a round that was run "
            "again the last attempt only. Where cells ran or were judged side by side, their "
            "seconds are divided by how many at a time. What is left is starting processes, "
            "warming caches up, moving the ship, and rounds run again; making the certified "
            f"optima to compare with, and designs, count as left over.{before}"
        ),
        heads=("stage", "cells", "wall time", "timed", "referee", "inside"),
        rows=tuple(rows),
        text_columns=1,
        folded=True,
    )


def _seconds(value: Any) -> str:
    return time_text(as_float(value) * 1e9)


def _inside_s(stage: dict[str, Any]) -> float:
    """Wall time of a stage inside timed phases or the referee [s]."""
    timed, judged = as_float(stage["timed_s"]), as_float(stage["referee_s"])
    return timed / as_float(stage["slots"]) + judged / as_float(stage["judges"])
