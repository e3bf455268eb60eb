"""What the names of a solver's settings mean, and whether its own keys and values are accepted.

The tolerance levels `default`, `low`, `mid` and `high` and further names of a solver stand in its
record (`by_tolerance`); they mean the same on both routes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from dpbench.errors import SettingsError, one_of
from dpbench.solvers.adapter import NativeAdapter, QpsolversAdapter, attributes
from dpbench.solvers.contract import Options, Settings
from dpbench.solvers.record import DEFAULT, LEVELS, MID, TOLERANCES
from dpbench.solvers.table import record


def settings_matter(solver: str) -> bool:
    """Whether the tolerance levels differ for this solver."""
    return any(level_options(level, solver) != level_options(DEFAULT, solver) for level in LEVELS)


def resolve(settings: Settings, adapter: NativeAdapter | QpsolversAdapter) -> Options:
    """Return the options that `settings` means for a library.

    Raises
    ------
    SettingsError : for a name that it does not have, a key the library does not have, or a value
        that its settings object refuses.
    """
    name = adapter.record.name
    if isinstance(settings, str):
        return dict(level_options(settings, name))
    target = None if adapter.make_settings is None else adapter.make_settings()
    if adapter.list_options is not None:
        check_names(name, settings, adapter.list_options())
    elif target is not None:
        check_names(name, settings, attributes(target))
    if target is not None:
        _check_values(name, settings, target)
    return {**adapter.record.levels.get(DEFAULT, {}), **settings}


def setting_names(solver: str) -> tuple[str, ...]:
    """List the settings of a solver: the tolerance levels and what it has beside them."""
    return tuple(dict.fromkeys((*LEVELS, *record(solver).levels)))


def tolerance_of(name: str) -> float | None:
    """Parse the tolerance of a setting such as "1e-4"; None for other names."""
    try:
        tolerance = float(name)
    except ValueError:
        return None
    return tolerance if 0.0 < tolerance < 1.0 else None


def has_setting(solver: str, name: str) -> bool:
    """Whether a solver has settings of that name: its own, or a tolerance it can be given."""
    return name in setting_names(solver) or _at_tolerance(solver, name) is not None


def _at_tolerance(solver: str, name: str) -> Options | None:
    """Return the options of a stated tolerance, between the levels or beyond them.

    None where neither.

    What is the tolerance itself at `low`, `mid` and `high` is this one here; the rest is as at
    `mid`. A solver without a tolerance to set has nothing to change.
    """
    tolerance, levels = tolerance_of(name), record(solver).levels
    if tolerance is None:
        return None
    if not settings_matter(solver):
        return levels.get(DEFAULT, {})
    mid = levels[MID]
    stated = [
        key for key in mid if all(levels[at].get(key) == eps for at, eps in TOLERANCES.items())
    ]
    return {**mid, **dict.fromkeys(stated, tolerance)} if stated else None


def level_options(name: str, solver: str) -> Options:
    """Return the options of a setting by name for a solver; SettingsError if there is none."""
    names, stated = setting_names(solver), _at_tolerance(solver, name)
    if name not in names and stated is None:
        allowed = f"{' | '.join(names)} | a tolerance such as 1e-4"
        raise SettingsError(f"settings of {solver}", "", repr(name), allowed)
    return record(solver).levels.get(name, {}) if stated is None else stated


def describe_levels(solver: str) -> str:
    """One line per name of its settings: what it sets, "the library's defaults" for nothing."""
    lines = []
    for name in setting_names(solver):
        keys = ", ".join(f"{key}={value!r}" for key, value in level_options(name, solver).items())
        lines.append(f"{name}: {keys or _nothing(name, solver)}")
    return "\n".join(lines)


def _nothing(name: str, solver: str) -> str:
    if settings_matter(solver) or name == DEFAULT:
        return "the library's defaults"
    return "as default: it has no tolerance to set"


def check_names(solver: str, settings: Mapping[str, object], allowed: Iterable[str]) -> None:
    """Raise SettingsError naming the first key that is not allowed, and its nearest neighbours.

    The libraries behind qpsolvers cannot be trusted with this: several drop what they do not know.
    """
    known = sorted(allowed)
    for key in _flat(settings):
        if key not in known:
            allowed = one_of(key, known) if known else "no settings"
            raise SettingsError(f"settings of {solver}", key, "an unknown key", allowed)


def _flat(settings: Mapping[str, object]) -> Iterable[str]:
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from (f"{key}.{member}" for member in value)
        else:
            yield key


def _check_values(solver: str, settings: Mapping[str, object], target: Any) -> None:
    for key, value in settings.items():
        try:
            setattr(target, key, value)
        except (TypeError, ValueError) as error:
            kind = type(getattr(target, key)).__name__
            raise SettingsError(f"settings of {solver}", key, repr(value), f"a {kind}") from error
