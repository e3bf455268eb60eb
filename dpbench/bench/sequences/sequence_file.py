"""Recorded sequences as files that anybody can read: `.npz` without Python objects, version 1.

| array | shape | what |
|---|---|---|
| `format`, `version` | | "dpbench-sequence", 1 |
| `name`, `meta`, `documents` | | texts; the last two in JSON: horizons, versions; the scenario |
| `block`, `moves` | | as in `QuadraticProgram` |
| `P, A, lb, ub` | (n, n), (m, n), (n,), (n,) | matrices and bounds of step 0 |
| `P_steps, A_steps, lb_steps, ub_steps` | (K, ...) | those of each step, only where they change |
| `q, l, u` | (K, n), (K, m), (K, m) | vectors of each step |
| `unit_z`, `unit_row` | (n,), (m,) | what 1 is in N, N·m or m/s: z in SI = unit_z · z |
| `z, y, y_box` | (K, n), (K, m), (K, n) | certified optimum and its multipliers |
| `active` | (K, m + n) int8 | per row of [A; I]: +1 at its upper, −1 at its lower limit, or 0 |
| `bound`, `certificate` | (K,) | max_i |z_i − z*_i| is at most `bound`; the kind of proof |

QPs are in scaled units, min ½zᵀPz + qᵀz, l ≤ Az ≤ u, lb ≤ z ≤ ub; y > 0 at an upper limit. A step
without a feasible point has z = NaN, bound = inf, and its Farkas vector in (y, y_box).

Problems that others recorded, `.npz` of `qpsolvers.Problem.save`, are read too, one file or a
folder of them:

    minimise ½ xᵀP x + qᵀx   subject to   G x ≤ h,  A x = b,  lb ≤ x ≤ ub

Each file is a step, in the natural order of the names (2 before 10). The rows are those of G, then
those of A with both limits at b. `foreign_qps.py` reads other formats.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args
from zlib import ZLIB_RUNTIME_VERSION as ZLIB

import numpy as np
from numpy.typing import NDArray

from dpbench.arrays import Vector
from dpbench.bench.record.npz import (
    DAMAGE,
    Arrays,
    read_arrays_and_pickles,
    read_float_array,
    read_stored_count,
    read_stored_text,
    write_npz,
)
from dpbench.bench.sequences.foreign_qps import (
    ONE_WAY,
    read_acados_qp,
    read_maros_meszaros_problem,
)
from dpbench.errors import (
    InputError,
    UnknownNameError,
    require_name_or_file,
    require_type,
    shorten_found,
)
from dpbench.files.regular_files import describe_json_fault, open_regular_file, parse_json
from dpbench.qp.program import (
    CONSTANT,
    QPSequence,
    QuadraticProgram,
    Units,
    convert_sequence_to_units,
    describe_qp_size,
    require_or_make_symmetric,
    require_units,
)
from dpbench.qp.referee.optimum import ACTIVE_MULTIPLIER, Kind, Optimum
from dpbench.scenario.problem_files import (
    SEQUENCES,
    list_shipped_problem_names,
    make_unknown_problem_name_error,
    resolve_sequence_path,
)

if TYPE_CHECKING:
    from dpbench.mpc.condense import UnitSystem

FORMAT = "dpbench-sequence"
FORMAT_VERSION = 1
WHAT = "a sequence written by `export_sequence()` (.npz)"
VERSIONED = ("dpbench", "numpy", "scipy", "numba")
INFINITE = {"l": "+-", "u": "+-", "lb": "+-", "ub": "+-", "bound": "+"}
_TEXTS = ("format", "name", "meta", "documents")


@dataclass(frozen=True, eq=False)
class Recorded:
    """A sequence of QPs in scaled units with its certified optima, None if not certified yet."""

    sequence: QPSequence
    optima: list[Optimum] | None

    def save(self, path: Path) -> None:
        """Write the QPs, certified optima, units and scenario documents to a `.npz` file."""
        save_sequence(path, self.sequence, self.optima)


def save_sequence(
    path: str | Path,
    sequence: QPSequence,
    optima: Sequence[Optimum] | None = None,
    *,
    units: Units | None = None,
    documents: dict[str, Any] | None = None,
) -> None:
    """Write a sequence of QPs and its certified optima to a `.npz` file, reproducibly.

    Parameters
    ----------
    path : a name that ends in .npz; InputError for another.
    sequence : one in SI is written as its scaled form; InputError for one with NaN.
    optima : those of `certify_all_steps`, which finds them where they are not given.
    units, documents : instead of those of the sequence.

    Examples
    --------
    >>> save_sequence("two.npz", load_sequence("paper-30-5"))
    >>> load_sequence("two.npz")
    <QPSequence paper-30-5[:300:4]: 75 QPs of 15 variables, 15 rows, constant matrices>
    """
    require_type("save_sequence: path", path, str | PathLike, "a path")
    require_type("save_sequence: sequence", sequence, QPSequence, "a QPSequence")
    allowed = "a list of Optimum, one per QP"
    require_type("save_sequence: optima", optima, Sequence | None, allowed)
    for optimum in optima or ():
        require_type("save_sequence: optima", optimum, Optimum, allowed)
    if (path := Path(path)).suffix != ".npz":
        allowed = "a name that ends in .npz; for other formats, use `export_sequence()`"
        raise InputError("save_sequence", "path", repr(path.name), allowed)
    scaled = sequence.scaled or sequence
    units = sequence.units if units is None else units
    if units is not None:
        require_units("save_sequence", units, scaled.base.n, scaled.base.m)
    documents = scaled.documents if documents is None else documents
    if optima is None:
        # Reading a file takes no referee, whose kernels take longer to load than the file.
        from dpbench.qp.referee.referee import certify_all_steps

        optima = certify_all_steps(scaled)
    base = scaled.base
    for name in (*CONSTANT, "q", "l", "u"):
        for array in (getattr(base, name), getattr(scaled, name)):
            if array is not None and np.isnan(array).any():
                raise InputError("save_sequence", f"sequence: {name}", "NaN", "numbers")
    meta = scaled.meta | {name: version(name) for name in VERSIONED} | {"zlib": ZLIB}
    arrays: dict[str, Any] = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "name": scaled.name,
        "meta": json.dumps(meta, sort_keys=True, ensure_ascii=False),
        "documents": json.dumps(documents, sort_keys=True, ensure_ascii=False),
        "block": base.block,
        "moves": base.moves,
    }
    arrays |= {name: getattr(base, name) for name in CONSTANT}
    steps = {f"{name}_steps": getattr(scaled, name) for name in CONSTANT}
    arrays |= {name: array for name, array in steps.items() if array is not None}
    arrays |= {name: getattr(scaled, name) for name in ("q", "l", "u")}
    arrays["unit_z"] = np.ones(base.n) if units is None else units.z
    arrays["unit_row"] = np.ones(base.m) if units is None else units.row
    for name in ("z", "y", "y_box"):
        arrays[name] = np.array([getattr(optimum, name) for optimum in optima])
    arrays["active"] = np.array([active_set(optimum) for optimum in optima])
    arrays["bound"] = np.array([optimum.bound for optimum in optima])
    arrays["certificate"] = np.array([optimum.kind for optimum in optima])
    write_npz(path, {name: np.asarray(array) for name, array in arrays.items()})


def active_set(optimum: Optimum) -> NDArray[np.int8]:
    """Return the active limits (m + n,) of A, then bounds: +1 upper, −1 lower, 0 neither."""
    multiplier = np.concatenate((optimum.y, optimum.y_box))
    if not np.isfinite(optimum.bound):
        return np.zeros(len(multiplier), dtype=np.int8)
    signs = np.where(np.abs(multiplier) > ACTIVE_MULTIPLIER, np.sign(multiplier), 0.0)
    return signs.astype(np.int8)


def load_sequence(name_or_path: str | Path, *, units: UnitSystem = "scaled") -> QPSequence:
    """Return the QPs of a stored sequence, in scaled or in SI units.

    Parameters
    ----------
    name_or_path : a stored sequence by name (`list_sequences()`), or a `.npz` file.

    Raises
    ------
    InputError : for a bad file, or one without SI units.
    TypeError : for what is neither a name nor a path.

    Examples
    --------
    >>> load_sequence("paper-30-5")
    <QPSequence paper-30-5[:300:4]: 75 QPs of 15 variables, 15 rows, constant matrices>
    """
    if units not in ("scaled", "si"):
        raise InputError("load_sequence", "units", repr(units), '"scaled" or "si"')
    require_name_or_file("sequence", name_or_path, "a .npz file")
    try:
        path = resolve_sequence_path(name_or_path)
    except UnknownNameError as error:
        name = str(name_or_path)
        if name not in list_shipped_problem_names("scenarios"):
            raise make_unknown_problem_name_error(SEQUENCES, name, "a .npz path") from None
        found = f"{error.found}, a scenario"
        allowed = f"a sequence, such as that of `record_sequence('{name}')`"
        raise UnknownNameError(error.where, error.key, found, allowed) from None
    if path.is_dir() or (path.suffix == ".mat" and path.is_file()):
        found = "a folder" if path.is_dir() else "a .mat file"
        raise InputError(str(path), "", found, f"{WHAT}; {ONE_WAY}")
    recorded = load_recorded(path)
    if units == "scaled":
        return recorded.sequence
    if recorded.sequence.units is None:
        found = "only ones, so the SI units are unknown"
        allowed = "SI units in unit_z and unit_row, or units='scaled'"
        raise InputError(str(path), "unit_z, unit_row", found, allowed)
    return convert_sequence_to_units(recorded.sequence, recorded.sequence.units)


def as_sequence(given: object) -> QPSequence:
    """Return a sequence that is given as an object, by name or as a `.npz` file.

    Raises TypeError for anything else, and what `load_sequence` raises.
    """
    if isinstance(given, (str, Path)):
        return load_sequence(given)
    if isinstance(given, QPSequence):
        return given
    found, allowed = shorten_found(given), "a QPSequence, a name or a .npz file"
    raise TypeError(f"sequence: found {found}; allowed: {allowed}")


def load_recorded(path: str | Path) -> Recorded:
    """Return the QPs and certified optima in a dpbench sequence file; InputError if bad."""
    where = str(path)
    arrays, objects = read_arrays_and_pickles(Path(path), WHAT)
    for name in objects:
        raise InputError(where, name, "Python objects", "numbers or text")
    texts = {name: read_stored_text(arrays, where, name) for name in _TEXTS}
    if texts["format"] != FORMAT:
        raise InputError(where, "format", repr(texts["format"]), repr(FORMAT))
    number = f"the whole number {FORMAT_VERSION}"
    if (version := read_stored_count(arrays, where, "version", number)) != FORMAT_VERSION:
        raise InputError(
            where, "version", version, f"{FORMAT_VERSION}; update dpbench to read a newer version"
        )
    q, A = _read_matrix(arrays, where, "q"), _read_matrix(arrays, where, "A")
    sizes = q.shape[0], q.shape[1], A.shape[0]
    sequence = _read_sequence(arrays, where, sizes, texts["name"], _read_meta(where, texts))
    _, n, m = sizes
    given = {"unit_z": (n,), "unit_row": (m,)}
    units = Units(*(read_float_array(arrays, where, *unit) for unit in given.items()))
    own = (units.z == 1.0).all() and (units.row == 1.0).all()
    documents = _read_document(where, "documents", texts)
    sequence = replace(sequence, units=None if own else units, documents=documents)
    return Recorded(sequence, _read_optima(arrays, where, sizes))


def _read_sequence(
    arrays: Arrays, where: str, sizes: tuple[int, int, int], name: str, meta: dict[str, Any]
) -> QPSequence:
    """Return the QPs from the arrays of a sequence file, after checking types and shapes."""
    K, n, m = sizes
    shapes = {"P": (n, n), "A": (m, n), "lb": (n,), "ub": (n,), "q": (K, n), "l": (K, m)}
    shapes["u"] = (K, m)

    def read(key: str, name: str, shape: tuple[int, ...]) -> Any:
        return read_float_array(arrays, where, name, shape, infinite=INFINITE.get(key, ""))

    vectors = {key: read(key, key, shapes[key]) for key in ("q", "l", "u")}
    matrices = {key: read(key, key, shapes[key]) for key in CONSTANT}
    names = {key: f"{key}_steps" for key in CONSTANT if f"{key}_steps" in arrays}
    steps = {key: read(key, name, (K, *shapes[key])) for key, name in names.items()}
    block, moves = (read_stored_count(arrays, where, key) for key in ("block", "moves"))
    try:
        first = {key: vector[0] for key, vector in vectors.items()}
        base = QuadraticProgram(**matrices, **first, block=block, moves=moves)
        return QPSequence(name, base, **vectors, meta=meta, **steps)
    except InputError as error:
        raise InputError(where, error.key, error.found, error.allowed) from error


def _read_optima(arrays: Arrays, where: str, sizes: tuple[int, int, int]) -> list[Optimum]:
    """Return the certified optima from the arrays of a sequence file, after checking them."""
    K, n, m = sizes
    shapes = {"z": (K, n), "y": (K, m), "y_box": (K, n)}
    columns: list[Any] = [
        read_float_array(arrays, where, key, shape, nan=True) for key, shape in shapes.items()
    ]
    bound = read_float_array(arrays, where, "bound", (K,), infinite="+")
    if "certificate" not in arrays or arrays["certificate"].shape != (K,):
        found = f"shape {arrays['certificate'].shape}" if "certificate" in arrays else "nothing"
        raise InputError(where, "certificate", found, f"shape {(K,)}")
    kinds = [str(kind) for kind in arrays["certificate"].tolist()]
    for k, kind in enumerate(kinds):
        if kind not in get_args(Kind):
            allowed = ", ".join(get_args(Kind))
            raise InputError(where, f"certificate[{k}]", repr(kind), allowed)
        if np.isfinite(bound[k]) and not all(np.isfinite(c[k]).all() for c in columns):
            found = "NaN at a step with a finite error bound"
            raise InputError(where, f"z, y, y_box[{k}]", found, "finite numbers")
    rows = zip(*columns, bound.tolist(), kinds, strict=True)
    return [Optimum(*row) for row in rows]


def _read_matrix(arrays: Arrays, where: str, name: str) -> NDArray[Any]:
    """Return the array `name` of a sequence file; InputError unless it is a matrix with columns."""
    array = arrays.get(name)
    least = 1 if name == "q" else 0
    if array is None or array.ndim != 2 or array.shape[0] < least or array.shape[1] < 1:
        found = "nothing" if array is None else f"shape {array.shape}"
        allowed = "shape (K, n) for K steps, K ≥ 1" if name == "q" else "shape (m, n)"
        raise InputError(where, name, found, allowed)
    return array


def _read_document(where: str, name: str, texts: dict[str, str]) -> dict[str, Any]:
    """Return the JSON object in the text `name` of a sequence file; InputError without one."""
    try:
        document = parse_json(texts[name])
    except ValueError as error:
        raise InputError(where, name, *describe_json_fault(error, "a JSON object")) from error
    if not isinstance(document, dict):
        found = "a list" if isinstance(document, list) else shorten_found(document)
        raise InputError(where, name, found, "a JSON object")
    return document


def _read_meta(where: str, texts: dict[str, str]) -> dict[str, Any]:
    """Read the facts about a sequence from its file; InputError for an impossible number."""
    meta = _read_document(where, "meta", texts)
    for key, least in (("first", 0), ("every", 1), ("sample_s", 0)):
        value = meta.get(key, least)
        whole = key == "sample_s" or isinstance(value, int)
        if not isinstance(value, int | float) or not whole or not value >= least:
            raise InputError(where, f"meta.{key}", repr(value), f"a number, {least} or more")
    return meta


_PROBLEM = "a problem written by `qpsolvers.Problem.save()` (.npz)"
KEYS = ("P", "q", "G", "h", "A", "b", "lb", "ub")


def list_problem_files(folder: Path) -> list[Path]:
    """Return a folder's problem files in natural order, of one format; InputError without any."""
    paths = [path for path in folder.iterdir() if path.is_file()]
    by_format = ([path for path in paths if path.suffix == suffix] for suffix in _READERS)
    files = next(filter(None, by_format), [])
    if not files:
        *others, last = _READERS
        found = f"no {', '.join(others)} or {last} file"
        is_export = any(path.suffix in (".csv", ".qps") for path in paths)
        allowed = "a folder of files with one QP each" + f"; {ONE_WAY}: use the .npz" * is_export
        raise InputError(str(folder), "", found, allowed)
    return sorted(files, key=lambda path: (_natural_sort_key(path.stem), path.name))


def _natural_sort_key(text: str) -> list[tuple[int, int, str]]:
    """Return a file name's sort key, in which numbers count by value."""
    parts = re.split(r"([0-9]+)", text)
    return [(1, int(part), "") if i % 2 else (0, 0, part) for i, part in enumerate(parts)]


def is_problem_file(path: Path) -> bool:
    """Return whether a file is a problem of others, not a sequence of dpbench."""
    if path.suffix in _READERS and path.suffix != ".npz":
        return True
    try:
        with open_regular_file(path) as file, zipfile.ZipFile(file) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, *DAMAGE):
        return False
    return bool(names & {"P", "q"}) and "format" not in names


def read_problems(place: Path) -> QPSequence:
    """Return the problems of others in a folder, or in one file, as a sequence."""
    files = list_problem_files(place) if place.is_dir() else [place]
    problems = [_READERS.get(path.suffix, read_problem)(path) for path in files]
    base = problems[0]
    for path, qp in zip(files, problems, strict=True):
        if (qp.n, qp.m) != (base.n, base.m):
            allowed = f"{describe_qp_size(base.n, base.m)}, as in {files[0].name}"
            raise InputError(str(path), "", describe_qp_size(qp.n, qp.m), allowed)
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
    arrays, objects = read_arrays_and_pickles(path, _PROBLEM)
    for name, packed in objects.items():
        # None is saved as an object, and so is a sparse matrix, which qpsolvers then fails to load.
        if b"scipy" in packed:
            raise InputError(where, name, "a pickled sparse matrix", "a dense array, or none")
    for name in [*arrays, *objects]:
        if name not in KEYS:
            allowed = f"the arrays {', '.join(KEYS)} of {_PROBLEM}"
            raise InputError(where, name, "an unknown array", allowed)
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
        raise InputError(where, missing, "nothing", f"both {matrix} and {vector}, or neither")
    # qpsolvers takes a single row as a vector.
    shaped = arrays | {matrix: np.atleast_2d(arrays[matrix]), vector: arrays[vector].reshape(-1)}
    m = shaped[matrix].shape[0]
    return (
        read_float_array(shaped, where, matrix, (m, n)),
        read_float_array(shaped, where, vector, (m,), infinite=infinite),
    )


_READERS = {
    ".npz": read_problem,
    ".json": read_acados_qp,
    ".mat": read_maros_meszaros_problem,
}
"""Readers of files of one QP by suffix, in the order in which a folder is searched for them."""
