"""Tables on the harness itself, on what repeats, and on what a worker takes beside time."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.judge.calibration import off_by_ns, within_bar
from dpbench.report.formats import (
    MISSING,
    count_text,
    error_text,
    micro_text,
    plural,
    share_text,
    significant,
)
from dpbench.report.machine_verdict import FOLD_ABOVE
from dpbench.report.table import Cell, Mark, Table, row_of
from dpbench.solvers.calibration import CALIBRATION, COPY_ONLY, NO_OP, WAITS_NS

MEGABYTE = 1e6


def cost_table(view: Records) -> Table | None:
    """What the harness's own configurations were measured to take; None where they did not run."""
    timed = [(row, view.times(row)) for row in view.calibration]
    rows = []
    for row, times in timed:
        if times is None:
            continue
        configuration, p50 = row.solver, row.raw_p50_ns
        held = within_bar(configuration, p50)
        rows.append(
            row_of(
                Cell(configuration),
                f"`{row.sequence}`",
                Cell("–" if held is None else "yes" if held else "no", _mark(held)),
                significant(WAITS_NS[configuration] / 1e3, 4)
                if configuration in WAITS_NS
                else MISSING,
                f"{p50 / 1e3:.2f}",
                micro_text(off_by_ns(configuration, p50)),
                micro_text(row.raw_p99_ns),
                micro_text(row.raw_max_ns),
                *(micro_text(times.phase_ns[phase]) for phase in ("update", "solve", "read")),
                count_text(len(times.raw_ns)),
            )
        )
    if not rows:
        return None
    return Table(
        title="What the harness itself costs",
        note=(
            "The harness's own configurations, replayed like any solver, which solve nothing "
            "and are ranked "
            f"nowhere. `{NO_OP}` does nothing: what is left is the clock between four calls. "
            f"`{COPY_ONLY}` copies q, l, u in and an answer out, as the contract asks of every "
            f"workspace. `busy_wait_…` waits a known time in its solve. The bar: at p50 of all "
            "samples a wait is measured within 1 µs or 1 %, and doing nothing within 1 µs. "
            "What is measured here is subtracted from no time in this report."
        ),
        heads=(
            "configuration",
            "sequence",
            "within the bar",
            "waits [µs]",
            "raw p50 [µs]",
            "beyond the wait [µs]",
            "raw p99 [µs]",
            "raw max [µs]",
            "update [µs]",
            "solve [µs]",
            "read [µs]",
            "samples",
        ),
        rows=tuple(rows),
        text_columns=3,
        folded=len(rows) > 2 * len(CALIBRATION),
    )


def _mark(held: bool | None) -> Mark:
    return "bad" if held is False else ""


def audited(rows: Sequence[RunRecord]) -> list[RunRecord]:
    """Solvers' replays with a step that was answered twice or more."""
    return [
        row
        for row in rows
        if row.solver not in CALIBRATION and math.isfinite(row.bit_identical_share)
    ]


def differs(row: RunRecord) -> bool:
    """Whether a configuration once answered the same QP in two ways, or counted other
    iterations."""
    return row.bit_identical_share < 1.0 or row.iterations_identical_share < 1.0


def determinism_table(rows: Sequence[RunRecord]) -> Table | None:
    """Configurations that do not repeat themselves bit for bit; None when all do."""
    found = [row for row in audited(rows) if differs(row)]
    if not found:
        return None
    found.sort(key=lambda row: -row.answer_spread_max)
    return Table(
        title="Configurations that do not repeat themselves",
        note=(
            f"{plural(len(found), 'configuration')} of {len(audited(rows))}. Over all rounds of "
            "a replay: "
            "share of the steps with the same status and bits of z in every round, and the same "
            "count of iterations; largest difference between two rounds, of z in scaled units (a "
            "variable of 1 is a whole rate-limit step)."
        ),
        heads=(
            "solver",
            "settings",
            "policy",
            "route",
            "sequence",
            "formulation",
            "same bits",
            "largest difference of z",
            "same iterations",
            "largest difference of iterations",
        ),
        rows=tuple(
            row_of(
                *(str(getattr(row, name)) for name in ("solver", "settings", "policy", "route")),
                f"`{row.sequence}`",
                row.formulation,
                share_text(row.bit_identical_share),
                error_text(row.answer_spread_max),
                share_text(row.iterations_identical_share),
                count_text(row.iterations_spread),
            )
            for row in found
        ),
        text_columns=6,
        folded=len(found) > FOLD_ABOVE,
    )


def memory_table(rows: Sequence[RunRecord]) -> Table | None:
    """Memory and threads per solver, route and size of the QP; None where none was measured."""
    groups: dict[tuple[str, ...], list[RunRecord]] = {}
    for row in rows:
        own = row.solver in CALIBRATION
        if math.isfinite(row.peak_rss_bytes) and (not own or row.solver == NO_OP):
            key = (row.solver, row.route, _horizons(row), row.formulation)
            groups.setdefault((*key, count_text(row.n), count_text(row.m)), []).append(row)
    if not groups:
        return None
    order = sorted(groups.items(), key=lambda item: (item[0][0] != NO_OP, -_most(item[1], "peak")))
    return Table(
        title="Memory of a worker",
        note=(
            "The largest of each solver's configurations. Peak: resident memory with the "
            "solver's library "
            "loaded, above the process every worker is forked from, less the QPs and the log of "
            f"the harness; good to some 0.1 MB; `{NO_OP}` is what the harness adds. Python: "
            "medians over up to 50 untimed steps, of the memory blocks an answer leaves held and "
            "of the peak of bytes that Python and NumPy allocate within a step. C heap: its growth "
            "a step, median of three such passes; a library that goes on growing leaks. How often "
            "it calls `malloc` within a step cannot be seen from outside it, and is not given."
        ),
        heads=(
            "solver",
            "route",
            "horizons",
            "formulation",
            "n",
            "m",
            "peak [MB]",
            "Python blocks",
            "Python peak [B]",
            "C heap growth [B/step]",
            "threads",
        ),
        rows=tuple(_memory_row(key, mine) for key, mine in order),
        text_columns=4,
        folded=len(order) > FOLD_ABOVE,
    )


def _horizons(row: RunRecord) -> str:
    ahead, moves = row.N_p, row.N_c
    return f"{ahead:.0f}/{moves:.0f}" if ahead == ahead else MISSING


_COLUMNS = {
    "peak": "peak_rss_bytes",
    "blocks": "python_blocks_per_step",
    "bytes": "python_peak_bytes_per_step",
    "growth": "heap_growth_bytes_per_step",
    "threads": "os_threads",
}


def _most(rows: Sequence[RunRecord], what: str) -> float:
    seen = [getattr(row, _COLUMNS[what]) for row in rows]
    return max((value for value in seen if value == value), default=float("nan"))


def _memory_row(key: tuple[str, ...], rows: Sequence[RunRecord]) -> tuple[Cell, ...]:
    name, *rest = key
    return row_of(
        Cell(name, "quiet" if name == NO_OP else ""),
        *rest,
        significant(_most(rows, "peak") / MEGABYTE),
        count_text(_most(rows, "blocks")),
        count_text(_most(rows, "bytes")),
        significant(_most(rows, "growth"), 2),
        count_text(_most(rows, "threads")),
    )
