"""Studies: what a configuration costs over many seas, paired with another in the same sea.

The sea moves every ship by metres, a solver by millimetres: of two configurations only the
difference *in the same sea* says anything. With d_pr the difference at point p in replicate r,

    d̄ = mean over points of mean over replicates,    s² = Σ_p s_p² / (P² R_p),    d̄ ± t s

s_p being the standard deviation over the R_p replicates of a point and t Student's quantile, its
degrees of freedom after Satterthwaite (1946): the points are chosen, the seas are drawn. Points
without replicates are themselves the sample.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.stats import t as student

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.statistics import TAILS, Interval
from dpbench.analysis.verdict.fastest import known_record
from dpbench.solvers.record import TOLERANCES
from dpbench.solvers.settings import settings_matter, tolerance_of

SMALL_M = 0.01
"""A difference of 1 cm in the 95 % radial error is what a tolerance may cost."""
SMALL_COST = 0.01
"""So is 1 % of the closed-loop cost."""
NOTHING_M = 1e-6
"""A difference in the same sea below a thousandth of a millimetre is none to a ship."""
LEAST_PAIRS = 4
"""With fewer pairs no interval is stated."""


@dataclass(frozen=True)
class PairedDifference:
    """How much more one configuration has of something than another in the same seas.

    Parameters
    ----------
    mean : with its 95 % interval; infinitely wide for too few pairs.
    pairs : seas in which both came to their end; points : at how many points.
    spread : standard deviation of the mean of one replicate of every point.
    unpaired : by what factor the interval were wider if seas were not paired; NaN if unknown.
    """

    mean: Interval
    pairs: int
    points: int
    spread: float
    unpaired: float

    @property
    def shown(self) -> bool:
        """Whether there is a difference: the interval does not hold 0."""
        return not self.mean.spans(0.0)

    def replicates_for(self, difference: float) -> int | None:
        """Replicates of each point after which a difference of this size would be told from none;
        None where the spread is not known."""
        if math.isnan(self.spread):
            return None
        # The quantile falls with the count, so the first count that satisfies its own is it.
        for count in range(2, 100_000):
            freedom = self.points * (count - 1)
            if float(student.ppf(TAILS[1], freedom)) * self.spread / math.sqrt(count) <= difference:
                return count
        return None


def paired_difference(one: pd.Series, other: pd.Series) -> PairedDifference:
    """one − other over the seas that both have.

    Parameters
    ----------
    one, other : values indexed by (point, replicate).
    """
    both = pd.concat([one, other], axis=1, join="inner").dropna()
    difference = both.iloc[:, 0] - both.iloc[:, 1]
    by_point = difference.groupby(level=0)
    counts, means = by_point.count(), by_point.mean()
    points, pairs = len(counts), len(difference)
    if pairs == 0:
        nothing = Interval(np.nan, -np.inf, np.inf)
        return PairedDifference(nothing, 0, 0, np.nan, np.nan)
    mean = float(means.mean())
    error, freedom = _standard_error(difference)
    if pairs < LEAST_PAIRS or freedom < 1:
        return PairedDifference(Interval(mean, -np.inf, np.inf), pairs, points, np.nan, np.nan)
    reach = float(student.ppf(TAILS[1], freedom)) * error
    alone = math.hypot(*(_standard_error(both.iloc[:, i])[0] for i in (0, 1)))
    return PairedDifference(
        Interval(mean, mean - reach, mean + reach),
        pairs,
        points,
        error * math.sqrt(float(counts.mean())),
        alone / error if error > 0 else np.inf,
    )


def _standard_error(values: pd.Series) -> tuple[float, float]:
    """Of the mean over points of the means over replicates, with its degrees of freedom."""
    by_point = values.groupby(level=0)
    counts, variances = by_point.count(), by_point.var()
    repeated = counts > 1
    if not repeated.any():
        count = len(values)
        return (float(values.std()) / math.sqrt(count), count - 1) if count > 1 else (np.nan, 0)
    # A point that lost all but one of its seas is as uncertain as the others.
    variances = variances.where(repeated, variances[repeated].mean())
    parts = variances / counts
    total = float(parts.sum())
    squares = float((parts[repeated] ** 2 / (counts[repeated] - 1)).sum())
    freedom = total**2 / squares if squares > 0 else float((counts[repeated] - 1).sum())
    return math.sqrt(total) / len(counts), freedom


@dataclass(frozen=True, eq=False)
class StudiedConfiguration:
    """One configuration in a study.

    Parameters
    ----------
    name, solver, settings : as everywhere.
    runs, finished : how many it was given, and how many came to their end.
    held : share of runs whose radial error stays within the radius in their second half; a run
        that did not end is not held.
    cost : closed-loop cost over that of the exactly solved loop in the same sea, less one: mean
        over runs.
    r_95_m : 95 % radial error, mean over runs [m].
    behind, dearer : against the reference, of the 95 % radial error [m] and of the logarithm of the
        closed-loop cost; None of the reference itself.
    """

    name: str
    solver: str
    settings: str
    runs: int
    finished: int
    held: float
    cost: float
    r_95_m: float
    behind: PairedDifference | None
    dearer: PairedDifference | None

    @property
    def tolerance(self) -> float | None:
        """The tolerance of its settings; None of a library's own choice, with none to set, or of a
        solver that this installation does not know."""
        if known_record(self.solver) is None or not settings_matter(self.solver):
            return None
        return TOLERANCES.get(self.settings) or tolerance_of(self.settings)

    @property
    def is_cheap(self) -> bool:
        """Whether it is shown to cost less than 1 cm and less than 1 % of the cost."""
        if self.finished < self.runs:
            return False
        if self.behind is None or self.dearer is None:
            return True
        return self.behind.mean.high < SMALL_M and self.dearer.mean.high < math.log1p(SMALL_COST)


class Study:
    """The runs of one study.

    Parameters
    ----------
    radius_m : within which a run is held.
    """

    def __init__(self, name: str, runs: Sequence[RunRecord], radius_m: float) -> None:
        self.name, self.radius_m = name, radius_m
        rows = [
            {
                "run_id": run.run_id,
                "configuration": run.name,
                "solver": run.solver,
                "settings": run.settings,
                "point": int(run.study_point),
                "replicate": int(run.replicate),
                "finished": run.outcome == "finished",
                "held": run.outcome == "finished" and run.r_tail_max_m <= radius_m,
                "r_95_m": run.r_95_m,
                "r_tail_max_m": run.r_tail_max_m,
                "cost": run.closed_loop_cost,
                "over_exact": run.closed_loop_cost / run.exact_cost - 1.0,
                "baseline_law": run.is_baseline_law,
            }
            for run in runs
        ]
        self.runs = pd.DataFrame(rows)
        """A row a run: run_id, configuration, point, replicate, whether it ended and held, its
        errors."""
        points = {int(run.study_point): dict(run.x) for run in runs}
        self.points = pd.DataFrame.from_dict(points, orient="index").sort_index()
        """The values of the keys (columns) at each point (index)."""

    @property
    def replicates(self) -> int:
        """How many seas each point was run in."""
        return int(self.runs["replicate"].nunique())

    @cached_property
    def reference(self) -> str:
        """Whom the others are set beside: nearest to the exactly solved loop, all of it run."""
        solving = self.runs[~self.runs["baseline_law"]]
        pool = solving if len(solving) else self.runs
        by_name = pool.groupby("configuration", sort=False)
        ended, away = by_name["finished"].mean(), by_name["over_exact"].apply(_size)
        order = pd.DataFrame({"ended": -ended, "away": away}).sort_values(["ended", "away"])
        return str(order.index[0])

    @cached_property
    def configurations(self) -> list[StudiedConfiguration]:
        """Every configuration against the reference, which is the first; then the nearest first."""
        known = [self._of(str(name)) for name in self.runs["configuration"].unique()]
        return sorted(known, key=lambda c: (c.name != self.reference, _nan_last(abs(c.cost))))

    def values(self, configuration: str, column: str) -> pd.Series:
        """A column of a configuration's finished runs, by (point, replicate)."""
        chosen = (self.runs["configuration"] == configuration) & self.runs["finished"]
        return self.runs[chosen].set_index(["point", "replicate"])[column]

    def difference(self, configuration: str, column: str) -> PairedDifference:
        """A column of a configuration less that of the reference, in the same seas."""
        return paired_difference(
            self.values(configuration, column), self.values(self.reference, column)
        )

    def _of(self, name: str) -> StudiedConfiguration:
        runs = self.runs[self.runs["configuration"] == name]
        itself = name == self.reference
        log_cost = [np.log(self.values(c, "cost")) for c in (name, self.reference)]
        return StudiedConfiguration(
            name=name,
            solver=str(runs["solver"].iloc[0]),
            settings=str(runs["settings"].iloc[0]),
            runs=len(runs),
            finished=int(runs["finished"].sum()),
            held=float(runs["held"].mean()),
            cost=float(runs["over_exact"].mean()),
            r_95_m=float(runs["r_95_m"].mean()),
            behind=None if itself else self.difference(name, "r_95_m"),
            dearer=None if itself else paired_difference(*log_cost),
        )

    @cached_property
    def loosest(self) -> dict[str, StudiedConfiguration | None]:
        """Of each solver that was run at stated tolerances, the loosest that is cheap; None where
        none is shown to be."""
        stated = [c for c in self.configurations if c.tolerance is not None]
        solvers = dict.fromkeys(c.solver for c in stated)
        cheap = {
            solver: [c for c in stated if c.solver == solver and c.is_cheap] for solver in solvers
        }
        return {
            solver: max(of, key=lambda c: c.tolerance or 0.0) if of else None
            for solver, of in cheap.items()
        }

    def held_map(self, configuration: str) -> pd.DataFrame:
        """Share of seas held at each point: the keys' values, `runs`, `held` (a share)."""
        runs = self.runs[self.runs["configuration"] == configuration]
        held = runs.groupby("point")["held"].agg(runs="count", held="mean")
        return self.points.join(held, how="inner")


def studies(records: Records) -> list[Study]:
    """All studies of a result folder."""
    tables = {table.get("name") or table["base"]: table for table in records.suite.get("study", [])}
    by_name: dict[str, list[RunRecord]] = {}
    for run in records.study:
        by_name.setdefault(run.study, []).append(run)
    return [
        Study(name, runs, float(tables.get(name, {}).get("radius_m", 1.0)))
        for name, runs in by_name.items()
    ]


def _size(values: pd.Series) -> float:
    """Mean size of what is known; infinite where nothing is."""
    known = values.abs().dropna()
    return float(known.mean()) if len(known) else np.inf


def _nan_last(value: float) -> float:
    return np.inf if math.isnan(value) else value
