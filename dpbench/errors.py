"""The errors that dpbench raises on purpose.

Bad input is an `InputError`, one line that the command line prints and exits with 2. A solver's
failure is never an exception that leaves the run: it is a `Status` in a record.
"""

import errno
import os
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from numbers import Integral
from os import PathLike
from typing import Any

_MOST = 80  # Characters of what was found in a message
_SYSTEM_ERRORS = frozenset(map(os.strerror, errno.errorcode))
"""Error messages of the system about files, such as "Permission denied"."""


class DpbenchError(Exception):
    """Base class of all errors raised by dpbench.

    Examples
    --------
    >>> issubclass(InputError, DpbenchError)
    True
    """


class InputError(DpbenchError, ValueError):
    """Bad user input: which file or option, which key, what was found, what is allowed.

    Parameters
    ----------
    where : file or argument the mistake is in. An argument is in backquotes, as others in its text;
        the command line prints them as its options, `jobs` as --jobs.
    key : the key inside it ("" when the whole of it is meant), by `format_key_path` where it is in
        a table or array.
    found : the value there; "nothing" for a key or option that is missing; "no such file" and the
        like for a name without a file; or what the system reports of a file.
    allowed : the values that are accepted.

    Examples
    --------
    >>> raise InputError("my.toml", "steps", -1, "1 or more")
    Traceback (most recent call last):
    dpbench.errors.InputError: my.toml: steps: found -1; allowed: 1 or more
    >>> raise InputError("dpbench init", "--length", "nothing", "a number above 0 [m]")
    Traceback (most recent call last):
    dpbench.errors.InputError: dpbench init: --length: missing; required: a number above 0 [m]
    """

    def __init__(self, where: str, key: str, found: object, allowed: str) -> None:
        self.where, self.key, self.found, self.allowed = where, key, found, allowed
        place = f"{where}: {key}" if key else where
        text = str(found)
        if found == "nothing":
            fault = f"missing; required: {allowed}"
        elif text in _SYSTEM_ERRORS or text.startswith("no such "):
            fault = f"{begin_in_lower_case(text)}; required: {allowed}"
        else:
            fault = f"found {found}; allowed: {allowed}"
        super().__init__(" ".join(f"{place}: {fault}".split()))

    def __reduce__(self) -> "tuple[type[InputError], tuple[str, str, object, str]]":
        return type(self), (self.where, self.key, self.found, self.allowed)


def begin_in_lower_case(text: str) -> str:
    """Return a report of the system, such as "Permission denied", as part of a sentence."""
    return f"{text[:1].lower()}{text[1:]}"


def shorten_found(value: object) -> str:
    """Return what was found as one short line.

    Examples
    --------
    >>> shorten_found("dapq"), len(shorten_found(list(range(99))))
    ("'dapq'", 81)
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= _MOST else f"{text[:_MOST]}…"


def format_key_path(
    parts: Sequence[str | int], *, is_table: bool = False, is_toml: bool = True
) -> str:
    """Return the path of a key as its user sees it in the file, with entries counted from 1.

    parts : keys, and indices from 0; is_table : a last index is that of a table. is_toml : arrays
        of tables are written `[[key]]`; otherwise as any other array, for JSON.

    Examples
    --------
    >>> format_key_path(["environment", "wind", "speed_mps"])
    'environment.wind.speed_mps'
    >>> format_key_path(["closed_loop", 0, "routes", 1])
    '[[closed_loop]] number 1, key routes, entry 2'
    >>> format_key_path(["inertia", 0, 2])
    'inertia, entry 1, entry 3'
    """
    texts: list[str] = []
    follows_key = False
    for part, after in zip(parts, [*parts, "" if is_table else 0][1:], strict=True):
        if isinstance(part, str):
            if follows_key:
                texts[-1] += f".{part}"
            else:
                texts.append(f"key {part}" if texts else part)
        elif is_toml and len(texts) == 1 and isinstance(after, str):
            texts = [f"[[{texts[0]}]] number {part + 1}"]
        else:
            texts.append(f"entry {part + 1}")
        follows_key = isinstance(part, str)
    return ", ".join(texts)


def require_integer_at_least(argument: str, value: int, least: int) -> int:
    """Return a whole number, be it one of NumPy, as int; InputError for one below `least`.

    Raises TypeError for one that is not whole.
    """
    allowed = f"a whole number, {least} or more"
    require_type(argument, value, Integral, allowed)
    if value < least:
        raise InputError(argument, "", value, allowed)
    return int(value)


def require_name_or_file(argument: str, value: object, file: str) -> None:
    """Raise TypeError for an argument that is neither a name nor a path."""
    require_type(argument, value, str | PathLike, f"a name or {file}")


def require_type(argument: str, value: object, kind: Any, allowed: str) -> None:
    """Raise TypeError, with what is allowed as text, for an argument of another type.

    kind : as in `isinstance`; True and False are not whole numbers.
    """
    if isinstance(value, bool) or not isinstance(value, kind):
        raise TypeError(f"{argument}: found {shorten_found(value)}; allowed: {allowed}")


def require_lists_of_names(entries: Mapping[str, str], /, **given: object) -> None:
    """Raise TypeError for a text or a single object where a list of names belongs; None passes.

    entries : by argument, what its list may contain instead of names alone.
    """
    for option, value in given.items():
        is_list = isinstance(value, Iterable) and not isinstance(value, str)
        if is_list and isinstance(value, Collection):
            for name in value:
                allowed = entries.get(option, "a name in the list")
                require_type(option, name, str | PathLike, allowed)
        elif not (value is None or is_list):
            found = shorten_found(value)
            such_as = f", such as [{found}]" if isinstance(value, str) else ""
            raise TypeError(f"{option}: found {found}; allowed: a list of names{such_as}")


class SituationError(InputError):
    """Bad user input that is no single wrong value: one sentence with what to do."""

    def __init__(self, where: str, sentence: str) -> None:
        super().__init__(where, "", sentence, "")
        self.args = (" ".join(f"{where}: {sentence}".split()),)

    def __reduce__(self) -> "tuple[type[SituationError], tuple[str, str]]":  # type: ignore[override] # rebuilt from two
        return type(self), (self.where, str(self.found))


class ShapeError(InputError):
    """An array of the wrong shape, with its name, found and expected shape."""

    @classmethod
    def from_shapes(
        cls, where: str, name: str, found: tuple[int, ...], expected: str
    ) -> "ShapeError":
        """Make the error for an array of a wrong shape, from its name and both shapes."""
        return cls(where, name, f"shape {found}", expected)


class UnknownNameError(InputError):
    """A vessel, scenario, suite, solver or setting that does not exist.

    Examples
    --------
    >>> issubclass(UnknownNameError, InputError)
    True
    """


class SettingsError(InputError):
    """A solver setting that the solver does not have or does not accept.

    Examples
    --------
    >>> raise SettingsError("settings of daqp", "iter_limit", -3, "0 or more")
    Traceback (most recent call last):
    dpbench.errors.SettingsError: settings of daqp: iter_limit: found -3; allowed: 0 or more
    """


class PolicyError(InputError):
    """A solver interface, or way of starting each solve, that a solver does not offer.

    Examples
    --------
    >>> issubclass(PolicyError, InputError)
    True
    """


class SolverUnavailableError(SituationError):
    """A solver whose library is missing or fails to import, with the reason.

    Examples
    --------
    >>> issubclass(SolverUnavailableError, InputError)
    True
    """


class ResultsError(InputError):
    """A result folder or file that is missing, damaged or of an unknown format version.

    Examples
    --------
    >>> issubclass(ResultsError, InputError)
    True
    """


MOST_NAMES = 6  # A list of more names is cut to the nearest
MOST_UNLISTED = 16  # The same where nothing else lists the names
_NEAREST = 3


def find_nearest_names(text: str, known: Iterable[str], *, likeness: float = 0.0) -> list[str]:
    """Return at most three names, the nearest to `text` first, without regard to case.

    likeness : the least that a name must have, 0 to 1 (`difflib.get_close_matches`).
    """
    names = {name.lower(): name for name in known}
    # A text of a megabyte would be compared letter by letter.
    near = get_close_matches(text[:80].lower(), names, n=_NEAREST, cutoff=likeness)
    return [names[name] for name in near]


def format_allowed_names(text: str, known: Sequence[str], *, listing: str = "") -> str:
    """Return as text all known names, or the three nearest to `text` and what lists all.

    Of more than `MOST_NAMES`, the nearest are the first.
    """
    near = find_nearest_names(text, known) if len(known) > MOST_NAMES else []
    if len(known) <= (MOST_NAMES if listing else MOST_UNLISTED):
        names = ", ".join(dict.fromkeys([*near, *known]))
        return names if len(known) == 1 else f"one of {names}"
    rest = f"{', '.join(near)}, … {len(known) - len(near)} more"
    return f"{rest}: `{listing}`" if listing else rest


class RenamedWarning(FutureWarning):
    """Warning about an outdated name in a user's file or command, with the new name."""


def warn_of_outdated_name(where: str, old: str, new: str) -> None:
    """Warn that a name in a user's file or command is outdated, and state the new one."""
    warnings.warn(f"{where}: {old} is now called {new}", RenamedWarning, stacklevel=3)


class CertificateError(DpbenchError):
    """A QP whose optimum could not be proven in exact arithmetic although it has one.

    Examples
    --------
    >>> issubclass(CertificateError, DpbenchError)
    True
    """
