"""The options of a name of settings, and validation of a solver's own keys and values.

The tolerance levels `default`, `low`, `mid` and `high` and further names of a solver are in its
record (`make_tolerance_presets`), for both routes.
"""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

from dpbench.errors import SettingsError, format_allowed_names
from dpbench.solvers.adapter import (
    SET_BY_DPBENCH,
    NativeAdapter,
    QpsolversAdapter,
    list_public_settings_attributes,
)
from dpbench.solvers.contract import (
    DEFAULT,
    HIGH,
    LEVELS,
    MID,
    TOLERANCES,
    Options,
    Policy,
    Range,
    Settings,
)
from dpbench.solvers.table import (
    find_solver_availability,
    find_solver_record,
    get_native_adapter,
    get_qpsolvers_adapter,
)

_NOUNS = {int: "a whole number", float: "a number", str: "text", bool: "true or false"}
"""Types of options, as allowed values in errors."""


def has_distinct_tolerance_presets(solver: str) -> bool:
    """Return whether a solver's tolerance presets low, mid and high differ from its defaults."""
    return any(
        find_options_of_preset(level, solver) != find_options_of_preset(DEFAULT, solver)
        for level in LEVELS
    )


def resolve_settings_to_options(
    settings: Settings, adapter: NativeAdapter | QpsolversAdapter
) -> Options:
    """Return solver options from a preset's name or a mapping; SettingsError if invalid."""
    name = adapter.record.name
    if isinstance(settings, str):
        return dict(find_options_of_preset(settings, name))
    target = None if adapter.make_settings is None else adapter.make_settings()
    if (known := list_option_names(adapter)) is not None:
        refuse_unknown_option_names(name, settings, known)
    if adapter.list_options is not None:
        options = adapter.list_options()
        defaults = options if isinstance(options, Mapping) else {}
        _refuse_text_and_limits_below_zero(
            name, settings, {**adapter.record.levels.get(MID, {}), **defaults}
        )
    if target is not None:
        _set_options_or_refuse_values(name, settings, target)
    _refuse_values_out_of_range(name, settings, adapter.record.ranges)
    one_above_zero = adapter.record.one_above_zero
    if one_above_zero and all(settings.get(key) == 0 for key in one_above_zero):
        allowed = "at least one of them above 0"
        raise SettingsError(f"settings of {name}", ", ".join(one_above_zero), 0, allowed)
    return resolve_settings_with_fixed_options(settings, name)


def list_option_names(adapter: NativeAdapter | QpsolversAdapter) -> list[str] | None:
    """Return the sorted names of a library's options on a route; None if they are not known."""
    if adapter.list_options is not None:
        return sorted(adapter.list_options())
    if adapter.make_settings is not None:
        return sorted(list_public_settings_attributes(adapter.make_settings()))
    return None


def list_options_by_route(solver: str) -> dict[str, list[str]]:
    """Return the option names of a solver by route; {} if its library is not installed."""
    record = find_solver_record(solver)
    if not find_solver_availability(solver, imported=False).ok:
        return {}
    options: dict[str, list[str]] = {}
    for route in record.routes:
        is_native = route == "native"
        adapter = get_native_adapter(solver) if is_native else get_qpsolvers_adapter(solver)
        options[route] = list_option_names(adapter) or []
    return options


def resolve_settings_with_fixed_options(settings: Settings, solver: str) -> Options:
    """Return the options that a preset or a mapping sets, with those that dpbench always sets."""
    if isinstance(settings, str):
        return find_options_of_preset(settings, solver)
    return {**find_solver_record(solver).levels.get(DEFAULT, {}), **settings}


IN_SCALED_UNITS = """\
# P, q, A, l, u: the scaled QP. Its variables are control increments divided by the maximum
# increments, not in N or N·m; A has the identity below the rows, l and u have the bounds there."""


def format_library_call(solver: str, route: str, policy: Policy, settings: Settings) -> str:
    """Return Python code that calls a solver's library without dpbench, as the adapter does.

    "" on route qpsolvers, for an adapter that has no such code, and without the library.
    """
    if route != "native" or "native" not in find_solver_record(solver).routes:
        return ""
    adapter = get_native_adapter(solver)
    if adapter.format_call is None:
        return ""
    options = resolve_settings_with_fixed_options(settings, solver)
    try:
        return f"{IN_SCALED_UNITS}\n{adapter.format_call(policy, options)}"
    except ImportError:
        return ""


def list_preset_names(solver: str) -> tuple[str, ...]:
    """Return the names of a solver's option presets: default, low, mid, high and its own."""
    return tuple(dict.fromkeys((*LEVELS, *find_solver_record(solver).levels)))


def parse_tolerance_preset_name(name: str) -> float | None:
    """Return a preset name such as "1e-4" as a tolerance in (0, 1); None for other names."""
    try:
        tolerance = float(name)
    except ValueError:
        return None
    return tolerance if 0.0 < tolerance < 1.0 else None


def list_tolerance_options(solver: str) -> list[str]:
    """Return the names of a solver's tolerances: what `high` sets to that tolerance or to zero."""
    high = find_solver_record(solver).levels.get(HIGH, {}).items()
    return [k for k, value in high if type(value) is float and value in (0.0, TOLERANCES[HIGH])]


def list_tolerances_left_at_default(solver: str, options: Options) -> list[str]:
    """Return the tolerances that options leave at the library's default though they set others."""
    known = list_tolerance_options(solver)
    left = [name for name in known if name not in options]
    return left if len(left) < len(known) else []


def find_default_tolerance(solver: str, name: str) -> float | None:
    """Return the installed library's default of a tolerance; None where it is not known."""
    try:
        adapter = get_native_adapter(solver)
        target = None if adapter.make_settings is None else adapter.make_settings()
    except (KeyError, ImportError):
        return None
    if target is None:
        options = {} if adapter.list_options is None else adapter.list_options()
        value = options.get(name) if isinstance(options, Mapping) else None
    else:
        value = getattr(target, name, None)
    return float(value) if isinstance(value, Real) else None


def has_preset_or_tolerance(solver: str, name: str) -> bool:
    """Return whether a solver has an option preset of this name, or takes it as a tolerance."""
    return name in list_preset_names(solver) or _make_options_at_tolerance(solver, name) is not None


def _make_options_at_tolerance(solver: str, name: str) -> Options | None:
    """Return a solver's options at a tolerance such as "1e-4", else as at `mid`; or None."""
    tolerance, levels = parse_tolerance_preset_name(name), find_solver_record(solver).levels
    if tolerance is None:
        return None
    if not has_distinct_tolerance_presets(solver):
        return levels.get(DEFAULT, {})
    mid = levels[MID]
    keys = [k for k in mid if all(levels[at].get(k) == eps for at, eps in TOLERANCES.items())]
    return {**mid, **dict.fromkeys(keys, tolerance)} if keys else None


def find_options_of_preset(name: str, solver: str) -> Options:
    """Return the options of a solver's preset or tolerance; SettingsError if there is none."""
    names, options = list_preset_names(solver), _make_options_at_tolerance(solver, name)
    if name not in names and options is None:
        allowed = describe_allowed_names_of_settings(names)
        raise SettingsError(f"settings of {solver}", "", repr(name), allowed)
    return find_solver_record(solver).levels.get(name, {}) if options is None else options


def describe_allowed_names_of_settings(names: Iterable[str], argument: str = "") -> str:
    """Return names and tolerances as allowed settings, and the argument that takes options."""
    options = f"; give solver options in {argument}, for example 'osqp[rho=1.6]'" * bool(argument)
    return f"{', '.join(names)}, or a tolerance such as 1e-4, above 0 and below 1{options}"


def describe_option_presets(solver: str) -> str:
    """Return one line of text for each of a solver's option presets, with the options it sets."""
    lines = []
    for name in list_preset_names(solver):
        text = ", ".join(
            f"{key}={value!r}" for key, value in find_options_of_preset(name, solver).items()
        )
        if not text and (name == DEFAULT or has_distinct_tolerance_presets(solver)):
            text = "the library's defaults"
        lines.append(f"{name}: {text or 'same as default (no tolerance to set)'}")
    return "\n".join(lines)


def refuse_unknown_option_names(
    solver: str, settings: Mapping[str, object], known: Sequence[str]
) -> None:
    """Raise SettingsError for the first option name that the solver does not have."""
    listing = f'list_solvers().options("{solver}")'
    for name, value in settings.items():
        keys = [f"{name}.{member}" for member in value] if isinstance(value, Mapping) else [name]
        for key in keys:
            if key in SET_BY_DPBENCH and key not in known:
                allowed = "other options" if known else "no settings"
                raise SettingsError(f"settings of {solver}", key, SET_BY_DPBENCH[key], allowed)
            if key not in known:
                allowed = (
                    format_allowed_names(key, known, listing=listing) if known else "no settings"
                )
                raise SettingsError(f"settings of {solver}", key[:80], "an unknown option", allowed)


def _refuse_text_and_limits_below_zero(
    solver: str, settings: Mapping[str, object], defaults: Mapping[str, object]
) -> None:
    """Raise SettingsError for text or a Boolean as a number, or a limit of iterations below zero.

    Libraries without a settings object raise in each solve, or return any point as solved.
    """
    for key, value in settings.items():
        if not isinstance(default := defaults.get(key), Real) or isinstance(default, bool):
            continue
        below = "iter" in key.lower() and isinstance(value, Real) and value < 0
        if isinstance(value, str) or below or _is_boolean_as_number(value, default):
            allowed = "0 or more" if below else "a number"
            found = f"{'the text ' * isinstance(value, str)}{value!r}"[:80]
            raise SettingsError(f"settings of {solver}", key, found, allowed)


def _is_boolean_as_number(value: object, default: object) -> bool:
    """Return whether a Boolean is given for a number; switches of C have the default 0 or 1."""
    is_switch = isinstance(default, int) and default in (0, 1)
    return isinstance(value, bool) and isinstance(default, Real) and not is_switch


def _refuse_values_out_of_range(
    solver: str, settings: Mapping[str, object], ranges: Mapping[str, Range]
) -> None:
    """Raise SettingsError for a number outside the range that the solver's record has for it."""
    for key in settings.keys() & ranges.keys():
        value, allowed = settings[key], ranges[key]
        if isinstance(value, Real) and not allowed.contains(float(value)):
            raise SettingsError(f"settings of {solver}", key, value, allowed.text)


def _set_options_or_refuse_values(solver: str, settings: Mapping[str, object], target: Any) -> None:
    """Set options on a library's settings object; SettingsError for a value that it refuses."""
    for key, value in settings.items():
        try:
            if _is_boolean_as_number(value, getattr(target, key)):
                raise TypeError
            setattr(target, key, value)
        except (TypeError, ValueError, OverflowError) as error:
            kind = type(getattr(target, key))
            allowed = _NOUNS.get(kind, f"a value of type {kind.__name__}")
            if isinstance(value, kind) and not isinstance(value, bool):
                allowed += " that the library accepts"
            raise SettingsError(f"settings of {solver}", key, repr(value)[:80], allowed) from error
