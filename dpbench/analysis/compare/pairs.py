"""Pairs of cells of two result folders with the same configuration on the same problem."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS
from dpbench.errors import ResultsError
from dpbench.solvers.own_settings import decode_options_from_json, format_each_option_as_toml

KEY = ("mode", "scenario", "sequence", *CONFIGURATION_COLUMNS, "steps_planned")
"""Columns that two cells share when they ask the same question of the same configuration."""
Key = tuple[Any, ...]
LASTING = ("cpu_model", "cores", "memory_GiB", "kernel", "python", "versions")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two runs of one solver configuration on one problem, from result folders A and B."""

    a: RunRecord
    b: RunRecord

    @property
    def configuration_label(self) -> str:
        """Name of the paired runs' solver configuration, with both versions where they differ."""
        old, new = (f"{run.solver_version} {run.build}".strip() for run in (self.a, self.b))
        versions = "" if old == new else f" {old} → {new}"
        label = self.a.configuration.make_label_with_name(f"{self.a.solver}{versions}")
        return f"{label} with {change}" if (change := self.changed_options_text) else label

    @property
    def changed_options_text(self) -> str:
        """Options of settings of one's own that differ, such as `rho 1.6 → 0.01`; "" for none."""
        old, new = (
            format_each_option_as_toml(decode_options_from_json(run.options))
            for run in (self.a, self.b)
        )
        return ", ".join(
            f"{name} {old.get(name, 'not set')} → {new.get(name, 'not set')}"
            for name in sorted({*old, *new})
            if old.get(name) != new.get(name)
        )


@dataclass(frozen=True, eq=False)
class Pairs:
    """Paired runs of two result folders, and descriptions of the runs left unpaired."""

    pairs: list[Pair]
    only_a: list[str]
    only_b: list[str]
    changed: list[str]
    lost: list[str]


def list_machine_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """List the properties, as processor, in which two computers differ; empty for the same one."""
    if a["id"] == b["id"]:
        return []
    differ = [name for name in LASTING if a.get(name) != b.get(name)]
    return differ or ["what neither describes"]


def pair_runs_of_folders(a: Records, b: Records, names: tuple[str, str]) -> Pairs:
    """Pair the runs of two result folders by configuration and problem.

    Settings of one's own whose options changed are paired by their name. A cell refused in both is
    left out; one whose problem changed under its name has no partner.

    Raises
    ------
    ResultsError : when no cell of one folder has a partner in the other.
    """
    cells_a, cells_b = _map_runs_by_identity(a), _map_runs_by_identity(b)
    pairs, changed, lost = [], [], []
    partners = {key: key for key in cells_a if key in cells_b} | _pair_keys_of_changed_options(
        cells_a, cells_b
    )
    for key in (key for key in cells_a if key in partners):
        pair = Pair(cells_a[key], cells_b[partners[key]])
        outcomes = pair.a.outcome, pair.b.outcome
        if make_problem_key(pair.a) != make_problem_key(pair.b):
            changed.append(_describe_run(pair.a))
        elif "lost" in outcomes:
            lost.append(_describe_run(pair.a))
        elif outcomes != ("refused", "refused"):
            pairs.append(pair)
    if not pairs and not lost:
        missing = "no cell that the first folder has too, of the same problem"
        raise ResultsError(names[1], "", missing, f"results of the suite of {names[0]}")
    only_a = [_describe_run(run) for key, run in cells_a.items() if key not in partners]
    found = set(partners.values())
    only_b = [_describe_run(run) for key, run in cells_b.items() if key not in found]
    return Pairs(pairs, only_a, only_b, changed, lost)


def _pair_keys_of_changed_options(
    cells_a: Mapping[Key, RunRecord], cells_b: Mapping[Key, RunRecord]
) -> dict[Key, Key]:
    """Map keys of A to those of B that differ in the options of settings of one name alone."""
    named_a, named_b = (
        _group_unpaired_keys_by_name(cells_a, cells_b),
        _group_unpaired_keys_by_name(cells_b, cells_a),
    )
    both = ((named_a[name], named_b[name]) for name in named_a if name in named_b)
    return {a[0]: b[0] for a, b in both if len(a) == len(b) == 1}


def _group_unpaired_keys_by_name(
    cells: Mapping[Key, RunRecord], others: Mapping[Key, RunRecord]
) -> dict[Key, list[Key]]:
    """Group the keys that only one folder has by what names them without their options."""
    groups: dict[Key, list[Key]] = {}
    for key, run in cells.items():
        if run.options and key not in others:
            name = tuple((pick_identifying_columns(run) | {"options": ""}).values())
            groups.setdefault(name, []).append(key)
    return groups


def pick_identifying_columns(run: RunRecord) -> dict[str, Any]:
    """Return a run's identifying column values by name: mode, problem, configuration, steps."""
    return {column: getattr(run, column) for column in KEY}


def _map_runs_by_identity(records: Records) -> dict[Key, RunRecord]:
    """Map each run's identifying column values to the run, simulated slow computers left out."""
    # A loop on a slow computer takes another course each time: its answers' delays are measured.
    lasting = (run for run in records.all_runs if not run.slowdown > 0.0)
    return {tuple(pick_identifying_columns(run).values()): run for run in lasting}


def _describe_run(run: RunRecord) -> str:
    """Describe a run by configuration, options, mode, steps and problem."""
    mode, options = run.mode.replace("_", " "), run.configuration.options_text
    label = run.configuration.label + (f" with {options}" if options else "")
    return f"{label}, {mode} of {run.steps_planned} steps of {run.problem}"


def make_problem_key(run: RunRecord) -> tuple[object, ...]:
    """Return what defines a run's problem, for comparison: scenario, origin of QPs, fallbacks."""
    return run.files, run.source, run.first, run.fallback, run.backup
