"""A cell: one configuration of the benchmark as a JSON description that runs it again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, Literal

from dpbench.bench.record.qp_source import CONTROLLER, HardestSource, QPSource, source_from
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.solvers.contract import Policy, Route

Formulation = Literal["condensed_box", "condensed_stacked", "sparse", "none"]
Units = Literal["scaled", "si"]
FORMULATIONS: tuple[Formulation, ...] = ("condensed_box", "condensed_stacked", "sparse", "none")
DEFAULT_FALLBACK = "shifted_plan"
SLOWEST = 1e9
"""Largest slow-down: with it a latency of some seconds still is a 64-bit integer [ns]."""
_PROBLEM = ("mode", "source", "scenario", "units", "first", "steps")
_OPTIONAL = (
    "source",
    "study",
    "slowdown",
    "deadline_s",
    "budget_s",
    "repeat_budget_s",
    "backup",
    "memory_gb",
)


@dataclass(frozen=True)
class StudyRealisation:
    """What of a study a closed loop is: its name, a point and a replicate of it.

    Parameters
    ----------
    x : values of the point's keys, by their dotted names.
    """

    name: str
    point: int
    replicate: int
    x: Mapping[str, object]


@dataclass(frozen=True)
class Cell:
    """problem × solver × route × policy × settings × formulation × units, in one mode.

    Parameters
    ----------
    mode : "closed_loop" or "replay".
    scenario : the documents of the scenario (`Scenario.files`); empty where the QPs have none.
    steps : steps to run from `first` on; the whole run in closed loop starts at 0.
    first : first step of a replayed sequence; of the hardest steps, that of the stretch they are
        chosen from.
    rounds, warmup_steps : replay only: counting rounds, and steps of the round before them.
    limit_s : the cell's own run time after which it stops.
    memory_gb : memory of its own that its process may have; 0 for the usual share of the machine's
        (`footprint.py`).
    budget_s : replay only: run time after which the rounds that are left are left out, once
        `FEWEST_ROUNDS` count (`interleaved.py`); 0 for none.
    repeat_budget_s : replay only: run time for rounds that were robbed, again (`interleaved.py`).
    fallback : the policy that acts when there is no usable answer, of `FALLBACKS`.
    backup : closed loop only: the second solver that steps in before the fallback does
        (`bench/run/backup.py`); "" for none.
    slowdown, deadline_s : closed loop only: how much slower than this machine the ship's computer
        is, ≥ 1, and what a step may take of its time; 0 for a loop that waits for every answer,
        and for the whole sample (`slow_computer.py`).
    seed : of the order of configurations within a round.
    solver_module : file of the plug-in that brings the solver; "" for none.
    source : replay only: what its QPs are made from; by default the scenario's controller, from
        `first` on.
    study : closed loop of a study only.
    """

    mode: Literal["closed_loop", "replay"]
    scenario: ScenarioDocuments
    solver: str
    route: Route
    policy: Policy
    settings: str
    steps: int
    formulation: Formulation = "condensed_box"
    units: Units = "scaled"
    first: int = 0
    rounds: int = 0
    warmup_steps: int = 0
    limit_s: float = 5.0
    fallback: str = DEFAULT_FALLBACK
    seed: int = 0
    solver_module: str = ""
    source: QPSource = CONTROLLER
    study: StudyRealisation | None = None
    slowdown: float = 0.0
    deadline_s: float = 0.0
    budget_s: float = 0.0
    repeat_budget_s: float = 0.0
    backup: str = ""
    memory_gb: float = 0.0

    @property
    def scenario_name(self) -> str:
        """Name of the scenario, with the backup and the fallback where these are not the usual
        ones; may be empty."""
        name = str(self.scenario["name"]) if self.scenario else ""
        if self.mode == "replay":
            return name
        backup = [f"backup {self.backup}"] if self.backup else []
        unusual = backup + [self.fallback] * (self.fallback != DEFAULT_FALLBACK)
        return f"{name} ({', '.join(unusual)})" if unusual else name

    @property
    def sequence(self) -> str:
        """Name of the replayed sequence; empty in closed loop."""
        if self.mode == "closed_loop":
            return ""
        if self.source != CONTROLLER:
            return self.source.name
        whole = self.first == 0
        last = self.first + self.steps
        return self.scenario_name if whole else f"{self.scenario_name}[{self.first}:{last}]"

    @property
    def is_timed(self) -> bool:
        """Whether it is a replay whose times are compared."""
        return self.mode == "replay" and self.source.is_timed

    @property
    def is_window(self) -> bool:
        """Whether it replays the hardest steps of a stretch."""
        return isinstance(self.source, HardestSource)

    @property
    def last_step(self) -> int:
        """The sample behind the last that it needs of its source."""
        return self.first + self.source.stretch(self.steps)

    def source_key(self, harness_version: str) -> str:
        """Equal for cells that share the file behind their QPs."""
        # A loop is solved once, whatever is made of it.
        return _digest([self.scenario or self.source.to_dict(), harness_version, SCHEMA_VERSION])[
            :12
        ]

    @property
    def problem_key(self) -> str:
        """Cells with the same problem key see the same QPs (replay) or the same ship."""
        description = self._description()
        return _digest([description.get(name) for name in _PROBLEM])

    @property
    def key(self) -> str:
        """Equal for equal cells, and for no others."""
        return _digest(self._description())

    def _description(self) -> dict[str, Any]:
        """All fields, less those of `_OPTIONAL` that are not used: other cells keep their keys."""
        study = {} if self.study is None else vars(self.study)
        values = vars(self) | {"source": self.source.to_dict(), "study": study}
        return {k: v for k, v in values.items() if k not in _OPTIONAL or v}

    def to_json(self) -> str:
        """The description as JSON."""
        return json.dumps(self._description(), sort_keys=True, ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> Cell:
        """The cell that `to_json` described."""
        values = json.loads(text)
        values["source"] = source_from(values.get("source", {}))
        if "study" in values:
            values["study"] = StudyRealisation(**values["study"])
        return cls(**values)

    def with_settings(self, name: str) -> Cell:
        """The same cell under another name of its settings."""
        return replace(self, settings=name)

    def run_id(self, solver_version: str, machine_id: str, harness_version: str) -> str:
        """Hash of the cell and of everything a result of it depends on (method.md section 5)."""
        description = self._description()
        return _digest([description, solver_version, machine_id, harness_version, SCHEMA_VERSION])


def _digest(value: object) -> str:
    text = json.dumps(value, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


OUTCOMES = ("finished", "crashed", "hung", "timed_out", "refused", "invalid", "lost")
"""What may become of a cell; `lost` is an accident of the harness, and never the last word."""


@dataclass(frozen=True)
class Outcome:
    """What became of a process: `outcome` as in `runs.parquet`, its cause, the solver's form.

    n, m : size of the QP the solver was given; None where it never got one.
    peak_bytes : largest resident memory of its process; None where it is not known.
    """

    outcome: str
    detail: str
    form: str = ""
    n: int | None = None
    m: int | None = None
    peak_bytes: float | None = None


HARNESS_VERSION = version("dpbench")
