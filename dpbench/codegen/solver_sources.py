"""C sources of each solver for a controller: template values, constant tables, files."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.codegen.c_tables import Table, format_number_for_c, make_c_table
from dpbench.embedded.recipe import RECIPES, Recipe, fetch_sources
from dpbench.embedded.recipes.osqp.generate import generate_c
from dpbench.errors import InputError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import count_rows_per_block
from dpbench.solvers.contract import Options, Settings
from dpbench.solvers.libraries.osqp import make_default_settings_of_library
from dpbench.solvers.own import compiling
from dpbench.solvers.own.library import ActiveSet, Problem, load_own_c_library
from dpbench.solvers.own_settings import format_each_option_as_toml, format_options_as_toml
from dpbench.solvers.settings import resolve_settings_to_options
from dpbench.solvers.table import CONTROLLER_SOLVERS, get_native_adapter
from dpbench.temporary_folders import make_temporary_folder_for_block, process_temporary_folder

TOLERANCE = 1e-6
"""Largest accepted difference of a replay from dpbench's solver, in maximum increments."""

_OF_GENERATED_OSQP = {"adaptive_rho": False, "rho_is_vec": False}
"""Options of OSQP's generated C, which cannot factorise for another ρ: neither over time, nor for a
row whose limits become equal, such as that of a lost thruster."""


@dataclass(frozen=True)
class SolverSources:
    """C sources of one solver for one controller.

    header, source : templates of `solver.h` and `solver.c`, with their values; files : sources
    beside them, by name; memory : bytes of `solver_memory`; origin : where the files are from, with
    their licence; heap : use of it; options : those of the C code, and of dpbench's solver that a
    replay compares it with; copies : whether a process may have several.
    """

    header: str
    source: str
    values: dict[str, Any]
    tables: tuple[Table, ...]
    files: dict[str, bytes]
    memory: int
    origin: str
    heap: str = "none"
    options: Options = field(default_factory=dict)
    copies: bool = True

    @property
    def c_files_to_compile(self) -> list[str]:
        """Names of the solver's C files to compile besides those of the controller."""
        return sorted(name for name in self.files if name.endswith(".c"))


def make_c_sources_of_active_set(qp: CondensedQP, settings: Settings = "default") -> SolverSources:
    """Return the C sources of the paper's method with all constants of a QP's P and A.

    SettingsError for any option, as the method has none.
    """
    resolve_settings_to_options(settings, get_native_adapter("paper_active_set"))
    problem = Problem(qp.n, qp.m)
    problem.P[:], problem.A[:] = qp.P, qp.A
    arrays = problem.P_pointer, problem.A_pointer
    refused = load_own_c_library().active_set_factorise(problem.pointer, *arrays)
    assert refused == 0, "a controller's P is positive definite"
    meanings = {
        "P": "the Hessian, row after row",
        "G": "P⁻¹ and A P⁻¹, row after row",
        "unit": "1/√ of the diagonal of C P⁻¹ Cᵀ, C = [I; A]",
        "a": "entries of A that are not zero",
        "column": "their columns",
        "first": "where each row of A begins in these two",
        "parent": "rows of A whose entries begin a row's",
        "rest": "first entry of a row after these",
        "order": "variables that P couples, part after part, then others",
        "sizes": "at the first variable of a part: how many it has",
        "blocks": "P⁻¹ of each part",
    }
    constants = problem.copy_arrays_that_depend_on_matrices()
    tables = tuple(
        make_c_table(name, constants[name], meaning) for name, meaning in meanings.items()
    )
    reals = (field[0] for field in ActiveSet._fields_ if field[1] is ctypes.c_double)
    scalars = {name: format_number_for_c(getattr(problem.head, name)) for name in reals}
    values = {"scalars": scalars, "block": qp.block, "coupled": problem.head.coupled}
    names = ("active_set.h", "active_set.c", "active_set_care.c")
    header, core, care = (Path(compiling.FOLDER, name).read_bytes() for name in names)
    # One file: the refinement includes the core, and all files of a folder are compiled.
    own = care.partition(b'#include "active_set.c"\n')[2]
    files = {"active_set.h": header, "active_set.c": core + own}
    origin = "active_set.c and active_set.h are part of dpbench, Apache-2.0"
    # The library places the memory of a step first: low … unit, active … first.
    head = problem.head
    step = head.unit - head.low + round_up_to_multiple_of_8(head.first - head.active)
    memory = 4 * 8 + 8 + ctypes.sizeof(ActiveSet) + step
    return SolverSources(
        "solver_active_set.h", "solver_active_set.c", values, tables, files, memory, origin
    )


def round_up_to_multiple_of_8(count: int) -> int:
    """Return a number of bytes rounded up to a multiple of 8."""
    return -(-count // 8) * 8


def generate_c_sources_of_osqp(qp: CondensedQP, settings: Settings | None = None) -> SolverSources:
    """Return the C sources that OSQP's own generator writes for a QP, with ρ constant.

    Without settings, those of its recipe.
    """
    options = _resolve_settings_of_osqp(settings)
    rows, one = np.vstack([np.eye(qp.n), qp.A]), np.ones(qp.n + qp.m)
    with make_temporary_folder_for_block(process_temporary_folder()) as folder:
        generate_c(qp.P, rows, (-one, one), folder, options)
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
    moved = count_rows_per_block(qp.n, qp.m, qp.block)
    return SolverSources(
        "solver_fixed.h",
        "solver_osqp.c",
        {"library": "OSQP, generated", "block": qp.block, "rows_of_block": moved},
        (),
        files,
        _count_static_solver_memory_bytes(qp),
        "OSQP's sources are those of its code generator, Apache-2.0, with "
        f"{format_options_as_toml(options)}",
        heap="none; OSQP's workspace is static memory besides",
        options=options,
        copies=False,
    )


def _resolve_settings_of_osqp(settings: Settings | None) -> Options:
    """Return the options of OSQP's C code; an error for one that it does not support."""
    if settings is None:
        return {**Recipe(RECIPES / "osqp").file.settings, **_OF_GENERATED_OSQP}
    options = dict(resolve_settings_to_options(settings, get_native_adapter("osqp")))
    options.setdefault("max_iter", make_default_settings_of_library().max_iter)
    # Presets have OSQP adapt ρ, as its library does by default: only a wish for it is refused.
    wanted = settings if not isinstance(settings, str) else {}
    unsupported = {"polishing": options, "time_limit": options}
    for name, chosen in {**unsupported, **dict.fromkeys(_OF_GENERATED_OSQP, wanted)}.items():
        if chosen.get(name):
            found = format_each_option_as_toml(chosen)[name]
            allowed = "no limit" if name == "time_limit" else "false"
            allowed += ", as OSQP's generated C code cannot change rho, polish its solution or "
            allowed += "limit its time"
            raise InputError("settings of osqp", name, found, allowed)
    options.pop("adaptive_rho_interval", None)
    return options | _OF_GENERATED_OSQP


def fetch_c_sources_and_tables_of_daqp(
    qp: CondensedQP, settings: Settings = "default"
) -> SolverSources:
    """Return DAQP's C files, downloaded once, and the QP's P and A as tables; or SituationError."""
    options = resolve_settings_to_options(settings, get_native_adapter("daqp"))
    package = Recipe(RECIPES / "daqp").file.package
    assert package is not None, "its C is fetched"
    root = fetch_sources(package.name, package.version, package.sha256)
    tables = (
        make_c_table("P", qp.P.reshape(-1), "the Hessian, row after row"),
        make_c_table("A", qp.A.reshape(-1), "the rows of amplitude limits, row after row"),
    )
    files = {path.name: path.read_bytes() for path in (root / "csrc").rglob("*.[ch]")}
    files["LICENSE.daqp"] = (root / "LICENSE").read_bytes()
    return SolverSources(
        "solver_fixed.h",
        "solver_daqp.c",
        {"library": f"DAQP {package.version}", "options": format_each_option_as_toml(options)},
        tables,
        files,
        _count_static_solver_memory_bytes(qp),
        f"DAQP's sources are those of its distribution {package.version}, MIT",
        heap="taken once by DAQP, in controller_start",
        options=options,
        copies=False,
    )


def _count_static_solver_memory_bytes(qp: CondensedQP) -> int:
    """Return the bytes of `solver_memory` of a solver whose workspace is elsewhere."""
    return 8 * (2 * qp.n + 2 * (qp.n + qp.m)) + 8


_MAKERS: tuple[Callable[..., SolverSources], ...] = (
    make_c_sources_of_active_set,
    generate_c_sources_of_osqp,
    fetch_c_sources_and_tables_of_daqp,
)
SOLVERS = dict(zip(CONTROLLER_SOLVERS, _MAKERS, strict=True))
"""Makers of the C sources by the name of the solver, from a QP and settings if there are any."""
