"""Answers stopped early: runs of a configuration by its limit of iterations."""

import math
from dataclasses import dataclass, replace
from itertools import takewhile

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import Mode, RunRecord, group_by_key
from dpbench.analysis.verdict.requirements import has_survived
from dpbench.analysis.verdict.verdict import find_solver_record_or_none
from dpbench.bench.record.cell import Configuration
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml
from dpbench.solvers.settings import (
    find_options_of_preset,
    list_preset_names,
    resolve_settings_with_fixed_options,
)


@dataclass(frozen=True, eq=False)
class LimitedConfiguration:
    """Runs of a configuration on one problem, by its limit of iterations in rising order."""

    configuration: Configuration
    runs: dict[int, RunRecord]

    @property
    def least_sufficient_limit(self) -> float:
        """Limit from which on every closed loop survives; infinite for none."""
        falling = reversed(self.runs.items())
        enough = takewhile(lambda item: has_survived(item[1]), falling)
        return min((limit for limit, _ in enough), default=math.inf)


@dataclass(frozen=True, eq=False)
class LimitedGroup:
    """Runs with limits of iterations in one closed loop or on one replay, by configuration."""

    mode: Mode
    problem: str
    configurations: tuple[LimitedConfiguration, ...]

    @property
    def limits(self) -> list[int]:
        """All limits of iterations of the group in rising order."""
        return sorted({limit for one in self.configurations for limit in one.runs})


def find_iteration_limit(run: RunRecord) -> int | None:
    """Return the limit of iterations among the options of a run; None without one."""
    limit = decode_options_from_json(run.options).get(_find_key_of_limit(run.solver))
    return limit if isinstance(limit, int) and limit > 0 else None


def group_limited_runs(records: Records) -> list[LimitedGroup]:
    """Return the runs of configurations with two limits of iterations or more on one problem."""
    limited = [run for run in records.runs if find_iteration_limit(run) is not None]
    groups = []
    for (mode, problem), runs in group_by_key(limited, lambda r: (r.mode, r.problem)).items():
        by_limit = {
            configuration: {find_iteration_limit(run) or 0: run for run in own}
            for configuration, own in group_by_key(runs, _remove_limit).items()
        }
        several = tuple(
            LimitedConfiguration(configuration, dict(sorted(own.items())))
            for configuration, own in by_limit.items()
            if len(own) > 1
        )
        if several:
            groups.append(LimitedGroup(mode, problem, several))
    return groups


def _find_key_of_limit(solver: str) -> str:
    """Return a solver's option that limits its iterations; "" where none is known."""
    record = find_solver_record_or_none(solver)
    return "" if record is None else record.iteration_limit


def _remove_limit(run: RunRecord) -> Configuration:
    """Return a run's configuration without the limit, under the name of a preset if it is one."""
    key = _find_key_of_limit(run.solver)

    def remove(options: Options) -> Options:
        return {name: value for name, value in options.items() if name != key}

    options = decode_options_from_json(run.options)
    rest = remove(resolve_settings_with_fixed_options(options, run.solver))
    presets = list_preset_names(run.solver)
    names = (n for n in presets if remove(find_options_of_preset(n, run.solver)) == rest)
    name = next(names, "") or format_options_as_toml(rest)
    return replace(run.configuration, settings=name, options="")
