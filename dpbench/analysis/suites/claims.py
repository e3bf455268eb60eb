"""The paper's claims held against the rows: what decides each of them, and what it comes to.

Claims are those of section IV and Figures 4-7 of Xia, Liu, Pang & Xue, "Constrained model
predictive control design for dynamic positioning of a supply ship".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.suites.paper import CIRCLE_M, errors, paper_pair

State = Literal["reproduced", "not reproduced", "opposite", "not measured"]

STEADY_M = 0.05
"""A steady radial error below this counts as nearly stationary."""
SAME = 0.01
"""Errors closer than this share of the larger one are equal."""


@dataclass(frozen=True, eq=False)
class Finding:
    """What the rows say of a claim.

    Parameters
    ----------
    by : what decided it, a key of `HOLDS` or `SMALLER`; "no loop", "one law" or "short" where
        nothing could.
    values : what there is to say of it: `run`, the constrained law, `law`, the clipped one, and
        what those two do not hold.
    """

    by: str
    state: State
    values: dict[str, Any]


HOLDS: dict[str, Callable[[RunRecord], bool]] = {
    "circle": lambda run: run.r_tail_max_m <= CIRCLE_M,
    "stationary": lambda run: run.r_tail_max_m < STEADY_M,
    "rates": lambda run: max(run.at_rate_surge, run.at_rate_sway, run.at_rate_yaw) > 0.0,
    "violations": lambda run: run.limit_violations == 0,
}
"""What has to be so of the constrained law."""
SMALLER = {
    "transient": ("overshoot_e", 0.0),
    "settling": ("settle_0p1m_s", 0.0),
    "steady": ("r_tail_max_m", SAME),
    "heading": ("heading_max_deg", 0.0),
}
"""What the constrained law has to have smaller than the clipped one, by more than which share of
the larger."""


def judged(records: Records, scenario: str, by: str) -> Finding:
    """What is found in the paper's scenario of that name, where its laws ran to the end."""
    pair = paper_pair(records, scenario)
    laws = 1 if by in HOLDS else 2
    runs = [run for run in (pair.constrained, pair.clipped)[:laws] if run is not None]
    if len(runs) < laws:
        return Finding("no loop" if laws == 1 else "one law", "not measured", {})
    done = min(run.steps_done for run in runs)
    if done < pair.whole:
        return Finding("short", "not measured", {"done": done, "whole": pair.whole})
    values: dict[str, Any] = dict(zip(("run", "law"), runs, strict=False))
    if by == "circle":
        values["entered_s"] = entered_s(records, runs[0])
    if by == "steady":
        values["alike"] = _alike_at_rest(records, *runs)
    return Finding(by, _state(by, *runs), values)


def _state(by: str, run: RunRecord, law: RunRecord | None = None) -> State:
    """The opposite of a claim is where the clipped law has the smaller figure."""
    if law is None:
        return "reproduced" if HOLDS[by](run) else "not reproduced"
    column, margin = SMALLER[by]
    constrained, clipped = getattr(run, column), getattr(law, column)
    if constrained < (1.0 - margin) * clipped:
        return "reproduced"
    return "opposite" if clipped < (1.0 - margin) * constrained else "not reproduced"


def entered_s(records: Records, run: RunRecord) -> float:
    """From when on a run stays within the circle [s]: 0 where it always is, inf where it is outside
    at the end."""
    scenario, steps = records.scenario(run.scenario), records.steps(run)
    assert scenario is not None, "a run of the paper's own scenario"
    outside = np.flatnonzero(errors(steps, scenario.reference)["radial"] > CIRCLE_M)
    if not len(outside):
        return 0.0
    last = int(outside[-1])
    return np.inf if last == len(steps) - 1 else float(steps["t_s"].iloc[last + 1])


def _alike_at_rest(records: Records, run: RunRecord, law: RunRecord) -> bool:
    """Whether the steady errors are equal as no limit is active then."""
    two = run.r_tail_max_m, law.r_tail_max_m
    active = records.steps(run)["n_active"].to_numpy()
    return abs(two[0] - two[1]) <= SAME * max(two) and not active[len(active) // 2 :].any()
