"""Pair the cells of two result folders: the same question, asked in both."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from dpbench.analysis.records import COMMON, Records, RunRecord, as_float
from dpbench.bench.record.result_folder import Results
from dpbench.errors import ResultsError

KEY = (
    "mode",
    "scenario",
    "sequence",
    "solver",
    "route",
    "policy",
    "settings",
    "formulation",
    "units",
    "steps_planned",
)
"""Columns that two cells share when they ask the same question of the same configuration."""
PROBLEM = ("scenario", "source", "first", "fallback")
"""Parts of a cell's description that they share too."""
LASTING = ("cpu_model", "cores", "memory_GiB", "kernel", "python", "versions")


@dataclass(frozen=True, eq=False)
class Pair:
    """A cell of folder A and the same cell of folder B."""

    a: RunRecord
    b: RunRecord

    @property
    def label(self) -> str:
        """The configuration, with both versions and builds of its solver where one of them
        differs."""
        row = self.a
        old, new = (f"{of['solver_version']} {of['build']}".strip() for of in (row, self.b))
        versions = "" if old == new else f" {old} → {new}"
        units = "" if row["units"] == "scaled" else f", {row['units']}"
        named = "" if row["formulation"] in (COMMON, "none") else f", {row['formulation']}"
        form = named.replace("condensed_", "")
        configuration = f"{row['route']} {row['policy']}, {row['settings']}{units}{form}"
        return f"{row['solver']}{versions} ({configuration})"

    @property
    def problem(self) -> str:
        """Sequence or scenario."""
        return str(self.a["sequence"] or self.a["scenario"])


@dataclass(frozen=True, eq=False)
class Pairs:
    """The pairs of two folders, and as text the cells without a partner, those whose problem
    changed, and those that the harness lost in either."""

    pairs: list[Pair]
    only_a: list[str]
    only_b: list[str]
    changed: list[str]
    lost: list[str]


def check_machines(a: Results, b: Results, where: str) -> None:
    """ResultsError, saying what differs, where two folders come from different machines.

    `where` is the folder of `b`.
    """
    ids = a.machine["id"], b.machine["id"]
    if ids[0] == ids[1]:
        return
    differ = [name for name in LASTING if a.machine.get(name) != b.machine.get(name)]
    found = f"{ids[1]!r}, which differs in {', '.join(differ) or 'what neither describes'}"
    allowed = f"the machine of the first folder, {ids[0]!r}, or --any-machine"
    raise ResultsError(f"{where}/machine.json", "id", found, allowed)


def pair_cells(a: Records, b: Records, names: tuple[str, str]) -> Pairs:
    """Pair the cells of two folders.

    A cell that was refused in both is left out; one whose problem changed under the same name
    (another scenario file) has no partner.

    Raises
    ------
    ResultsError : when no cell of one folder has a partner in the other.
    """
    mine, theirs = _by_key(a), _by_key(b)
    pairs, changed, lost = [], [], []
    for key, row in mine.items():
        other = theirs.get(key)
        if other is None:
            continue
        if _problem(row) != _problem(other):
            changed.append(_name(key))
        elif "lost" in (row["outcome"], other["outcome"]):
            lost.append(_name(key))
        elif not row["outcome"] == other["outcome"] == "refused":
            pairs.append(Pair(row, other))
    if not pairs and not lost:
        found = "no cell that the first folder has too, of the same problem"
        raise ResultsError(names[1], "", found, f"results of the suite of {names[0]}")
    only_a = [_name(key) for key in mine if key not in theirs]
    only_b = [_name(key) for key in theirs if key not in mine]
    return Pairs(pairs, only_a, only_b, changed, lost)


def _by_key(records: Records) -> dict[tuple[str, ...], RunRecord]:
    # A loop on a slow computer takes another course each time: its answers' delays are measured.
    lasting = (row for row in records.all_runs if not as_float(row["slowdown"]) > 0.0)
    return {tuple(str(row[name]) for name in KEY): row for row in lasting}


def _name(key: tuple[str, ...]) -> str:
    mode, scenario, sequence, solver, *configuration, steps = key
    what = f"{mode.replace('_', ' ')} of {steps} steps of {sequence or scenario}"
    return f"{solver} ({' '.join(configuration)}), {what}"


def _problem(row: RunRecord) -> dict[str, Any]:
    """What the cell was asked, as far as its description says."""
    described = str(row["cell"])
    cell = json.loads(described) if described.startswith("{") else {}
    return {name: cell.get(name) for name in PROBLEM}
