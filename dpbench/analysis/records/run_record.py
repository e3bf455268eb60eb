"""Typed rows of `runs.parquet`, and their grouping."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from pydantic import BaseModel, ValidationError

from dpbench.bench.judge.answer_caching import CachingSign, find_caching_sign
from dpbench.bench.record.cell import (
    COMMON_FORMULATION,
    CONTROLLER,
    CapabilitySource,
    Configuration,
    ConsequenceSource,
    Formulation,
    HardestSource,
    QPSource,
    RandomSource,
    RecordedSource,
    Units,
    parse_qp_source,
)
from dpbench.bench.record.result_folder import make_json_fault_error
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.errors import InputError, ResultsError
from dpbench.files.regular_files import describe_json_fault, parse_json
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.tables.key_types import Horizons
from dpbench.solvers.contract import Policy, Route

Count = float
"""A count that a run may not have: NaN then, as null in the table."""
Mode = Literal["closed_loop", "replay"]
SEPARATE = "timed in separate commands"
"""Reason for no ratio of times: load and speed of the machine may differ from one to the other."""


class ThrusterUse(BaseModel, strict=True):
    """Use of the thrusters that are left in a reference loop: `exact_thruster_use`.

    window_s : start and end; thrust : mean and largest share of their thrust; thrusters : by name,
    mean and largest share, share of steps at a limit of thrust or sector, and at the rate limit.
    """

    window_s: tuple[float, float]
    thrust: tuple[float, float]
    thrusters: dict[str, tuple[float, float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """One run of a solver configuration on one problem: a typed row of `runs.parquet`.

    files : the documents of its scenario, or empty; first, fallback, backup : as in its cell.
    x : of a study, the values of its keys at the run's point.
    default_route : whether it runs on its solver's own route, set by `Records`.
    untimed_iterations : of a replay, the factor that bounds its p99 by the iterations of its
        solver's closed loop, set by `Records`; at least 1. untimed_iterations_max : of its
        longest step.
    own_switches_a_step : involuntary switches a step of the configuration's own making, set by
        `machine.py` and then not among `involuntary_switches`; NaN for none.
    """

    # identity and outcome: `IDENTITY_COLUMNS`
    run_id: str
    mode: Mode
    scenario: str
    sequence: str
    solver: str
    solver_version: str
    build: str
    route: Route
    policy: Policy
    settings: str
    options: str
    formulation: Formulation
    N_p: Count
    N_c: Count
    n: Count
    units: Units
    slowdown: float
    deadline_s: float
    sample_s: float
    first_sample: Count
    study: str
    study_point: Count
    replicate: Count
    outcome: str
    outcome_detail: str
    machine_id: str
    concurrency: Count
    campaign_utc: str
    judged_utc: str
    turns: str
    steps_planned: int
    steps_done: int
    # accuracy: `ACCURACY_COLUMNS`
    true_share: float
    claimed_not_true: Count
    error_move_max: float
    error_plan_max: float
    uncertified: Count
    undecided_steps: Count
    infeasible_steps: Count
    failed_steps: Count
    iterations_p50: float
    iterations_p99: float
    iterations_max: float
    # timing: `TIMING_COLUMNS`
    rounds: Count
    disturbed_rounds: Count
    counting_disturbed: Count
    rerun_rounds: Count
    reference_kernel_ns: float
    load_kernel_ns: float
    algo_p50_ns: float
    algo_p95_ns: float
    algo_p99_ns: float
    algo_max_ns: float
    window_p99_ns: float
    raw_p50_ns: float
    raw_p99_ns: float
    raw_max_ns: float
    first_visit_ratio: float
    first_visit_excess: float
    loop_ratio: float
    loop_tail_ratio: float
    # machine: `MACHINE_COLUMNS`
    replay_s: float
    voluntary_switches: Count
    involuntary_switches: Count
    steal_s: float
    throttle_events: float
    solve_s: float
    thread_s: float
    # control: `CONTROL_COLUMNS`
    fallbacks: Count
    latency_max_ns: float
    unconverged: Count
    clipped: Count
    limit_violations: Count
    r_rms_m: float
    r_95_m: float
    r_max_m: float
    r_tail_max_m: float
    heading_max_deg: float
    settle_s: float
    settle_0p1m_s: float
    overshoot_e: float
    share_1m: float
    total_variation: float
    at_rate_surge: float
    at_rate_sway: float
    at_rate_yaw: float
    at_amplitude_surge: float
    at_amplitude_sway: float
    at_amplitude_yaw: float
    power_share: float
    thrust_variation: float
    azimuth_travel_deg: float
    at_rate_thrusters: float
    at_limit_thrusters: float
    closed_loop_cost: float
    exact_cost: float
    exact_steps: Count
    station_radius_m: float
    exact_offset_max_m: float
    exact_offset_max_s: float
    exact_offset_end_m: float
    exact_offset_rise_m: float
    exact_heading_max_deg: float
    exact_heading_end_deg: float
    exact_loss_offset_max_m: float
    exact_loss_heading_max_deg: float
    exact_loss_swing_m: float
    exact_left_s: float
    exact_transfer_offset_max_m: float
    exact_transfer_s: float
    exact_active_share: float
    exact_thruster_use: str
    dev_position_max_m: float

    files: ScenarioDocuments = field(default_factory=ScenarioDocuments, repr=False)
    source: QPSource = field(default=CONTROLLER, repr=False)
    first: int = 0
    fallback: str = ""
    backup: str = ""
    x: Mapping[str, Any] = field(default_factory=dict)
    default_route: bool = False
    own_switches_a_step: float = np.nan
    untimed_iterations: float = 1.0
    untimed_iterations_max: float = 1.0

    def copy_without_times(self) -> "RunRecord":
        """Return a copy of the run with all times set to NaN."""
        times = (one.name for one in fields(self) if one.name.endswith("_ns"))
        timed: dict[str, Any] = dict.fromkeys(times, np.nan)
        return replace(self, **timed)

    @property
    def configuration(self) -> Configuration:
        """Solver configuration of the run: interface, warm start, settings, units, formulation."""
        return Configuration(
            *(self.solver, self.route, self.policy, self.settings),
            *(self.units, self.formulation, self.options),
        )

    @property
    def measurement_key(self) -> tuple[object, ...]:
        """Key that is equal for one measured run listed under several names of settings."""
        settings = "" if self.has_steps else self.settings
        where = self.mode, self.problem, self.study, str(self.study_point), str(self.replicate)
        times = str(self.replay_s), str(self.raw_max_ns)
        return *where, replace(self.configuration, settings=settings), *times

    def explain_separate_timing(self, other: "RunRecord") -> str:
        """Return why the times of two replays make no paired ratio; "" if they were interleaved.

        Of two runs of an earlier release, which does not record it, turns are assumed.
        """
        if self.turns == other.turns:
            return ""
        return SEPARATE if self.campaign_utc != other.campaign_utc else "not interleaved"

    @property
    def is_outside_verdicts(self) -> bool:
        """True if the run counts in no solver's verdict: a study, or a problem without a ship."""
        return bool(self.study) or not self.source.is_judged

    @property
    def family(self) -> str:
        """Name of the family of random QPs that the run solves; "" for any other run."""
        return self.source.recipe.family if isinstance(self.source, RandomSource) else ""

    @property
    def lost_thruster_group(self) -> str:
        """Name of the thruster group whose loss the run's QPs assume; "" for any other run."""
        return self.source.group if isinstance(self.source, ConsequenceSource) else ""

    @property
    def is_at_boundary(self) -> bool:
        """True if the run solves the QPs at the limits of a vessel's capability plot."""
        return isinstance(self.source, CapabilitySource)

    @property
    def export_argument(self) -> str:
        """Argument with which `dpbench export` finds the run's QPs: file, scenario or sequence."""
        path = self.source.path if isinstance(self.source, RecordedSource) else ""
        return path or self.scenario or self.sequence

    @property
    def first_step(self) -> int:
        """Index of the scenario's step at which the run begins."""
        if self.steps_searched_for_hardest and not np.isnan(self.first_sample):
            return int(self.first_sample)
        return self.first

    @property
    def steps_searched_for_hardest(self) -> int:
        """Number of steps of which the hardest are replayed by this run; 0 of other runs."""
        return self.source.of if isinstance(self.source, HardestSource) else 0

    @property
    def problem(self) -> str:
        """Name of the problem that the run solves: QP sequence of a replay, else its scenario."""
        return self.sequence or self.scenario

    def has_problem_of(self, other: "RunRecord") -> bool:
        """Return whether two runs have the same ship, tuning and weather, whatever their names."""
        documents = (self.files.get("scenario"), self.files.get("vessel"))
        return bool(self.files) and documents == (
            other.files.get("scenario"),
            other.files.get("vessel"),
        )

    @property
    def horizons(self) -> Horizons | None:
        """Prediction and control horizon (N_p, N_c); None for a QP without a ship."""
        return None if np.isnan(self.N_c) else (int(self.N_p), int(self.N_c))

    @property
    def sequence_without_horizons(self) -> str:
        """Sequence name without horizons: `paper[0:300]` of `paper-60-10[0:300]`."""
        name, bracket, window = self.sequence.partition("[")
        horizons = "" if self.horizons is None else "-{}-{}".format(*self.horizons)
        return name.removesuffix(horizons) + bracket + window

    @property
    def scenario_documents(self) -> ScenarioDocuments | None:
        """Scenario and vessel documents of the run; None where it has none."""
        return self.files if "scenario" in self.files else None

    @property
    def is_of_own_plant(self) -> bool:
        """True if the run is a closed loop of a `LinearMPC`, whose plant is no ship."""
        return bool(self.files) and self.mode == "closed_loop" and "scenario" not in self.files

    @property
    def commands_thrusters(self) -> bool:
        """True if the controller commands thrusters instead of three forces."""
        scenario = (self.scenario_documents or {}).get("scenario")
        return scenario is not None and scenario["controller"].get("kind", "forces") != "forces"

    @property
    def thruster_use(self) -> ThrusterUse | None:
        """Use of the thrusters in the run's reference loop; None without commanded thrusters."""
        if not self.exact_thruster_use:
            return None
        try:
            return ThrusterUse.model_validate_json(self.exact_thruster_use)
        except ValidationError as error:
            raise _make_description_error("exact_thruster_use", error) from error

    @property
    def is_baseline_law(self) -> bool:
        """True if the run is of the baseline control law, which solves no QP."""
        return self.formulation == "none"

    @property
    def has_steps(self) -> bool:
        """True if the run completed at least one step."""
        return self.steps_done > 0

    @property
    def has_all_steps(self) -> bool:
        """True if every planned step was recorded, of a replay in one round that counts."""
        return self.steps_done >= self.steps_planned

    @property
    def has_no_optimum(self) -> bool:
        """True if no step of the run has a feasible point, and therefore none an optimum."""
        # Errors are known, or infinite, at every step that has an optimum.
        without_proof = self.uncertified > 0 or self.undecided_steps > 0
        return self.infeasible_steps > 0 and np.isnan(self.error_move_max) and not without_proof

    @property
    def unverified_steps(self) -> int:
        """Number of steps reported as solved whose solution the referee does not verify."""
        in_a_round = self.claimed_not_true / max(1.0, np.nan_to_num(self.rounds))
        return int(np.ceil(np.nan_to_num(in_a_round)))

    @property
    def outcome_message(self) -> str:
        """Message of the solver library or benchmark on how the run ended; "" for none."""
        return self.outcome_detail.strip().rstrip(".")

    @property
    def caching_sign(self) -> CachingSign | None:
        """Sign of cached answers in a replay's times, and its value; None without it."""
        return find_caching_sign(
            self.first_visit_ratio, self.loop_ratio, self.first_visit_excess, self.loop_tail_ratio
        )

    @property
    def solver_label(self) -> str:
        """Name of the run's solver, with what differs from its default configuration."""
        words = [] if self.default_route else [str(self.route)]
        words += [] if self.policy == "fresh" else [str(self.policy)]
        words += [] if self.settings == "default" else [self.settings]
        names = [f"{self.solver} ({', '.join(words)})" if words else self.solver]
        names += [] if self.units == "scaled" else [self.units]
        common = self.formulation in (COMMON_FORMULATION, "none")
        return ", ".join(names if common else [*names, self.formulation.replace("_", " ")])


class _Table(BaseModel, strict=True, extra="allow"):
    """Base class of validated JSON tables that may have unknown keys."""


class _Scenario(_Table):
    """Scenario document, of which only the controller is checked."""

    controller: dict[str, Any]


class _Files(_Table):
    """Scenario part of a run's JSON description."""

    scenario: _Scenario | None = None


class _Study(_Table):
    """Study part of a run's JSON description: the parameter values varied in this run."""

    x: dict[str, Any] = {}


class _RunDescription(_Table):
    """Parts that are read of a run's JSON description: scenario, origin of QPs, fallbacks."""

    scenario: _Files | None = None
    source: dict[str, Any] = {}
    study: _Study = _Study()
    first: int = 0
    fallback: str = ""
    backup: str = ""


def build_run_records(runs: pd.DataFrame, keys: Sequence[str] = ()) -> list[RunRecord]:
    """Return a list of `RunRecord`, one for each row of a data frame of runs.

    keys : those of studies in the order of the suite, for `x`; a run's description sorts them.
    """
    names = [name for name in RunRecord.__annotations__ if name in RUN_COLUMNS]
    values = [_READ[RUN_COLUMNS[name][0]](runs[name]) for name in names]
    shared: dict[str, Any] = {}
    return [
        RunRecord(**dict(zip(names, row, strict=True)), **_parse_description(cell, shared, keys))
        for *row, cell in zip(*values, runs["cell"].astype(str), strict=True)
    ]


def _parse_description(cell: str, shared: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Return the record fields of a run's JSON description; equal parts share one object."""
    if not cell.startswith("{"):
        return {}
    try:
        described = parse_json(cell)
        read = _RunDescription.model_validate(described)
    except ValueError as error:
        raise _make_description_error("cell", error) from error
    files = described.get("scenario") or {}
    for whole in files.values():
        if isinstance(whole, dict):
            for name, part in whole.items():
                whole[name] = shared.setdefault(repr(part), part) if name != "scenario" else part
    key = f"source {read.source!r}"
    if key not in shared:
        try:
            shared[key] = parse_qp_source(read.source)
        except ValueError as error:
            raise _make_description_error("cell.source", error) from error
    same = {name: getattr(read, name) for name in ("first", "fallback", "backup")}
    values = read.study.x
    ordered = {key: values[key] for key in (*keys, *values) if key in values}
    x = shared.setdefault(repr(values), ordered)
    return {"files": files, "source": shared[key], "x": x, **same}


def _make_description_error(key: str, error: ValueError) -> ResultsError:
    """Return the error on a run's stored description, with file, key and value."""
    if isinstance(error, InputError):
        return ResultsError("runs.parquet", f"cell.{error.key}", error.found, error.allowed)
    if isinstance(error, ValidationError):
        return make_json_fault_error("runs.parquet", error, key)
    allowed = "a cell description in JSON, written by `run_campaign()`; run the suite again"
    return ResultsError("runs.parquet", key, *describe_json_fault(error, allowed))


def _convert_column_to_floats(column: "pd.Series[Any]") -> list[float]:
    """Return a numeric column as a list of floats, null as NaN."""
    return column.to_numpy(dtype=np.float64, na_value=np.nan).tolist()


_READ: "Mapping[str, Callable[[pd.Series[Any]], list[Any]]]" = {
    "str": lambda column: [str(value) for value in column],
    "bool": lambda column: [bool(value) for value in column],
    "int64": lambda column: [int(value) for value in column],
    "Int64": _convert_column_to_floats,
    "float64": _convert_column_to_floats,
}
"""Readers of a column by its type; a null of a nullable integer becomes NaN."""

Item = TypeVar("Item")
Key = TypeVar("Key")


def group_by_key(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return lists of items by their key, keys and items in order of appearance."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def map_first_by_key(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, Item]:
    """Return by key the first of the items that have it."""
    first: dict[Key, Item] = {}
    for item in items:
        first.setdefault(key(item), item)
    return first
