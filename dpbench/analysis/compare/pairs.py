"""Pairs of cells of two result folders with the same configuration on the same problem."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.record.configuration import CONFIGURATION_COLUMNS
from dpbench.errors import ResultsError

KEY = ("mode", "scenario", "sequence", *CONFIGURATION_COLUMNS, "steps_planned")
"""Columns that two cells share when they ask the same question of the same configuration."""
LASTING = ("cpu_model", "cores", "memory_GiB", "kernel", "python", "versions")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two runs of one solver configuration on one problem, from result folders A and B."""

    a: RunRecord
    b: RunRecord

    @property
    def label(self) -> str:
        """Name of the paired runs' solver configuration, with both versions where they differ."""
        old, new = (f"{run.solver_version} {run.build}".strip() for run in (self.a, self.b))
        versions = "" if old == new else f" {old} → {new}"
        return self.a.configuration.label_of(f"{self.a.solver}{versions}")


@dataclass(frozen=True, eq=False)
class Pairs:
    """Paired runs of two result folders, and descriptions of the runs left unpaired."""

    pairs: list[Pair]
    only_a: list[str]
    only_b: list[str]
    changed: list[str]
    lost: list[str]


def machine_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """List the properties, as processor, in which two computers differ; empty for the same one."""
    if a["id"] == b["id"]:
        return []
    differ = [name for name in LASTING if a.get(name) != b.get(name)]
    return differ or ["what neither describes"]


def pair_cells(a: Records, b: Records, names: tuple[str, str]) -> Pairs:
    """Pair the runs of two result folders by configuration and problem.

    A cell refused in both is left out; one whose problem changed under its name has no partner.

    Raises
    ------
    ResultsError : when no cell of one folder has a partner in the other.
    """
    cells_a, cells_b = _runs_by_key(a), _runs_by_key(b)
    pairs, changed, lost = [], [], []
    for key in (key for key in cells_a if key in cells_b):
        pair = Pair(cells_a[key], cells_b[key])
        outcomes = pair.a.outcome, pair.b.outcome
        if problem_key(pair.a) != problem_key(pair.b):
            changed.append(_describe_cell(pair.a))
        elif "lost" in outcomes:
            lost.append(_describe_cell(pair.a))
        elif outcomes != ("refused", "refused"):
            pairs.append(pair)
    if not pairs and not lost:
        missing = "no cell that the first folder has too, of the same problem"
        raise ResultsError(names[1], "", missing, f"results of the suite of {names[0]}")
    only_a = [_describe_cell(run) for key, run in cells_a.items() if key not in cells_b]
    only_b = [_describe_cell(run) for key, run in cells_b.items() if key not in cells_a]
    return Pairs(pairs, only_a, only_b, changed, lost)


def cell_key(run: RunRecord) -> dict[str, Any]:
    """Return a run's identifying column values by name: mode, problem, configuration, steps."""
    return {column: getattr(run, column) for column in KEY}


def _runs_by_key(records: Records) -> dict[tuple[Any, ...], RunRecord]:
    """Map each run's identifying column values to the run, simulated slow computers left out."""
    # A loop on a slow computer takes another course each time: its answers' delays are measured.
    lasting = (run for run in records.all_runs if not run.slowdown > 0.0)
    return {tuple(cell_key(run).values()): run for run in lasting}


def _describe_cell(run: RunRecord) -> str:
    mode, options = run.mode.replace("_", " "), run.configuration.options_text
    label = run.configuration.label + (f" with {options}" if options else "")
    return f"{label}, {mode} of {run.steps_planned} steps of {run.problem}"


def problem_key(run: RunRecord) -> tuple[object, ...]:
    """Return what defines a run's problem, for comparison: scenario, origin of QPs, fallbacks."""
    return run.files, run.source, run.first, run.fallback, run.backup
