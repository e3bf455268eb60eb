"""Tables of solvers and of the vessels, scenarios, suites and sequences of the package.

Each kind imports its own work: only the cells of a suite take the planner and its kernels.
"""

from pathlib import Path

from rich.console import Group, RenderableType

from dpbench.cli.terminal import format_heading_and_paragraphs, make_small_table, make_unstyled_text
from dpbench.errors import InputError
from dpbench.report.formats import MISSING, plural

VESSELS_ARE = """
largest acceleration: by the largest force in an axis when the thrusters may
also push in the other axes. `dpbench check` shows the acceleration with the
force of one axis alone."""

SEQUENCES_ARE = """
Each sequence has QPs of the reference loop of the scenario in its name, at the
horizons N_p-N_c. Every optimum is certified. n: variables; m: rows; K: QPs;
active: share of active rows, over all QPs; samples: stored samples of the loop."""

SUITES_ARE = """
cells: solver configurations, each in one scenario or replay. Rounds are
repetitions of a replay."""

SOLVERS_ARE = """
form: matrix format. native, qpsolvers: routes, each with its call policies.
low, mid, high: tolerance presets."""


def list_table(kind: str, name: str = "") -> RenderableType:
    """Return a table of all stored vessels, scenarios, suites, QP sequences or known solvers.

    name : of a solver, which alone is described then, with its options.
    """
    if name:
        if kind != "solvers":
            raise InputError("NAME", "", repr(name), "a NAME only where KIND is solvers")
        return make_unstyled_text(_describe_solver(name, with_options=True) + f"\n{SOLVERS_ARE}")
    makers = {"vessels": _list_vessels, "scenarios": _list_scenarios, "suites": _list_suites}
    return (makers | {"sequences": _list_sequences, "solvers": _list_solvers})[kind]()


def _list_vessels() -> RenderableType:
    """Return a table of all stored vessels: time constants and largest accelerations."""
    from dpbench.scenario import problem_files as problems
    from dpbench.scenario.tables.vessel_file import VesselFile
    from dpbench.ship.characteristics import compute_axis_time_constants_s

    entries = []
    for name in problems.list_shipped_problem_names("vessels"):
        path = problems.find_problem_path("vessels", name)
        vessel = problems.read_toml_as_model(path, VesselFile).build_vessel(name, str(path))
        times = [f"{t:.3g}" for t in compute_axis_time_constants_s(vessel)]
        surge, sway, yaw = 1e3 * vessel.accelerations_at_force_limits()[1]
        reached = f"surge {surge:.3g} mm/s², sway {sway:.3g} mm/s², yaw {yaw:.3g} mrad/s²"
        about = [
            f"time constants: surge {times[0]} s, sway {times[1]} s, yaw {times[2]} s",
            f"largest acceleration: {reached}",
        ]
        entries.append(format_heading_and_paragraphs(name, [vessel.title, *about]))
    return make_unstyled_text("\n".join([*entries, VESSELS_ARE]))


def _list_scenarios() -> RenderableType:
    """Return a text on all stored scenarios: vessel, tuning, steps and what they show."""
    from dpbench.scenario import problem_files as problems
    from dpbench.scenario.tables.scenario_file import ScenarioFile
    from dpbench.ship.froude import Froude

    entries = []
    for name in problems.list_shipped_problem_names("scenarios"):
        scenario = problems.read_toml_as_model(
            problems.find_problem_path("scenarios", name), ScenarioFile
        )
        controller = scenario.controller
        horizons = f"{controller.prediction_horizon}/{controller.control_horizon}"
        vessel = Path(scenario.vessel).stem
        about = f"vessel {vessel}; tuning {controller.tuning}; horizons {horizons}; "
        about += f"{scenario.steps} steps"
        drawn = scenario.environment.build_environment(Froude(1.0)).random_parts
        about += f"; random: {', '.join(drawn) or 'none'}"
        entries.append(format_heading_and_paragraphs(name, [about, scenario.shows]))
    return make_unstyled_text("\n".join(entries))


def _list_suites() -> RenderableType:
    """Return a table of all stored suites, with a legend: number of cells and purpose."""
    from dpbench.bench.plan.plan import plan_suite
    from dpbench.bench.plan.suite import load_path_and_suite
    from dpbench.scenario import problem_files as problems

    table = make_small_table("name", "cells", "purpose")
    for name in problems.list_shipped_problem_names("suites"):
        path, suite = load_path_and_suite(name)
        purpose = suite.title.removeprefix(f"{name.capitalize()}: ")
        described = ", ".join(filter(None, (purpose, suite.duration)))
        table.add_row(name, str(len(plan_suite(suite, beside=path.parent))), described)
    return Group(table, make_unstyled_text(SUITES_ARE))


def _list_sequences() -> RenderableType:
    """Return a table of all stored QP sequences: sizes, active limits and sample time."""
    import numpy as np

    from dpbench.bench.sequences.sequence_file import active_set, load_recorded
    from dpbench.scenario import problem_files as problems

    table = make_small_table("name", "n", "m", "K", "active", "matrices", "samples")
    for name in problems.list_shipped_problem_names(problems.SEQUENCES):
        recorded = load_recorded(problems.resolve_sequence_path(name))
        sequence, meta = recorded.sequence, recorded.sequence.meta
        sets = [active_set(o) for o in recorded.optima or [] if np.isfinite(o.bound)]
        base, every = sequence.base, int(meta.get("every", 1))
        table.add_row(
            name,
            *(str(count) for count in (base.n, base.m, len(sequence))),
            f"{100 * np.count_nonzero(sets) / np.size(sets):.1f} %" if sets else MISSING,
            "constant" if sequence.P is None else "varying",
            "all" if every == 1 else f"every {_make_ordinal(every)}",
        )
    return Group(table, make_unstyled_text(SEQUENCES_ARE))


def _make_ordinal(number: int) -> str:
    """Return a whole number as an ordinal, such as 2nd."""
    last = 0 if number % 100 in (11, 12, 13) else number % 10
    return f"{number}{ {1: 'st', 2: 'nd', 3: 'rd'}.get(last, 'th') }"


def _list_solvers() -> RenderableType:
    """Return a text on all solvers with their descriptions."""
    from dpbench.solvers.table import list_all_solver_names

    return make_unstyled_text(
        "\n".join([*map(_describe_solver, list_all_solver_names()), SOLVERS_ARE])
    )


def _describe_solver(name: str, *, with_options: bool = False) -> str:
    """Return a text on a solver: version, method, form, policies, tolerance levels and options."""
    from dpbench.solvers.settings import describe_option_presets, list_options_by_route
    from dpbench.solvers.table import find_solver_availability, find_solver_record

    # Importing all libraries takes longer than all the rest.
    row, library = find_solver_record(name), find_solver_availability(name, imported=False)
    version = library.version or "" if library.ok else f"({library.reason})"
    policies = "; ".join(f"{route}: {', '.join(p)}" for route, p in row.policies_by_route.items())
    about = [
        row.method,
        f"form {row.form}; {policies}",
        *describe_option_presets(name).splitlines(),
    ]
    for route, options in list_options_by_route(name).items() if with_options else ():
        about.append(f"options, {route}: {', '.join(options) or 'none known'}")
    return format_heading_and_paragraphs(f"{name} {version}".rstrip(), about)


def list_tables_of_folder(folder: Path) -> list[str]:
    """Return a line on each table of a result folder that has rows, and on how to get it.

    Until a report has written them, the line on CSV names the command that does.
    """
    from dpbench.notebook.results import load_results
    from dpbench.report.report import LEGEND, describe_table

    tables = load_results(folder).tables.items()
    files, legend = folder / "tables", folder / "tables" / LEGEND
    csv = f"`dpbench report {folder}` writes the tables to {files}"
    if legend.is_file():
        csv = f"{files} (columns described in {legend})"
    return [
        *(
            f"{name} ({plural(len(table), 'row')}): {describe_table(name, table)}"
            for name, table in tables
            if len(table)
        ),
        f"CSV: {csv}",
        f"LaTeX: dpbench report {folder} --latex NAME",
        f'Python: load_results("{folder}").tables["NAME"]',
    ]
