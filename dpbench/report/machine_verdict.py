"""The verdict on the machine: how quiet it was while replays were timed, what is known of it."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import Any

import numpy as np

from dpbench.analysis.machine import disturbance_of
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.record.disturbance import RULE, Disturbance
from dpbench.report.formats import MISSING, and_list, count_text, plural, share_text, significant
from dpbench.report.table import Table, row_of

FOLD_ABOVE = 8
"""RunRecords above which a table is folded."""


def verdict_text(found: Disturbance) -> str:
    """ "quiet", or "disturbed" and by what."""
    complaints = found.complaints()
    return f"disturbed: {and_list(complaints)}" if complaints else "quiet"


def verdict_paragraph(found: Disturbance) -> str:
    """The verdict with its rule, and what it means for the times."""
    means = (
        "Algorithmic times are minima over rounds and suffer least; raw percentiles are this "
        "machine's as much as a solver's."
        if found.complaints()
        else "Nothing it shows spoils the times below."
    )
    return f"**The machine was {verdict_text(found)}.** {means} Quiet means: {RULE}."


def machine_facts(machine: dict[str, Any]) -> list[tuple[str, str]]:
    """What is known of a machine, whatever ran on it."""

    def of(key: str, unit: str = "") -> str:
        value = machine.get(key, "not recorded")
        return f"{value} {unit}" if unit and isinstance(value, int | float) else str(value)

    cores = [str(core) for core in machine.get("affinity") or []]
    return [
        ("processor", f"{of('cpu_model')}, {of('cores')} cores"),
        ("cores allowed", ", ".join(cores) or "not recorded"),
        ("frequency governor", of("governor")),
        ("frequency at the start", of("frequency_MHz", "MHz")),
        ("throttle counters", of("throttle_counters")),
        ("BLAS", ", ".join(machine.get("blas") or ["none seen"])),
        ("reading the clock", of("clock_read_ns", "ns")),
        ("resolution of the clock", of("timer_resolution_ns", "ns")),
    ]


def disturbance_facts(found: Disturbance) -> list[tuple[str, str]]:
    """What disturbed some replays, as the kernel shows it."""
    disturbed = f"{count_text(found.disturbed)} of {plural(found.rounds, 'round')}"
    throttled = count_text(found.throttled)
    return [
        ("disturbed rounds left", f"{disturbed}; {count_text(found.rerun)} run again"),
        ("involuntary context switches", f"{_rate(found.switches_per_s)} a second"),
        ("time stolen by the host", f"{_steal(found.steal_share)}"),
        ("throttle events", "not visible" if throttled == MISSING else throttled),
    ]


def _rate(value: float) -> str:
    return significant(value, 2)


def _steal(share: float) -> str:
    return "not visible" if share != share else share_text(share)


def machine_table(view: Records, rows: Sequence[RunRecord]) -> Table:
    """The machine and what disturbed the timed replays on it."""
    found = disturbance_of(rows)
    cores = view.machine.get("affinity") or []
    pinned = [("core of the timed worker", str(cores[-1]))] if cores else []
    facts = [*machine_facts(view.machine), *pinned, *disturbance_facts(found)]
    facts += [*_own_switches(rows), *_threads(rows)]
    return Table(
        title="The machine, and what disturbed the replays",
        note=f"{plural(len(rows), 'replayed configuration')}, the harness's own among them; "
        f"{significant(found.seconds)} s of rounds that count. A steal time of 0 may also mean "
        "that the host does not tell.",
        heads=("what", "found"),
        rows=tuple(row_of(*fact) for fact in facts),
        text_columns=2,
    )


def _own_switches(rows: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """The configurations that leave the processor by their own doing, which is not the machine's
    fault."""
    own: dict[str, float] = {}
    for row in rows:
        if not isnan(row.own_switches_a_step):
            name = f"{row.solver} ({row.route} {row.policy})"
            own[name] = max(own.get(name, 0.0), row.own_switches_a_step)
    if not own:
        return []
    said = ", ".join(f"{name}: {_rate(a_step)} a step" for name, a_step in own.items())
    return [("switches a configuration makes itself, not counted above", said)]


def _threads(rows: Sequence[RunRecord]) -> list[tuple[str, str]]:
    """The most threads seen in a worker, and whose they are."""
    said = []
    for column, what in (
        ("pool_threads", "BLAS or OpenMP threads allowed in a worker"),
        ("os_threads", "threads of a worker"),
    ):
        seen = [(getattr(row, column), row.solver) for row in rows]
        most = max((count for count, _ in seen if count == count), default=float("nan"))
        whose = sorted({solver for count, solver in seen if count > 1})
        of = f" ({', '.join(whose)})" if whose else ""
        said.append((what, f"at most {count_text(most)}{of}" if most == most else MISSING))
    return said


def sequence_table(rows: Sequence[RunRecord]) -> Table | None:
    """What disturbed each replayed sequence; None where there is only one."""
    sequences = list(dict.fromkeys(row.sequence for row in rows))
    if len(sequences) < 2:
        return None
    lines = []
    for sequence in sequences:
        mine = [row for row in rows if row.sequence == sequence]
        found = disturbance_of(mine)
        lines.append(
            row_of(
                f"`{sequence}`",
                verdict_text(found),
                count_text(len(mine)),
                count_text(found.rounds),
                count_text(found.disturbed),
                count_text(found.rerun),
                _rate(found.switches_per_s),
                count_text(np.fmax.reduce([row.involuntary_switches for row in mine])),
                _steal(found.steal_share),
            )
        )
    return Table(
        title="What disturbed each replayed sequence",
        note="By the rule above. Of each configuration the same figures are in `runs.parquet`.",
        heads=(
            "sequence",
            "verdict",
            "configurations",
            "rounds",
            "disturbed",
            "run again",
            "switches/s",
            "switches, worst configuration",
            "stolen",
        ),
        rows=tuple(lines),
        text_columns=2,
        folded=len(lines) > FOLD_ABOVE,
    )
