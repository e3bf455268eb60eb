"""Measure how often stated intervals hold a known truth, and how often `dpbench compare` is right.

    python benchmarks/coverage.py [--quick]

Draws data with a known truth, hands them to the functions that make every interval of a report, and
counts. Prints a table and writes it between the markers of docs/method.md; --quick draws little,
checks the script alone and writes nothing. Exit 1 where an interval that is stated in at least a
tenth of the draws holds the truth in less than 93 % or more than 99 % of them, beyond the Monte
Carlo error.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import log_ndtr, ndtri

from dpbench.analysis.compare.pairs import Pair
from dpbench.analysis.compare.times import compare_times_and_shared_factors, compute_log_time_ratios
from dpbench.analysis.statistics import (
    Interval,
    bound_probability_after_no_event,
    estimate_paired_time_ratio,
    estimate_percentile_interval,
    estimate_pooled_ratio,
)
from dpbench.analysis.suites.study import Study, compute_paired_difference
from dpbench.analysis.suites.study_effects import STEP_TIME, compute_study_effects
from dpbench.bench.record.disturbance import Disturbance

METHOD = Path(__file__).parents[1] / "docs" / "method.md"
MARKERS = ("<!-- coverage -->", "<!-- /coverage -->")
ALLOWED = (0.93, 0.99)
"""Bounds of the share of intervals that hold the truth."""
DRAWS, TABLES = 2000, 300
"""Draws of each interval, and tables of each comparison."""
QUICK_DRAWS, QUICK_TABLES = 40, 3

Floats = NDArray[np.float64]
Random = np.random.Generator
Draw = Callable[[Random], tuple[float, Interval]]
"""A truth, and an interval that should hold it; an infinite one is not stated."""


@dataclass(frozen=True)
class Row:
    """One row of the table: how many intervals were stated, and the share that hold the truth."""

    interval: str
    truth: str
    draws: int
    stated: int
    held: float
    is_coverage: bool = True

    @property
    def error(self) -> float:
        """Monte Carlo error of the share, of one standard deviation; none counts as half a draw."""
        least = 0.5 / max(1, self.stated)
        held = min(max(self.held, least), 1.0 - least)
        return math.sqrt(held * (1.0 - held) / max(1, self.stated))

    @property
    def is_allowed(self) -> bool:
        """True where the share lies within `ALLOWED`, as far as the draws can tell."""
        reach, rare = 2.0 * self.error, self.stated < 0.1 * self.draws
        low, high = ALLOWED
        return not self.is_coverage or rare or low - reach <= self.held <= high + reach

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text."""
        share = f"{100 * self.held:.1f} ± {100 * self.error:.1f}" if self.stated else "–"
        stated = f"{100 * self.stated / self.draws:.0f}"
        return self.interval, self.truth, f"{self.draws}", stated, share


# Studies: points (rows) in realisations (columns), lost ones NaN.

COUNTS_EVEN, COUNTS_ODD = (6, 6, 6, 6), (3, 5, 8, 4)


def draw_noise(kind: str, shape: tuple[int, ...], rng: Random, shared: float = 0.0) -> Floats:
    """Noise of mean 0 of some kind, normal deviates of the points of a realisation correlated."""
    normal = math.sqrt(1.0 - shared) * rng.standard_normal(shape)
    normal += math.sqrt(shared) * rng.standard_normal(shape[-1])
    if kind == "exponential":
        return np.asarray(-log_ndtr(normal) - 1.0)
    return np.exp(normal) - math.exp(0.5) if kind == "lognormal" else normal


def draw_study(
    rng: Random,
    counts: tuple[int, ...],
    *,
    kind: str = "normal",
    shared: float = 0.0,
    lost: float = 0.0,
    roughest: float = 1.3,
) -> tuple[float, Interval]:
    """The paired difference of two configurations at points that differ in mean and spread.

    Parameters
    ----------
    counts : realisations of each point; lost : share of the runs that one of the two does not
        finish; roughest : spread of normal noise at the last point, 0.7 at the first.
    """
    points, most = len(counts), max(counts)
    truth = np.linspace(-0.5, 1.0, points)
    spread = np.linspace(0.7, roughest if kind == "normal" else 0.7, points)[:, None]
    sea = rng.uniform(20.0, 60.0, most)
    reference = sea + np.zeros((points, 1))
    own = reference + truth[:, None] + spread * draw_noise(kind, (points, most), rng, shared)
    keep = np.arange(most) < np.array(counts)[:, None]
    one, other = (
        pd.DataFrame(np.where(keep & (rng.uniform(size=own.shape) >= lost / 2), values, np.nan))
        for values in (own, reference)
    )
    found = compute_paired_difference(one.stack().dropna(), other.stack().dropna())
    both = (one.notna() & other.notna()).any(axis=1).to_numpy()
    return float(truth[both].mean()), found.mean_interval


def draw_none(rng: Random, count: int) -> tuple[float, Interval]:
    """The bound of a share of which none was found, of the share for which it is most often wrong:
    just above the bound."""
    truth = 1.001 * bound_probability_after_no_event(count)
    found = rng.uniform(size=count) < truth
    high = 1.0 if found.any() else bound_probability_after_no_event(count)
    return truth, Interval(float(found.mean()), 0.0, high)


STUDIES: dict[str, Draw] = {
    "balanced: 4 points, 6 realisations each": partial(draw_study, counts=COUNTS_EVEN),
    "balanced: 1 point, 10 realisations": partial(draw_study, counts=(10,)),
    "balanced: 8 points, 2 realisations each": partial(draw_study, counts=(2,) * 8),
    "unbalanced: 3, 5, 8 and 4 realisations": partial(draw_study, counts=COUNTS_ODD),
    "unbalanced: 3, 3, 2, 1, 1 and 1 realisations": partial(draw_study, counts=(3, 3, 2, 1, 1, 1)),
    "unbalanced: 4, 4, 1 and 1 realisations, the last point with twice the scatter of the first": (
        partial(draw_study, counts=(4, 4, 1, 1), roughest=1.4)
    ),
    "unbalanced: 2, 1, 1 and 1 realisations": partial(draw_study, counts=(2, 1, 1, 1)),
    "30 % of runs lost at random: 10 points, 4 realisations each": partial(
        draw_study, counts=(4,) * 10, lost=0.3
    ),
    "30 % of runs lost at random: 6 points, 3 realisations each": partial(
        draw_study, counts=(3,) * 6, lost=0.3
    ),
    "2 % of runs lost at random: 4 points, 30 realisations each": partial(
        draw_study, counts=(30,) * 4, lost=0.02
    ),
    "correlated points (0.3): 16 points, 6 realisations each": partial(
        draw_study, counts=(6,) * 16, shared=0.3
    ),
    "skewed (exponential): 4 points, 6 realisations each": partial(
        draw_study, counts=COUNTS_EVEN, kind="exponential"
    ),
    "skewed (exponential): 1 point, 10 realisations": partial(
        draw_study, counts=(10,), kind="exponential"
    ),
    "very skewed (lognormal): 1 point, 30 realisations": partial(
        draw_study, counts=(30,), kind="lognormal"
    ),
}


# Steps: log step times or ratios that are correlated from step to step.


def draw_steps(rng: Random, steps: int, correlation: float) -> Floats:
    """A stationary first-order autoregression of variance 1."""
    start = math.ceil(8.0 / (1.0 - correlation))
    noise = math.sqrt(1.0 - correlation**2) * rng.standard_normal(start + steps)
    return np.asarray(lfilter([1.0], [1.0, -correlation], noise)[start:], dtype=np.float64)


def draw_ratio(rng: Random, steps: tuple[int, ...], correlation: float) -> tuple[float, Interval]:
    """The ratio of two solvers over one sequence or several, true 1.2."""
    logs = [math.log(1.2) + 0.1 * draw_steps(rng, one, correlation) for one in steps]
    ones = [np.ones(len(one)) for one in logs]
    return 1.2, (
        estimate_paired_time_ratio(np.exp(logs[0]), ones[0])
        if len(logs) == 1
        else estimate_pooled_ratio(logs)
    )


def draw_percentile(
    rng: Random, steps: int, correlation: float, percent: float
) -> tuple[float, Interval]:
    """A percentile of lognormal step times."""
    times = np.exp(0.3 * draw_steps(rng, steps, correlation))
    found = estimate_percentile_interval(times, percent)
    # An end that the steps do not reach holds everything on its side.
    high = found.high if found.low == 0.0 else min(found.high, 1e300)
    return math.exp(0.3 * float(ndtri(percent / 100.0))), Interval(found.value, found.low, high)


STEPS: dict[str, dict[str, Draw]] = {
    "paired ratio of step times": {
        f"{steps} steps, correlation {phi:g} from step to step": partial(
            draw_ratio, steps=(steps,), correlation=phi
        )
        for steps, phi in ((400, 0.9), (500, 0.0), (500, 0.9), (500, 0.97), (1000, 0.97))
    }
    | {
        "1000 and 500 steps, correlation 0.97": partial(
            draw_ratio, steps=(1000, 500), correlation=0.97
        )
    },
    "percentile of step times": {
        f"p{percent:g} of {steps} steps, correlation {phi:g}": partial(
            draw_percentile, steps=steps, correlation=phi, percent=percent
        )
        for percent, steps, phi in (
            *((50, 1000, 0.0), (50, 1000, 0.9), (99, 1000, 0.0), (99, 1000, 0.9)),
            (99, 5000, 0.9),
        )
    },
}


# Comparisons of two runs, through `compute_log_time_ratios` and `compare_times_and_shared_factors`.

CONFIGURATIONS, ROUNDS, STEPS_OF_TABLE = 12, 6, 100
SEQUENCE = "paper"


class SimulatedRecords:
    """The step times of one run, in the form in which `compute_log_time_ratios` reads them."""

    has_steps = True

    def __init__(self, rng: Random, slow: Floats, *, disturbed: bool) -> None:
        machine = math.exp(0.1 * rng.standard_normal()) if disturbed else 1.0
        pattern = 2e4 * (1.5 + np.sin(np.arange(STEPS_OF_TABLE) / 7.0))
        self._steps: dict[str, pd.DataFrame] = {}
        self.runs: list[Any] = []
        for number, factor in enumerate(slow):
            own = machine * factor * math.exp(0.01 * rng.standard_normal())
            noise = np.exp(0.02 * rng.exponential(size=(ROUNDS, STEPS_OF_TABLE)))
            if disturbed:
                met = rng.uniform(size=(ROUNDS, 1)) < 0.4
                noise *= np.where(met, 1.0 + 0.4 * rng.uniform(size=(ROUNDS, 1)), 1.0)
            self._steps[f"{number}"] = pd.DataFrame(
                {
                    "repeat": np.repeat(np.arange(1, ROUNDS + 1), STEPS_OF_TABLE),
                    "k": np.tile(np.arange(STEPS_OF_TABLE), ROUNDS),
                    "total_ns": (own * pattern * noise).ravel(),
                }
            )
            self.runs.append(_simulated_run(number, 5e4 * machine))

    def read_counting_step_table(self, run: Any, columns: object) -> pd.DataFrame:
        """The step rows of a run."""
        return self._steps[run.solver]

    def get_step_times(self, run: Any) -> None:
        """None, as `compute_spread` has what the rounds of a disturbed run differ by."""

    def compute_spread(self, run: Any) -> float:
        """The time of a run's slowest round over that of its fastest."""
        of_rounds = self._steps[run.solver].groupby("repeat")["total_ns"].sum()
        return float(of_rounds.max() / of_rounds.min())

    def has_comparable_times(self, run: Any) -> bool:
        """All of them are."""
        return True


def _simulated_run(number: int, kernel_ns: float) -> Any:
    words = dict.fromkeys(("scenario", "sequence", "problem"), SEQUENCE)
    words |= {"mode": "replay", "solver": f"{number}", "route": "native", "policy": "fresh"}
    words |= {"turns": "", "settings": "default", "units": "scaled", "formulation": "condensed_box"}
    kernels = dict.fromkeys(("reference_kernel_ns", "load_kernel_ns"), kernel_ns)
    numbers = {"steps_planned": STEPS_OF_TABLE, "steps_searched_for_hardest": 0}
    return SimpleNamespace(**words, **kernels, **numbers, options="")


def compare_once(rng: Random, planted: float, *, disturbed: bool) -> tuple[bool, bool, bool]:
    """Compare simulated runs: do all intervals hold their truth, is a claim false, is one true?"""
    truth = np.ones(CONFIGURATIONS)
    truth[0] += planted
    one = SimulatedRecords(rng, np.ones(CONFIGURATIONS), disturbed=disturbed)
    other = SimulatedRecords(rng, truth, disturbed=disturbed)
    pairs = [Pair(*both) for both in zip(one.runs, other.runs, strict=True)]
    timings = compute_log_time_ratios(cast(Any, one), cast(Any, other), pairs)
    if disturbed:
        timings = [
            replace(t, spread=max(one.compute_spread(t.pair.a), other.compute_spread(t.pair.b)))
            for t in timings
        ]
    why = {SEQUENCE: "both runs were disturbed" if disturbed else ""}
    found, _ = compare_times_and_shared_factors(timings, 0.05, 0.05, why)
    assessments = [compared.assessment for compared in found]
    held = all(a.ratio.contains(t) for a, t in zip(assessments, truth, strict=True))
    claimed = [a.verdict in ("slower", "faster") for a in assessments]
    return held, any(claimed[1:]), claimed[0] and planted > 0.0


def comparison_rows(rng: Random, tables: int) -> Iterator[Row]:
    """Yield the rows of `compare`: machine quiet or disturbed, with and without a change."""
    for planted, disturbed in ((0.0, False), (0.0, True), (0.05, True), (0.15, True), (0.5, True)):
        found = np.array([compare_once(rng, planted, disturbed=disturbed) for _ in range(tables)])
        held, false, slower = found.mean(axis=0).tolist()
        machine = "disturbed" if disturbed else "quiet"
        change = f"one configuration {100.0 * planted:.0f} % slower" if planted else "no change"
        case = f"{machine} machine, {change}"
        yield Row("`compare`, all intervals of a table together", case, tables, tables, held)
        yield Row("`compare`, tables with a false verdict", case, tables, tables, false, False)
        if planted:
            what = "false" if planted <= 0.05 else "correct"
            yield Row(
                f"`compare`, tables with a {what} *slower*", case, tables, tables, slower, False
            )


# Effects on the step times of a study on a disturbed machine, through `compute_study_effects`.

LEVELS, REALISATIONS, SOLVERS = 3, 10, ("one", "other")
HIGHEST_LOAD = 2.0
"""Largest factor of a median step time between runs of one point under other load."""
NO_STEPS = dict.fromkeys(("r_95_m", "r_max_m", "r_tail_max_m", "failed_steps", "exact_left_s"), 0.0)


def yield_load(rng: Random) -> Iterator[float]:
    """Yield the factor of the step time of each run in turn: load comes and goes at random.

    It lasts one to a hundred runs on average and is there for 20 to 80 % of the time.
    """
    runs, share = math.exp(rng.uniform(0.0, math.log(100.0))), rng.uniform(0.2, 0.8)
    lengths = {True: max(1.0, runs * share), False: max(1.0, runs * (1.0 - share))}
    on = bool(rng.uniform() < share)
    factor = rng.uniform(1.0, HIGHEST_LOAD)
    while True:
        yield factor if on else 1.0
        if rng.uniform() < 1.0 / lengths[on]:
            on, factor = not on, rng.uniform(1.0, HIGHEST_LOAD)


def simulate_study(rng: Random, factor: float) -> Study:
    """A study of a key with three values, the last of which multiplies the step times."""
    order = [(p, r, s) for r in range(REALISATIONS) for p in range(LEVELS) for s in SOLVERS]
    seas, load = 0.1 * rng.standard_normal(REALISATIONS), yield_load(rng)
    runs = []
    for point, sea, solver in order:
        log = seas[sea] + 0.03 * rng.standard_normal() + 0.02 * rng.exponential()
        slow = next(load) * (factor if point == LEVELS - 1 else 1.0)
        words = {"solver_label": solver, "solver": solver, "settings": "default"}
        numbers = {"steps_done": 400, "has_all_steps": True, "exact_steps": 400, "true_share": 1.0}
        times = {"raw_p50_ns": 1e5 * slow * math.exp(log), "raw_p99_ns": math.nan}
        rest = {"closed_loop_cost": 1.0, "exact_cost": 1.0, "is_baseline_law": False}
        rest |= {"claimed_not_true": 0, "error_move_max": 0.0, "caching_sign": None}
        names = {"run_id": "", "campaign_utc": "", "outcome": "finished", "has_no_optimum": False}
        place = {"study_point": point, "replicate": sea + 1, "x": {"key": float(point)}}
        runs.append(
            SimpleNamespace(**words, **numbers, **times, **rest, **names, **place, **NO_STEPS)
        )
    busy = Disturbance(0.0, 0.0, 0.0, seconds=1.0, involuntary=99.0, steal_s=0.0, throttled=0.0)
    return Study("simulated", cast(Any, runs), 1.0, busy)


def study_effect_rows(rng: Random, tables: int) -> Iterator[Row]:
    """Yield the rows of a disturbed study: coverage, false and correct effects on step times."""
    for planted in (0.0, 0.7, 2.0):
        held, false, correct = np.zeros((3, tables))
        for i in range(tables):
            found = [
                (math.log1p(planted) if one.measured.change.end == LEVELS - 1 else 0.0, one)
                for one in compute_study_effects(simulate_study(rng, 1.0 + planted))
                if one.measure == STEP_TIME
            ]
            shown = [truth for truth, one in found if not one.is_disturbed]
            held[i] = np.mean([one.mean_difference.mean_interval.contains(t) for t, one in found])
            false[i], correct[i] = 0.0 in shown, sum(t > 0.0 for t in shown) / len(SOLVERS)
        change = f"one value {100.0 * planted:.0f} % slower" if planted else "no change"
        case = f"disturbed machine, {change}"
        yield Row("effect on step times of a study", case, tables, tables, held.mean())
        yield Row("studies with a false effect", case, tables, tables, false.mean(), False)
        if planted:
            what = "correct effects on step times that are shown"
            yield Row(what, case, tables, tables, correct.mean(), False)


def rows(rng: Random, draws: int, tables: int) -> Iterator[Row]:
    """All rows of the table."""
    kinds: dict[str, dict[str, Draw]] = {"mean difference of a study": STUDIES}
    bound = {
        f"no case in {count} realisations": partial(draw_none, count=count) for count in (10, 30)
    }
    kinds |= {"bound on a share": cast(dict[str, Draw], bound)} | STEPS
    for kind, cases in kinds.items():
        for case, draw in cases.items():
            found = [draw(rng) for _ in range(draws)]
            stated = [one for one in found if math.isfinite(one[1].high)]
            held = float(np.mean([i.contains(t) for t, i in stated])) if stated else math.nan
            yield Row(kind, case, draws, len(stated), held)
    # Of its own, or a change of another row would change these.
    yield from comparison_rows(np.random.default_rng(2), tables)
    yield from study_effect_rows(np.random.default_rng(3), tables)


def main() -> int:
    """Draw, count, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="draw little and write nothing")
    quick: bool = parser.parse_args().quick
    draws, tables = (QUICK_DRAWS, QUICK_TABLES) if quick else (DRAWS, TABLES)
    heads = (
        "interval or verdict",
        "simulated data",
        "draws",
        "draws with an interval [%]",
        "share [%]",
    )
    lines = [" | ".join(("", *heads, "")).strip(), "|---|---|--:|--:|--:|"]
    print("\n".join(lines))
    outside = []
    for row in rows(np.random.default_rng(1), draws, tables):
        lines.append(" | ".join(("", *row.cells, "")).strip())
        print(lines[-1], flush=True)
        outside += [] if row.is_allowed else [row]
    if not quick:
        before, rest = METHOD.read_text(encoding="utf-8").split(MARKERS[0])
        after = rest.split(MARKERS[1])[1]
        table = "\n\n".join((MARKERS[0], "\n".join(lines), MARKERS[1]))
        METHOD.write_text(before + table + after, encoding="utf-8")
    print(f"{len(outside)} outside {ALLOWED}: {'; '.join(row.truth for row in outside)}")
    return int(bool(outside) and not quick)


if __name__ == "__main__":
    raise SystemExit(main())
