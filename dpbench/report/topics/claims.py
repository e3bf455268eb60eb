"""The paper, reproduced: each of its claims, what the rows say, and whether the two agree.

Claims are those of section IV and Figures 4-7 of Xia, Liu, Pang & Xue, "Constrained model
predictive control design for dynamic positioning of a supply ship".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.suites.paper import OF_PAPER, Pair, is_of_paper, paper_pair
from dpbench.display import numbers_text
from dpbench.report.charts.ship import CIRCLE_M, errors
from dpbench.report.formats import count_text, plural, seconds_text, share_text, significant

State = Literal["reproduced", "not reproduced", "opposite", "not measured"]

STEADY_M = 0.05
"""A steady radial error below this counts as nearly stationary."""
SAME = 0.01
"""Errors closer than this share of the larger one are equal."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, what was found, and whether it is reproduced."""

    claim: str
    found: str
    state: State


def claims(view: Records) -> list[Claim]:
    """All claims, in the order of the paper; those on heading and settling are read off Fig. 5."""
    paper, tight = (paper_pair(view, name) for name in OF_PAPER)
    circle, steady = partial(_circle, view), partial(_steady, view)
    said: tuple[tuple[Pair, str, Callable[..., Finding], int], ...] = (
        (paper, "The ship is held within the 1 m precision circle (Fig. 4)", circle, 1),
        (paper, "It is nearly stationary there (steady error below 5 cm)", _stationary, 1),
        (paper, "The constrained law is smoother in the transient: less overshoot", _transient, 2),
        (paper, "It settles earlier (Fig. 5)", _settling, 2),
        (paper, "Its steady error is smaller (tuning of `paper`)", steady, 2),
        (tight, "Its steady error is smaller (`paper_tight`, R × 0.7)", steady, 2),
        (paper, "Its precision is better in heading too (Fig. 5)", _heading, 2),
        (paper, "The rate limits shape the transfer (Fig. 7)", _rates, 1),
        (paper, "No limit is ever violated (Figs 6, 7)", _violations, 1),
    )
    return [Claim(claim, *_found(pair, find, laws)) for pair, claim, find, laws in said]


Finding = tuple[str, State]


def _found(pair: Pair, find: Callable[..., Finding], laws: int) -> Finding:
    """What is found of the constrained law, or of both, where they ran to the end."""
    runs = [run for run in (pair.constrained, pair.clipped)[:laws] if run is not None]
    if len(runs) < laws:
        both = "one of the two laws has no complete closed loop"
        return both if laws == 2 else "no complete closed loop of this scenario", "not measured"
    done = min(run.steps_done for run in runs)
    if done < pair.whole:
        return f"{count_text(done)} of {plural(pair.whole, 'step')}", "not measured"
    return find(*runs)


def _state(holds: bool) -> State:
    return "reproduced" if holds else "not reproduced"


def _less(constrained: float, clipped: float, margin: float = 0.0) -> State:
    """Whether the constrained law has the smaller figure, by more than a share of the larger; the
    opposite where the clipped one has."""
    if constrained < (1.0 - margin) * clipped:
        return "reproduced"
    return "opposite" if clipped < (1.0 - margin) * constrained else "not reproduced"


def _circle(view: Records, row: RunRecord) -> Finding:
    text = f"{_entering(view, row)} ({share_text(row.share_1m)} of the run inside)"
    return text, _state(row.r_tail_max_m <= CIRCLE_M)


def _entering(view: Records, row: RunRecord) -> str:
    """From when on a run stays within the circle."""
    scenario, steps = view.scenario(row.scenario), view.steps(row)
    if scenario is None:
        return f"{CIRCLE_M:g} m"
    outside = np.flatnonzero(errors(steps, scenario.reference)["radial"] > CIRCLE_M)
    if not len(outside):
        return f"within {CIRCLE_M:g} m from the start"
    if outside[-1] == len(steps) - 1:
        return f"outside {CIRCLE_M:g} m at the end"
    entered_s = float(steps["t_s"].iloc[outside[-1] + 1])
    return f"enters {CIRCLE_M:g} m at {significant(entered_s)} s and stays"


def _stationary(row: RunRecord) -> Finding:
    tail = row.r_tail_max_m
    text = f"largest radial error in the second half {significant(100 * tail)} cm"
    return text, _state(tail < STEADY_M)


def _transient(row: RunRecord, law: RunRecord) -> Finding:
    constrained, clipped = row.overshoot_e, law.overshoot_e
    text = (
        f"sway overshoot {significant(constrained)} m against {significant(clipped)} m clipped; "
        f"total variation of the forces {significant(row.total_variation)} against "
        f"{significant(law.total_variation)} times their limits"
    )
    return text, _less(constrained, clipped)


def _settling(row: RunRecord, law: RunRecord) -> Finding:
    constrained, clipped = row.settle_0p1m_s, law.settle_0p1m_s
    text = "never settles into 0.1 m,"
    if math.isfinite(constrained):
        text = f"settles into 0.1 m after {seconds_text(constrained)}"
    return f"{text} against {seconds_text(clipped)} clipped", _less(constrained, clipped)


def _steady(view: Records, row: RunRecord, law: RunRecord) -> Finding:
    constrained, clipped = row.r_tail_max_m, law.r_tail_max_m
    text = (
        f"largest radial error in the second half {significant(100 * constrained)} cm against "
        f"{significant(100 * clipped)} cm clipped"
    )
    active = view.steps(row)["n_active"].to_numpy()
    if (
        abs(constrained - clipped) <= SAME * max(constrained, clipped)
        and not active[len(active) // 2 :].any()
    ):
        text += ", equal within 1 %: no limit is active then"
    if math.isinf(law.settle_0p1m_s):
        text += "; the clipped law never settles into 0.1 m"
    return text, _less(constrained, clipped, SAME)


def _heading(row: RunRecord, law: RunRecord) -> Finding:
    constrained, clipped = row.heading_max_deg, law.heading_max_deg
    text = (
        f"largest heading error {significant(constrained)}° against {significant(clipped)}° clipped"
    )
    return text, _less(constrained, clipped)


def _rates(row: RunRecord) -> Finding:
    shares = {axis: getattr(row, f"at_rate_{axis}") for axis in ("surge", "sway", "yaw")}
    text = ", ".join(f"{axis} {share_text(share)}" for axis, share in shares.items())
    steps = plural(row.steps_done, "step")
    return f"share of the {steps} at a rate limit: {text}", _state(max(shares.values()) > 0.0)


def _violations(row: RunRecord) -> Finding:
    count = row.limit_violations
    steps = plural(row.steps_done, "step")
    return f"{plural(count, 'applied force')} outside a limit in {steps}", _state(count == 0)


def choices(view: Records) -> list[tuple[str, str]]:
    """What the paper leaves open and what the scenario `paper` of these rows chose."""
    scenario = view.scenario("paper")
    if scenario is None or not is_of_paper(view, "paper"):
        return []
    sea = scenario.files["scenario"]["environment"]
    vessel = scenario.vessel
    return [
        ("M and D", f"{vessel.title} (`{vessel.id}`; {vessel.source.rstrip('.')})"),
        ("Q", f"diag({numbers_text(scenario.Q.diagonal())}) in 1/m², 1/m², 1/rad²"),
        ("R", f"diag({numbers_text(scenario.R.diagonal())}) in 1/N², 1/N², 1/(N·m)²"),
        ("disturbance, mean", f"{numbers_text(sea['mean_kN'])} (kN, kN, kN·m; north, east, yaw)"),
        ("disturbance, amplitude", f"{numbers_text(sea['amplitude_kN'])} (kN, kN, kN·m)"),
        ("disturbance, period", f"{numbers_text(sea['period_s'])} s"),
        ("duration", f"{significant(scenario.steps * scenario.sample_s)} s"),
        (
            "baseline",
            "the unconstrained optimum of eq. 27, clipped to the rate limits, then to the "
            "amplitude limits",
        ),
        ("estimator", "none: the state is known without noise"),
    ]
