"""Generate QOCO's C for the matrices of a sequence by `qocogen`."""

import contextlib
import io
import shutil
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from dpbench.arrays import Matrix
from dpbench.errors import InputError
from dpbench.qp.program import QPSequence

NAME = "qoco_custom"


def write_sources(
    sequence: QPSequence, folder: Path, single: bool, settings: Mapping[str, Any]
) -> None:
    """Write QOCO's sources and `rows.h`: which limits are its equalities and inequalities.

    InputError for a limit that is finite in some steps only.
    """
    qp = sequence.base
    C = np.vstack([qp.A, np.eye(qp.n)])
    low, high = (
        _stack_row_and_bound_limits(sequence, *names) for names in (("l", "lb"), ("u", "ub"))
    )
    equal = np.flatnonzero((low == high).all(axis=0))
    upper, lower = (
        _find_finite_inequality_limits(sequence.name, limits, equal) for limits in (high, low)
    )
    G = scipy.sparse.csc_matrix(np.vstack([C[upper], -C[lower]]))
    A = scipy.sparse.csc_matrix(C[equal]) if len(equal) else None
    m = len(upper) + len(lower)
    sizes = {"n": qp.n, "m": m, "p": len(equal), "l": m, "nsoc": 0, "q": None}
    data = {"P": scipy.sparse.csc_matrix(qp.P), "c": qp.q, "A": A, "G": G}
    data |= {"b": high[0, equal], "h": np.concatenate([high[0, upper], -low[0, lower]])}
    with contextlib.redirect_stdout(io.StringIO()):
        import_module("qocogen").generate_solver(**sizes, **data, output_dir=str(folder), name=NAME)
    generated = folder / NAME
    for path in generated.glob("*.[ch]"):
        if path.name != "runtest.c":
            path.rename(folder / path.name)
    shutil.rmtree(generated)
    rows = {"equal": equal, "upper": upper, "lower": lower}
    (folder / "rows.h").write_text("".join(_format_c_index_array(*row) for row in rows.items()))


def _stack_row_and_bound_limits(sequence: QPSequence, rows: str, bounds: str) -> Matrix:
    """Return the limits (K, m + n) of rows and bounds on one side."""
    of_rows, changing = getattr(sequence, rows), getattr(sequence, bounds)
    of_bounds = np.tile(getattr(sequence.base, bounds), (len(of_rows), 1))
    return np.hstack([of_rows, of_bounds if changing is None else changing])


def _find_finite_inequality_limits(name: str, limits: Matrix, equal: Any) -> Any:
    """Return the indices of finite limits other than equalities."""
    finite = np.isfinite(limits)
    if (finite.any(axis=0) != finite.all(axis=0)).any():
        raise InputError(
            "qoco", "", f"limits in {name} that only some steps have", "limits that every step has"
        )
    return np.setdiff1d(np.flatnonzero(finite[0]), equal)


def _format_c_index_array(name: str, indices: Any) -> str:
    """Return row indices as a C array, with their number."""
    numbers = ", ".join(map(str, indices.tolist())) or "0"
    return f"enum {{{name}_rows = {len(indices)}}};\nstatic const int {name}[] = {{{numbers}}};\n"
