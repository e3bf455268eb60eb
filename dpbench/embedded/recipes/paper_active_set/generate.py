"""Write what the paper's method needs of P and A as constants of C, computed on the desk."""

import ctypes
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.solvers.own.library import Problem, open_library

FOLDER = Path(__file__).parent
SCALARS = ("coupled", "longest", "steepest", "largest", "widest", "loss")


def write_sources(
    sequence: QPSequence, folder: Path, single: bool, settings: Mapping[str, Any]
) -> None:
    """Write `constants.h` with P, P⁻¹ and the rows where they stay, and the common step."""
    (folder / "active_set_step.h").write_bytes((FOLDER / "active_set_step.h").read_bytes())
    text = ""
    if all(getattr(sequence, name) is None for name in ("P", "A")):
        text = _write_constants(sequence.base)
    (folder / "constants.h").write_text(text)


def _write_constants(qp: QuadraticProgram) -> str:
    """Return the constants of a QP's matrices as text of a C header."""
    n, m = qp.n, qp.m
    problem = Problem(n, m)
    problem.P[:], problem.A[:] = qp.P, qp.A
    open_library().active_set_factorise(problem.pointer, problem.P_pointer, problem.A_pointer)
    entries = int(np.count_nonzero(qp.A))
    reals = {"P": n * n, "G": (n + m) * n, "unit": n + m, "a": entries}
    integers = {"column": entries, "first": m + 1, "parent": m, "order": n}
    lines = [_array("as_real", name, problem.view(name, size)) for name, size in reals.items()]
    for name, size in integers.items():
        pointer = ctypes.cast(getattr(problem.head, name), ctypes.POINTER(ctypes.c_int))
        lines.append(_array("int", name, np.ctypeslib.as_array(pointer, (size,))))
    scalars = ", ".join(f".{name} = {getattr(problem.head, name)!r}" for name in SCALARS)
    return "\n".join([*lines, f"#define SCALARS {scalars}", ""])


def _array(kind: str, name: str, values: NDArray[Any]) -> str:
    """Return an array as C, each number so that it is read back exactly."""
    numbers = ", ".join(repr(value) for value in values.tolist()) or "0"
    return f"static const {kind} {name}_[] = {{{numbers}}};"
