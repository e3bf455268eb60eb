"""Test sets of `qpbenchmark` 2.7: a Parquet table and the class reading it.

The table has P, q, G, h, A, b, lb, ub, flattened by rows, and a name per problem.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.bench.sequences.qpsolvers_files import KEYS
from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.solvers.one_sided import OneSidedForm

_TAKEN = frozenset(sys.stdlib_module_names) | {"qpbenchmark", "qpsolvers", "numpy", "pandas"}
_TEST_SET = '''"""{title}.

Written by dpbench beside {stem}.parquet; run it with

    qpbenchmark --results-path results.csv {stem}.py run --author NAME
"""

from pathlib import Path

from qpbenchmark import ParquetTestSet


class {class_name}(ParquetTestSet):
    """{title}."""

    def __init__(self):
        super().__init__(Path(__file__).with_suffix(".parquet"))

    @property
    def title(self) -> str:
        return {title!r}

    @property
    def description(self) -> str:
        return {description!r}

    @property
    def sparse_only(self) -> bool:
        return False
'''


def save_qpbenchmark(out: str | Path, recorded: Recorded) -> tuple[Path, Path]:
    """Write a sequence as a qpbenchmark test set: `<stem>.parquet` and `<stem>.py`.

    Steps without a certified optimum are left out; InputError for a stem that Python cannot import.
    """
    path = Path(out)
    stem = path.stem
    if not stem.isidentifier() or stem in _TAKEN or path.suffix not in ("", ".py", ".parquet"):
        allowed = "a Python name no library has, as qpbenchmark imports it, e.g. dp_paper.py"
        raise InputError("`out`", "", repr(path.name), allowed)
    sequence = recorded.sequence
    steps = list_steps_with_optimum(recorded)
    if not steps:
        raise InputError(sequence.name, "", "no step with a certified optimum", "one or more")
    table, code = path.with_suffix(".parquet"), path.with_suffix(".py")
    part = table.with_name(table.name + ".part")
    pq.write_table(build_problem_table(sequence, steps), part)
    part.replace(table)
    code.write_text(_render_test_set(stem, sequence, len(steps)), encoding="utf-8")
    return table, code


def list_steps_with_optimum(recorded: Recorded) -> list[int]:
    """Return the indices of a sequence's steps whose optimum is certified."""
    optima = recorded.optima or []
    return [k for k, optimum in enumerate(optima) if np.isfinite(optimum.bound)]


def build_problem_table(sequence: QPSequence, steps: Sequence[int]) -> pa.Table:
    """Return some steps of a sequence as a table for `qpbenchmark.ParquetTestSet`."""
    first, every = (int(sequence.meta.get(*key)) for key in (("first", 0), ("every", 1)))
    digits = len(str(first + every * (len(sequence) - 1)))
    # Names tell the step of the run, and go on a command line without quotes.
    run = sequence.name.partition("[")[0]
    names = [f"{run}_{first + every * k:0{digits}d}" for k in steps]
    rows = [to_qpsolvers_arrays(sequence.problem(k)) for k in steps]
    numbers = pa.list_(pa.float64())
    columns: dict[str, Any] = {
        key: pa.array([None if row[key] is None else row[key].ravel() for row in rows], numbers)
        for key in KEYS
    }
    columns["name"] = pa.array(names, pa.string())
    return pa.table(columns)


def to_qpsolvers_arrays(qp: QuadraticProgram) -> dict[str, Any]:
    """Convert a QP to the arrays P, q, G, h, A, b, lb, ub of qpsolvers; None for empty ones.

    Rows with l = u become equalities; of the others the upper sides come first.
    """
    form = OneSidedForm(qp, "dense", "native")
    form.write_step_vectors_as_one_sided(qp.q, qp.l, qp.u)
    return {key: getattr(form, key) for key in KEYS}


def _render_test_set(stem: str, sequence: QPSequence, count: int) -> str:
    """Return the Python code of a qpbenchmark test set for a sequence of `count` QPs."""
    base = sequence.base
    title = f"dpbench {sequence.name}".replace("\\", "/").replace('"', "'")
    description = (
        f"{count} QPs recorded along one run of the MPC of a ship, n = {base.n}, m = {base.m}, in "
        "scaled units, each with a certified optimum in dpbench."
    )
    # The name by which qpbenchmark looks the class up in the file.
    class_name = stem.title().replace("_", "")
    return _TEST_SET.format(stem=stem, class_name=class_name, title=title, description=description)
