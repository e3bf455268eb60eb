"""Step time ratios of chosen configurations, whatever their verdicts."""

from collections.abc import Sequence
from itertools import chain, combinations

from dpbench.analysis.records.records import Records
from dpbench.analysis.times.paired_times import PairedComparison, compare_configurations
from dpbench.bench.record.cell import Configuration, sort_key_of_settings
from dpbench.errors import InputError, UnknownNameError, format_allowed_names
from dpbench.solvers.own_settings import (
    encode_options_as_json,
    expand_choice_over_option_grid,
    normalise_options,
    parse_options_of_choice,
    split_into_solver_and_options_text,
)


def compare_chosen(records: Records, choices: Sequence[str]) -> list[PairedComparison]:
    """Return the step time ratios of each two chosen configurations on common replays.

    Two choices are compared in each call mode that both were timed in, or where there is none, in
    each of the modes of either.

    choices : of `select_timed_configurations`, a grid of options one for each point.

    Raises
    ------
    InputError : for fewer than two choices, or one that was not timed.
    """
    expanded = (
        expand_choice_over_option_grid(choice) if _has_options(choice) else [choice]
        for choice in choices
    )
    points = list(dict.fromkeys(chain.from_iterable(expanded)))
    chosen = [select_timed_configurations(records, choice) for choice in points]
    if len(points) < 2:
        found = f"{points[0]} alone" if points else "none"
        allowed = "two or more, such as daqp, 'osqp high' and 'osqp[rho=1.6]'"
        raise InputError("`choices`", "", found, allowed)
    pairs = [pair for two in combinations(chosen, 2) for pair in _pair_in_equal_call_modes(*two)]
    return [one for pair in dict.fromkeys(pairs) for one in compare_configurations(records, *pair)]


def select_timed_configurations(records: Records, choice: str) -> list[Configuration]:
    """Return the timed configurations of a choice, one for each call mode.

    choice : a solver (its `default` settings, or the first that were timed), solver and options as
        `osqp[rho=1.6]`, solver and name of settings as `osqp high`, with the call mode as
        `osqp high (native warm)`, or a label of the report.

    Raises
    ------
    UnknownNameError : naming the nearest choices, where none was timed.
    """
    known = dict.fromkeys(
        run.configuration.moved_to_common_formulation
        for run in records.select_runs(mode="replay", units="scaled")
        if records.get_step_times(run) is not None
    )
    if _has_options(choice):
        solver, _ = split_into_solver_and_options_text(choice)
        wanted = normalise_options(encode_options_as_json(parse_options_of_choice(choice)))
        alike = [c for c in known if c.solver == solver and normalise_options(c.options) == wanted]
    else:
        own = [c for c in known if c.solver == choice]
        usual = min((c.settings for c in own), key=sort_key_of_settings, default="")
        alike = [c for c in own if c.settings == usual]
        alike += [c for c in known if choice in _list_names(c)]
    if alike:
        return alike
    names = dict.fromkeys(
        c.solver if c.settings == "default" else f"'{c.solver} {c.settings}'" for c in known
    )
    timed = format_allowed_names(choice, [*names])
    allowed = f"a solver that was timed: {timed}" if names else "results with timed replays"
    raise UnknownNameError("`choices`", "", f"{choice!r}, which was not timed", allowed)


def _has_options(choice: str) -> bool:
    """Return whether a choice is a solver with options, not a name such as `osqp grid[rho=1]`."""
    solver, _, options = choice.partition("[")
    return "=" in options and " " not in solver


def _list_names(configuration: Configuration) -> tuple[str, ...]:
    """Return the texts by which tables and terminal name a configuration."""
    c, name = configuration, f"{configuration.solver} {configuration.settings}"
    return c.label, name, f"{name} ({c.route} {c.policy})"


def _pair_in_equal_call_modes(
    first: Sequence[Configuration], second: Sequence[Configuration]
) -> list[tuple[Configuration, Configuration]]:
    """Return pairs of configurations in one call mode; where there are none, all pairs."""
    pairs = [(one, other) for one in first for other in second if one != other]
    alike = [
        (one, other)
        for one, other in pairs
        if (one.route, one.policy) == (other.route, other.policy)
    ]
    return alike or pairs
