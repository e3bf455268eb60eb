"""Cost of solvers as C on the ship's computer: instructions, memory, and the desk's ranking."""

from collections.abc import Iterator
from typing import Any

import pandas as pd

from dpbench.analysis.suites.embedded import CountedSequence, EmbeddedResults
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.report.embedded_text import (
    CAVEAT,
    NOTE,
    describe_cheapest_solver,
    describe_emulation,
    name_core_and_precision,
    yield_ranking_sentences,
    yield_uncounted_loops_sentences,
    yield_uncounted_sentences,
    yield_unranked_sentences,
)
from dpbench.report.formats import MISSING, Table, format_count, format_error, format_time, plural
from dpbench.report.page.section import Topic

WORST = "The maximum holds for these steps only."
TABLE = "Instructions per step, memory and error"
LABELS = {
    "k": "step k of the maximum",
    "worst": "maximum",
    "active": "active limits",
    "code": "code [bytes]",
    "static": "static [bytes]",
    "stack": "stack [bytes]",
    "median": "p50",
    "desk p99": "p99 on this machine",
    "desk rank": "rank on this machine",
}
TITLE = "Embedded cores"


def build_embedded_topic(results: EmbeddedResults, requirements: Requirements) -> Topic | None:
    """Return the report's part on counts of solvers' C; None where nothing was to be counted."""
    if not (results.sequences or results.not_counted):
        return None
    rows = [row for sequence in results.sequences for row in _yield_table_rows(sequence)]
    compilers = sorted({one.compiler for group in results.sequences for one in group.solvers})
    lines = [
        *(describe_cheapest_solver(sequence, requirements) for sequence in results.sequences),
        *yield_ranking_sentences(results.sequences, requirements),
    ]
    if results.sequences:
        lines[0] = f"The solvers' C code was {describe_emulation(results.sequences)}. {lines[0]}"
    lines += yield_uncounted_sentences(results.not_counted)
    unranked = yield_unranked_sentences(results.sequences)
    uncounted = [*yield_uncounted_loops_sentences(results)] or [WORST]
    fewest = min((group.steps for group in results.sequences), default=0)
    rough = (
        f"Over {fewest} steps, a p99 is a rough estimate, as at most "
        f"{plural(fewest // 100, 'step')} can exceed it. "
    ) * (0 < fewest < 1000)
    compiled = f"The C code was compiled by {', '.join(compilers)} with -O2."
    note = " ".join([f"{NOTE} {rough}{compiled}", *uncounted, CAVEAT, *unranked])
    looks: dict[str, Any] = {"text_columns": 3, "folded": True, "labels": LABELS}
    tables = (Table.from_rows(rows, TABLE, note=note, **looks),) if rows else ()
    return Topic("embedded", TITLE, tuple(lines), tables=tables)


def tabulate_counts(results: EmbeddedResults) -> pd.DataFrame:
    """Return a table of counts, memory, errors and times as numbers; missing ones are NA."""
    rows = [
        {
            "solver": one.solver,
            "sequence": sequence.sequence,
            "core": name_core_and_precision(sequence.target, single=sequence.single),
            "median": one.p50,
            "p99": one.p99,
            "worst": one.worst,
            "k": one.k,
            "iterations": one.iterations if one.iterations >= 0 else None,
            "active": one.active if one.active >= 0 else None,
            "code": one.code + one.constants,
            "static": one.static + one.heap,
            "stack": one.stack,
            "error": one.error_move,
            "desk_p99_us": one.desk_p99_ns / 1e3,
            "desk_rank": sequence.desk_rank_by_solver.get(one.solver),
        }
        for sequence in results.sequences
        for one in sequence.solvers
    ]
    counts = dict.fromkeys(("iterations", "active", "desk_rank"), "Int64")
    return pd.DataFrame(rows).astype(counts)


def _yield_table_rows(sequence: CountedSequence) -> Iterator[dict[str, str]]:
    """Yield a row of cells for each solver along a sequence."""
    ranks = sequence.desk_rank_by_solver
    for one in sequence.solvers:
        yield {
            "solver": one.solver,
            "sequence": sequence.sequence,
            "core": name_core_and_precision(sequence.target, single=sequence.single),
            "median": format_count(one.p50),
            "p99": format_count(one.p99),
            "worst": format_count(one.worst),
            "k": str(one.k),
            "iterations": format_count(one.iterations) if one.iterations >= 0 else MISSING,
            "active": str(one.active) if one.active >= 0 else MISSING,
            "code": format_count(one.code + one.constants),
            "static": format_count(one.static + one.heap),
            "stack": format_count(one.stack),
            "error": format_error(one.error_move),
            "desk p99": format_time(one.desk_p99_ns),
            "desk rank": str(ranks.get(one.solver, MISSING)),
        }
