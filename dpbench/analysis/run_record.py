"""A row of `runs.parquet`, typed: read once, and asked by attribute from there on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from dpbench.bench.judge.memory_of_answers import is_remembered
from dpbench.bench.record.cell import Formulation, Units
from dpbench.bench.record.configuration import COMMON, Configuration
from dpbench.bench.record.schema import RUN_COLUMNS
from dpbench.scenario.horizons import Horizons
from dpbench.solvers.contract import Policy, Route

Count = float
"""A count that a run may not have: NaN then, as null in the table."""
Mode = Literal["closed_loop", "replay"]


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """One run of one configuration. The columns mean what `bench/record/schema.py` says of them.

    Parameters
    ----------
    description : what `cell` says, read.
    family, drawn_n, drawn_m : of a random sequence its family and its size as drawn; "" and 0 of
        every other run.
    default_route : whether it runs on its solver's own route, which `Records` finds out.
    own_switches_a_step : involuntary switches a step that the configuration makes itself, which
        `machine.py` finds out; they are not among `involuntary_switches` then. NaN for none.
    """

    # identity and outcome: `IDENTITY_COLUMNS`
    run_id: str
    mode: Mode
    scenario: str
    sequence: str
    solver: str
    solver_version: str
    build: str
    generic_build: bool
    route: Route
    policy: Policy
    settings: str
    formulation: Formulation
    form: str
    N_p: Count
    N_c: Count
    n: Count
    m: Count
    units: Units
    slowdown: float
    deadline_s: float
    seed: int
    outcome: str
    outcome_detail: str
    machine_id: str
    schema: int
    cell: str
    steps_planned: int
    steps_done: int
    # accuracy: `ACCURACY_COLUMNS`
    claimed_share: float
    true_share: float
    true_1e4_share: float
    true_1e6_share: float
    claimed_not_true: Count
    true_not_claimed: Count
    error_move_p50: float
    error_move_max: float
    error_plan_max: float
    primal_max: float
    dual_max: float
    optimum_bound_max: float
    uncertified: Count
    undecided_steps: Count
    infeasible_steps: Count
    failed_steps: Count
    iterations_p50: float
    iterations_max: float
    # timing: `TIMING_COLUMNS`
    setup_once_ns: float
    matrix_updates: Count
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
    algo_median_p50_ns: float
    raw_p50_ns: float
    raw_p99_ns: float
    raw_p999_ns: float
    raw_max_ns: float
    raw_samples: Count
    first_visit_ratio: float
    loop_ratio: float
    emit_p50_ns: float
    overhead_p50_ns: float
    # machine: `MACHINE_COLUMNS`
    replay_s: float
    voluntary_switches: Count
    involuntary_switches: Count
    steal_s: float
    throttle_events: float
    bit_identical_share: float
    answer_spread_max: float
    iterations_identical_share: float
    iterations_spread: Count
    peak_rss_bytes: float
    os_threads: Count
    pool_threads: Count
    python_blocks_per_step: float
    python_peak_bytes_per_step: float
    heap_growth_bytes_per_step: float
    # control: `CONTROL_COLUMNS`
    fallbacks: Count
    fallback_longest: Count
    recover_steps_max: Count
    deadline_misses: Count
    longest_miss_streak: Count
    miss_recover_steps_max: Count
    computations: Count
    interrupted: Count
    latency_p50_ns: float
    latency_max_ns: float
    unconverged: Count
    clipped: Count
    limit_violations: Count
    matrix_steps: Count
    r_rms_m: float
    r_95_m: float
    r_max_m: float
    r_tail_max_m: float
    heading_rms_deg: float
    heading_max_deg: float
    iae_n: float
    iae_e: float
    iae_psi: float
    ise_n: float
    ise_e: float
    ise_psi: float
    itae_n: float
    itae_e: float
    itae_psi: float
    settle_s: float
    settle_0p1m_s: float
    overshoot_n: float
    overshoot_e: float
    overshoot_psi: float
    share_1m: float
    share_green: float
    share_yellow: float
    share_red: float
    pose_error: float
    effort_s: float
    total_variation: float
    work_J: float
    at_rate_surge: float
    at_rate_sway: float
    at_rate_yaw: float
    at_amplitude_surge: float
    at_amplitude_sway: float
    at_amplitude_yaw: float
    closed_loop_cost: float
    exact_cost: float
    dev_position_max_m: float
    dev_position_rms_m: float
    dev_heading_max_deg: float
    dev_heading_rms_deg: float
    dev_force_max_N: float
    dev_force_rms_N: float

    description: dict[str, Any] = field(repr=False)
    family: str = ""
    drawn_n: int = 0
    drawn_m: int = 0
    default_route: bool = False
    own_switches_a_step: float = np.nan

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> RunRecord:
        """The record of a row of `runs.parquet`."""
        columns: dict[str, Any] = {
            name: _READ[dtype](row[name]) for name, (dtype, _) in RUN_COLUMNS.items()
        }
        described = columns["cell"].startswith("{")
        description = json.loads(columns["cell"]) if described else {}
        source = description.get("source", {})
        if source.get("kind") != "random":
            return cls(**columns, description=description)
        recipe = source["recipe"]
        family, n, m = str(recipe["family"]), int(recipe["n"]), int(recipe["m"])
        return cls(**columns, description=description, family=family, drawn_n=n, drawn_m=m)

    @property
    def configuration(self) -> Configuration:
        """The configuration that ran."""
        return Configuration(
            self.solver, self.route, self.policy, self.settings, self.units, self.formulation
        )

    @property
    def problem(self) -> str:
        """The sequence of a replay, the scenario of a closed loop."""
        return self.sequence or self.scenario

    @property
    def horizons(self) -> Horizons | None:
        """N_p and N_c; None without a ship."""
        return None if np.isnan(self.N_c) else (int(self.N_p), int(self.N_c))

    @property
    def sequence_without_horizons(self) -> str:
        """`paper[0:300]` of the sequence `paper-60-10[0:300]`."""
        name, bracket, window = self.sequence.partition("[")
        horizons = "" if self.horizons is None else "-{}-{}".format(*self.horizons)
        return name.removesuffix(horizons) + bracket + window

    @property
    def scenario_files(self) -> dict[str, Any] | None:
        """The documents of its scenario; None where the row carries none."""
        files = self.description.get("scenario") or {}
        return files if "scenario" in files else None

    @property
    def is_baseline_law(self) -> bool:
        """Whether it is of the baseline law, which solves no QP and is never ranked."""
        return self.formulation == "none"

    @property
    def has_steps(self) -> bool:
        """Whether the run left rows."""
        return self.steps_done > 0

    @property
    def cause(self) -> str:
        """The cause of its outcome, in the library's or the harness's words; "" for none."""
        return self.outcome_detail.strip().rstrip(".")

    @property
    def remembers(self) -> bool:
        """Whether its times are those of remembered answers."""
        return is_remembered(self.first_visit_ratio, self.loop_ratio)

    @property
    def short_name(self) -> str:
        """The solver, with its route where not its default, its policy where not `fresh`."""
        return self._named([])

    @property
    def name(self) -> str:
        """As `short_name`, with settings, units and formulation where they are not the default."""
        words = [self._named([] if self.settings == "default" else [self.settings])]
        words += [] if self.units == "scaled" else [self.units]
        common = self.formulation in (COMMON, "none")
        words += [] if common else [self.formulation.replace("_", " ")]
        return ", ".join(words)

    def _named(self, settings: list[str]) -> str:
        words = [] if self.default_route else [str(self.route)]
        words += [] if self.policy == "fresh" else [str(self.policy)]
        words += settings
        return f"{self.solver} ({', '.join(words)})" if words else self.solver


def records_of(runs: pd.DataFrame) -> list[RunRecord]:
    """The records of a table of runs."""
    return [RunRecord.of({str(k): v for k, v in row.items()}) for row in runs.to_dict("records")]


def as_float(value: object) -> float:
    """A number out of a table; a missing one (None, pd.NA, NaN) is NaN."""
    try:
        return float(value)  # type: ignore[arg-type] # any cell of a table; what fails is missing
    except (TypeError, ValueError):
        return float(np.nan)


_READ: Mapping[str, Any] = {
    "str": str,
    "bool": bool,
    "int64": int,
    "Int64": as_float,
    "float64": float,
}
"""How a column of each type is read; a null of a nullable integer becomes NaN."""
