"""C sources of each solver for a controller: template values, constant tables, files."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.arrays import Indices
from dpbench.codegen.c_tables import Table, make_table, number_text
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.solvers.own import compiling
from dpbench.solvers.own.library import ActiveSet, Problem, open_library


@dataclass(frozen=True)
class SolverSources:
    """C sources of one solver for one controller.

    values : of the templates `solver_NAME.h.j2` and `.c.j2`; files : sources beside them, by name;
    compiled : the C files among them; memory : bytes of `solver_memory`; heap : its use of it;
    origin : where the files are from, with their licence.
    """

    template: str
    values: dict[str, Any]
    tables: tuple[Table, ...]
    files: dict[str, bytes]
    compiled: tuple[str, ...]
    memory: int
    origin: str
    heap: str = "none"


def write_active_set(qp: CondensedQP) -> SolverSources:
    """Return the paper's method with all constants of P and A: no factorising on the target."""
    n, m = qp.n, qp.m
    problem = Problem(n, m)
    problem.P[:], problem.A[:] = qp.P, qp.A
    arrays = problem.P_pointer, problem.A_pointer
    refused = open_library().active_set_factorise(problem.pointer, *arrays)
    assert refused == 0, "a controller's P is positive definite"
    first = _view_integers(problem, "first", m + 1)
    entries = int(first[-1])
    G = problem.view("G", (n + m) * n)
    tables = (
        make_table("P", problem.view("P", n * n), "the Hessian, row after row"),
        make_table("G", G, "P⁻¹ and A P⁻¹, row after row"),
        make_table(
            "unit", problem.view("unit", n + m), "1/√ of the diagonal of C P⁻¹ Cᵀ, C = [I; A]"
        ),
        make_table("a", problem.view("a", entries), "entries of A that are not zero"),
        make_table("column", _view_integers(problem, "column", entries), "their columns"),
        make_table("first", first, "where each row of A begins in these two"),
        make_table("order", _view_integers(problem, "order", n), "coupled variables, then others"),
    )
    reals = (field[0] for field in ActiveSet._fields_ if field[1] is ctypes.c_double)
    scalars = {name: number_text(getattr(problem.head, name)) for name in reals}
    values = {"scalars": scalars, "block": qp.block, "coupled": problem.head.coupled}
    names = ("active_set.h", "active_set.c")
    files = {name: Path(compiling.FOLDER, name).read_bytes() for name in names}
    origin = "active_set.c and active_set.h are part of dpbench, Apache-2.0"
    numbers = 9 * n + 4 * (n + m) + n * (n + 1) // 2
    memory = 4 * 8 + 8 + ctypes.sizeof(ActiveSet) + 8 * numbers + round_up(4 * (3 * n + m))
    return SolverSources("active_set", values, tables, files, ("active_set.c",), memory, origin)


def round_up(count: int) -> int:
    """Return a number of bytes rounded up to a multiple of 8."""
    return -(-count // 8) * 8


def _view_integers(problem: Problem, name: str, length: int) -> Indices:
    """Return an array of integers of the library's structure as a view."""
    address = getattr(problem.head, name)
    return np.ctypeslib.as_array((ctypes.c_int * length).from_address(address))


SOLVERS: dict[str, Callable[[CondensedQP], SolverSources]] = {"paper_active_set": write_active_set}
"""By the name of the solver."""
