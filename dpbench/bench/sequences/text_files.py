"""Sequences for other tools: a MATLAB file, a folder of CSV tables, a folder of QPS files."""

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.files.writing import (
    make_folder_if_missing,
    write_file_atomically,
    write_text_atomically,
)
from dpbench.qp.program import ARRAYS, QPSequence, QuadraticProgram

OPTIMUM = ("z", "y", "y_box")


def save_mat(path: Path, recorded: Recorded) -> Path:
    """Write a sequence to a MATLAB file, version 5.

    P, A, lb, ub as in `QuadraticProgram`, with the step as the first axis where they vary; q, l, u
    (K, ·), the optima z, y, y_box (K, ·) and their error `bound` (K,). `unit_z` (n,) and `unit_row`
    (m,) are 1 of z and of a row in N or N·m. The structure `meta` has `name`, `scenario`,
    `sample_s` [s], `first` and `every` sample, the horizons, and the version of dpbench.
    """
    from scipy.io import savemat

    with write_file_atomically(path) as part:
        contents = {**_collect_arrays(recorded), "meta": _collect_meta(recorded)}
        savemat(str(part), contents, appendmat=False)
    return path


def save_csv(folder: Path, recorded: Recorded) -> Path:
    """Write a sequence to a folder, each array a CSV table without head, a row per row.

    Arrays of every step have a row per step; a matrix is flattened by rows there.
    """
    make_folder_if_missing(folder)
    for name, array in _collect_arrays(recorded).items():
        rows = array.reshape(len(array), -1)
        text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
        write_text_atomically(folder / f"{name}.csv", f"{text}\n")
    return folder


def save_qps(folder: Path, recorded: Recorded) -> Path:
    """Write each QP of a sequence to a folder as a file in QPS format, named by its step.

    The format of the Maros-Meszaros and CUTEst test sets (MPS with a section QUADOBJ, free form).
    A row with two limits is stored as its upper limit and the range between them.
    """
    make_folder_if_missing(folder)
    sequence = recorded.sequence
    for k in range(len(sequence)):
        lines = _qps_lines(sequence.problem(k), f"{sequence.name.partition('[')[0]}_{k}")
        write_text_atomically(folder / f"{k:06d}.qps", "\n".join(lines) + "\n")
    return folder


def _collect_arrays(recorded: Recorded) -> dict[str, Vector]:
    """Return the arrays of a sequence and its certified optima by name."""
    sequence: QPSequence = recorded.sequence
    own = {name: getattr(sequence, name) for name in ARRAYS}
    arrays = {name: getattr(sequence.base, name) if a is None else a for name, a in own.items()}
    optima = recorded.optima or []
    if optima:
        arrays |= {name: np.array([getattr(o, name) for o in optima]) for name in OPTIMUM}
        arrays["bound"] = np.array([o.bound for o in optima])
    if recorded.units is not None:
        arrays |= {"unit_z": recorded.units.z, "unit_row": recorded.units.row}
    return arrays


def _collect_meta(recorded: Recorded) -> dict[str, str | int | float]:
    """Return the name of a sequence, its origin and the version of dpbench, by field."""
    known = {"name": recorded.sequence.name, "dpbench": version("dpbench")}
    meta = known | recorded.sequence.meta
    return {key: value for key, value in meta.items() if isinstance(value, str | int | float)}


def _qps_lines(qp: QuadraticProgram, name: str) -> Iterator[str]:
    """Yield the lines of a QP in QPS format, with variables x0 to xn and rows r0 to rm."""
    kinds = [_row_kind(low, high) for low, high in zip(qp.l, qp.u, strict=True)]
    yield f"NAME {name}"
    yield "ROWS"
    yield " N cost"
    yield from (f" {kind} r{i}" for i, kind in enumerate(kinds))
    yield "COLUMNS"
    for j in range(qp.n):
        yield f" x{j} cost {float(qp.q[j])!r}"
        yield from (f" x{j} r{i} {float(qp.A[i, j])!r}" for i in np.flatnonzero(qp.A[:, j]))
    yield "RHS"
    for i, kind in enumerate(kinds):
        if kind != "N":
            yield f" rhs r{i} {float(qp.l[i] if kind == 'G' else qp.u[i])!r}"
    yield "RANGES"
    for i, kind in enumerate(kinds):
        if kind == "L" and np.isfinite(qp.l[i]):
            yield f" range r{i} {float(qp.u[i] - qp.l[i])!r}"
    yield "BOUNDS"
    for j in range(qp.n):
        for kind, infinite, value in (("LO", "MI", qp.lb[j]), ("UP", "PL", qp.ub[j])):
            yield (
                f" {kind} bound x{j} {float(value)!r}"
                if np.isfinite(value)
                else (f" {infinite} bound x{j}")
            )
    yield "QUADOBJ"
    for j, i in zip(*np.nonzero(np.triu(qp.P)), strict=True):
        yield f" x{j} x{i} {float(qp.P[i, j])!r}"
    yield "ENDATA"


def _row_kind(low: float, high: float) -> str:
    """Return the kind of a row in MPS: N free, E equality, L with an upper limit, G without."""
    if low == high:
        return "E"
    if np.isfinite(high):
        return "L"
    return "G" if np.isfinite(low) else "N"
