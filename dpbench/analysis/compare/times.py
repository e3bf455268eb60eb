"""Step times of the same configurations in two runs: one ratio each, with its own noise."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.analysis.compare.evidence import (
    MACHINE_NOISE,
    Assessment,
    Evidence,
    assess_time_ratios,
    remove_factor_shared_by_group,
    remove_reference_factor,
)
from dpbench.analysis.compare.pairs import Pair, pick_identifying_columns
from dpbench.analysis.records.machine import compute_round_spread, sum_disturbances_by_sequence
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.statistics import bootstrap_error_of_mean
from dpbench.analysis.times.paired_times import MACHINE_DISTURBED
from dpbench.arrays import Floats, Ints
from dpbench.bench.judge.rules import median_of_known
from dpbench.bench.record.cell import sort_key_of_settings
from dpbench.errors import UnknownNameError, format_allowed_names

BLOCK_STEPS, LEAST_BLOCKS = 20, 4
"""Length of a block of steps, and how many there must be for their spread to be an error. It leaves
out what two runs share, which is why blocks may be shorter than weather."""
PARTS = 4
"""A run's rounds are cut into so many consecutive parts, each left out in turn."""
JACKKNIFE_SHARE = 0.25
"""Share of the jackknife's variance of a minimum that counts, because the jackknife overstates it:
what the scatter of 14 configurations shows between 40 runs of unchanged code, 0.18 to 0.4 with 5 to
36 rounds. Where a configuration's own is beyond the usual one it counts in full: such a
configuration may have met a neighbour in every round."""
LOAD_SHARE, LOAD_ERROR = 0.5, 0.3
"""Part of the load kernel's excess over other configurations that the step times feel, measured in
the same runs (0.5 to 0.6), and how far it differs from configuration to configuration."""
LOAD_WEIGHT, LOAD_WEIGHT_ERROR = 0.8, 0.3
"""Share that all configurations together feel of a change of the load kernel beyond the reference
kernel (0.76 to 0.82 in those runs, with a correlation of 0.98), and its error."""

REFERENCES = ("paper_active_set", "daqp")
"""The reference solver between two machines: the first that both have timed. Both are small active
sets without a library below them, so that a build matters least."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Log step time ratio of runs B and A for a configuration on one QP sequence, with error.

    own : standard error from inside the runs.
    median_ns : the median step in A and in B [ns].
    k, a_ns, b_ns : the steps of both runs and their minima [ns]; empty without steps.
    group : name of the replays that were interleaved in A and in B, which share the machine's
        factor: the sequence, with a number where several commands timed it.
    spread : slowest over fastest round, the larger of both runs, where other load disturbed one.
    """

    pair: Pair
    log: float
    own: float
    steps: int
    rounds: int
    median_ns: tuple[float, float]
    k: Ints
    a_ns: Floats
    b_ns: Floats
    group: str = ""
    spread: float = 1.0


@dataclass(frozen=True, eq=False)
class ComparedTimes:
    """Step time ratio of one configuration between two runs, with the verdict on it."""

    timing: Timing
    assessment: Assessment

    @property
    def table_row(self) -> dict[str, Any]:
        """Table row: run identity, step time ratio with interval, adjusted p-values and verdict."""
        timing, found = self.timing, self.assessment
        ratio = {"ratio": found.ratio.value, "low": found.ratio.low, "high": found.ratio.high}
        p_values = {"p_differs": found.p_differs, "p_equal": found.p_equal}
        return (
            pick_identifying_columns(timing.pair.a)
            | {"raw": found.raw, "machine": found.machine, **ratio, "own": timing.own, **p_values}
            | {"steps": timing.steps, "rounds": timing.rounds, "verdict": found.verdict}
        )


@dataclass(frozen=True)
class SharedFactor:
    """Step time ratio B/A that all configurations of one group on a QP sequence share.

    factor : median over the configurations; kernel, load : of the reference and the load kernel, or
        NaN.
    assessment : on factor / what the kernels predict; None for the reason `unjudged`.
    """

    sequence: str
    factor: float
    kernel: float
    load: float
    configurations: int
    assessment: Assessment | None
    unjudged: str


def compute_log_time_ratios(a: Records, b: Records, pairs: Sequence[Pair]) -> list[Timing]:
    """Return the log step time ratio B/A, with its error, of each timed pair of replays."""
    time_of = (
        _compute_timing_from_steps if a.has_steps and b.has_steps else _compute_timing_from_medians
    )
    # A window has too few steps for an interval, and each claim costs the others power.
    replays = (
        pair for pair in pairs if pair.a.mode == "replay" and not pair.a.steps_searched_for_hardest
    )
    timings = [
        replace(timing, spread=max(_compute_spread(a, pair.a), _compute_spread(b, pair.b)))
        for pair in replays
        if (timing := time_of(a, b, pair)) is not None
    ]
    return _name_groups(timings)


def _compute_spread(records: Records, run: RunRecord) -> float:
    """Return `compute_round_spread` of a run; 1 where its folder has no steps."""
    times = records.get_step_times(run) if records.has_steps else None
    return 1.0 if times is None else compute_round_spread(records, run, times)


def _name_groups(timings: Sequence[Timing]) -> list[Timing]:
    """Return timings with the names of their groups."""
    turns: dict[str, dict[tuple[str, str], int]] = {}
    for timing in timings:
        of_sequence = turns.setdefault(timing.pair.a.problem, {})
        of_sequence.setdefault((timing.pair.a.turns, timing.pair.b.turns), len(of_sequence) + 1)
    named = []
    for timing in timings:
        of_sequence = turns[timing.pair.a.problem]
        number = of_sequence[timing.pair.a.turns, timing.pair.b.turns]
        group = timing.pair.a.problem
        group += f", command {number} of {len(of_sequence)}" if len(of_sequence) > 1 else ""
        named.append(replace(timing, group=group))
    return named


def explain_unjudged_sequences(a: Records, b: Records, timings: Sequence[Timing]) -> dict[str, str]:
    """Return, by group of replays, why its speed test cannot measure the machine's speed; or "".

    A kernel feels only some of what a solver feels of a busy machine, so both runs must have been
    quiet while they timed the sequence.
    """
    known = sum_disturbances_by_sequence(a), sum_disturbances_by_sequence(b)
    reasons = {}
    for name, own in group_by_key(timings, lambda t: t.group).items():
        disturbances = [by_sequence.get(own[0].pair.a.problem) for by_sequence in known]
        hidden = [one is None for one in disturbances]
        disturbed = [one is not None and bool(one.complaints()) for one in disturbances]
        if not np.isfinite(_compute_kernel_ratios(own).kernel):
            reasons[name] = "the reference kernel was not timed"
        elif any(disturbed):
            reasons[name] = f"{_name_flagged_runs(disturbed)} disturbed"
        elif any(hidden):
            reasons[name] = f"no counters show how quiet {_name_flagged_runs(hidden)}"
        else:
            reasons[name] = ""
    return reasons


def choose_reference_solver(timings: Sequence[Timing], asked: str | None) -> str:
    """Return the solver by whose times two machines are compared; "" for none.

    It is the one asked for, else one of `REFERENCES`, else the one timed on the most sequences.

    Raises
    ------
    InputError : for a solver that was not timed in both.
    """
    counts = Counter(t.pair.a.solver for t in timings)
    if asked is not None and asked not in counts:
        allowed = (
            format_allowed_names(asked, sorted(counts))
            if counts
            else "a solver that was replayed in both folders"
        )
        raise UnknownNameError("`reference`", "", repr(asked), allowed)
    known = [name for name in REFERENCES if name in counts]
    most = [name for name, _ in counts.most_common(1)]
    return asked or next(iter([*known, *most]), "")


def find_reference_indices(timings: Sequence[Timing], solver: str) -> Ints:
    """Return for each timing the index of the reference solver's in its group, or −1.

    Of several the most usual, see `make_usual_first_sort_key`.
    """
    runs = [timing.pair.a for timing in timings]
    own = [i for i, run in enumerate(runs) if run.solver == solver]
    usual_first = sorted(own, key=lambda i: make_usual_first_sort_key(runs[i]))
    usual = map_first_by_key(usual_first, lambda i: timings[i].group)
    return np.array([usual.get(timing.group, -1) for timing in timings], dtype=np.int64)


def make_usual_first_sort_key(run: RunRecord) -> tuple[Any, ...]:
    """Return a sort key of a run: scaled units, default settings, cold start first."""
    settings = sort_key_of_settings(run.settings)
    return run.units != "scaled", settings, run.policy != "fresh", run.route, run.formulation


def compare_times_to_reference(
    timings: Sequence[Timing], margin: float, alpha: float, rows: Ints
) -> list[ComparedTimes]:
    """Return verdicts on step time ratios B/A over the reference solver's, except its own.

    rows : (N,) as of `find_reference_indices`; the timings they name have no verdict.
    """
    groups = [t.group for t in timings]
    logs, own = np.array([t.log for t in timings]), np.array([t.own for t in timings])
    evidence = remove_reference_factor(logs, own, groups, rows, JACKKNIFE_SHARE)
    judged = np.setdiff1d(np.arange(len(timings)), rows)
    family = Evidence(
        *(part[judged] for part in (evidence.effect, evidence.machine, evidence.error, evidence.df))
    )
    assessments = assess_time_ratios(family, margin, alpha) if len(judged) else []
    return [_judge_timing(timings[i], one) for i, one in zip(judged, assessments, strict=True)]


def _judge_timing(timing: Timing, assessment: Assessment) -> ComparedTimes:
    """Return a step time ratio with its verdict; "faster" only if all B's answers are true.

    "not judged" where nothing tells the machine's factor, so that the interval is unbounded;
    "machine disturbed" where a run is disturbed and the ratio is neither equivalent nor differs
    from 1 by more than the rounds of that run.
    """
    ratio, is_equal = assessment.ratio, assessment.verdict == "equivalent"
    if not math.isfinite(ratio.high):
        assessment = replace(assessment, verdict="not judged")
    elif timing.spread > 1.0 and not is_equal and ratio.is_within_spread(timing.spread):
        assessment = replace(assessment, verdict=MACHINE_DISTURBED)
    elif assessment.verdict == "faster" and timing.pair.b.true_share != 1.0:
        assessment = replace(assessment, verdict="faster, not all verified")
    return ComparedTimes(timing, assessment)


def _name_flagged_runs(of: Sequence[bool]) -> str:
    """Return which of a pair's runs are flagged: "run A was", "run B was", "both runs were"."""
    return "both runs were" if all(of) else f"run {'AB'[list(of).index(True)]} was"


def compare_times_and_shared_factors(
    timings: Sequence[Timing], margin: float, alpha: float, unjudged: Mapping[str, str]
) -> tuple[list[ComparedTimes], list[SharedFactor]]:
    """Return verdicts on step time ratios B/A, and the factors that all of a QP sequence share.

    unjudged : see `explain_unjudged_sequences`; such a sequence has no shared factor judged.
    """
    groups = [t.group for t in timings]
    labels = np.asarray(groups)
    machines = {
        n: _compute_kernel_ratios(own)
        for n, own in group_by_key(timings, lambda t: t.group).items()
    }
    fit = np.array(
        [np.nan if unjudged[name] else machines[name].predicted_log_ratio for name in groups]
    )
    logs = np.array([t.log for t in timings])
    met = _compute_relative_load_ratios(timings, labels)
    own = np.hypot([t.own for t in timings], LOAD_ERROR * np.abs(met))
    less = logs - LOAD_SHARE * met
    configurations = remove_factor_shared_by_group(
        less, own, groups, kernel=fit, own_share=JACKKNIFE_SHARE
    )
    factors = {name: float(np.median(logs[labels == name])) for name in machines}
    together = [
        (
            factors[name] - machine.predicted_log_ratio,
            machine.compute_prediction_error(configurations.error[labels == name]),
        )
        for name, machine in machines.items()
        if not unjudged[name]
    ]
    family = Evidence(
        np.concatenate([configurations.effect, [effect for effect, _ in together]]),
        np.concatenate([configurations.machine + LOAD_SHARE * met, np.zeros(len(together))]),
        np.concatenate([configurations.error, [error for _, error in together]]),
        np.concatenate([configurations.df, np.full(len(together), MACHINE_NOISE.df)]),
    )
    assessments = assess_time_ratios(family, margin, alpha)
    compared = [_judge_timing(*both) for both in zip(timings, assessments, strict=False)]
    rest = iter(assessments[len(timings) :])
    shared = []
    for name, machine in machines.items():
        common_logs = factors[name], machine.kernel, machine.load
        factor, kernel, load = (float(np.exp(log)) for log in common_logs)
        assessment, count = None if unjudged[name] else next(rest), groups.count(name)
        shared.append(SharedFactor(name, factor, kernel, load, count, assessment, unjudged[name]))
    return compared, shared


@dataclass(frozen=True)
class _KernelRatios:
    """Log time ratios B/A of two machine-speed tests: a fixed computation, and one sensing load."""

    kernel: float
    load: float

    @property
    def log_excess_of_load_test(self) -> float:
        """Log time ratio of the load-sensing speed test less the fixed one's; 0 if unknown."""
        return self.load - self.kernel if np.isfinite(self.load) else 0.0

    @property
    def predicted_log_ratio(self) -> float:
        """Log ratio B/A of solver step times that both machine-speed tests predict."""
        return self.kernel + LOAD_WEIGHT * self.log_excess_of_load_test

    def compute_prediction_error(self, configurations: Floats) -> float:
        """Return the standard error of the predicted less the median log step time ratio."""
        median2 = np.pi / 2 * float(np.median(configurations)) ** 2 / len(configurations)
        load2 = (LOAD_WEIGHT_ERROR * self.log_excess_of_load_test) ** 2
        return float(np.sqrt(MACHINE_NOISE.sd**2 + load2 + median2))


def _compute_relative_load_ratios(timings: Sequence[Timing], labels: NDArray[np.str_]) -> Floats:
    """Return each run pair's log time ratio of the load test less its QP sequence's median.

    Rounds of two configurations meet different neighbours; 0 where a folder does not tell.
    """
    logs = _compute_log_ratios_of_column(timings, "load_kernel_ns")
    met = np.zeros(len(logs))
    for name in np.unique(labels[np.isfinite(logs)]):
        known = (labels == name) & np.isfinite(logs)
        met[known] = logs[known] - np.median(logs[known])
    return met


def _compute_log_ratios_of_column(timings: Sequence[Timing], column: str) -> Floats:
    """Return log(B/A) (N,) of one recorded time, named by its column, of each pair of runs."""
    times = [[getattr(run, column) for run in (t.pair.a, t.pair.b)] for t in timings]
    a_ns, b_ns = np.array(times, dtype=np.float64).reshape(-1, 2).T
    return np.asarray(np.log(b_ns / a_ns), dtype=np.float64)


def _compute_kernel_ratios(timings: Sequence[Timing]) -> _KernelRatios:
    """Return the median log time ratio B/A of each of two machine-speed tests; NaN if untimed."""
    columns = (
        _compute_log_ratios_of_column(timings, name)
        for name in ("reference_kernel_ns", "load_kernel_ns")
    )
    return _KernelRatios(*(median_of_known(logs[np.isfinite(logs)]) for logs in columns))


def _tabulate_times_by_repetition(records: Records, run: RunRecord) -> pd.DataFrame | None:
    """Return a run's step times (repetitions, steps) [ns], undisturbed ones; None if unranked."""
    counting = records.read_counting_step_table(run, ("repeat", "k", "total_ns"))
    if counting.empty or not records.has_comparable_times(run):
        return None
    times = counting.assign(total_ns=counting["total_ns"].astype("float64"))
    table = times.pivot(index="repeat", columns="k", values="total_ns")
    whole = table.dropna(axis="index")
    # A configuration that its time limit stopped in its first round has the steps it has.
    return whole if len(whole) else table.dropna(axis="columns")


def _compute_timing_from_medians(a: Records, b: Records, pair: Pair) -> Timing | None:
    """Return two runs' log step time ratio from recorded medians, no error; None if untimed."""
    medians = pair.a.algo_p50_ns, pair.b.algo_p50_ns
    if not all(map(math.isfinite, medians)):
        return None
    steps = min(pair.a.steps_done, pair.b.steps_done)
    rounds = int(min(pair.a.rounds, pair.b.rounds))
    log, none = math.log(medians[1] / medians[0]), np.empty(0)
    return Timing(pair, log, 0.0, steps, rounds, medians, none.astype(np.int64), none, none)


def _compute_timing_from_steps(records_a: Records, records_b: Records, pair: Pair) -> Timing | None:
    """Return two runs' log step time ratio from common steps' fastest repetition, or None."""
    a, b = (
        _tabulate_times_by_repetition(records_a, pair.a),
        _tabulate_times_by_repetition(records_b, pair.b),
    )
    if a is None or b is None:
        return None
    steps = a.columns.intersection(b.columns)
    if steps.empty:
        return None
    # The minimum over more rounds is smaller, so both runs get as many: their first ones.
    rounds = min(len(a), len(b))
    a_ns, b_ns = (run[steps].to_numpy(dtype=np.float64)[:rounds] for run in (a, b))
    best_a_ns, best_b_ns = a_ns.min(axis=0), b_ns.min(axis=0)
    logs = np.log(best_b_ns / best_a_ns)
    over_steps = (
        bootstrap_error_of_mean(logs, BLOCK_STEPS)
        if len(logs) >= LEAST_BLOCKS * BLOCK_STEPS
        # As good as a single step: that all of so few resemble each other cannot be excluded.
        else logs.std()
    )
    own = float(
        np.sqrt(
            over_steps**2 + _compute_jackknife_variance(a_ns) + _compute_jackknife_variance(b_ns)
        )
    )
    k = steps.to_numpy(dtype=np.int64)
    medians = float(np.median(best_a_ns)), float(np.median(best_b_ns))
    mean = float(logs.mean())
    return Timing(pair, mean, own, len(steps), rounds, medians, k, best_a_ns, best_b_ns)


def _compute_jackknife_variance(times: Floats) -> float:
    """Return the jackknife variance, over repetitions, of the mean log fastest step time.

    Consecutive parts are left out in turn: a stretch of slow rounds leaves the minimum unchanged,
    and one reached in a single part is not reliable. A single round has 0.
    """
    parts = min(PARTS, len(times))
    if parts < 2:
        return 0.0
    left_out = np.array_split(np.arange(len(times)), parts)
    means = [np.log(np.delete(times, rows, axis=0).min(axis=0)).mean() for rows in left_out]
    return float(np.var(means)) * (parts - 1)
