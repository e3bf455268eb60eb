"""Custom settings: a solver's options as written by a person, as grids and as text.

    osqp[rho=1.6,eps_abs=1e-5]    OSQP with two options
    osqp[rho=[0.1,1,10]]          a grid: OSQP three times, with one value each

The brackets hold what a TOML inline table holds between its braces.
"""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import product
from math import isfinite

import numpy as np

from dpbench.errors import InputError, ResultsError
from dpbench.files.regular_files import parse_json
from dpbench.solvers.contract import Options

MOST_POINTS = 1000
"""A grid of more points is a slip of the keyboard."""
LONGEST_TEXT, LARGEST_INTEGER = 200, 2**63


def split_into_solver_and_options_text(choice: str) -> tuple[str, str]:
    """Return solver and options of `osqp[rho=1.6]` as two texts; "" for a solver alone."""
    solver, bracket, rest = choice.partition("[")
    return (solver, rest.removesuffix("]")) if bracket else (choice, "")


def expand_choice_over_option_grid(choice: str) -> list[str]:
    """Return a choice of solver and options, such as `osqp[rho=[1,2]]`, for each grid point.

    The options of each are sorted and written alike; InputError for a text that is no such choice.
    """
    solver, _ = split_into_solver_and_options_text(choice)
    if solver == choice:
        return [choice]
    points = expand_option_grid(parse_options_of_choice(choice), f"solver {solver}")
    return [f"{solver}[{format_options_as_toml(options)}]" for options in points]


def parse_options_of_choice(choice: str) -> Options:
    """Return the options of a choice such as `osqp[rho=1.6]`; {} for a solver alone."""
    solver, text = split_into_solver_and_options_text(choice)
    if solver == choice:
        return {}
    try:
        options = tomllib.loads(f"options = {{{text}}}")["options"]
        reason = ""
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        # Without the position, as it is in the text above.
        _refuse_text_without_quotes(solver, text)
        options, reason = {}, f" ({str(error).partition(' (at ')[0]})"
    if not options or not choice.endswith("]"):
        allowed = f"names with TOML values, such as {solver}[max_iter=50]"
        raise InputError(f"solver {solver}", "", f"{choice!r}{reason}"[:200], allowed)
    return dict(options)


def _refuse_text_without_quotes(solver: str, text: str) -> None:
    """Raise InputError for the first option with a bare word as its value, such as `rho=fast`."""
    for name, value in re.findall(r"(?:^|,)\s*([\w.-]+)\s*=\s*\[?\s*([A-Za-z_]\w*)", text):
        if value not in ("true", "false", "inf", "nan"):
            allowed = f'a number, true, false, or text in quotes, as in {name}="{value}"'
            raise InputError(f"solver {solver}", name, value[:80], allowed)


def parse_choice_without_grid(choice: str, where: str, allowed: str) -> tuple[str, Options]:
    """Return solver and options of a choice such as `osqp[rho=1.6]`; InputError for a grid."""
    solver, _ = split_into_solver_and_options_text(choice)
    points = expand_option_grid(parse_options_of_choice(choice), f"solver {solver}")
    if len(points) != 1:
        raise InputError(where, "", choice[:90], allowed)
    return solver, points[0]


def expand_option_grid(options: Options, where: str) -> list[Options]:
    """Return the options of each point of a grid, in which a list has one value for each point.

    InputError, at `where`, for a list without values or a grid of more than `MOST_POINTS` points.
    """
    pairs = list(_yield_dotted_names_and_values(options))
    axes = [value if isinstance(value, list) else [value] for _, value in pairs]
    count = 1
    for (key, _), axis in zip(pairs, axes, strict=True):
        count *= len(axis)
        bad = [value for value in axis if not _is_allowed_option_value(value)]
        if bad or not axis:
            found = repr(bad[0])[:80] if bad else "[]"
            allowed = "a finite number, text, true or false, or a list of at least one of these"
            raise InputError(where, key, found, allowed)
        if count > MOST_POINTS:
            raise InputError(where, key, f"a grid of {count} points", f"at most {MOST_POINTS}")
    keys = [key for key, _ in pairs]
    return [
        _nest_dotted_option_names(dict(zip(keys, point, strict=True))) for point in product(*axes)
    ]


def convert_numbers_of_numpy(options: Options) -> Options:
    """Return options with the numbers of NumPy among them as numbers of Python."""
    return {
        option: value.item() if isinstance(value, np.generic) else value
        for option, value in options.items()
    }


def format_options_as_toml(options: Options) -> str:
    """Return options as text in TOML, sorted by name, such as `eps_abs=1e-5,rho=1.6`."""
    return ",".join(f"{key}={value}" for key, value in format_each_option_as_toml(options).items())


def format_each_option_as_toml(options: Options) -> dict[str, str]:
    """Return the value of each option as text in TOML, sorted by name."""
    return {
        key: _format_option_value(value)
        for key, value in sorted(_yield_dotted_names_and_values(options))
    }


def encode_options_as_json(options: Options) -> str:
    """Return options as JSON, equal for equal options; "" for none."""
    # In a notebook a value may be of a library's own type.
    return json.dumps(options, sort_keys=True, ensure_ascii=False, default=str) if options else ""


@cache
def normalise_options(text: str) -> str:
    """Return encoded options with all numbers as floating-point ones, equal for equal values."""
    return json.dumps(json.loads(text, parse_int=float), sort_keys=True) if text else ""


def decode_options_from_json(text: str) -> Options:
    """Return the options in a text of `encode_options_as_json`; ResultsError for another text."""
    try:
        options = parse_json(text) if text else {}
    except ValueError:
        options = None
    if not isinstance(options, dict):
        raise ResultsError("runs.parquet", "options", repr(text[:80]), "a JSON object")
    return options


def _is_allowed_option_value(value: object) -> bool:
    """Return whether an option may have this value: true, false, a short text, a finite number."""
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    if isinstance(value, int):
        return abs(value) < LARGEST_INTEGER
    return isinstance(value, float) and isfinite(value)


def _yield_dotted_names_and_values(
    options: Options, prefix: str = ""
) -> Iterator[tuple[str, object]]:
    """Yield name and value of each option; an option of a group is named `group.name`."""
    for key, value in options.items():
        if isinstance(value, Mapping):
            yield from _yield_dotted_names_and_values(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _nest_dotted_option_names(options: Options) -> Options:
    """Return options with those named `group.name` in a mapping of each group."""
    nested: dict[str, object] = {}
    for key, value in options.items():
        group, dot, name = key.partition(".")
        if not dot:
            nested[key] = value
            continue
        known = nested.get(group)
        nested[group] = {**(known if isinstance(known, Mapping) else {}), name: value}
    return nested


def _format_option_value(value: object) -> str:
    """Return the value of an option as TOML, exponents without a leading zero."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text.replace("e-0", "e-").replace("e+0", "e+") if isinstance(value, float) else text
