"""The options of a name of settings, and validation of a solver's own keys and values.

The tolerance levels `default`, `low`, `mid` and `high` and further names of a solver are in its
record (`by_tolerance`), for both routes.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from dpbench.errors import SettingsError, format_allowed_names
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter, list_attributes
from dpbench.solvers.contract import Options, Settings
from dpbench.solvers.record import DEFAULT, LEVELS, MID, TOLERANCES
from dpbench.solvers.table import find_record


def has_tolerance_levels(solver: str) -> bool:
    """Return whether a solver's tolerance presets low, mid and high differ from its defaults."""
    return any(level_options(level, solver) != level_options(DEFAULT, solver) for level in LEVELS)


def resolve_options(settings: Settings, adapter: NativeAdapter | QpsolversAdapter) -> Options:
    """Return solver options from a preset's name or a mapping; SettingsError if invalid."""
    name = adapter.record.name
    if isinstance(settings, str):
        return dict(level_options(settings, name))
    target = None if adapter.make_settings is None else adapter.make_settings()
    if adapter.list_options is not None:
        check_option_names(name, settings, adapter.list_options())
    elif target is not None:
        check_option_names(name, settings, list_attributes(target))
    if target is not None:
        _check_values(name, settings, target)
    return all_options(settings, name)


def all_options(settings: Settings, solver: str) -> Options:
    """Return the options that a preset or a mapping sets, with those that dpbench always sets."""
    if isinstance(settings, str):
        return level_options(settings, solver)
    return {**find_record(solver).levels.get(DEFAULT, {}), **settings}


def setting_names(solver: str) -> tuple[str, ...]:
    """List the names of a solver's option presets: default, low, mid, high and its own."""
    return tuple(dict.fromkeys((*LEVELS, *find_record(solver).levels)))


def parse_tolerance(name: str) -> float | None:
    """Parse a preset name such as "1e-4" as a tolerance in (0, 1); None for other names."""
    try:
        tolerance = float(name)
    except ValueError:
        return None
    return tolerance if 0.0 < tolerance < 1.0 else None


def has_setting(solver: str, name: str) -> bool:
    """Return whether a solver has an option preset of this name, or takes it as a tolerance."""
    return name in setting_names(solver) or _options_at_tolerance(solver, name) is not None


def _options_at_tolerance(solver: str, name: str) -> Options | None:
    """Return a solver's options at a tolerance such as "1e-4", else as at `mid`; or None."""
    tolerance, levels = parse_tolerance(name), find_record(solver).levels
    if tolerance is None:
        return None
    if not has_tolerance_levels(solver):
        return levels.get(DEFAULT, {})
    mid = levels[MID]
    keys = [k for k in mid if all(levels[at].get(k) == eps for at, eps in TOLERANCES.items())]
    return {**mid, **dict.fromkeys(keys, tolerance)} if keys else None


def level_options(name: str, solver: str) -> Options:
    """Return the options of a solver's preset or tolerance; SettingsError if there is none."""
    names, options = setting_names(solver), _options_at_tolerance(solver, name)
    if name not in names and options is None:
        allowed = f"{' | '.join(names)} | a tolerance such as 1e-4"
        raise SettingsError(f"settings of {solver}", "", repr(name), allowed)
    return find_record(solver).levels.get(name, {}) if options is None else options


def describe_levels(solver: str) -> str:
    """Return one line of text for each of a solver's option presets, with the options it sets."""
    lines = []
    for name in setting_names(solver):
        text = ", ".join(f"{key}={value!r}" for key, value in level_options(name, solver).items())
        if not text and (name == DEFAULT or has_tolerance_levels(solver)):
            text = "the library's defaults"
        lines.append(f"{name}: {text or 'as default: it has no tolerance to set'}")
    return "\n".join(lines)


def check_option_names(solver: str, settings: Mapping[str, object], allowed: Iterable[str]) -> None:
    """Raise SettingsError for the first option name that the solver does not have."""
    known = sorted(allowed)
    for name, value in settings.items():
        keys = [f"{name}.{member}" for member in value] if isinstance(value, Mapping) else [name]
        for key in keys:
            if key not in known:
                allowed = format_allowed_names(key, known) if known else "no settings"
                raise SettingsError(f"settings of {solver}", key[:80], "an unknown key", allowed)


def _check_values(solver: str, settings: Mapping[str, object], target: Any) -> None:
    """Set options on a library's settings object; SettingsError for a value that it refuses."""
    for key, value in settings.items():
        try:
            setattr(target, key, value)
        except (TypeError, ValueError, OverflowError) as error:
            kind = type(getattr(target, key)).__name__
            raise SettingsError(
                f"settings of {solver}", key, repr(value)[:80], f"a {kind}"
            ) from error
