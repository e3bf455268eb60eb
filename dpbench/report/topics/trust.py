"""Can the times be believed: the machine, the harness measured by itself, what is not covered."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from dpbench.analysis.machine import delayed_runs, disturbance_of, round_spread, timed_runs
from dpbench.analysis.records import Records
from dpbench.bench.judge.calibration import within_bar
from dpbench.bench.record.disturbance import Disturbance
from dpbench.report.charts.lines import dots
from dpbench.report.formats import and_list, share_text, significant
from dpbench.report.machine_verdict import (
    disturbance_facts,
    machine_facts,
    own_switches,
)
from dpbench.report.page.topic import Figure, SmallTable, Topic
from dpbench.solvers.calibration import COPY_ONLY, WAITS_NS

COVERED = (
    "An interval covers this run on this machine, by resampling blocks of neighbouring steps; not "
    "another machine, build or day: compare two runs for that.",
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
        "of a step is its fastest."
    ]


def _waits_text(asked: Sequence[tuple[str, float, float]]) -> str:
    """Whether waits of known length [µs] were measured right, and what follows where not."""
    known = {name: us for name, us, _ in asked}
    longest = {name: max(p50 for n, _, p50 in asked if n == name) for name in known}
    missed = [name for name in known if within_bar(name, 1e3 * longest[name]) is False]
    if not missed:
        return "Waits of known length were measured within 1 µs or 1 %."
    said = [f"{known[name]:g} µs as {longest[name]:.1f} µs" for name in missed]
    worst = max(abs(longest[name] / known[name] - 1.0) for name in missed)
    return (
        f"Waits of known length: {and_list(said)}, off by more than 1 µs and 1 %. Times of that "
        f"length, and their ratios, are known to {share_text(worst)} at best."
    )


def _quiet_text(found: Disturbance) -> str:
    """Whether the machine did other things while replays were timed."""
    if complaints := found.complaints():
        return (
            f"Other work disturbed the machine: {and_list(complaints)}. Times may be too long; "
            "run again when it is idle."
        )
    return "The machine did little else meanwhile, by the counters of its kernel (in the table)."


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
        lines.append(_waits_text(asked))
        table = (
            pd.DataFrame(asked, columns=["name", "x", "y"]).groupby("name", as_index=False).max()
        )
        chart = dots(table, "Waits of known length", "asked [µs]", "measured p50 [µs]")
        figures.append(Figure("calibration", chart, "Asked and measured."))
    if found.seconds > 0:
        lines.append(_quiet_text(found))
    facts = [
        *machine_facts(records.machine),
        *(disturbance_facts(found) if found.seconds > 0 else ()),
        *own_switches(timed),
    ]
    return Topic(
        id="trust",
        title="Can I believe the times",
        short="Trust",
        lines=(*lines, *COVERED),
        figures=tuple(figures),
        tables=(SmallTable(("machine", ""), tuple(facts)),),
    )
