"""Answers stopped early: runs of a configuration by its limit of iterations or time."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Literal

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import Mode, RunRecord, group_by_key
from dpbench.analysis.verdict.requirements import compute_cost_ratio, has_survived
from dpbench.analysis.verdict.verdict import find_solver_record_or_none
from dpbench.bench.record.cell import Configuration
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml
from dpbench.solvers.settings import (
    find_options_of_preset,
    list_preset_names,
    resolve_settings_with_fixed_options,
)

LimitOf = Literal["iterations", "time"]


@dataclass(frozen=True, eq=False)
class LimitedConfiguration:
    """Runs of a configuration on one problem, by its limit, a number or [s], in rising order."""

    configuration: Configuration
    runs: dict[float, RunRecord]

    @property
    def least_sufficient_limit(self) -> float:
        """Limit from which on every closed loop survives; infinite for none."""
        falling = reversed(self.runs.items())
        enough = takewhile(lambda item: has_survived(item[1]), falling)
        return min((limit for limit, _ in enough), default=math.inf)


@dataclass(frozen=True, eq=False)
class LimitedGroup:
    """Runs with limits of one kind in one closed loop or on one replay, by configuration."""

    limit_of: LimitOf
    mode: Mode
    problem: str
    configurations: tuple[LimitedConfiguration, ...]

    @property
    def limits(self) -> list[float]:
        """All limits of the group in rising order."""
        return sorted({limit for one in self.configurations for limit in one.runs})


@dataclass(frozen=True, eq=False)
class RequiredLimit:
    """Limit from which on every closed loop of a configuration survives, in all its scenarios.

    limit : a number or [s]; infinite where no limit suffices in one of the scenarios.
    runs : its runs at this limit, one per scenario; empty for an infinite one.
    """

    configuration: Configuration
    limit: float
    runs: tuple[RunRecord, ...]


def find_required_limits(loops: Sequence[LimitedGroup]) -> list[RequiredLimit]:
    """Return the largest limit that each configuration needs in closed loops, least first.

    Only the configurations count that ran in the most scenarios.

    loops : groups with limits of one kind.
    """
    limited = [one for group in loops for one in group.configurations]
    by_configuration = group_by_key(limited, lambda one: one.configuration)
    most = max(map(len, by_configuration.values()), default=0)
    required = []
    for configuration, own in by_configuration.items():
        if len(own) == most:
            limit = max(one.least_sufficient_limit for one in own)
            runs = tuple(one.runs[limit] for one in own if limit in one.runs)
            required.append(RequiredLimit(configuration, limit, runs))
    return sorted(required, key=lambda one: one.limit)


_COLUMNS = (
    *("scenario", "configuration", "limit_of", "limit", "cost_ratio", "dev_position_max_m"),
    *("error_move_max", "unconverged", "steps_done", "raw_p50_ns"),
)


def tabulate_limited_loops(records: Records) -> pd.DataFrame:
    """Return one row per closed loop with a limit, of configurations with two limits or more."""
    rows = [
        (
            *(run.scenario, one.configuration.label, group.limit_of, limit),
            *(compute_cost_ratio(run), run.dev_position_max_m, run.error_move_max),
            *(run.unconverged, run.steps_done, run.raw_p50_ns),
        )
        for group in group_limited_runs(records)
        if group.mode == "closed_loop"
        for one in group.configurations
        for limit, run in one.runs.items()
    ]
    return pd.DataFrame(rows, columns=_COLUMNS)


def find_limit(run: RunRecord) -> tuple[LimitOf, float] | None:
    """Return the limit among the options of a run, of iterations or time [s]; None without one.

    No preset has a limit of time, so one counts before that of iterations, which presets have.
    """
    options = decode_options_from_json(run.options)
    kinds: tuple[LimitOf, ...] = ("time", "iterations")
    for limit_of in kinds:
        limit = options.get(_find_key_of_limit(run.solver, limit_of))
        if isinstance(limit, (int, float)) and limit > 0:
            return limit_of, limit
    return None


def is_about_limits(records: Records) -> bool:
    """Return whether the suite sets limits of its own, and all runs have one."""
    suite = records.suite
    tables = [
        table
        for listed in (suite.get("closed_loop"), suite.get("replay"), suite.get("recorded"))
        for table in listed or ()
    ]
    is_limited = any(t.get("iteration_limits") or t.get("time_limits") for t in tables)
    return is_limited and all(find_limit(run) for run in records.runs)


def group_limited_runs(records: Records) -> list[LimitedGroup]:
    """Return the runs of configurations with two limits of a kind or more on one problem.

    Runs in SI units do not count.
    """
    scaled = records.select_runs(units="scaled")
    limits = {run: limit for run in scaled if (limit := find_limit(run)) is not None}
    groups = []
    alike = group_by_key(limits, lambda run: (limits[run][0], run.mode, run.problem))
    for (limit_of, mode, problem), runs in alike.items():
        by_limit = {
            _name_as_in_runs(configuration, own, limit_of): {limits[run][1]: run for run in own}
            for configuration, own in group_by_key(
                runs, lambda run: _remove_limit(run, limits[run][0])
            ).items()
        }
        several = tuple(
            LimitedConfiguration(configuration, dict(sorted(own.items())))
            for configuration, own in by_limit.items()
            if len(own) > 1
        )
        if several:
            groups.append(LimitedGroup(limit_of, mode, problem, several))
    return groups


def _find_key_of_limit(solver: str, limit_of: LimitOf) -> str:
    """Return a solver's option that limits its iterations or time; "" where none is known."""
    record = find_solver_record_or_none(solver)
    if record is None:
        return ""
    return record.time_limit if limit_of == "time" else record.iteration_limit


def _remove_limit(run: RunRecord, limit_of: LimitOf) -> Configuration:
    """Return a run's configuration without the limit, under the name of a preset if it is one."""
    key = _find_key_of_limit(run.solver, limit_of)

    def remove(options: Options) -> Options:
        return {name: value for name, value in options.items() if name != key}

    options = decode_options_from_json(run.options)
    rest = remove(resolve_settings_with_fixed_options(options, run.solver))
    presets = list_preset_names(run.solver)
    names = (n for n in presets if remove(find_options_of_preset(n, run.solver)) == rest)
    name = next(names, "") or format_options_as_toml(rest)
    return replace(run.configuration, settings=name, options="")


def _name_as_in_runs(
    configuration: Configuration, runs: Sequence[RunRecord], limit_of: LimitOf
) -> Configuration:
    """Return a configuration under the one name that its runs have apart from their limits.

    That of `mine[max_iter=5]` is `mine`; of names without the limit there is none.
    """
    key = re.escape(_find_key_of_limit(configuration.solver, limit_of))
    entry = re.compile(rf"(?<![^\[,]){key}=[^,\]]*,?")
    names = {
        entry.sub("", run.settings).replace(",]", "]").replace("[]", "").rstrip(",")
        for run in runs
        if entry.search(run.settings)
    }
    if len(names) != 1 or not all(entry.search(run.settings) for run in runs):
        return configuration
    return replace(configuration, settings=names.pop() or configuration.settings)
