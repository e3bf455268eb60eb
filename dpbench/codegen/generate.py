"""`dpbench codegen`: write the complete control step of a scenario as C99."""

import shlex
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dpbench.codegen.c_tables import Table, format_number_for_c, make_c_table, render_c_template
from dpbench.codegen.controller_data import (
    ControllerData,
    Trajectory,
    read_controller_data_of_scenario,
    record_closed_loop_trajectory,
)
from dpbench.codegen.counted_replay import StepCost, count_replay
from dpbench.codegen.fmu import SYSTEMS, build_fmu_bytes
from dpbench.codegen.solver_sources import (
    SOLVERS,
    TOLERANCE,
    SolverSources,
    round_up_to_multiple_of_8,
)
from dpbench.embedded.toolchain import REMEDY, has_extra
from dpbench.errors import InputError, SettingsError
from dpbench.files.regular_files import write_bytes_to_file_or_pipe, write_file_set_into_folder
from dpbench.report.formats import format_count, plural
from dpbench.scenario.scenario import Scenario, resolve_to_scenario
from dpbench.solvers.contract import DEFAULT
from dpbench.solvers.own_settings import format_options_as_toml, parse_choice_without_grid
from dpbench.solvers.settings import (
    describe_allowed_names_of_settings,
    has_preset_or_tolerance,
    list_preset_names,
)
from dpbench.solvers.table import find_solver_record

MOST_REPLAYED = 1000
"""Steps of the recorded trajectory."""


def generate_controller(
    scenario: Scenario | str | Path,
    solver: str = "paper_active_set",
    *,
    out: str | Path,
    settings: str | None = None,
    steps: int = MOST_REPLAYED,
    fmu: str | Path | None = None,
    fmi: int = 2,
    counts: bool = True,
) -> list[str]:
    """Write a scenario's controller as C99 into a folder; return what was written, as lines.

    Parameters
    ----------
    scenario : an object, a name or a TOML file; its controller has one model and no cascade.
    solver : the name of a solver with C sources, or with options as `osqp[rho=1.6]`.
    out : the folder, made unless it exists.
    settings : a preset of the solver such as "high" or "1e-4"; by default those of its C code.
    steps : length of the recorded trajectory that comes with it.
    fmu : file of a functional mock-up unit to write too; fmi : its version, 2 or 3.
    counts : put instructions of the replayed steps into README.md, where the extra `embedded` is
        installed.

    Raises
    ------
    InputError : for a controller or solver without C code, or without the extra `embedded`, whose
        compiler an FMU needs.
    SituationError : the sources cannot be fetched, or an emulated core commands something else.
    """
    name, options = parse_choice_without_grid(solver, "`solver`", "one value per option")
    if name not in SOLVERS:
        raise InputError("`solver`", "", repr(name), f"one of {', '.join(SOLVERS)}")
    if options and settings:
        found = f"{settings!r} with the options in {solver}"
        raise InputError("`settings`", "", found, "a preset or options, not both")
    if settings and not has_preset_or_tolerance(name, settings):
        allowed = describe_allowed_names_of_settings(list_preset_names(name), "`solver`")
        raise SettingsError("`settings`", "", repr(settings), allowed)
    if fmi not in SYSTEMS:
        raise InputError("`fmi`", "", fmi, "2 or 3")
    data = read_controller_data_of_scenario(resolve_to_scenario(scenario))
    chosen = options or settings
    sources = SOLVERS[name](data.qp, *([chosen] if chosen else []))
    if fmu is not None and not sources.copies:
        allowed = "`solver` paper_active_set, which uses only the caller's memory"
        raise InputError("`fmu`", "", f"`solver` {name}", allowed)
    tables = list_constant_tables(data)
    sizes = {
        "constants": sum(table.bytes for table in (*tables, *sources.tables)),
        "memory": _count_controller_structure_bytes(data, sources),
    }
    trajectory = record_closed_loop_trajectory(data, name, steps, sources.options or DEFAULT)
    costs = count_steps(data, sources, tables, trajectory) if counts and has_extra() else []
    arguments = shlex.join(["--solver", solver, *(["--settings", settings] if settings else [])])
    unsolved = _describe_unsolved_steps(name, sources, trajectory)
    rows = [cost.row for cost in costs]
    facts = {**sizes, "arguments": arguments, "costs": rows, "warnings": unsolved}
    files = render_c_sources(data, sources, tables, **facts)
    names = [signal.name for signal in (*data.inputs, *data.outputs)]
    files["trajectory.csv"] = trajectory.format_as_csv(names).encode()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    write_file_set_into_folder(folder, {name: partial(bytes, text) for name, text in files.items()})
    lines = [
        f"Wrote {len(files)} files to {folder}: the control step in controller.c, an example in "
        "main.c.",
        f"The QP has {data.qp.n} variables and {data.qp.m} rows. Constants take "
        f"{format_count(sizes['constants'])} bytes and working memory takes "
        f"{format_count(sizes['memory'])} bytes"
        + ("." if sources.copies else f", without the static memory of {name}."),
        *unsolved,
        *_describe_settings(name, sources),
    ]
    lines += [f"{cost.summary}." for cost in costs]
    if counts and not costs:
        lines.append(f"Instructions were not counted: {REMEDY}, then generate again.")
    if fmu is not None:
        whole = build_fmu_bytes(data, files, fmi)
        write_bytes_to_file_or_pipe(Path(fmu), whole)
        systems = ", ".join(place for place, _, _ in SYSTEMS[fmi])
        lines.append(
            f"Wrote a functional mock-up unit (FMI {fmi}.0, {len(whole) / 1000:.0f} kB) to {fmu}, "
            f"with libraries for {systems}."
        )
    return lines


def _describe_unsolved_steps(
    solver: str, sources: SolverSources, trajectory: Trajectory
) -> list[str]:
    """Return a line on the steps of the recorded loop without the status solved, if any."""
    if not trajectory.unsolved:
        return []
    limit = find_solver_record(solver).iteration_limit
    at = f" ({limit} = {sources.options[limit]})" if limit in sources.options else ""
    whole = plural(len(trajectory.commands), "step")
    count = f"{format_count(trajectory.unsolved)} of {whole} of the recorded loop"
    return [f"{count} ended without the status solved{at}: judge the settings with dpbench run."]


def _describe_settings(solver: str, sources: SolverSources) -> list[str]:
    """Return lines on the settings of the C code, and the command that judges the same ones."""
    if not sources.options:
        return []
    choice = f"{solver}[{format_options_as_toml(sources.options)}]"
    constant = "" if sources.options.get("adaptive_rho", True) else " It cannot adapt rho."
    return [
        f"The code has the settings of the following command, which judges them.{constant}",
        f"dpbench run standard --solver '{choice}' --route native --policy warm",
    ]


def count_steps(
    data: ControllerData,
    sources: SolverSources,
    tables: Iterable[Table],
    trajectory: Trajectory,
) -> list[StepCost]:
    """Return what the steps of a trajectory take on emulated cores."""
    files = render_c_sources(data, sources, tables, arguments="", constants=0, memory=0, costs=[])
    compiled = {name: files[name] for name in files if Path(name).suffix in (".c", ".h")}
    del compiled["main.c"]
    compiled["count_step.c"] = render_c_template("count_step.c", inputs=data.inputs)
    return count_replay(compiled, trajectory, data.du_max, TOLERANCE)


def _count_controller_structure_bytes(data: ControllerData, sources: SolverSources) -> int:
    """Return the bytes of the structure `controller`, with pointers of 8 bytes."""
    whole = sum(signal.is_integer for signal in data.inputs)
    n_u, moves = len(data.du_max), data.qp.control.N_c
    own = (
        8 * (len(data.inputs) - whole)
        + round_up_to_multiple_of_8(4 * whole)
        + 8 * n_u * (1 + moves)
        + 8
    )
    return sources.memory + own


def list_constant_tables(data: ControllerData) -> tuple[Table, ...]:
    """Return the constant tables of the generated control step, from the controller's data."""
    gradient = make_c_table("gradient", data.gradient, "q of the QP = gradient θ")
    du_max = make_c_table("du_max", data.du_max, "rate limits: the largest change in one step")
    thrusters = data.thrusters
    if thrusters is None:
        limits = (
            make_c_table("intact_low", data.low, "limits of surge, sway [N] and yaw [N·m]"),
            make_c_table("intact_high", data.high, "and their other side"),
        )
        return gradient, du_max, *limits
    of_rows = (
        ("normal", thrusters.normal, "rows of limits, on the entries of their thruster"),
        ("intact_low", thrusters.low, "limits [N] of these rows"),
        ("intact_high", thrusters.high, "and their other side"),
        ("lost_low", thrusters.lost_low, "limits after the loss of the row's thruster"),
        ("lost_high", thrusters.lost_high, "and their other side"),
        ("row_max", thrusters.row_max, "change of a row by a maximum increment"),
        ("first_row", np.array(thrusters.first_row), "where the rows of each thruster begin"),
        ("first_entry", np.array(thrusters.first_entry), "where the forces of each thruster begin"),
    )
    return gradient, du_max, *(make_c_table(*table) for table in of_rows)


def render_c_sources(
    data: ControllerData, sources: SolverSources, tables: Iterable[Table], **facts: Any
) -> dict[str, bytes]:
    """Return the C sources of the controller by file name; `facts` are more values of templates."""
    scenario, thrusters = data.scenario, data.thrusters
    theta = data.gradient.shape[1]
    common = {
        "scenario": scenario.name,
        "vessel": scenario.vessel.title,
        "description": scenario.controller.tuning_horizons_and_command_text,
        "sample_s": format_number_for_c(scenario.sample_s),
        "n_u": len(data.du_max),
        "moves": data.qp.control.N_c,
        "theta": theta,
        "reachable": data.reachable,
        "thrusters": thrusters,
        "inputs": data.inputs,
        "outputs": data.outputs,
        "du_max": [format_number_for_c(x) for x in data.du_max],
        "sources": ["controller.c", "solver.c", *sources.c_files_to_compile],
        "n": data.qp.n,
        "m": data.qp.m,
        "origin": sources.origin,
        "heap": sources.heap,
        "tolerance": format_number_for_c(TOLERANCE),
        "warnings": [],
        **facts,
    }
    defines = [f"THETA {theta}"]
    if thrusters is not None:
        defines += [f"ROWS {len(thrusters.low)}"]
    of_step = {"title": "Constants of the control step", "defines": defines, "tables": tables}
    of_solver = {"title": "Constants of the solver", "defines": [], "tables": sources.tables}
    texts = {
        "README.md": render_c_template("README.md", **common),
        "controller.h": render_c_template("controller.h", **common),
        "controller.c": render_c_template("controller.c", **common),
        "controller_tables.h": render_c_template("tables.h", **of_step, **common),
        "solver.h": render_c_template(sources.header, **common, **sources.values),
        "solver.c": render_c_template(sources.source, **common, **sources.values),
        "solver_tables.h": render_c_template("tables.h", **of_solver, **common),
        "main.c": render_c_template("main.c", **common),
        "CMakeLists.txt": render_c_template("CMakeLists.txt", **common),
    }
    return texts | sources.files
