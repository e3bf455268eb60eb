"""`dpbench export`: a scenario or a sequence as a file for others."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.arrays import Vector
from dpbench.bench.run.exact_loop import Part
from dpbench.bench.sequences import source
from dpbench.bench.sequences.sequence_file import KEYS, Recorded
from dpbench.errors import InputError, UnknownNameError, require_type
from dpbench.files.regular_files import (
    make_folder_if_missing,
    write_file_atomically,
    write_text_atomically,
)
from dpbench.qp.program import ARRAYS, QPSequence, QuadraticProgram
from dpbench.qp.random_mpc import is_random_mpc_sequence_name
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.scenario.problem_files import (
    SEQUENCE_SUFFIXES,
    is_shipped_sequence_name,
    list_shipped_problem_names,
    make_unknown_qps_name_error,
)
from dpbench.scenario.scenario import Scenario, resolve_to_scenario
from dpbench.scenario.tables.key_types import Horizons, parse_horizons
from dpbench.solvers.one_sided import OneSidedForm

Format = Literal["npz", "qpbenchmark", "mat", "csv", "qps"]
FORMATS: tuple[Format, ...] = get_args(Format)
FILES: dict[Format, str] = {"npz": ".npz", "mat": ".mat"}  # of the formats that are one file
_TAKEN = frozenset(sys.stdlib_module_names) | {"qpbenchmark", "qpsolvers", "numpy", "pandas"}
_TEST_SET = '''"""{title}.

Written by dpbench next to {stem}.parquet; run it with

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
OPTIMUM = ("z", "y", "y_box")


def export_sequence(
    what: str | Path | Scenario | QPSequence,
    out: str | Path,
    *,
    format: Format = "npz",
    horizons: str | None = None,
    steps: int | None = None,
    every: int = 1,
    at: int | None = None,
    part: Part = "controller",
) -> str:
    """Write the certified QPs of a scenario or a sequence to a file; return a line on it.

    Parameters
    ----------
    what : a scenario, a sequence, or the name or path of either; a file or folder of other QPs; or
        a random MPC problem such as random_mpc-10-4-10 (states, inputs, horizon).
    out : the `.npz` or `.mat` file; for "qpbenchmark" the name of the Parquet file and the Python
        file; for "csv" and "qps" a folder.
    horizons : "N_p/N_c" instead of those of the tuning; of a scenario only.
    steps, every : the first so many steps, and of these each `every`-th; at : one step instead.
    part : "allocation" for the second QPs of a cascade; of a scenario only.

    Raises
    ------
    InputError : for bad input; CertificateError when the loop of a scenario cannot be certified.

    Examples
    --------
    >>> export_sequence("paper-30-5", "paper.mat", format="mat", steps=20).split(";")[0]
    'paper.mat: 20 QPs, n = 15, m = 15'
    >>> export_sequence("turn", "step-4.npz", at=4).split(";")[0]
    'step-4.npz: 1 QP, n = 30, m = 30'
    """
    _require_types(what, out, horizons, steps=steps, every=every, at=at)
    target = Path(out)
    if format not in FORMATS:
        raise InputError("`format`", "", repr(format), ", ".join(FORMATS))
    if (suffix := FILES.get(format)) and target.suffix != suffix:
        others = [name for name, end in FILES.items() if end == target.suffix]
        others += ["csv"] * (target.suffix == ".csv")  # which writes a folder
        instead = "".join(f", or `format` {name}" for name in others)
        allowed = f"a file name that ends in {suffix}{instead}"
        raise InputError("`out`", "", repr(target.name), allowed)
    if at is not None and (steps is not None or every != 1):
        raise InputError(
            "`at`",
            "",
            f"{at} with `steps` or `every`",
            "one step with `at`, or several with `steps` and `every`",
        )
    if part not in get_args(Part):
        raise InputError("`part`", "", repr(part), ", ".join(get_args(Part)))
    recorded = _record_requested(what, _parse_horizons(horizons), steps, every, at, part)
    target.parent.mkdir(parents=True, exist_ok=True)
    if format == "npz":
        recorded.save(target)
        written = str(target)
    elif write := {"mat": save_mat, "csv": save_csv, "qps": save_qps}.get(format):
        written = str(write(target, recorded))
    else:
        written = " and ".join(map(str, save_qpbenchmark(target, recorded)))
    left_out = len(recorded.optima or []) - len(list_steps_with_optimum(recorded))
    some = left_out and format == "qpbenchmark"
    without = f"; {left_out} left out, as they have no optimum" if some else ""
    about = source.describe_sequence(recorded.sequence, recorded.optima or [])
    return f"{written}: {about}{without}"


def _require_types(what: object, out: object, horizons: object, **numbers: object) -> None:
    """Raise TypeError for an argument of `export_sequence` of another type, and for no path."""
    named = "the name or file of a scenario or a sequence (TOML, .npz)"
    kinds = str | Path | Scenario | QPSequence
    require_type("what", what, kinds, f"a Scenario, a QPSequence, or {named}")
    require_type("out", out, str | PathLike, "a path")
    require_type("horizons", horizons, str | None, "text N_p/N_c, such as '30/5'")
    for name, number in numbers.items():
        kind = Integral if name == "every" else Integral | None
        require_type(name, number, kind, "a whole number")


def check_export_options(options: dict[str, Any]) -> None:
    """Raise InputError unless `dpbench export` has --all alone, or what to export with --out."""
    if not options["all"]:
        if options["what"] is None:
            raise InputError("export", "WHAT", "nothing", "the QPs to write, or --all")
        if options["out"] is None:
            _require_known_name(options["what"])
            raise InputError("export", "--out", "nothing", "the file or folder to write")
        return
    defaults = {"every": 1, "format": "npz", "part": "controller"}
    for key in ("what", "horizons", "steps", "every", "format", "at", "part"):
        if options[key] != defaults.get(key):
            option = key.upper() if key == "what" else f"--{key}"
            found = f"{options[key]} with --all"
            raise InputError("export", option, found, "--all alone or with --out")


def _record_requested(
    what: str | Path | Scenario | QPSequence,
    horizons: tuple[int, int] | None,
    steps: int | None,
    every: int,
    at: int | None,
    part: Part,
) -> Recorded:
    """Return a stored sequence, or one recorded from a scenario, cut to the requested steps."""
    if _is_scenario(what):
        scenario = _load_scenario(what)
        record = partial(source.record_scenario, horizons=horizons, part=part)
        if at is None:
            return record(scenario, steps=steps, every=every)
        # The loop up to there is what leads to the step; what follows is not needed.
        upto = at + 1 if 0 <= at < scenario.steps else None
        return _record_step(record(scenario, steps=upto), at)
    if part != "controller":
        allowed = "a scenario, as the QPs of a recorded sequence are fixed"
        raise InputError("`part`", "", f"{part} for a recorded sequence", allowed)
    if horizons is not None:
        found = f"{horizons[0]}/{horizons[1]} for a recorded sequence"
        raise InputError(
            "`horizons`", "", found, "a scenario, as the horizons of a recorded sequence are fixed"
        )
    stored = _load_recorded(what)
    if at is not None:
        return _record_step(stored, at)
    sequence = source.thin_sequence(stored.sequence, steps, every)
    # The optima of a file are certified again.
    return replace(stored, sequence=sequence, optima=certify_all_steps(sequence))


def _is_scenario(what: object) -> bool:
    """Return whether something is a scenario or names one, and no sequence of QPs."""
    if not isinstance(what, str | Path):
        return not isinstance(what, QPSequence)
    path = Path(what)
    is_file = (
        path.suffix in SEQUENCE_SUFFIXES
        or path.is_dir()
        or is_shipped_sequence_name(what)
        or is_random_mpc_sequence_name(what)
    )
    return str(what) in list_shipped_problem_names("scenarios") or not is_file


def _load_scenario(what: object) -> Scenario:
    """Return a scenario given as an object, by name or as a file; the name may be a sequence's."""
    try:
        return resolve_to_scenario(what)
    except UnknownNameError as error:
        name = str(what)
        if "@" in name:  # The error may be about the vessel
            raise
        raise make_unknown_qps_name_error(name) from error


def _require_known_name(what: str) -> None:
    """Raise InputError for a name of neither a scenario nor a sequence, and a missing file."""
    if _is_scenario(what):
        _load_scenario(what)
    elif not is_random_mpc_sequence_name(what):
        _load_recorded(what)


def _load_recorded(what: str | Path | Scenario | QPSequence) -> Recorded:
    """Return a sequence by name or file as recorded; one given as an object, without optima."""
    if isinstance(what, QPSequence):
        return Recorded(what.scaled or what, None)
    return source.load_named_sequence(str(what))


def _record_step(recorded: Recorded, k: int) -> Recorded:
    """Return step k of a recording as a recording, its optimum certified again."""
    sequence = source.select_step(recorded.sequence, k)
    return replace(recorded, sequence=sequence, optima=certify_all_steps(sequence))


def _parse_horizons(text: str | None) -> Horizons | None:
    """Return the MPC horizons in a text "N_p/N_c", None for None; InputError for other texts."""
    if text is None:
        return None
    try:
        return parse_horizons(text)
    except ValueError as error:
        raise InputError("`horizons`", "", repr(text), str(error)) from error


def save_qpbenchmark(out: str | Path, recorded: Recorded) -> tuple[Path, Path]:
    """Write a sequence as a qpbenchmark test set, Parquet and Python file; return their paths.

    Steps without a certified optimum are left out; InputError for a stem that Python cannot import.
    """
    path = Path(out)
    stem = path.stem
    if not stem.isidentifier() or stem in _TAKEN or path.suffix not in ("", ".py", ".parquet"):
        allowed = "a Python file with a valid module name that no library has, such as dp_paper.py"
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


_MAT_TEXT = b"MATLAB 5.0 MAT-file, written by dpbench".ljust(116)
"""Text at the start of a MATLAB file; without the time, so that equal arrays give equal bytes."""


def save_mat(path: Path, recorded: Recorded) -> Path:
    """Write a sequence to a MATLAB file, version 5, and return its path.

    P, A, lb, ub as in `QuadraticProgram`, with the step as the first axis where they vary; q, l, u
    (K, ·), the optima z, y, y_box (K, ·) and their error `bound` (K,). `unit_z` (n,) and `unit_row`
    (m,) are 1 of z and of a row in N or N·m. The structure `meta` has `name`, `scenario`,
    `sample_s` [s], `first` and `every` sample, the horizons, and the version of dpbench.
    """
    from scipy.io import savemat

    with write_file_atomically(path) as part:
        contents = {**_collect_arrays(recorded), "meta": _collect_meta(recorded)}
        savemat(str(part), contents, appendmat=False)
        with part.open("r+b") as file:  # savemat writes the time there
            file.write(_MAT_TEXT)
    return path


def save_csv(folder: Path, recorded: Recorded) -> Path:
    """Write a sequence to a folder, a CSV table without head for each array; return the folder.

    Arrays of every step have a row per step; a matrix is flattened by rows there.
    """
    make_folder_if_missing(folder)
    for name, array in _collect_arrays(recorded).items():
        rows = array.reshape(len(array), -1)
        text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
        write_text_atomically(folder / f"{name}.csv", f"{text}\n")
    return folder


def save_qps(folder: Path, recorded: Recorded) -> Path:
    """Write each QP of a sequence to a folder as a QPS file, named by its step; return the folder.

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
    if sequence.units is not None:
        arrays |= {"unit_z": sequence.units.z, "unit_row": sequence.units.row}
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
