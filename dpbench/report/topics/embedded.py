"""Cost of solvers as C on the ship's computer: instructions, memory, and the desk's ranking."""

from collections.abc import Iterator

from dpbench.analysis.suites.embedded import CountedSequence, EmbeddedResults
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.report.embedded_text import (
    CAVEAT,
    NOTE,
    cheapest_text,
    core_text,
    not_counted_texts,
    ranking_texts,
)
from dpbench.report.formats import MISSING, count_text, error_text, time_text
from dpbench.report.page.section import Topic
from dpbench.report.table import Table

WORST = "The worst step is the worst of its sequence."
TITLE = "On the ship's computer"


def embedded_topic(results: EmbeddedResults, requirements: Requirements) -> Topic | None:
    """Build the report's part on counts of solvers' C; None where nothing was to be counted."""
    if not (results.sequences or results.not_counted):
        return None
    rows = [row for sequence in results.sequences for row in _table_rows(sequence)]
    compilers = sorted({one.compiler for group in results.sequences for one in group.solvers})
    lines = [
        *(cheapest_text(sequence, requirements) for sequence in results.sequences),
        *ranking_texts(results.sequences, requirements),
    ]
    if rows:
        lines.append(f"Compiled by {', '.join(compilers)} with -O2. {CAVEAT} {WORST}")
    lines += not_counted_texts(results.not_counted)
    tables = (Table.of(rows, note=NOTE, text_columns=3),) if rows else ()
    return Topic("embedded", TITLE, tuple(lines), tables=tables)


def _table_rows(sequence: CountedSequence) -> Iterator[dict[str, str]]:
    """Yield a row of cells for each solver along a sequence."""
    ranks = sequence.desk_ranks
    for one in sequence.solvers:
        yield {
            "solver": one.solver,
            "sequence": sequence.sequence,
            "core": core_text(sequence.target, single=sequence.single),
            "median": count_text(one.p50),
            "p99": count_text(one.p99),
            "worst": count_text(one.worst),
            "k": str(one.k),
            "iterations": str(one.iterations) if one.iterations >= 0 else MISSING,
            "active": str(one.active) if one.active >= 0 else MISSING,
            "code": count_text(one.code + one.constants),
            "static": count_text(one.static + one.heap),
            "stack": count_text(one.stack),
            "error": error_text(one.error_move),
            "desk p99": time_text(one.desk_p99_ns),
            "desk rank": str(ranks.get(one.solver, MISSING)),
        }
