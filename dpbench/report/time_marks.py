"""Marks of solvers beside their times: the build is a generic one, the answers are remembered."""

from __future__ import annotations

from collections.abc import Iterable

from dpbench.analysis.run_record import RunRecord

GENERIC = "†"
REMEMBERS = "‡"


def timed_name(row: RunRecord) -> str:
    """The solver of a row beside whose time it stands, with its marks."""
    marks = (GENERIC if row.generic_build else "") + (REMEMBERS if row.remembers else "")
    return f"{row.solver} {marks}" if marks else row.solver


def marks_legend(rows: Iterable[RunRecord]) -> str:
    """What the marks of these rows mean, each in a sentence with a space before it."""
    shown = list(rows)
    builds = sorted({row.build for row in shown if row.generic_build})
    legend = ""
    if builds:
        legend += (
            f" {GENERIC}: {', '.join(builds)}: the library has kernels for this kind of processor, "
            "and the build that is installed leaves them out; its times are not those of a build "
            "for it."
        )
    if any(row.remembers for row in shown):
        legend += (
            f" {REMEMBERS}: it remembers answers: the first visit of a step, or its own closed "
            "loop, took far longer than the same step when it was replayed again; its times are no "
            "solver's."
        )
    return legend
