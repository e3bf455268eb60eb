"""Tables of the active sets that QPs visit, and of what a memory of their laws saves."""

from collections.abc import Sequence

import numpy as np

from dpbench.analysis.suites.active_sets import SavedWork, VisitedSets
from dpbench.arrays import Floats
from dpbench.report.formats import MISSING, Table, format_count


def make_table_of_visited_sets(visited: Sequence[VisitedSets]) -> Table:
    """Return a table of how many active sets sequences of QPs visit, and of those not seen."""
    rows = [
        {
            "QPs": one.name,
            "n": str(one.n),
            "steps": format_count(one.steps),
            "sets": str(one.sets),
            "seen once": str(one.once),
            "unseen mass": f"{100 * one.unseen_mass:.1f} ± {100 * one.unseen_error:.1f} %",
            "most active": str(one.most_active),
            "table, bytes": format_count(one.table_bytes),
        }
        for one in visited
    ]
    note = "Unseen mass: share of further steps whose set was not visited (Good-Turing)."
    return Table.from_rows(rows, "Active sets visited", note=note)


def make_table_of_saved_work(saved: Sequence[SavedWork]) -> Table:
    """Return a table of the instructions that a memory of active sets saves at p50 and p99."""
    rows = [
        {
            "QPs": one.name,
            "answered by a law": f"{np.count_nonzero(one.answered)} of {len(one.answered)}",
            "method there": _format_p50_and_p99(one.instructions[one.answered]),
            "multiply-adds": _format_p50_and_p99(one.multiply_adds[one.answered]),
            "method, all steps": _format_p50_and_p99(one.instructions),
            "with active_set_memory, at least": _format_p50_and_p99(one.least_instructions),
        }
        for one in saved
    ]
    note = (
        "p50 and p99 of a step. Method: instructions of paper_active_set, warm, as C on an "
        "emulated Cortex-M7. Multiply-adds: of the laws that a step tries and of their checks, by "
        "the sizes of the arrays. At least: one instruction a multiply-add, none for loads."
    )
    return Table.from_rows(rows, "Instructions saved by stored laws", note=note)


def _format_p50_and_p99(values: Floats) -> str:
    """Return median and p99 of numbers as text; a dash without any."""
    if not len(values):
        return MISSING
    return " and ".join(format_count(round(float(np.percentile(values, q)))) for q in (50, 99))
