"""What stands beside the step times: the verdict on the machine, the harness's own cost; and the
section on what repeats itself and what memory it takes.
"""

from __future__ import annotations

from dpbench.analysis.machine import disturbance_of, timed_runs
from dpbench.analysis.records import Records
from dpbench.bench.judge.calibration import within_bar
from dpbench.report.blocks import Block, Paragraph, Section, Tabular
from dpbench.report.formats import and_list, plural, time_text
from dpbench.report.machine_verdict import (
    machine_table,
    sequence_table,
    verdict_paragraph,
    verdict_text,
)
from dpbench.report.tables_harness import (
    audited,
    cost_table,
    determinism_table,
    differs,
    memory_table,
)


def machine_blocks(view: Records) -> list[Block]:
    """The verdict on the machine and the cost of the harness; nothing where nothing was counted."""
    rows = timed_runs(view)
    found = disturbance_of(rows)
    if not found.seconds > 0:
        return []
    tables = [machine_table(view, rows), sequence_table(rows), cost_table(view)]
    shown: list[Block] = [Tabular(table) for table in tables if table is not None]
    return [Paragraph(verdict_paragraph(found)), *shown]


def repeat_section(view: Records) -> Section | None:
    """Which configurations repeat themselves, and what memory each takes; None where nobody
    looked."""
    rows = timed_runs(view)
    seen, memory = audited(rows), memory_table(rows)
    if not seen and memory is None:
        return None
    section = Section("repeat", "Repeatability and memory")
    if seen:
        section.add(Paragraph(_repeats(len(seen), sum(map(differs, seen)))))
    table = determinism_table(rows)
    section.add(*(Tabular(found) for found in (table, memory) if found is not None))
    return section


def _repeats(configurations: int, others: int) -> str:
    every = "in every round of its replay, with the same iterations"
    if not others:
        said = (
            "the only replayed configuration gives"
            if configurations == 1
            else f"each of {configurations} replayed configurations gives"
        )
        return f"Determinism: {said} the same QP the same answer, bit for bit, {every}."
    same = configurations - others
    return (
        f"Determinism: {plural(same, 'configuration')} of {configurations} "
        f"{'gives' if same == 1 else 'give'} the same "
        f"QP the same answer, bit for bit, {every}; {others} {'does' if others == 1 else 'do'} not."
    )


def harness_lines(view: Records) -> list[str]:
    """The verdicts on machine and harness in plain lines; none where nothing was counted."""
    lines = []
    found = disturbance_of(timed_runs(view))
    if found.seconds > 0:
        lines.append(f"machine: {verdict_text(found)}")
    configurations = [row for row in view.calibration if row.has_steps]
    if configurations:
        p50 = {row.solver: row.raw_p50_ns for row in configurations}
        lines.append(calibration_line(p50))
    return lines


def calibration_line(p50_ns: dict[str, float]) -> str:
    """What the harness's own configurations say in one line, from the median of each [ns]."""
    missed = [
        configuration
        for configuration, p50 in p50_ns.items()
        if within_bar(configuration, p50) is False
    ]
    said = ", ".join(f"{configuration} {time_text(p50)}" for configuration, p50 in p50_ns.items())
    verdict = f"missed by {and_list(missed)}" if missed else "within the bar"
    return f"harness: {verdict} ({said})"
