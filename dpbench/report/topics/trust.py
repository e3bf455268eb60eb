"""Can the times be believed: the machine, the harness measured by itself, what is not covered."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.machine import delayed_runs, disturbance_of, round_spread, timed_runs
from dpbench.analysis.records import Records
from dpbench.bench.judge.calibration import within_bar
from dpbench.bench.record.revision import revision_text
from dpbench.report.charts.lines import dots
from dpbench.report.formats import significant
from dpbench.report.machine_verdict import (
    disturbance_facts,
    machine_facts,
    own_switches,
    verdict_text,
)
from dpbench.report.page.topic import Figure, SmallTable, Topic
from dpbench.solvers.calibration import COPY_ONLY, WAITS_NS

COVERED = (
    "An interval covers this run on this machine: blocks of steps are drawn anew, so neighbouring "
    "steps stay together.",
    "It does not cover another machine, build or day: compare two runs for that.",
    "Not covered at all: other ships, weather and tunings; times on an embedded target; the worst "
    "step that was never met.",
)


def calling_ns(records: Records) -> float:
    """What calling a library that only copies takes [ns]; NaN where it was not measured."""
    times = [r.algo_p50_ns for r in records.calibration if r.solver == COPY_ONLY]
    known = [t for t in times if math.isfinite(t)]
    return min(known) if known else math.nan


def _spread(records: Records) -> list[str]:
    """From which ratio on two solvers differ, by what rounds of one replay differ."""
    usual, largest = round_spread(records)
    if math.isnan(largest):
        return []
    return [
        f"Ratios of two solvers: yes, beyond {significant(largest)}. So far apart, at most, lie "
        f"fastest and slowest round of one replay (in the median {significant(usual)}); the time "
        "of a step is its fastest. Microseconds: of this machine on that day alone."
    ]


def _off(asked: Sequence[tuple[str, float, float]], missed: Sequence[str]) -> str:
    """What was asked of the waits off the bar [µs], and what was measured."""
    longest = {name: (us, max(p50 for n, _, p50 in asked if n == name)) for name, us, _ in asked}
    return ", ".join(f"{longest[n][0]:g} µs took {longest[n][1]:.1f} µs" for n in missed)


def trust_topic(records: Records) -> Topic | None:
    """The topic; None where nothing was timed."""
    timed = timed_runs(records) or delayed_runs(records)
    found = disturbance_of(timed)
    asked = [
        (run.solver, WAITS_NS[run.solver] / 1e3, run.raw_p50_ns / 1e3)
        for run in records.calibration
        if run.solver in WAITS_NS and math.isfinite(run.raw_p50_ns)
    ]
    if not found.seconds > 0 and not asked:
        return None
    lines = _spread(records)
    figures = []
    if asked:
        missed = sorted({n for n, _, p50 in asked if within_bar(n, 1e3 * p50) is False})
        lines.append(
            "Waits of known length were measured "
            + (
                f"wrong by more than 1 µs or 1 %: {_off(asked, missed)}."
                if missed
                else "within 1 µs or 1 %."
            )
        )
        table = (
            pd.DataFrame(asked, columns=["name", "x", "y"]).groupby("name", as_index=False).max()
        )
        chart = dots(table, "Waits of known length", "asked [µs]", "measured p50 [µs]")
        figures.append(Figure("calibration", chart, "The harness's own waits: asked and measured."))
    if found.seconds > 0:
        lines.append(f"The machine was {verdict_text(found)}.")
    facts = [
        *machine_facts(records.machine),
        *(disturbance_facts(found) if found.seconds > 0 else ()),
        *own_switches(timed),
        *(("dpbench", text) for text in (revision_text(records.suite),) if text),
    ]
    return Topic(
        id="trust",
        title="Can I believe the times",
        lines=(*lines, *COVERED),
        figures=tuple(figures),
        tables=(SmallTable(("machine", ""), tuple(facts)),),
    )
