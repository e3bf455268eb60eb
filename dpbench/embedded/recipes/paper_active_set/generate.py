"""Write what the paper's method needs of P and A as constants of C, computed on the desk."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from dpbench.qp.program import QPSequence, QuadraticProgram
from dpbench.solvers.own.library import Problem, load_own_c_library

FOLDER = Path(__file__).parent
SCALARS = ("coupled", "longest", "steepest", "largest", "widest", "loss")


def write_sources(
    sequence: QPSequence, folder: Path, single: bool, settings: Mapping[str, Any]
) -> None:
    """Write `constants.h` with P, P⁻¹ and the rows where they stay, and the common step."""
    (folder / "active_set_step.h").write_bytes((FOLDER / "active_set_step.h").read_bytes())
    text = ""
    if all(getattr(sequence, name) is None for name in ("P", "A")):
        text = _format_constants_header(sequence.base, refined=bool(settings.get("refine")))
    (folder / "constants.h").write_text(text)


def _format_constants_header(qp: QuadraticProgram, *, refined: bool) -> str:
    """Return the constants of a QP's matrices as text of a C header."""
    problem = Problem(qp.n, qp.m)
    problem.P[:], problem.A[:] = qp.P, qp.A
    load_own_c_library().active_set_factorise(problem.pointer, problem.P_pointer, problem.A_pointer)
    constants = problem.copy_arrays_that_depend_on_matrices()
    lines = [] if refined else ["#define P_ 0 /* the refinement alone reads P */"]
    if not refined:
        del constants["P"]
    lines += [_format_c_array(name, values) for name, values in constants.items()]
    scalars = ", ".join(f".{name} = {getattr(problem.head, name)!r}" for name in SCALARS)
    return "\n".join([*lines, f"#define SCALARS {scalars}", ""])


def _format_c_array(name: str, values: NDArray[Any]) -> str:
    """Return an array as C, each number so that it is read back exactly."""
    kind = "as_real" if values.dtype.kind == "f" else "int"
    numbers = ", ".join(repr(value) for value in values.tolist()) or "0"
    return f"static const {kind} {name}_[] = {{{numbers}}};"
