"""Studies: the cost of a configuration over many realisations, paired with a reference.

The sea moves every ship by metres, a solver by millimetres, so configurations are compared in the
same realisation. Points share their realisations, so a realisation, not a run, is the unit; points
that are all run once are the sample. docs/method.md has the formulas (*The interval of a study*).

A difference is conditional on the runs that both configurations finished. A run that its time limit
stopped, or that the benchmark lost, is not judged: it is in no share within the radius.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from dpbench.analysis.records.machine import separate_own_switches, sum_disturbances
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.statistics import (
    LEAST_SKEW_DF,
    TAILS,
    Interval,
    MeanEstimate,
    adjust_p_values_by_holm,
    bound_probability_after_no_event,
)
from dpbench.analysis.verdict.requirements import Requirements, is_right_on_every_step
from dpbench.analysis.verdict.verdict import find_solver_record_or_none
from dpbench.arrays import Floats
from dpbench.bench.record.disturbance import Disturbance
from dpbench.solvers.contract import TOLERANCES
from dpbench.solvers.settings import has_distinct_tolerance_presets, parse_tolerance_preset_name

SMALL_M = 0.01
"""Difference in the 95 % radial error that a tolerance may cost [m]."""
SMALL_COST = 0.01
"""Relative difference in the closed-loop cost that a tolerance may cost."""
NOTHING = 1e-6
"""A difference in the same realisation below a thousandth of a millimetre, or a millionth of the
cost, is none to a ship. No standard error is smaller: runs without any spread give no interval
without width."""
SINGLE_VARIANCE = 2.0
"""Variance of the single run of a point, over that of a run of the repeated points."""
LEAST_PAIRS = 6
"""Least number of pairs for which an interval is stated."""
ALPHA = 0.05
"""Family-wise error of the claims of a study, each kind of claim a family (Holm 1979)."""
NOT_JUDGED = ("timed_out", "lost", "invalid", "refused")
"""Outcomes that are no result of the solver: its time limit or the benchmark ended the run, or
nothing was run."""
EXACT_FIRST = ("paper_active_set", "daqp")
"""Solvers that are the reference of a study before all others: active sets, exact to rounding."""


@dataclass(frozen=True)
class PairedDifference:
    """Mean difference of an error or cost between two configurations in the same seas.

    estimate : the mean difference with its error; the error is NaN where none is supported.
    pairs : realisations that both finished; points : at how many points.
    spread : standard deviation of the mean of one realisation of every point.
    is_constant : whether it is the same in all pairs of a point, or at all points where each has
        one pair, within `NOTHING`.
    """

    estimate: MeanEstimate
    pairs: int
    points: int
    spread: float
    is_constant: bool

    @property
    def mean_interval(self) -> Interval:
        """Mean difference with its 95 % interval; infinitely wide if unsupported."""
        return self.estimate.confidence_interval

    @property
    def stated_numbers(self) -> tuple[float, float, float]:
        """Mean and interval ends as tables state them; NaN or infinite ends of no interval.

        A constant difference has no interval, whose width would be that of `NOTHING`, and is 0 if
        not above that.
        """
        mean = self.mean_interval
        if self.is_constant:
            return (0.0 if abs(mean.value) <= NOTHING else mean.value), math.nan, math.nan
        return mean.value, mean.low, mean.high

    def count_seas_needed_for(self, difference: float) -> int | None:
        """Return how many seas per point make half the interval no wider than a difference.

        The interval is Student's; None if its width is not known.
        """
        if math.isnan(self.spread):
            return None
        # The quantile falls with the count, so the first count that satisfies its own is it.
        for count in range(2, 100_000):
            reach = float(student.ppf(TAILS[1], count - 1)) * self.spread / math.sqrt(count)
            if reach <= difference:
                return count
        return None


def compute_paired_difference(one: pd.Series, other: pd.Series) -> PairedDifference:
    """Return the mean difference of two configurations over the seas that both finished.

    one, other : values indexed by (point, replicate).
    """
    both = pd.concat([one, other], axis=1, join="inner").dropna()
    if both.empty:
        return PairedDifference(MeanEstimate(np.nan), 0, 0, np.nan, is_constant=False)
    columns = [both.iloc[:, i].unstack().to_numpy(dtype=np.float64) for i in (0, 1)]
    difference = columns[0] - columns[1]
    estimate = estimate_mean_over_points(difference)
    known = np.isfinite(difference)
    are_single = (known.sum(axis=1) == 1).all()
    samples = difference[known][None, :] if are_single else difference
    extent = np.nanmax(samples, axis=1) - np.nanmin(samples, axis=1)
    return PairedDifference(
        estimate,
        len(both),
        len(difference),
        estimate.error * math.sqrt(len(both) / len(difference)),
        is_constant=bool((extent <= NOTHING).all()),
    )


def estimate_mean_over_points(values: Floats) -> MeanEstimate:
    """Return the mean over study points of their means over sea realisations, with error.

    values : (points, realisations), NaN where a run is lost; each point has one at least.
    """
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    mean = float(np.nanmean(values, axis=1).mean())
    if not (counts > 1).any():
        # The points are the sample: as one point with so many realisations.
        values, known = values[known][None, :], np.ones((1, len(counts)), dtype=bool)
        counts = np.array([len(counts)])
    points, repeated = len(counts), counts > 1
    if known.sum() < LEAST_PAIRS or repeated.sum() < points / 2:
        return MeanEstimate(mean)
    alone = SINGLE_VARIANCE * (points - repeated.sum())
    inflation = 1.0 + float(alone / (1.0 / counts[repeated]).sum())
    values, known, counts = values[repeated], known[repeated], counts[repeated]
    away = np.where(known, values - np.nanmean(values, axis=1, keepdims=True), 0.0)
    weights2 = 1.0 / (points**2 * counts * (counts - 1))
    together = np.sqrt(weights2) @ away
    # Covariance of `together` for independent runs of one variance.
    covariance = np.diag(weights2 @ known) - known.T @ ((weights2 / counts)[:, None] * known)
    df = float(np.trace(covariance) ** 2 / (covariance**2).sum())
    error = math.sqrt(inflation * float(together @ together))
    if error <= NOTHING or df < LEAST_SKEW_DF:
        return MeanEstimate(mean, max(error, NOTHING), df)
    third = float((together**3).sum()) / float(together @ together) ** 1.5
    return MeanEstimate(mean, error, df, math.sqrt(df * (df + 1.0)) / (df - 1.0) * third)


@dataclass(frozen=True, eq=False)
class StudiedConfiguration:
    """Results of a configuration in a study: share of runs in position, cost, error, p-values.

    runs, finished, stopped : how many it was given, came to their end, and met their time limit.
    within : share of judged runs that end, with a radial error within the radius in their second
        half; NaN without a judged run.
    cost : closed-loop cost over that of the exact loop in the same sea, less one: mean over judged
        runs.
    r_95_m : 95 % radial error, mean over judged runs [m].
    accurate : share of verified steps over all runs; NaN if no QP was solved.
    false_claims, steps : of so many steps, how many were reported as solved but not verified.
    error_move : largest error of the first move on any step, in maximum increments.
    is_accurate_enough : whether every run passes the accuracy requirements of the suite.
    error_excess_m, log_cost_excess : r_95_m and logarithm of the cost, less the reference's; None
        of the reference itself.
    p_differs : of a radial error that differs from the reference's by more than `NOTHING`;
    p_cheap : of costing less than `SMALL_M` and `SMALL_COST`; both Holm over the study.
    """

    name: str
    solver: str
    settings: str
    runs: int
    finished: int
    stopped: int
    within: float
    cost: float
    r_95_m: float
    accurate: float
    false_claims: int
    steps: int
    error_move: float
    is_accurate_enough: bool
    error_excess_m: PairedDifference | None
    log_cost_excess: PairedDifference | None
    p_differs: float = 1.0
    p_cheap: float = 1.0

    @property
    def share_within_radius(self) -> float:
        """Share of judged runs within the radius; 1 where none is judged, as nothing is lost."""
        return 1.0 if math.isnan(self.within) else self.within

    @property
    def differs_from_reference(self) -> bool:
        """True if the configuration's radial error differs significantly from the reference's."""
        return self.p_differs <= ALPHA

    @property
    def has_larger_error_than_reference(self) -> bool:
        """True if the configuration's radial error is significantly over the reference's."""
        excess = self.error_excess_m
        return excess is not None and self.differs_from_reference and excess.estimate.value > 0.0

    @property
    def tolerance(self) -> float | None:
        """Solver tolerance that a configuration's settings state; None if default or without."""
        return _find_tolerance(self.solver, self.settings)

    @property
    def adds_little_error_and_cost(self) -> bool:
        """True if the configuration adds significantly less than 1 cm error and 1 % cost."""
        if self.finished < self.runs:
            return False
        return self.error_excess_m is None or self.p_cheap <= ALPHA

    @property
    def unadjusted_p_values(self) -> tuple[float, float]:
        """P-values, uncorrected, of differing from the reference, and of adding little to it."""
        if self.error_excess_m is None or self.log_cost_excess is None:
            return 1.0, 1.0
        cheap = self.log_cost_excess.estimate.compute_p_value_of_mean_below(math.log1p(SMALL_COST))
        return (
            self.error_excess_m.estimate.compute_p_value_of_mean_beyond(NOTHING),
            max(self.error_excess_m.estimate.compute_p_value_of_mean_below(SMALL_M), cheap),
        )


class Study:
    """All runs of one study: solver configurations over parameter points and sea realisations.

    refused : runs that were not run; disturbance : of the others, where it is known.
    requirements : limits on accuracy of the suite.
    aliases : further names of a configuration's settings, with its own name.
    """

    def __init__(
        self,
        name: str,
        runs: Sequence[RunRecord],
        radius_m: float,
        disturbance: Disturbance | None = None,
        aliases: Mapping[str, str] | None = None,
        requirements: Requirements | None = None,
    ) -> None:
        self.name, self.radius_m, self.disturbance = name, radius_m, disturbance
        self.requirements = requirements or Requirements()
        self.refused = [run for run in runs if run.outcome == "refused"]
        names = {run.solver_label for run in runs}
        self.aliases = {alias: own for alias, own in (aliases or {}).items() if own in names}
        rows = [
            {
                "run_id": run.run_id,
                "campaign": run.campaign_utc,
                "configuration": run.solver_label,
                "solver": run.solver,
                "settings": run.settings,
                "point": int(run.study_point),
                "replicate": int(run.replicate),
                "finished": run.outcome == "finished",
                "stopped": run.outcome == "timed_out",
                "within": _flag_end_within_radius(run, radius_m),
                "r_95_m": run.r_95_m,
                "r_max_m": run.r_max_m,
                "r_tail_max_m": run.r_tail_max_m,
                "failed_steps": run.failed_steps,
                "steps_done": run.steps_done,
                "true_share": run.true_share,
                "claimed_not_true": run.claimed_not_true,
                "error_move_max": run.error_move_max,
                "passes_accuracy": is_right_on_every_step(run, self.requirements),
                "raw_p50_ns": run.raw_p50_ns,
                "raw_p99_ns": run.raw_p99_ns,
                "cost": run.closed_loop_cost,
                "log_cost": np.log(run.closed_loop_cost),
                "over_exact": run.closed_loop_cost / run.exact_cost - 1.0,
                "baseline_law": run.is_baseline_law,
                "exact_leaves": run.exact_steps > 0.0 and not math.isnan(run.exact_left_s),
            }
            for run in runs
        ]
        self.runs = pd.DataFrame(rows)
        """A row a run: run_id, configuration, point, replicate, whether it ended, whether it was
        within the radius (1 or 0, NaN where it is not judged), its errors and step times."""
        points = {
            int(run.study_point): {key: _make_level(value) for key, value in run.x.items()}
            for run in runs
        }
        self.points = pd.DataFrame.from_dict(points, orient="index").sort_index()
        """The values of the keys (columns) at each point (index), arrays as text."""

    @property
    def seas_per_point(self) -> int:
        """Number of sea realisations in which each parameter point was run."""
        return int(self.runs["replicate"].nunique())

    @property
    def is_disturbed(self) -> bool:
        """True if other work disturbed the machine while the runs were timed."""
        return self.disturbance is not None and bool(self.disturbance.complaints())

    @property
    def has_alternating_points(self) -> bool:
        """True if one command ran each realisation of all points before the next realisation."""
        seas = self.runs.loc[self.runs["finished"], ["replicate", "campaign"]]
        commands = seas.groupby("replicate")["campaign"].nunique()
        in_order = seas["replicate"].is_monotonic_increasing
        return len(commands) > 1 and in_order and commands.max() == 1

    @property
    def sample_count(self) -> int:
        """Number of independent samples: sea realisations, or points if each is run once."""
        return self.seas_per_point if self.seas_per_point > 1 else len(self.points)

    @property
    def bound_of_none_percent(self) -> int:
        """95 % upper bound, rounded up [%], of a share that no sample is in.

        100 less it is the lower bound, rounded down, of a share that every sample is in.
        """
        # Rounding errors of 3/n do not add a percent.
        return math.ceil(round(100.0 * bound_probability_after_no_event(self.sample_count), 9))

    @property
    def step_time_column(self) -> str:
        """Column of the step time: the p99 where every run that solves QPs to its end has one.

        On a disturbed machine the median, as other load changes a p99 most.
        """
        solved = self.runs[self.runs["finished"] & ~self.runs["baseline_law"]]
        has_p99 = solved["raw_p99_ns"].notna().all() and not self.is_disturbed
        return "raw_p99_ns" if has_p99 else "raw_p50_ns"

    @cached_property
    def reference_name(self) -> str:
        """Name of the most exact configuration by its settings, of those that finished most runs.

        All others are compared with it. No error or cost decides: those are compared.
        """
        solving = self.runs[~self.runs["baseline_law"]]
        pool = solving if len(solving) else self.runs
        finished = pool.groupby("configuration", sort=False)["finished"].sum()
        most = finished[finished == finished.max()].index
        candidates = pool[pool["configuration"].isin(most)].drop_duplicates("configuration")
        ranked = candidates[["solver", "settings", "configuration"]].itertuples(index=False)
        return min((*_make_exactness_sort_key(row[0], row[1]), str(row[2])) for row in ranked)[-1]

    @cached_property
    def results_by_cost(self) -> list[StudiedConfiguration]:
        """Results of every configuration, the reference first, then by increasing cost change."""
        known = [
            self._summarise_configuration(str(name)) for name in self.runs["configuration"].unique()
        ]
        known.sort(
            key=lambda c: (c.name != self.reference_name, np.nan_to_num(abs(c.cost), nan=np.inf))
        )
        reference, *others = known
        adjusted = [
            adjust_p_values_by_holm(np.array(p))
            for p in zip(*(c.unadjusted_p_values for c in others), strict=True)
        ]
        return [reference] + [
            replace(one, p_differs=float(differs), p_cheap=float(cheap))
            for one, differs, cheap in zip(others, *adjusted, strict=True)
        ]

    def get_result_series(self, configuration: str, column: str) -> pd.Series:
        """Return one result of a configuration's finished runs, as a series by point and sea."""
        chosen = (self.runs["configuration"] == configuration) & self.runs["finished"]
        return self.runs[chosen].set_index(["point", "replicate"])[column]

    @cached_property
    def points_left_out(self) -> list[int]:
        """Points at which the exact loop leaves its station in a sea; none where all points do.

        There any deviation grows without bound, so they are in no difference to the reference.
        """
        leaves = self.runs.groupby("point")["exact_leaves"].any()
        return [] if leaves.all() else [int(point) for point in leaves.index[leaves]]

    def get_compared_series(self, configuration: str, column: str) -> pd.Series:
        """Return a result of a configuration without the points that are left out."""
        series = self.get_result_series(configuration, column)
        points = series.index.get_level_values("point")
        return series[~points.isin(self.points_left_out)]

    def compute_difference_from_reference(
        self, configuration: str, column: str
    ) -> PairedDifference:
        """Return a configuration's mean difference from the reference in the same seas."""
        return compute_paired_difference(
            *(self.get_compared_series(c, column) for c in (configuration, self.reference_name))
        )

    def _summarise_configuration(self, name: str) -> StudiedConfiguration:
        """Return the summary of a configuration's runs, and its differences to the reference's."""
        runs = self.runs[self.runs["configuration"] == name]
        judged, itself = runs[runs["within"].notna()], name == self.reference_name
        solved = runs[runs["true_share"].notna()]
        steps = solved["steps_done"].sum()
        return StudiedConfiguration(
            name=name,
            solver=str(runs["solver"].iloc[0]),
            settings=str(runs["settings"].iloc[0]),
            runs=len(runs),
            finished=int(runs["finished"].sum()),
            stopped=int(runs["stopped"].sum()),
            within=float(judged["within"].mean()),
            cost=float(judged["over_exact"].mean()),
            r_95_m=float(judged["r_95_m"].mean()),
            accurate=float((solved["true_share"] * solved["steps_done"]).sum() / steps)
            if steps
            else math.nan,
            false_claims=int(solved["claimed_not_true"].sum()),
            steps=int(steps),
            error_move=float(solved["error_move_max"].max()),
            is_accurate_enough=bool(runs["passes_accuracy"].all()),
            error_excess_m=None
            if itself
            else self.compute_difference_from_reference(name, "r_95_m"),
            log_cost_excess=None
            if itself
            else self.compute_difference_from_reference(name, "log_cost"),
        )

    @cached_property
    def loosest_cheap_by_solver(self) -> dict[str, StudiedConfiguration | None]:
        """Loosest tolerance of each solver that ran with little added error or cost, or None."""
        ran = [c for c in self.results_by_cost if c.finished]
        stated = [(c.tolerance, c) for c in ran if c.tolerance is not None]
        loosest: dict[str, StudiedConfiguration | None] = {}
        for solver, of_solver in group_by_key(stated, lambda one: one[1].solver).items():
            cheap = [one for one in of_solver if one[1].adds_little_error_and_cost]
            loosest[solver] = max(cheap, key=itemgetter(0))[1] if cheap else None
        return loosest


def _flag_end_within_radius(run: RunRecord, radius_m: float) -> float:
    """Return 1 where a run's second half stays within the radius, else 0; NaN: not judged."""
    if run.outcome in NOT_JUDGED:
        return math.nan
    return float(run.outcome == "finished" and run.r_tail_max_m <= radius_m)


def _make_level(value: Any) -> Any:
    """Return a key's value as a level of a factor: an array as its text, which can be compared."""
    return json.dumps(value) if isinstance(value, list) else value


def find_studies(records: Records) -> list[Study]:
    """Return all studies of a result folder: solvers over many parameter points and seas."""
    radii = {
        table.get("name") or table["base"]: table.get("radius_m", 1.0)
        for table in records.suite.get("study", [])
    }
    studies, requirements = [], Requirements.from_suite(records.suite)
    for name, runs in group_by_key(records.study, lambda run: run.study).items():
        timed = separate_own_switches([run for run in runs if run.has_steps])
        disturbance = sum_disturbances(timed)
        radius_m = float(radii.get(name, 1.0))
        aliases = records.study_aliases
        studies.append(Study(name, runs, radius_m, disturbance, aliases, requirements))
    return studies


def _find_tolerance(solver: str, settings: str) -> float | None:
    """Return the tolerance that a solver's settings state; None if default or without one."""
    if find_solver_record_or_none(solver) is None or not has_distinct_tolerance_presets(solver):
        return None
    return TOLERANCES.get(settings) or parse_tolerance_preset_name(settings)


def _make_exactness_sort_key(solver: str, settings: str) -> tuple[int, float]:
    """Return a sort key of a solver's settings, the most exact first.

    `EXACT_FIRST`, solvers without a tolerance, the tightest tolerance, then unknown ones.
    """
    tolerance = _find_tolerance(solver, settings)
    if solver in EXACT_FIRST:
        return 0, EXACT_FIRST.index(solver) + (tolerance or 0.0)
    if find_solver_record_or_none(solver) is not None and not has_distinct_tolerance_presets(
        solver
    ):
        return 1, 0.0
    return (3, 0.0) if tolerance is None else (2, tolerance)
