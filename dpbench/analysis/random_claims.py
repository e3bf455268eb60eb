"""Count what solvers claimed of random problems and what the referee found, from rows alone.

Every certified step of a configuration counts once:

    steps = true and claimed + claimed, not true + true, not claimed + rightly or wrongly called
            infeasible + no answer
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.bench.judge.rules import (
    NO_ANSWER_CLAIMS,
    claimed_not_true,
    decided,
    true_not_claimed,
)
from dpbench.bench.record.configuration import Configuration, settings_level
from dpbench.qp.residuals import PLAN_TOL_FACTOR, TRUE_TOL

CONFIGURATION = ("solver", "route", "policy", "settings")


@dataclass(frozen=True)
class Tally:
    """What became of the steps of some cells.

    Parameters
    ----------
    steps : certified steps that were reached; unknown : reached, but without a certificate, or
    undecided at rounding; missed : asked for and never reached.
    told : claimed and true; lies : claimed and not true, at 1e-3, 1e-4 and 1e-6;
    silent : true and not claimed; empty_right, empty_wrong : called infeasible or unbounded,
    rightly and wrongly; nothing : neither a claim nor a true answer.
    off, outside, empty, dual : lies at 1e-3 by their cause: off the optimum, outside the limits,
    on a step without a feasible point, by multipliers alone.
    worst : largest error_plan of a lie at 1e-3; NaN where no lie has one.
    """

    steps: int
    unknown: int
    missed: int
    told: int
    lies: tuple[int, int, int]
    silent: int
    empty_right: int
    empty_wrong: int
    nothing: int
    off: int
    outside: int
    empty: int
    dual: int
    worst: float

    @property
    def wrong(self) -> int:
        """Untrue claims of either kind."""
        return self.lies[0] + self.empty_wrong


class RandomClaims:
    """The steps of all random sequences with what they count as.

    `runs` are those that were not refused, each once: settings without effect, one run shown
    under several names, stand as one run with all of them in `settings`.
    """

    def __init__(self, records: Records) -> None:
        self.runs = _once([run for run in records.random if run.outcome != "refused"])
        self._steps = _evaluated(records, self.runs)

    def of(self, runs: Sequence[RunRecord]) -> Tally:
        """The tally of some of the runs."""
        ids = {run.run_id for run in runs}
        return _tally(self._steps[self._steps["run_id"].isin(ids)], _missed(runs))

    def by(self, *names: str) -> dict[tuple[str, ...], Tally]:
        """Tallies by the values of some columns of the runs."""
        groups: dict[tuple[str, ...], list[RunRecord]] = {}
        for run in self.runs:
            groups.setdefault(tuple(str(getattr(run, name)) for name in names), []).append(run)
        parts = dict(list(self._steps.groupby([*names], sort=False))) if len(self._steps) else {}
        none = self._steps.iloc[:0]
        return {key: _tally(parts.get(key, none), _missed(runs)) for key, runs in groups.items()}

    def certificates(self) -> dict[str, dict[str, int]]:
        """How many different steps of each family have which certificate."""
        once = self._steps.drop_duplicates(["sequence", "k"])
        return {
            str(family): {str(kind): int(count) for kind, count in kinds.value_counts().items()}
            for family, kinds in once.groupby("family", sort=False)["certificate"]
        }


def _once(runs: Sequence[RunRecord]) -> list[RunRecord]:
    by_settings: dict[Configuration, dict[str, list[RunRecord]]] = {}
    for run in runs:
        levels = by_settings.setdefault(replace(run.configuration, settings=""), {})
        levels.setdefault(run.settings, []).append(run)
    kept: list[RunRecord] = []
    for levels in by_settings.values():
        names: dict[str, list[str]] = {}
        for settings, of_level in levels.items():
            # Times never repeat to the nanosecond, so equal ones are those of one run.
            figures = {run.sequence: (run.raw_max_ns, run.steps_done) for run in of_level}
            names.setdefault(repr(sorted(figures.items())), []).append(settings)
        for alike in names.values():
            shown = ", ".join(sorted(alike, key=settings_level))
            kept += [replace(run, settings=shown) for run in levels[alike[0]]]
    return kept


def _missed(runs: Sequence[RunRecord]) -> int:
    """Steps of a counting round that were never reached."""
    return sum(run.steps_planned - run.steps_done for run in runs)


def _evaluated(records: Records, runs: Sequence[RunRecord]) -> pd.DataFrame:
    names = (*CONFIGURATION, "family", "sequence")
    parts = [records.steps(run) for run in runs]
    steps = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
    if steps.empty:
        return pd.DataFrame(columns=["run_id", "k", "certificate", *names])
    counts = [len(part) for part in parts]
    for name in names:
        steps[name] = np.repeat([str(getattr(run, name)) for run in runs], counts)
    steps = steps[steps["counts"]].copy()
    known, none_said = decided(steps), steps["status"].isin(NO_ANSWER_CLAIMS)
    lie, feasible = claimed_not_true(steps), steps["error_plan"].notna()
    steps["known"], steps["lie"] = known, lie
    steps["told"] = known & steps["claimed"] & steps["true"]
    steps["lie_1e4"] = claimed_not_true(steps, "true_1e4")
    steps["lie_1e6"] = claimed_not_true(steps, "true_1e6")
    answered = known & ~steps["claimed"] & ~none_said
    steps["silent"] = true_not_claimed(steps)
    steps["nothing"] = answered & ~steps["true"]
    steps["empty_right"] = known & none_said & steps["true"]
    steps["empty_wrong"] = known & none_said & ~steps["true"]
    steps["empty"] = lie & ~feasible
    steps["off"] = lie & feasible & ~(steps["error_plan"] <= PLAN_TOL_FACTOR * TRUE_TOL)
    steps["outside"] = lie & feasible & ~steps["off"] & ~(steps["primal"] <= TRUE_TOL)
    steps["dual_alone"] = lie & feasible & ~steps["off"] & ~steps["outside"]
    return steps


def _tally(steps: pd.DataFrame, missed: int) -> Tally:
    if steps.empty:
        return Tally(0, 0, missed, 0, (0, 0, 0), *(0,) * 8, math.nan)

    def count(name: str) -> int:
        return int(steps[name].to_numpy(dtype=bool).sum())

    errors = steps.loc[steps["lie"].to_numpy(dtype=bool), "error_plan"].to_numpy(dtype=np.float64)
    errors = errors[~np.isnan(errors)]
    return Tally(
        steps=count("known"),
        unknown=len(steps) - count("known"),
        missed=missed,
        told=count("told"),
        lies=(count("lie"), count("lie_1e4"), count("lie_1e6")),
        silent=count("silent"),
        empty_right=count("empty_right"),
        empty_wrong=count("empty_wrong"),
        nothing=count("nothing"),
        off=count("off"),
        outside=count("outside"),
        empty=count("empty"),
        dual=count("dual_alone"),
        worst=float(errors.max()) if len(errors) else math.nan,
    )
