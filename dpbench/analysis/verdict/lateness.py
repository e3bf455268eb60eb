"""Late timings that the machine does not explain, by one-sided tests; uncertainty of step times.

The fastest round of a step hides a solver that is late at random; its single timings show it, but
so do interrupts of the machine. Time in which another program had the core is taken off where the
kernel shows it (`run_steps.py`), so that waits alone are neither late nor a stall. The rest of the
machine is known from what the other configurations met in the same interleaved rounds: a stall
strikes whoever runs, in proportion to the time that it runs. A solver that waits for threads of its
own (`THREAD_WAITS`), and those that it is compared with, are tested without regard to who had the
core.

Replays. A timing is late if it exceeds the limit and twice the fastest time of its step. Let x be
the count of late timings in the middle round (the lower median: a burst of the machine is in one or
two rounds), B the time that the round is exposed, λ the rate of stalls longer than half the limit
on the same sequence. If the machine alone acts, counts are negative binomial with mean λB and the
dispersion found over those rounds. Two nulls are tested: the machine alone ("late at random", at
each of `MULTIPLES` of the limit, Bonferroni), and the machine with one late timing in a hundred,
which a p99 allows ("late timings").

Closed loops, and replays of one round. Hard steps and delays look the same, and one late timing in
a hundred is allowed: binomial with a share of 1 %. Late is what exceeds the limit by more than the
uncertainty of the times. Where waits are not recorded, each involuntary context switch that can
have hit a timed call explains one (`count_explained_late_timings`). A disturbed run proves nothing:
waits do not show what other programs cost in caches and clock frequency. The iterations do where
they alone, at the least time per iteration of all steps, make the run late.

Deadline. So long a stall is rare in a whole campaign: its rate is that of all replays together.

The tests of one kind are one family (Holm 1979): "proven" holds at a family-wise error of `PROVEN`,
"doubtful" at one of `DOUBTFUL`.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Literal

import numpy as np
from scipy.stats import binom, nbinom

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.records.run_steps import Delays, RunSteps
from dpbench.analysis.statistics import adjust_p_values_by_holm
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.arrays import Floats
from dpbench.bench.judge.rules import count_explained_late_timings
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.disturbance import MAX_SWITCHES_PER_S

QUANTILE = 0.95
"""Share of the configurations whose rounds differ by less than the usual factor."""
LEAST = 1.05
"""Smallest uncertainty, however even the rounds are."""
UNKNOWN = 1.5
"""Uncertainty without any replay of two rounds: machines of one kind differ by as much."""


@dataclass(frozen=True)
class Uncertainty:
    """Factors within which step times are uncertain, by configuration.

    A replay's time is the fastest round of each step, so it is as uncertain as the middle round is
    slower. A closed loop is timed once, maybe in a slow round: the upper quartile of the rounds.

    middle, slow, slowest : median of the middle round, of the upper quartile and of the slowest
        round over that of the fastest, the largest of its replays.
    usual : the quantile `QUANTILE` of `middle`, at least `LEAST`.
    """

    middle: dict[Configuration, float]
    slow: dict[Configuration, float]
    slowest: dict[Configuration, float]
    usual: float

    def get_factor_of_run(self, run: RunRecord) -> float:
        """Return the factor within which a run's step times are uncertain."""
        own = self.middle if run.mode == "replay" else self.slow
        return max(self.usual, own.get(run.configuration.moved_to_common_formulation, 0.0))


def estimate_uncertainty(records: Records) -> Uncertainty:
    """Return the factors by which step times are uncertain, from spread between repetitions."""
    factors: dict[Configuration, list[Floats]] = {}
    for run in records.select_runs(mode="replay", units="scaled"):
        times = records.get_step_times(run)
        # A window has too few steps: the middle of each round is one of a few timings.
        if times is None or len(times.rounds_ns) < 2 or run.steps_searched_for_hardest:
            continue
        quantiles = np.quantile(times.rounds_ns, (0.5, 0.75, 1.0)) / times.rounds_ns.min()
        factors.setdefault(run.configuration.moved_to_common_formulation, []).append(quantiles)
    largest = {key: np.max(own, axis=0).tolist() for key, own in factors.items()}
    middle, slow, slowest = ({key: own[i] for key, own in largest.items()} for i in range(3))
    usual = max(LEAST, compute_factor_quantile(middle.values())) if middle else UNKNOWN
    return Uncertainty(middle, slow, slowest, usual)


def compute_factor_quantile(factors: Iterable[float]) -> float:
    """Return the 95 % quantile of some factors, as of the configurations' uncertainty."""
    return float(np.quantile(list(factors), QUANTILE))


Kind = Literal["late timings", "late at random", "past the deadline"]
PROVEN, DOUBTFUL = 0.001, 0.05
"""Family-wise error of a claim that a configuration is late, and that it may be."""
ALLOWED = 0.01
"""Share of the timings that may be late: the limit is one of a p99."""
MULTIPLES = (1.0, 3.0)
"""Multiples of the limit at which delays at random are looked for: the machine has many short
stalls, in which some short ones of a solver are lost, and few long ones."""
DISPERSION = (0.5, 50.0)
"""Bounds of the shape of the negative binomial: the lower, the more uneven the machine."""
DEADLINE_SHAPE = 0.5
"""Its shape for stalls past the deadline, too rare for an estimate."""
THREAD_WAITS = 0.5
"""A configuration that waits in so many of its steps waits for threads of its own, and how long
those wait for the core is unknown."""
PASSES = 3
"""Estimates of the machine: first from the trusted, then without those proven late."""


@dataclass(frozen=True)
class LateTimings:
    """Number of a run's solver calls that took too long, and the share the machine explains.

    late, samples : late timings and all timings, over all rounds; known waits are taken off.
    machine : share of late timings that the machine leads to expect; NaN where nothing shows it.
    p : one-sided p-value, adjusted within its kind (Holm).
    is_disturbed : whether it is the only round of its steps, on a disturbed machine.
    """

    kind: Kind
    run: RunRecord
    late: int
    samples: int
    machine: float
    p: float
    is_disturbed: bool = False

    @property
    def late_share(self) -> float:
        """Share of a run's timings that are late."""
        return self.late / self.samples

    @property
    def is_proven_late(self) -> bool:
        """True if the test excludes the machine as the cause of a run's late timings."""
        return self.p <= PROVEN and not self.is_disturbed


@dataclass(frozen=True)
class StallModel:
    """Model of a computer's stalls: rate per ns of computing time, dispersion of counts."""

    rate: float
    shape: float

    def compute_tail_probability(self, count: int, exposed_ns: float, allowed: int = 0) -> float:
        """Return the probability that `count` or more timings are late by the machine's stalls."""
        mean = self.rate * exposed_ns
        if count <= 0:
            return 1.0
        stalls = nbinom(self.shape, self.shape / (self.shape + mean))
        if not allowed:
            return float(stalls.sf(count - 1))
        others = np.arange(count)
        both = binom.pmf(others, allowed, ALLOWED) * stalls.sf(count - 1 - others)
        return float(both.sum() + binom.sf(count - 1, allowed, ALLOWED))


MachineAt = Callable[[float], StallModel]
"""The machine by the limit [ns]."""


def find_late_timings(
    records: Records, requirements: Requirements, uncertainty: Uncertainty
) -> dict[str, list[LateTimings]]:
    """Return, by run id, test results on late solver calls of all replays and closed loops."""
    scaled = [run for run in records.runs if run.units == "scaled" and run.has_steps]
    runs = [run for run in scaled if not run.is_baseline_law]
    replays = [run for run in runs if run.mode == "replay" and records.has_comparable_times(run)]
    loops = [run for run in runs if run.mode == "closed_loop"]
    arms = [run for run in records.calibration if run.mode == "replay"]
    delays = read_delays(records, [*replays, *loops, *arms])
    replays, loops, arms = ([r for r in of if r.run_id in delays] for of in (replays, loops, arms))
    repeated = [run for run in replays if len(delays[run.run_id].samples) > 1]
    once = [*loops, *(run for run in replays if run not in repeated)]
    limits_ns = {run: requirements.p99_ns * uncertainty.get_factor_of_run(run) for run in once}
    tests: dict[Kind, list[LateTimings]] = {
        "late at random": _test_replays_for_late_timings(
            repeated, arms, delays, requirements, "late at random"
        ),
        "late timings": [
            *_test_replays_for_late_timings(repeated, arms, delays, requirements, "late timings"),
            *_clear_disturbance_of_long_steps(
                records,
                [_test_run_timed_once(run, delays[run.run_id], limits_ns[run]) for run in once],
                limits_ns,
            ),
        ],
        "past the deadline": _test_steps_past_deadline(loops, replays, arms, delays, requirements),
    }
    adjusted = (test for family in tests.values() for test in adjust_p_values(family))
    return group_by_key(
        (test for test in adjusted if test.p <= DOUBTFUL), lambda test: test.run.run_id
    )


def read_delays(records: Records, runs: Sequence[RunRecord]) -> dict[str, Delays]:
    """Return the unusually long timings of timed runs, by run id.

    No waits are known of a run whose own threads may have the core.
    """
    found = records.read_delays_by_run(runs)
    timed = ((run, found[run.run_id]) for run in runs if run.run_id in found)
    return {
        run.run_id: own.without_waits if waits_for_threads(run, int(own.samples.sum())) else own
        for run, own in timed
        if own.samples.any()
    }


def waits_for_threads(run: RunRecord, samples: int) -> bool:
    """Return whether a run waits so often in its timings that its own threads may have the core."""
    return run.voluntary_switches >= THREAD_WAITS * samples


def adjust_p_values(tests: Sequence[LateTimings]) -> list[LateTimings]:
    """Return tests for late timings with p-values adjusted by Holm's method, as one family."""
    family = [test for test in tests if not math.isnan(test.machine)]
    adjusted = adjust_p_values_by_holm(np.array([test.p for test in family]))
    return [
        *(replace(test, p=float(p)) for test, p in zip(family, adjusted, strict=True)),
        *(test for test in tests if math.isnan(test.machine)),
    ]


def _test_replays_for_late_timings(
    replays: Sequence[RunRecord],
    arms: Sequence[RunRecord],
    delays: Mapping[str, Delays],
    requirements: Requirements,
    kind: Kind,
) -> list[LateTimings]:
    """Return each replay's test for late timings against stalls in other solvers' replays."""
    tests: list[LateTimings] = []
    sources = choose_runs_that_show_stalls(replays, arms, delays, requirements)
    for _ in range(PASSES):
        on_sequence = group_by_key(sources, lambda run: run.sequence)
        machines: dict[tuple[str, str, bool], MachineAt | None] = {}
        tests = []
        for run in replays:
            own = delays[run.run_id]
            key = run.sequence, run.solver, own.has_waits
            if key not in machines:
                runs = on_sequence.get(run.sequence, [])
                others = [delays[one.run_id] for one in runs if one.solver != run.solver]
                machines[key] = _make_stall_model_by_limit(others, own.has_waits)
            tests.append(_test_replay_for_late_timings(run, own, machines[key], requirements, kind))
        late = {test.run for test in adjust_p_values(tests) if test.is_proven_late}
        sources = [run for run in (*replays, *arms) if run not in late]
    return tests


def _make_stall_model_by_limit(others: Sequence[Delays], has_waits: bool) -> MachineAt | None:
    """Return a function from time limit to stall model; None if no other run is comparable."""
    if has_waits:
        comparable = [other for other in others if other.has_waits]
    else:
        comparable = [other.without_waits for other in others]
    return cache(partial(_fit_stall_model, comparable)) if comparable else None


def choose_runs_that_show_stalls(
    replays: Sequence[RunRecord],
    arms: Sequence[RunRecord],
    delays: Mapping[str, Delays],
    requirements: Requirements,
) -> list[RunRecord]:
    """Return the runs that show the machine's stalls: test solvers, else the calmest half."""
    if arms:
        return list(arms)
    stalls: Counter[str] = Counter()
    for run in replays:
        stalls[run.solver] += int(
            delays[run.run_id].count_stalls_by_repetition(0.5 * requirements.p99_ns).sum()
        )
    half = sorted(stalls, key=lambda solver: stalls[solver])[: max(1, len(stalls) // 2)]
    return [run for run in replays if run.solver in half]


def _fit_stall_model(others: Sequence[Delays], limit_ns: float) -> StallModel:
    """Return the model of machine stalls beyond half a limit, from other solvers' runs.

    Their first round is left out: it is slow where answers are remembered, and not by the machine.
    """
    counts = [one.count_stalls_by_repetition(0.5 * limit_ns) for one in others]
    first = [min(1, len(count) - 1) for count in counts]
    stalls = np.concatenate([count[i:] for count, i in zip(counts, first, strict=True)])
    exposed_ns = np.concatenate([one.base_ns[i:] for one, i in zip(others, first, strict=True)])
    return estimate_stall_model(stalls.astype(np.float64), exposed_ns)


def estimate_stall_model(stalls: Floats, exposed_ns: Floats) -> StallModel:
    """Return a model of stalls from counts (R,) in computing times (R,) [ns].

    The rate has half a stall added (Jeffreys), the shape is that of the moments.
    """
    rate = float((stalls.sum() + 0.5) / exposed_ns.sum())
    mean = rate * exposed_ns
    beyond = float(((stalls - mean) ** 2 - stalls).sum())
    shape = float((mean**2).sum()) / beyond if beyond > 0.0 else math.inf
    return StallModel(rate, float(np.clip(shape, *DISPERSION)))


def _test_replay_for_late_timings(
    run: RunRecord, own: Delays, machine: MachineAt | None, requirements: Requirements, kind: Kind
) -> LateTimings:
    """Return a replay's late timings, with the p-value that stalls of the machine explain them."""
    counts, samples = own.count_late_by_repetition(requirements.p99_ns), int(own.samples.sum())
    late = int(counts.sum())
    if machine is None:
        x = int(np.sort(counts)[(len(counts) - 1) // 2])
        p = DOUBTFUL if x > ALLOWED * own.samples.mean() else 1.0
        return LateTimings(kind, run, late, samples, math.nan, p)
    allowed = round(float(own.samples.mean())) if kind == "late timings" else 0
    limits_ns = [m * requirements.p99_ns for m in ((1.0,) if allowed else MULTIPLES)]
    rounds = len(own.samples)
    middle, ps = (rounds - 1) // 2, []
    for limit_ns in limits_ns:
        x = int(np.sort(own.count_late_by_repetition(limit_ns))[middle])
        p = machine(limit_ns).compute_tail_probability(x, float(own.base_ns.mean()), allowed)
        ps.append(float(binom.sf(rounds - middle - 1, rounds, p)))
    expected = machine(requirements.p99_ns).rate * float(own.base_ns.sum()) / samples
    return LateTimings(kind, run, late, samples, expected, min(1.0, len(ps) * min(ps)))


def _test_run_timed_once(run: RunRecord, own: Delays, limit_ns: float) -> LateTimings:
    """Return late timings of a run timed once a step, with p-value that the machine caused them."""
    late, samples = int(own.count_late_by_repetition(limit_ns).sum()), int(own.samples.sum())
    explained = _count_late_explained_by_machine(run, own)
    p = float(binom.sf(late - np.nan_to_num(explained) - 1, samples, ALLOWED))
    if own.net_step_ns > limit_ns:
        # The median is the plainer answer.
        p = 1.0
    # Where the kernel hides its switches they may explain all of it.
    p = DOUBTFUL if math.isnan(explained) and p < DOUBTFUL else p
    switches = MAX_SWITCHES_PER_S * run.replay_s, ALLOWED * samples
    is_disturbed = run.involuntary_switches > max(switches)
    return LateTimings("late timings", run, late, samples, explained / samples, p, is_disturbed)


def _clear_disturbance_of_long_steps(
    records: Records, tests: Sequence[LateTimings], limits_ns: Mapping[RunRecord, float]
) -> list[LateTimings]:
    """Return tests of runs timed once; a run is not disturbed if its iterations make it late."""
    disturbed = [test.run for test in tests if test.is_disturbed and test.p <= DOUBTFUL]
    cleared = {
        run_id
        for run_id, steps, _ in records.yield_merged_and_raw_steps(disturbed)
        if _is_late_by_iterations(
            steps, next(limits_ns[run] for run in disturbed if run.run_id == run_id)
        )
    }
    return [replace(t, is_disturbed=t.is_disturbed and t.run.run_id not in cleared) for t in tests]


def _is_late_by_iterations(steps: RunSteps, limit_ns: float) -> bool:
    """Return whether the iterations of a run's steps alone make too many of them late.

    Each iteration counts with the least time of all steps, which other work can only prolong.
    """
    work, timed = 1.0 + steps.iterations, ~np.isnan(steps.time_ns * steps.iterations)
    if not timed.any():
        return False
    least_ns = float((steps.time_ns[timed] / work[timed]).min())
    late = int(np.count_nonzero(work[timed] * least_ns > limit_ns))
    return bool(binom.sf(late - 1, np.count_nonzero(timed), ALLOWED) <= PROVEN)


def _count_late_explained_by_machine(run: RunRecord, own: Delays) -> float:
    """Return how many late timings of a run context switches explain; NaN if unknown.

    Where waits are known, these are taken off, and switches explain nothing beyond them.
    """
    if own.has_waits:
        return 0.0
    if math.isnan(run.involuntary_switches):
        return math.nan
    timed_share = 1e-9 * float(own.base_ns.sum()) / run.replay_s
    return count_explained_late_timings(run.involuntary_switches, timed_share)


def _test_steps_past_deadline(
    loops: Sequence[RunRecord],
    replays: Sequence[RunRecord],
    arms: Sequence[RunRecord],
    delays: Mapping[str, Delays],
    requirements: Requirements,
) -> list[LateTimings]:
    """Return tests of step timings past the deadline against stalls in other solvers' runs."""
    limit_ns = requirements.deadline_ns
    stalls: dict[str, list[tuple[int, float]]] = {}
    for run in (*replays, *arms):
        own = delays[run.run_id]
        count = int(own.count_stalls_by_repetition(0.5 * limit_ns).sum())
        stalls.setdefault(run.solver, []).append((count, float(own.base_ns.sum())))
    tests = []
    for run in (*loops, *replays):
        own = delays[run.run_id]
        late, samples = int(own.count_late_by_repetition(limit_ns).sum()), int(own.samples.sum())
        others = [one for solver, of in stalls.items() if solver != run.solver for one in of]
        if not late:
            p, expected = 1.0, 0.0
        elif not others:
            p, expected = DOUBTFUL, math.nan
        else:
            count, exposed_ns = (sum(part) for part in zip(*others, strict=True))
            machine = StallModel((count + 0.5) / exposed_ns, DEADLINE_SHAPE)
            expected = machine.rate * float(own.base_ns.sum()) / samples
            p = machine.compute_tail_probability(late, float(own.base_ns.sum()))
        tests.append(LateTimings("past the deadline", run, late, samples, expected, p))
    return tests


def compute_repetition_spread(records: Records) -> tuple[float, float, int]:
    """Return median, 95 % quantile and number of configurations' slowest over fastest repetition.

    NaN, NaN and 0 without two rounds.
    """
    slowest = list(estimate_uncertainty(records).slowest.values())
    if not slowest:
        return math.nan, math.nan, 0
    return float(np.median(slowest)), compute_factor_quantile(slowest), len(slowest)
