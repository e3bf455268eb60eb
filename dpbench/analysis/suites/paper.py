"""The paper's case in the records: its two control laws, the data of its figures, its claims.

Claims are those of section IV and Figures 4-7 of Xia, Liu, Pang & Xue, "Constrained model
predictive control design for dynamic positioning of a supply ship".
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.arrays import Floats, Vector
from dpbench.bench.record.schema import AXIS_FORCES
from dpbench.scenario.problem_files import omit_prose
from dpbench.scenario.scenario import Scenario, load_scenario

PAPER = "paper"
OF_PAPER = (PAPER, "paper_tight")
"""Scenarios that restate the paper's case."""
CIRCLE_M = 1.0
"""Radius of the paper's precision circle."""


@dataclass(frozen=True)
class LawPair:
    """Runs of the paper's MPC law, and of its unconstrained law with clipped forces.

    whole : steps of the whole scenario; the loops are complete but may have been asked for fewer.
    """

    constrained: RunRecord | None
    clipped: RunRecord | None
    whole: int = 0


def find_mpc_and_clipped_runs(view: Records, scenario: str) -> LawPair:
    """Return a scenario's complete runs of MPC and clipped unconstrained law; None for missing."""
    planned, carried = view.count_steps_of_longest_loop(scenario), view.build_scenario(scenario)
    usual = {"mode": "closed_loop", "settings": "default", "units": "scaled"}
    full = view.select_runs(scenario=scenario, steps_planned=planned, **usual)
    loops = [row for row in full if row.has_steps and row.outcome == "finished"]
    solved = [row for row in loops if not row.is_baseline_law and row.policy == "fresh"]
    off_m = {row: np.nan_to_num(row.dev_position_max_m, nan=np.inf) for row in solved}
    best = min(solved, key=lambda row: (off_m[row], row.solver), default=None)
    clipped = next((row for row in loops if row.is_baseline_law), None)
    return LawPair(best, clipped, planned if carried is None else carried.steps)


@dataclass(frozen=True, eq=False)
class Law:
    """Closed loop under one control law: name of the law and table of steps."""

    label: str
    steps: pd.DataFrame


def read_laws_in_paper_scenario(view: Records) -> list[Law]:
    """Return the steps of MPC and of clipped unconstrained control in the paper's scenario."""
    pair = find_mpc_and_clipped_runs(view, PAPER)
    if pair.constrained is None:
        return []
    laws = [Law(f"constrained ({pair.constrained.solver})", view.read_step_table(pair.constrained))]
    if pair.clipped is not None:
        laws.append(Law("baseline law", view.read_step_table(pair.clipped)))
    return laws


def compute_pose_errors(steps: pd.DataFrame, reference: Vector) -> dict[str, Floats]:
    """Return north, east and radial [m] and heading [°] errors at each step of a loop, by name."""
    n = steps["n_m"].to_numpy() - reference[0]
    e = steps["e_m"].to_numpy() - reference[1]
    psi = np.degrees(steps["psi_rad"].to_numpy() - reference[2])
    return {"north": n, "east": e, "heading": psi, "radial": np.hypot(n, e)}


def tabulate_paper_figure(figure: str, law: Law, scenario: Scenario) -> pd.DataFrame:
    """Return a table of what one of the paper's figures shows, for one control law.

    Forces and increments have each axis, then its limits.

    figure : path, errors, forces or increments.
    """
    steps = law.steps
    columns: dict[str, Any] = {"law": law.label, "t_s": steps["t_s"]}
    if figure == "path":
        columns |= {name: steps[name] for name in ("n_m", "e_m")}
    elif figure == "errors":
        units = {"north": "m", "east": "m", "heading": "deg", "radial": "m"}
        by_name = compute_pose_errors(steps, scenario.reference)
        columns |= {f"{name}_{unit}": by_name[name] for name, unit in units.items()}
    else:
        vessel, most = scenario.vessel, scenario.force_step_max
        limits = {"forces": (vessel.tau_min, vessel.tau_max), "increments": (-most, most)}
        what, (low, high) = "tau" if figure == "forces" else "dtau", limits[figure]
        columns |= {f"{what}_{axis}": steps[f"{what}_{axis}"] for axis in AXIS_FORCES}
        for i, axis in enumerate(AXIS_FORCES):
            columns |= {f"{what}_min_{axis}": low[i], f"{what}_max_{axis}": high[i]}
    return pd.DataFrame(columns)


def is_paper_scenario(view: Records, name: str) -> bool:
    """Return whether a recorded scenario equals the paper's scenario in this package."""
    scenario = view.build_scenario(name) if name in OF_PAPER else None
    return scenario is not None and _serialise_scenario(scenario) == _serialise_packaged_scenario(
        name
    )


@cache
def _serialise_packaged_scenario(name: str) -> str:
    """Return the content of a scenario of the package, to compare a recorded one with."""
    return _serialise_scenario(load_scenario(name))


def _serialise_scenario(scenario: Scenario) -> str:
    """Return a scenario's documents as JSON, without descriptive text."""
    files = scenario.files
    documents = {"scenario": omit_prose(files["scenario"]), "vessel": omit_prose(files["vessel"])}
    return json.dumps(documents, sort_keys=True)


State = Literal["reproduced", "not reproduced", "contradicted", "not simulated"]

STEADY_M = 0.05
"""A steady radial error below this counts as nearly stationary."""
SAME = 0.01
"""Errors closer than this share of the larger one are equal."""


@dataclass(frozen=True, eq=False)
class ClaimFinding:
    """Evidence on one claim of the paper: criterion, whether reproduced, and measured values.

    by : a key of `HOLDS` or `SMALLER`; "no loop", "one law", "no clipped law" or "short" where
        nothing decides.
    values : `run`, the constrained law, `law`, the clipped one, and what those two do not hold.
    """

    by: str
    state: State
    values: dict[str, Any]


HOLDS: dict[str, Callable[[RunRecord], bool]] = {
    "circle": lambda run: run.r_tail_max_m <= CIRCLE_M,
    "stationary": lambda run: run.r_tail_max_m < STEADY_M,
    "rates": lambda run: max(run.at_rate_surge, run.at_rate_sway, run.at_rate_yaw) > 0.0,
    "violations": lambda run: run.clipped == run.limit_violations == 0,
}
"""Conditions on the constrained law."""
SMALLER = {
    "transient": ("overshoot_e", 0.0),
    "settling": ("settle_0p1m_s", 0.0),
    "steady": ("r_tail_max_m", SAME),
    "heading": ("heading_max_deg", 0.0),
}
"""Figures that the constrained law has smaller, by more than which share of the larger."""


def assess_paper_claim(records: Records, scenario: str, by: str) -> ClaimFinding:
    """Return the finding on a claim of the paper by runs of MPC and clipped unconstrained law."""
    is_own = is_paper_scenario(records, scenario)
    pair = find_mpc_and_clipped_runs(records, scenario) if is_own else LawPair(None, None)
    laws = 1 if by in HOLDS else 2
    runs = [run for run in (pair.constrained, pair.clipped)[:laws] if run is not None]
    if len(runs) < laws:
        missing = "one law" if pair.constrained is None else "no clipped law"
        return ClaimFinding("no loop" if laws == 1 else missing, "not simulated", {})
    done = min(run.steps_done for run in runs)
    if done < pair.whole:
        return ClaimFinding("short", "not simulated", {"done": done, "whole": pair.whole})
    values: dict[str, Any] = dict(zip(("run", "law"), runs, strict=False))
    if by == "circle":
        values["entered_s"], values["within_m"] = find_circle_entry(records, runs[0])
    if by == "steady":
        # Whether both end with equal errors, as no limit is active.
        two = [run.r_tail_max_m for run in runs]
        active = records.read_step_table(runs[0])["n_active"].to_numpy()
        is_free = not active[len(active) // 2 :].any()
        values["alike"] = abs(two[0] - two[1]) <= SAME * max(two) and is_free
    return ClaimFinding(by, _judge_claim(by, *runs), values)


def _judge_claim(by: str, run: RunRecord, law: RunRecord | None = None) -> State:
    """Return whether runs reproduce a claim of the paper, or show the opposite."""
    if law is None:
        return "reproduced" if HOLDS[by](run) else "not reproduced"
    column, margin = SMALLER[by]
    constrained, clipped = getattr(run, column), getattr(law, column)
    if constrained < (1.0 - margin) * clipped:
        return "reproduced"
    return "contradicted" if clipped < (1.0 - margin) * constrained else "not reproduced"


def find_circle_entry(records: Records, run: RunRecord) -> tuple[float, float]:
    """Return the time [s] from which the ship stays within 1 m, and its largest error then [m].

    The time is inf if the ship ends outside.
    """
    scenario, steps = records.build_scenario(run.scenario), records.read_step_table(run)
    assert scenario is not None, "a run of the paper's own scenario"
    radial = compute_pose_errors(steps, scenario.reference)["radial"]
    entered = int(np.flatnonzero(np.r_[True, radial > CIRCLE_M])[-1])
    if entered == len(radial):
        return np.inf, np.nan
    return float(steps["t_s"].iloc[entered]) if entered else 0.0, float(radial[entered:].max())
