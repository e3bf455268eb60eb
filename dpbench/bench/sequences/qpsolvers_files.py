"""Problems that others recorded: `.npz` of `qpsolvers.Problem.save`, one file or a folder of them.

    minimise ½ xᵀP x + qᵀx   subject to   G x ≤ h,  A x = b,  lb ≤ x ≤ ub

Each file is a step, in the natural order of the names (2 before 10). The rows are those of G, then
those of A with both limits at b.
"""

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.record.npz import DAMAGE, Arrays, read_arrays_and_pickles, read_float_array
from dpbench.errors import InputError
from dpbench.files.regular_files import open_regular_file
from dpbench.qp.program import CONSTANT, QPSequence, QuadraticProgram, require_or_make_symmetric

WHAT = "a problem written by `qpsolvers.Problem.save` (.npz)"
KEYS = ("P", "q", "G", "h", "A", "b", "lb", "ub")


def list_problem_files(folder: Path) -> list[Path]:
    """Return the `.npz` files of a folder in natural order; InputError without any."""
    files = [path for path in folder.iterdir() if path.suffix == ".npz" and path.is_file()]
    if not files:
        raise InputError(str(folder), "", "no .npz file", f"a folder of files, each {WHAT}")
    return sorted(files, key=lambda path: (_natural_sort_key(path.stem), path.name))


def _natural_sort_key(text: str) -> list[tuple[int, int, str]]:
    """Return a file name's sort key, in which numbers count by value."""
    parts = re.split(r"([0-9]+)", text)
    return [(1, int(part), "") if i % 2 else (0, 0, part) for i, part in enumerate(parts)]


def is_problem_file(path: Path) -> bool:
    """Return whether a file has the arrays of a qpsolvers problem, not of a dpbench format."""
    try:
        with open_regular_file(path) as file, zipfile.ZipFile(file) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, *DAMAGE):
        return False
    return bool(names & {"P", "q"}) and "format" not in names


def read_problems(place: Path) -> QPSequence:
    """Return the qpsolvers problems of a folder, or of one file, as a sequence."""
    files = list_problem_files(place) if place.is_dir() else [place]
    problems = [read_problem(path) for path in files]
    base = problems[0]
    for path, qp in zip(files, problems, strict=True):
        if (qp.n, qp.m) != (base.n, base.m):
            found = f"{qp.n} variables and {qp.m} rows"
            allowed = f"{base.n} variables and {base.m} rows, as in {files[0].name}"
            raise InputError(str(path), "", found, allowed)
    vectors: dict[str, Any] = {
        name: np.array([getattr(qp, name) for qp in problems]) for name in ("q", "l", "u")
    }
    changed: dict[str, Any] = {}
    for name in CONSTANT:
        first = getattr(base, name)
        if not all(np.array_equal(getattr(qp, name), first) for qp in problems):
            changed[name] = np.array([getattr(qp, name) for qp in problems])
    meta: dict[str, str | float | int] = {"first_file": files[0].name, "last_file": files[-1].name}
    name = place.resolve().name if place.is_dir() else place.stem
    return QPSequence(name, base, **vectors, **changed, meta=meta)


def read_problem(path: Path) -> QuadraticProgram:
    """Return the QP of a qpsolvers problem file in two-sided form; InputError for a bad file."""
    where = str(path)
    arrays, objects = read_arrays_and_pickles(path, WHAT)
    for name, packed in objects.items():
        # None is saved as an object, and so is a sparse matrix, which qpsolvers then fails to load.
        if b"scipy" in packed:
            raise InputError(where, name, "a pickled sparse matrix", "a dense array, or none")
    for name in [*arrays, *objects]:
        if name not in KEYS:
            raise InputError(where, name, "an unknown array", f"{', '.join(KEYS)}: {WHAT}")
    shape = arrays["q"].shape if "q" in arrays else ()
    if len(shape) != 1 or shape[0] < 1:
        raise InputError(where, "q", f"shape {shape}" if shape else "nothing", "shape (n,), n ≥ 1")
    n = shape[0]
    P = require_or_make_symmetric(read_float_array(arrays, where, "P", (n, n)), where)
    G, h = _read_rows(arrays, where, ("G", "h"), n, "+")
    A, b = _read_rows(arrays, where, ("A", "b"), n, "")
    free = np.full(n, np.inf)
    lb, ub = (
        read_float_array(arrays, where, name, (n,), infinite=sign) if name in arrays else default
        for name, sign, default in (("lb", "-", -free), ("ub", "+", free))
    )
    q = read_float_array(arrays, where, "q", (n,))
    below = np.concatenate((np.full(len(h), -np.inf), b))
    return QuadraticProgram(P, q, np.vstack((G, A)), below, np.concatenate((h, b)), lb, ub)


def _read_rows(
    arrays: Arrays, where: str, names: tuple[str, str], n: int, infinite: str
) -> tuple[Vector, Vector]:
    """Return a matrix G or A and its vector h or b from a problem file; no rows where absent."""
    matrix, vector = names
    present = [name for name in names if name in arrays]
    if not present:
        return np.zeros((0, n)), np.zeros(0)
    if len(present) == 1:
        missing = vector if present == [matrix] else matrix
        raise InputError(where, missing, "nothing", f"{matrix} and {vector}, or none of the two")
    # qpsolvers takes a single row as a vector.
    shaped = arrays | {matrix: np.atleast_2d(arrays[matrix]), vector: arrays[vector].reshape(-1)}
    m = shaped[matrix].shape[0]
    return (
        read_float_array(shaped, where, matrix, (m, n)),
        read_float_array(shaped, where, vector, (m,), infinite=infinite),
    )
