"""The verdict on a result folder in a few plain lines, for a terminal."""

from __future__ import annotations

from dpbench.analysis.machine import delayed_runs, disturbance_of, timed_runs
from dpbench.analysis.random_claims import RandomClaims
from dpbench.analysis.records import Records
from dpbench.analysis.slowdown import delayed_groups
from dpbench.analysis.verdict import Verdicts
from dpbench.bench.judge.calibration import within_bar
from dpbench.report.formats import and_list, plural, time_text
from dpbench.report.machine_verdict import verdict_text
from dpbench.report.verdict_text import recommendation, summary


def last_lines(records: Records, verdicts: Verdicts) -> list[str]:
    """What a run ends with: the answer, then machine and harness."""
    other = records.random or records.delayed or records.calibration
    lines: list[str] = []
    if records.runs or not other:
        lines += summary(verdicts)
        if verdicts.of:
            lines += recommendation(records, verdicts)
    lines += [*slowdown_lines(records), *_random(records), *_harness(records)]
    return [line.replace("**", "").replace("`", "") for line in lines]


def slowdown_lines(records: Records) -> list[str]:
    """Who survives most, of each scenario."""
    lines = []
    for group in delayed_groups(records):
        survivors = [c for c in group.configurations if c.survives > 0]
        best = [f"{c.configuration.label} × {c.survives:g}" for c in survivors[:3]]
        said = ", ".join(best) if best else "nobody survives a slow-down"
        lines.append(f"slower computers, {group.scenario}: {said}")
    return lines


def _random(records: Records) -> list[str]:
    """How many false claims, and whose."""
    if not records.random:
        return []
    by_solver = RandomClaims(records).by("solver")
    liars = sorted(solver for (solver,), tally in by_solver.items() if tally.wrong)
    wrong = sum(tally.wrong for tally in by_solver.values())
    steps = sum(tally.steps for tally in by_solver.values())
    by = f" by {and_list(liars)}" if liars else ""
    return [f"random QPs: {plural(wrong, 'false claim')} in {steps} answers{by}"]


def _harness(records: Records) -> list[str]:
    """The verdicts on machine and harness; none where nothing was counted."""
    lines = []
    disturbance = disturbance_of(timed_runs(records) or delayed_runs(records))
    if disturbance.seconds > 0:
        lines.append(f"machine: {verdict_text(disturbance)}")
    timed = {run.solver: run.raw_p50_ns for run in records.calibration if run.has_steps}
    if timed:
        lines.append(calibration_line(timed))
    return lines


def calibration_line(p50_ns: dict[str, float]) -> str:
    """What the harness's own solvers say in one line, from the median of each [ns]."""
    missed = [name for name, p50 in p50_ns.items() if within_bar(name, p50) is False]
    said = ", ".join(f"{name} {time_text(p50)}" for name, p50 in p50_ns.items())
    verdict = f"missed by {and_list(missed)}" if missed else "within the bar"
    return f"harness: {verdict} ({said})"
