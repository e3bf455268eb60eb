"""The configurations of a suite: its solvers in every mode and with all settings of each table.

Settings are presets, or of one's own: these come with the choice of a solver, as `osqp[rho=1.6]`,
or from the table `[settings.NAME]` of the suite; a grid becomes settings of a name each.
"""

from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from dpbench.bench.plan.study_points import RunsTable
from dpbench.bench.plan.suite import (
    CapabilityTable,
    ClosedLoopTable,
    RandomTable,
    RecordedTable,
    ReplayTable,
    ScenarioRunsTable,
    SettingsTable,
    SuiteFile,
)
from dpbench.bench.record.cell import Cell, Configuration
from dpbench.errors import (
    InputError,
    PolicyError,
    SettingsError,
    UnknownNameError,
    format_allowed_names,
)
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.contract import Options, Policy, Route
from dpbench.solvers.own.adapters import UNCONSTRAINED_CLIPPED
from dpbench.solvers.own_settings import (
    decode_options_from_json,
    encode_options_as_json,
    expand_choice_over_option_grid,
    expand_option_grid,
    format_options_as_toml,
    parse_options_of_choice,
    split_into_solver_and_options_text,
)
from dpbench.solvers.plugins import find_plugin
from dpbench.solvers.settings import (
    describe_allowed_names_of_settings,
    find_options_of_preset,
    has_distinct_tolerance_presets,
    has_preset_or_tolerance,
    list_preset_names,
    resolve_settings_to_options,
)
from dpbench.solvers.table import (
    TABLE,
    Availability,
    find_solver_availability,
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
    list_all_solver_names,
)

BASELINE_LAW = UNCONSTRAINED_CLIPPED.name
Table = ClosedLoopTable | ReplayTable | RandomTable | RecordedTable | CapabilityTable


class NamedSettings(NamedTuple):
    """Settings by name: custom options as JSON, or a preset with other names of the same.

    route, policy : of settings that have a call mode of their own.
    """

    name: str
    options: str = ""
    alias: tuple[str, ...] = ()
    route: Route | None = None
    policy: Policy | None = None


def list_settings_of_choice(choice: str, table: RunsTable, suite: SuiteFile) -> list[NamedSettings]:
    """Return the settings that a choice such as `osqp` or `osqp[rho=1.6]` runs with in a table."""
    settings = _list_settings_without_limits(choice, table, suite)
    if not (table.iteration_limits or table.time_limits):
        return settings
    solver, _ = split_into_solver_and_options_text(choice)
    record = find_solver_record(solver)
    limits = [
        *((record.iteration_limit, limit) for limit in table.iteration_limits),
        *((record.time_limit, limit) for limit in table.time_limits),
    ]
    return [_limit(own, solver, key, limit) for own in settings for key, limit in limits if key]


def _limit(own: NamedSettings, solver: str, key: str, limit: float) -> NamedSettings:
    """Return settings that end a solve at a limit of iterations or time, as `high[max_iter=5]`."""
    options = decode_options_from_json(own.options) or find_options_of_preset(own.name, solver)
    limited = encode_options_as_json({**options, key: limit})
    return own._replace(name=f"{own.name}[{key}={limit:g}]", options=limited, alias=())


def _list_settings_without_limits(
    choice: str, table: RunsTable, suite: SuiteFile
) -> list[NamedSettings]:
    """Return the settings of a choice in a table before its limits of iterations and time."""
    solver, text = split_into_solver_and_options_text(choice)
    if text:
        return [NamedSettings(text, encode_options_as_json(parse_options_of_choice(choice)))]
    own = [
        settings for name in table.settings for settings in _list_own_settings(suite, name, solver)
    ]
    names = [name for name in table.settings if has_preset_or_tolerance(solver, name)]
    if has_distinct_tolerance_presets(solver) or not names:
        return [*map(NamedSettings, names), *own]
    return [NamedSettings(names[0], alias=tuple(names[1:])), *own]


def _list_own_settings(suite: SuiteFile, name: str, solver: str) -> list[NamedSettings]:
    """Return the settings of a solver in `[settings.NAME]`, one for each point of their grid."""
    table = suite.settings.get(name)
    options = None if table is None else table.options_by_solver.get(solver)
    if table is None or options is None:
        return []
    mode = table.route, table.policy
    points = expand_option_grid(options, f"suite: settings.{name}.{solver}")
    if len(points) == 1:
        return [NamedSettings(name, encode_options_as_json(points[0]), (), *mode)]
    varied = {key for key, value in options.items() if points[0].get(key) != value}
    return [
        NamedSettings(
            f"{name}[{format_options_as_toml({k: v for k, v in point.items() if k in varied})}]",
            encode_options_as_json(point),
            (),
            *mode,
        )
        for point in points
    ]


def refuse_unknown_settings_names(
    suite: SuiteFile, table: RunsTable, choices: Sequence[str]
) -> None:
    """Raise SettingsError for a name in a table that neither suite nor any of its solvers has."""
    solvers = [
        split_into_solver_and_options_text(choice)[0]
        for choice in choices
        if split_into_solver_and_options_text(choice)[0] == choice
    ]
    for name in table.settings if solvers else ():
        if not any(
            name in suite.settings or has_preset_or_tolerance(solver, name) for solver in solvers
        ):
            presets = [preset for solver in solvers for preset in list_preset_names(solver)]
            known = dict.fromkeys((*presets, *suite.settings))
            allowed = describe_allowed_names_of_settings(known, "`solvers`")
            raise SettingsError("settings", "", repr(name), allowed)


def refuse_invalid_own_settings(suite: SuiteFile, choices: Iterable[str], where: str) -> None:
    """Raise SettingsError for custom settings that an installed solver does not accept.

    where : the place of the choices of solvers.

    Raises
    ------
    SettingsError : for an unknown option, or a value that the library refuses.
    InputError : for a bad grid, or the name of a preset.
    UnknownNameError : for an unknown solver.
    """
    for choice in choices:
        solver, _ = split_into_solver_and_options_text(choice)
        try:
            _refuse_unaccepted_options(solver, parse_options_of_choice(choice))
        except SettingsError as error:
            key = f"{solver}[{error.key}]"
            raise SettingsError(where, key, error.found, error.allowed) from None
    for name, table in suite.settings.items():
        for solver, options in table.options_by_solver.items():
            where = f"suite: settings.{name}.{solver}"
            try:
                _refuse_unavailable_call_mode(solver, table, where)
                has_preset = has_preset_or_tolerance(find_solver_record(solver).name, name)
                for point in expand_option_grid(options, where):
                    _refuse_unaccepted_options(solver, point)
            except (PolicyError, SettingsError, UnknownNameError) as error:
                raise type(error)(where, error.key, error.found, error.allowed) from None
            if has_preset:
                where = f"suite: settings.{name}"
                is_preset = name in list_preset_names(solver)
                found = "the name of a preset" if is_preset else "a tolerance as a name"
                raise InputError(
                    where, "", found, "a name that is neither a tolerance nor a preset"
                )


def _refuse_unavailable_call_mode(solver: str, table: SettingsTable, where: str) -> None:
    """Raise PolicyError where a solver has no route, or no policy of it, that settings name."""
    row = find_solver_record(solver)
    if (route := table.route) is not None and route not in row.routes:
        raise PolicyError(where, "route", repr(route), ", ".join(row.routes))
    offered = [p for own in ([route] if route else row.routes) for p in row.policies_by_route[own]]
    if table.policy is not None and table.policy not in offered:
        raise PolicyError(where, "policy", repr(table.policy), ", ".join(dict.fromkeys(offered)))


def _refuse_unaccepted_options(solver: str, options: Options) -> None:
    """Raise SettingsError for options that the solver accepts through none of its interfaces."""
    if not options or not find_solver_availability(solver).ok:
        return
    refused: list[SettingsError] = []
    routes = find_solver_record(solver).routes
    for route in routes:
        try:
            adapter = (
                get_native_adapter(solver) if route == "native" else get_qpsolvers_adapter(solver)
            )
            resolve_settings_to_options(options, adapter)
        except SettingsError as error:
            refused.append(error)
    if len(refused) == len(routes):
        raise refused[0]


def choose_solvers(suite: SuiteFile, only: Sequence[str] | None) -> list[str]:
    """Return the solvers of a suite, or those of `only` where some are chosen.

    A solver with custom options is a text such as `osqp[rho=1.6]`. "all" leaves out those of
    an optional extra that is not installed, and what the suite does not want as superseded.
    UnknownNameError for an unknown solver; SettingsError
    for options that a solver does not have; InputError for a baseline of the report, or solvers of
    a table, that the suite has not.
    """
    named = _resolve_solvers("solvers", suite.solvers, superseded=suite.superseded)
    for kind, tables in (("closed_loop", suite.closed_loop), ("replay", suite.replay)):
        key = f"{kind}.solvers"
        for table in tables:
            wanted = _resolve_solvers(key, table.solvers)
            if wanted and not any(_is_choice_among(choice, wanted) for choice in named):
                found = ", ".join(table.solvers)
                allowed = f"a solver of the suite: {format_allowed_names(found, named)}"
                raise InputError("suite", key, found, allowed)
    baseline = suite.report.baseline
    solvers = [split_into_solver_and_options_text(choice)[0] for choice in named]
    if baseline is not None and baseline not in solvers:
        allowed = f"a solver of the suite: {format_allowed_names(baseline, solvers)}"
        raise InputError("suite", "report.baseline", repr(baseline), allowed)
    chosen = named
    if only:
        try:
            chosen = _expand_solver_choices(only)
        except UnknownNameError as error:
            raise UnknownNameError("`solvers`", "", error.found, error.allowed) from None
    if not only and suite.baseline_law:
        chosen.append(BASELINE_LAW)
    if not only and suite.calibration:
        chosen += CALIBRATION
    refuse_invalid_own_settings(suite, chosen, "`solvers`" if only else "suite: solvers")
    return list(dict.fromkeys(chosen))


def _is_choice_among(choice: str, names: Sequence[str]) -> bool:
    """Return whether a choice such as `osqp[rho=1.6]`, or its solver, is one of `names`."""
    return choice in names or split_into_solver_and_options_text(choice)[0] in names


def _resolve_solvers(key: str, names: Sequence[str], *, superseded: bool = True) -> list[str]:
    """Return the solvers that an entry of the suite names; an InputError names the entry."""
    try:
        return _expand_solver_choices(names, superseded=superseded)
    except InputError as error:
        place = f"{key}: {error.key}" if error.key else key
        raise type(error)("suite", place, error.found, error.allowed) from None


def _expand_solver_choices(names: Sequence[str], *, superseded: bool = True) -> list[str]:
    """Return choices of solvers without repeats, with "all" and grids of settings expanded."""
    chosen: list[str] = []
    for name in names:
        if name == "all":
            chosen += list_default_solvers(superseded=superseded)
        else:
            find_solver_record(split_into_solver_and_options_text(name)[0])
            chosen += expand_choice_over_option_grid(name)
    return list(dict.fromkeys(chosen))


def name_solvers_of_suite(choices: Sequence[str], *, superseded: bool = True) -> list[str]:
    """Return the names of the solvers that a suite lists, without options, "all" expanded.

    superseded : as of the suite.

    >>> name_solvers_of_suite(["daqp", "osqp[rho=[0.1,1]]"])
    ['daqp', 'osqp']
    """
    named: list[str] = []
    for choice in choices:
        if choice == "all":
            named += list_default_solvers(superseded=superseded)
        else:
            named.append(split_into_solver_and_options_text(choice)[0])
    return list(dict.fromkeys(named))


def list_default_solvers(*, superseded: bool = True) -> list[str]:
    """Return the solvers of "all": neither the baseline law nor those of a missing extra.

    superseded : whether those are included for which another of the same code is chosen instead.
    """
    names = [s for s in list_all_solver_names() if s != BASELINE_LAW and _is_default_solver(s)]
    return [s for s in names if superseded or not find_solver_record(s).choose_instead]


def _is_default_solver(solver: str) -> bool:
    """Return whether "all solvers" includes one: it is no optional extra, or is installed."""
    return (
        find_solver_record(solver).extra not in ("jax", "casadi")
        or find_solver_availability(solver).ok
    )


def find_backup_and_refusal(name: str) -> tuple[str, str]:
    """Return the backup solver of a closed loop, and why it cannot be opened; "" for neither.

    UnknownNameError for an unknown solver; InputError for a plug-in of a file, which the workers of
    another solver do not load.
    """
    if not name:
        return "", ""
    one = name != "all" and "[" not in name
    (solver,) = _resolve_solvers("closed_loop.backup", [name]) if one else ("",)
    if not solver or find_plugin_file(solver) or solver in CALIBRATION:
        allowed = "one solver without options, from `list_solvers()` or an installed plug-in"
        raise InputError("suite", "closed_loop.backup", repr(name), allowed)
    here = find_solver_availability(solver)
    return solver, "" if here.ok else f"backup {solver}: {here.reason}"


def identify_libraries_of_cell(cell: Cell, library: Availability) -> str:
    """Return version and build of the libraries of a run's solver and backup solver."""
    if not cell.backup:
        return library.version_and_build_text
    backup = find_solver_availability(cell.backup)
    return f"{library.version_and_build_text}, backup {backup.version_and_build_text}"


def find_plugin_file(solver: str) -> str:
    """Return the Python plug-in file that a solver is loaded from; "" for other solvers."""
    plugin = None if solver in TABLE else find_plugin(solver)
    return plugin.origin if plugin is not None and Path(plugin.origin).is_file() else ""


def list_configurations(
    suite: SuiteFile, solvers: Sequence[str], table: Table
) -> list[Configuration]:
    """Return the configurations of a suite table: solvers by mode, settings, units and QP form.

    Of solvers named by the table, those of the suite take part. The harness's own configurations
    have one call mode, whatever the table has, and take part in timed replays alone.
    """
    solvers = _select_solvers(solvers, table)
    if not solvers:
        return []
    refuse_unknown_settings_names(suite, table, solvers)
    calibration = [name for name in solvers if name in CALIBRATION]
    solvers = [name for name in solvers if name not in CALIBRATION]
    configurations: list[Configuration] = []
    for units, formulation, policy, wanted, choice in product(
        table.units, table.formulations, table.policies, table.routes, solvers
    ):
        row = find_solver_record(split_into_solver_and_options_text(choice)[0])
        route: Route = row.default_route if wanted == "default" else wanted
        for own in list_settings_of_choice(choice, table, suite):
            called = own.route or route, own.policy or policy
            if called[0] in row.policies_by_route:
                name, options, alias = own.name, own.options, own.alias
                configurations.append(
                    Configuration(row.name, *called, name, units, formulation, options, alias)
                )
    timed = isinstance(table, ReplayTable | RecordedTable)
    # Settings with a call mode of their own come with every mode of the table.
    configurations = list(dict.fromkeys(configurations))
    return configurations + [
        Configuration(name, "native", "reuse") for name in calibration if timed
    ]


def _select_solvers(solvers: Sequence[str], table: Table) -> list[str]:
    """Return the suite's solvers that take part in a table, by its `solvers` and `without`."""
    if not isinstance(table, ScenarioRunsTable):
        return list(solvers)
    named = _expand_solver_choices(table.solvers) if table.solvers else solvers
    without = _expand_solver_choices(table.without)
    return [
        choice
        for choice in solvers
        if _is_choice_among(choice, named) and not _is_choice_among(choice, without)
    ]


def find_reason_to_refuse(configuration: Configuration) -> str:
    """Return why a solver configuration cannot run on this machine; "" where it can."""
    here = find_solver_availability(configuration.solver)
    if not here.ok:
        return here.reason
    policy = configuration.policy
    reason = find_solver_record(configuration.solver).state_why_policy_is_unavailable(
        configuration.route, policy
    )
    return f"policy {policy}: {reason}" if reason else ""
