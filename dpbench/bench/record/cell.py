"""A cell: one configuration with the source of its QPs, as JSON that runs it again.

A configuration is one solver, its call mode and its settings, from the plan to the page.

`sequences/source.py` makes and reads the QPs.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import TypeAdapter

from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.errors import InputError
from dpbench.qp.random_sequence import RandomRecipe
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.solvers.contract import LEVELS, Policy, Route, Settings
from dpbench.solvers.own_settings import decode_options_from_json, format_options_as_toml


@dataclass(frozen=True)
class QPSource:
    """Origin of a replay's QPs; `name` is that of the replayed sequence.

    Attributes
    ----------
    kind : its name in descriptions of cells.
    is_timed : whether its QPs follow each other in time, so that times of replays are compared.
    is_judged : whether replays of it are part of verdicts.
    is_of_controller : whether its QPs are those of the scenario's controller.
    """

    kind: ClassVar[str] = ""
    is_timed: ClassVar[bool] = True
    is_judged: ClassVar[bool] = True
    is_of_controller: ClassVar[bool] = False

    name: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the origin of the QPs as a JSON object; empty for the controller's own QPs."""
        return {"kind": self.kind, **asdict(self)} if self.kind else {}

    def count_stretch_steps(self, steps: int) -> int:
        """Return how many steps of its closed loop a replay of `steps` steps is chosen from."""
        return steps


class ControllerSource(QPSource):
    """QPs of the scenario's controller along its reference loop."""

    is_of_controller = True


@dataclass(frozen=True)
class HardestSource(QPSource):
    """The hardest consecutive QPs of a controller, among `of` steps of its reference loop."""

    kind = "hardest"
    is_of_controller = True

    of: int = 0

    def count_stretch_steps(self, steps: int) -> int:
        """Return how many steps of the loop the hardest ones are chosen from."""
        return self.of


@dataclass(frozen=True)
class ConsequenceSource(QPSource):
    """QPs along a loop that test if thrusters hold the ship without the failure group `group`.

    margin : by which the force to hold is multiplied; earlier folders have none.
    """

    kind = "consequence"
    is_judged = False

    group: str = ""
    margin: float = 1.0


@dataclass(frozen=True)
class CapabilitySource(QPSource):
    """QPs at a ship's wind limits, with polygons of `sides` in place of thrust circles."""

    kind = "capability"
    is_timed = is_judged = False

    sides: int = 0
    vessel_name: str = ""
    vessel: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RandomSource(QPSource):
    """Random QPs, generated from family, size and seed."""

    kind = "random"
    is_timed = is_judged = False

    recipe: RandomRecipe


@dataclass(frozen=True)
class RecordedSource(QPSource):
    """QPs read from a recorded file or folder, identified by its SHA-256."""

    kind = "recorded"

    path: str = ""
    sha256: str = ""


CONTROLLER = ControllerSource()
_validator: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
_KINDS = (RandomSource, RecordedSource, HardestSource, ConsequenceSource, CapabilitySource)
SOURCES: Mapping[str, type[QPSource]] = {source.kind: source for source in _KINDS}


def parse_qp_source(values: Mapping[str, Any]) -> QPSource:
    """Return the origin of a replay's QPs that a JSON object describes; an error if it is bad."""
    if not values:
        return CONTROLLER
    kind = str(values.get("kind"))
    if kind not in SOURCES:
        raise InputError("cell", "source.kind", repr(kind), ", ".join(map(repr, SOURCES)))
    source: QPSource = _validator(SOURCES[kind]).validate_python(values)
    return source


Formulation = Literal["condensed_box", "condensed_stacked", "sparse", "none"]
Units = Literal["scaled", "si"]
FORMULATIONS: tuple[Formulation, ...] = ("condensed_box", "condensed_stacked", "sparse", "none")
COMMON_FORMULATION: Formulation = "condensed_box"
"""The formulation that solvers are compared in."""
CONFIGURATION_COLUMNS = (
    *("solver", "route", "policy", "settings", "options"),
    *("formulation", "units"),
)
"""The columns of `runs.parquet` that name a configuration."""
DEFAULT_FALLBACK = "shifted_plan"
SLOWEST = 1e9
"""Largest slowdown: with it a latency of some seconds still is a 64-bit integer [ns]."""
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
    "options",
)


@dataclass(frozen=True)
class StudyRealisation:
    """Parameter point and repetition of a study that a closed loop runs; `x` has the values."""

    name: str
    point: int
    replicate: int
    x: Mapping[str, object]


@dataclass(frozen=True)
class Cell:
    """One run of a campaign: closed loop or replay of a problem by a solver with its settings.

    Parameters
    ----------
    scenario : documents of the scenario (`Scenario.files`); empty where the QPs have none.
    first : first step of a replayed sequence, or of the stretch whose hardest steps are replayed.
    rounds, warmup_steps : of a replay: counting rounds, and steps of the round before them.
    limit_s : the cell's run time, without waits for its core, after which it stops.
    memory_gb : own memory of its process; 0 for the usual share of the machine's (`footprint.py`).
    budget_s, repeat_budget_s : of a replay: run time for all and for repeated rounds
        (`interleaved.py`); no limit of all for 0.
    fallback : policy of `FALLBACKS` without a usable answer; backup : solver asked before it.
    slowdown, deadline_s : of a closed loop: factor ≥ 1 by which the ship's computer is slower, and
        deadline of a step; 0 to wait for every answer, and for the whole sample.
    seed : of the order of configurations within a round.
    solver_module : file of the solver's plug-in; "" for none.
    options : options of custom settings, as JSON; "" where `settings` names a preset.
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
    options: str = ""

    @property
    def solver_settings(self) -> Settings:
        """Settings to open the solver with: custom options, or the name of a preset."""
        return decode_options_from_json(self.options) or self.settings

    @property
    def scenario_name(self) -> str:
        """Name of the scenario, with backup and fallback where unusual; empty without scenario."""
        name = str(self.scenario["name"]) if self.scenario else ""
        if self.mode == "replay":
            return name
        backup = [f"backup {self.backup}"] if self.backup else []
        unusual = backup + [self.fallback] * (self.fallback != DEFAULT_FALLBACK)
        return f"{name} ({', '.join(unusual)})" if unusual else name

    @property
    def fmu_name(self) -> str:
        """Name of the FMU file that replaces the scenario's ship; "" for a run without one."""
        plant = self.scenario.get("scenario", {}).get("plant", {})
        return Path((plant.get("fmu") or {}).get("file", "")).name

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
        """Return whether the run is a replay whose times are compared between solvers."""
        return self.mode == "replay" and self.source.is_timed

    @property
    def is_hardest_window(self) -> bool:
        """Return whether the run replays only the hardest steps of a sequence."""
        return isinstance(self.source, HardestSource)

    @property
    def steps_needed_in_file(self) -> int:
        """Number of steps that the file of the run's QPs must have."""
        return self.first + self.source.count_stretch_steps(self.steps)

    def source_key(self, harness_version: str) -> str:
        """Return a hash shared by all runs whose QPs are read from the same file."""
        # A loop is solved once, whatever is made of it.
        return _hash_json(
            [self.scenario or self.source.to_dict(), harness_version, SCHEMA_VERSION]
        )[:12]

    @property
    def problem_key(self) -> str:
        """Hash shared by runs on the same QPs (replay) or the same scenario (closed loop)."""
        description = self._to_dict()
        return _hash_json([description.get(name) for name in _PROBLEM])

    @cached_property
    def key(self) -> str:
        """Hash of all fields that describe a planned run."""
        return _hash_json(self._to_dict())

    def _to_dict(self) -> dict[str, Any]:
        """Return the run's description as a JSON object, without unused optional fields."""
        study = {} if self.study is None else vars(self.study)
        values = vars(self) | {"source": self.source.to_dict(), "study": study}
        values.pop("key", None)  # cached, and no field
        return {k: v for k, v in values.items() if k not in _OPTIONAL or v}

    def to_json(self) -> str:
        """Return the run's description as JSON text, from which it can be run again."""
        return json.dumps(self._to_dict(), sort_keys=True, ensure_ascii=False)

    @classmethod
    def from_json(cls, text: str) -> "Cell":
        """Return the description of a run from JSON text, as `to_json` wrote it."""
        values = json.loads(text)
        values["source"] = parse_qp_source(values.get("source", {}))
        if "study" in values:
            values["study"] = StudyRealisation(**values["study"])
        return cls(**values)

    def with_settings_name(self, name: str) -> "Cell":
        """Return this run under another name of its solver settings."""
        return replace(self, settings=name)

    def run_id(self, solver_version: str, machine_id: str, harness_version: str) -> str:
        """Return the run's id: hash of its description, solver version, machine and dpbench."""
        description = self._to_dict()
        return _hash_json(
            [description, solver_version, machine_id, harness_version, SCHEMA_VERSION]
        )


def _hash_json(value: object) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of a value as JSON."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


OUTCOMES = ("finished", "crashed", "hung", "timed_out", "refused", "invalid", "lost")
"""Possible outcomes of a cell; `lost` is an accident of the harness, and never the last word."""


@dataclass(frozen=True)
class Outcome:
    """End of a run (finished, crashed, hung, ...), its reason, and the size of its QP.

    n, m : size of the QP given to the solver; None where it got none.
    peak_bytes : largest resident memory of its process; None where unknown.
    """

    outcome: str
    detail: str
    form: str = ""
    n: int | None = None
    m: int | None = None
    peak_bytes: float | None = None


HARNESS_VERSION = version("dpbench")


@dataclass(frozen=True)
class Configuration:
    """A solver with call mode, settings, units and formulation, as results are compared by.

    `options` of custom settings are JSON, "" with a preset; `alias` has further names of the
    same settings, where settings have no effect.
    """

    solver: str
    route: Route
    policy: Policy
    settings: str = "default"
    units: Units = "scaled"
    formulation: Formulation = COMMON_FORMULATION
    options: str = ""
    alias: tuple[str, ...] = field(default=(), compare=False)

    @property
    def solver_settings(self) -> Settings:
        """Settings to open the solver with: custom options, or the name of a preset."""
        return decode_options_from_json(self.options) or self.settings

    @property
    def options_text(self) -> str:
        """Options of custom settings, where their name does not show them; "" else."""
        text = format_options_as_toml(decode_options_from_json(self.options))
        return "" if text == self.settings else text

    @property
    def call_text(self) -> str:
        """Call of the solver, with unusual settings, as text such as `native warm, high`."""
        settings = "" if self.settings == "default" else f", {self.settings}"
        return f"{self.route} {self.policy}{settings}"

    @property
    def label(self) -> str:
        """Solver and options as text, such as `osqp (native warm, high, in SI units, sparse)`."""
        return self.make_label_with_name(self.solver)

    @property
    def marked_label(self) -> str:
        """The label with the solver marked as code, such as "`osqp` (native warm)"."""
        return self.make_label_with_name(f"`{self.solver}`")

    def make_label_with_name(self, solver: str) -> str:
        """Return the label with another name of the solver, such as one with its version."""
        units = "" if self.units == "scaled" else ", in SI units"
        formulated = self.formulation not in (COMMON_FORMULATION, "none")
        formulation = f", {self.formulation.replace('_', ' ')}" if formulated else ""
        return f"{solver} ({self.call_text}{units}{formulation})"

    @property
    def moved_to_common_formulation(self) -> "Configuration":
        """The configuration moved to the condensed formulation, in which results are compared."""
        return replace(self, formulation=COMMON_FORMULATION)


def sort_key_of_settings(settings: str) -> tuple[int, tuple[str | float, ...]]:
    """Return a sort key of a settings name: default and tolerance presets first, in order.

    Other names are sorted by their text, and numbers in it by value.
    """
    known = settings in LEVELS
    level = LEVELS.index(settings) if known else len(LEVELS)
    # Text and numbers alternate, so that two keys have the same type at each place.
    parts = _NUMBER.split(settings)
    return level, tuple(float(part) if i % 2 else part for i, part in enumerate(parts))


_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)", re.ASCII)
