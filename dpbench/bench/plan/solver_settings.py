"""The settings a solver runs with in a table of a suite: presets, and settings of one's own.

Settings of one's own come with the choice of a solver, as `osqp[rho=1.6]`, or from the table
`[settings.NAME]` of the suite; a grid becomes settings of a name each.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from dpbench.bench.plan.study_points import RunsTable
from dpbench.bench.plan.suite import SuiteFile
from dpbench.errors import InputError, SettingsError, UnknownNameError
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import (
    encode_options_as_json,
    expand_option_grid,
    format_options_as_toml,
    parse_options_of_choice,
    split_into_solver_and_options_text,
)
from dpbench.solvers.settings import (
    has_distinct_tolerance_presets,
    has_preset_or_tolerance,
    list_preset_names,
    resolve_settings_to_options,
)
from dpbench.solvers.table import (
    find_solver_availability,
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
)


class NamedSettings(NamedTuple):
    """Settings by name: options of one's own as JSON, or a preset with other names of the same."""

    name: str
    options: str = ""
    alias: tuple[str, ...] = ()


def list_settings_of_choice(choice: str, table: RunsTable, suite: SuiteFile) -> list[NamedSettings]:
    """Return the settings that a choice such as `osqp` or `osqp[rho=1.6]` runs with in a table."""
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
    options = suite.settings.get(name, {}).get(solver)
    if options is None:
        return []
    points = expand_option_grid(options, f"suite: settings.{name}.{solver}")
    if len(points) == 1:
        return [NamedSettings(name, encode_options_as_json(points[0]))]
    varied = {key for key, value in options.items() if points[0].get(key) != value}
    return [
        NamedSettings(
            f"{name}[{format_options_as_toml({k: v for k, v in point.items() if k in varied})}]",
            encode_options_as_json(point),
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
            allowed = f"{' | '.join(known)} | a tolerance such as 1e-4"
            raise SettingsError("settings", "", repr(name), allowed)


def refuse_invalid_own_settings(suite: SuiteFile, choices: Iterable[str], where: str) -> None:
    """Check settings of one's own against the options of the solvers that are installed.

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
            raise SettingsError(where, key, error.found, error.allowed) from error
    for name, solvers in suite.settings.items():
        for solver, options in solvers.items():
            where = f"suite: settings.{name}.{solver}"
            try:
                has_preset = has_preset_or_tolerance(find_solver_record(solver).name, name)
                for point in expand_option_grid(options, where):
                    _refuse_unaccepted_options(solver, point)
            except (SettingsError, UnknownNameError) as error:
                raise type(error)(where, error.key, error.found, error.allowed) from error
            if has_preset:
                where = f"suite: settings.{name}"
                raise InputError(where, "", "the name of a preset", "a name of its own")


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
