"""Disturbances of the timed runs, by sequence and cause."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.run_steps import StepTimes
from dpbench.bench.record.disturbance import MAX_SWITCHES_PER_S, Disturbance
from dpbench.solvers.calibration import COPY_ONLY, WAITS_NS

OWN_A_STEP, OWN_TIMES = 0.5, 10.0
"""A configuration with so many involuntary switches a step, and so many times as many a second as
the median configuration and the rule allow, makes them itself: a library that starts a thread in
each solve is put off its only core by that thread, where a busy machine would put off its
neighbours too."""
GROSS = 1.5
"""Ratio of step times on a disturbed machine beyond which other load does not explain it."""


def select_timed_replays(records: Records) -> list[RunRecord]:
    """Return every timed replay, those of the benchmark's test solvers included, each once.

    Involuntary switches that a configuration makes itself are in `own_switches_a_step`, and are NaN
    among those that the machine is judged by.
    """
    runs = [*records.calibration, *records.all_runs]
    timed = [run for run in runs if run.mode == "replay" and not run.family and run.has_steps]
    measured = map_first_by_key(timed, lambda run: run.measurement_key)
    return separate_own_switches(list(measured.values()))


@lru_cache(maxsize=4)
def find_disturbed_replays(records: Records) -> frozenset[tuple[object, ...]]:
    """Return keys of timed replays that other load disturbed, alone or with their command."""
    runs = select_timed_replays(records)
    states = sum_disturbances_by_campaign(runs)
    commands = {utc for utc, state in states.items() if state.complaints()}
    return frozenset(
        run.measurement_key
        for run in runs
        if run.campaign_utc in commands or sum_disturbances([run]).complaints()
    )


def compute_round_spread(records: Records, run: RunRecord, times: StepTimes) -> float:
    """Return the time of a disturbed replay's slowest round over that of its fastest; 1 if quiet.

    inf for a single round. The interval of a paired ratio covers the steps and not the rounds.
    """
    if run.measurement_key not in find_disturbed_replays(records):
        return 1.0
    rounds_ns = times.rounds_ns
    return float(rounds_ns.max() / rounds_ns.min()) if len(rounds_ns) > 1 else math.inf


def select_delayed_loops(records: Records) -> list[RunRecord]:
    """Return every closed loop on a simulated slow computer that did a step."""
    return separate_own_switches([run for run in records.delayed if run.has_steps])


def separate_own_switches(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return runs, those whose solver switches context itself with such switches kept apart."""
    rates = np.array([run.involuntary_switches / run.replay_s for run in runs])
    known = rates[np.isfinite(rates)]
    allowed = max(float(np.median(known)), MAX_SWITCHES_PER_S) if len(known) else np.inf
    separated = []
    for run, rate in zip(runs, rates, strict=True):
        rounds = 1.0 if run.mode == "closed_loop" else run.rounds
        # One that was stopped before its first round that counts has none.
        a_step = run.involuntary_switches / (rounds * run.steps_done) if rounds else np.nan
        if a_step >= OWN_A_STEP and rate > OWN_TIMES * allowed:
            own = replace(run, involuntary_switches=np.nan, own_switches_a_step=a_step)
            separated.append(own)
        else:
            separated.append(run)
    return separated


def sum_disturbances(runs: Sequence[RunRecord]) -> Disturbance:
    """Return the sum of what disturbed replays: repetitions, context switches, stolen time."""
    parts = [
        Disturbance(
            rounds=run.rounds + run.disturbed_rounds - run.counting_disturbed,
            disturbed=run.disturbed_rounds,
            rerun=run.rerun_rounds,
            seconds=run.replay_s,
            involuntary=run.involuntary_switches,
            steal_s=run.steal_s,
            throttled=run.throttle_events,
        )
        for run in runs
    ]
    return Disturbance.from_parts(parts)


def sum_disturbances_by_campaign(runs: Sequence[RunRecord]) -> dict[str, Disturbance]:
    """Return what disturbed timed runs, by the start of the command that timed them, worst first.

    The start is "" where it is not recorded; a command without a known state is left out, unless
    none has one.
    """
    campaigns = group_by_key(runs, lambda run: run.campaign_utc)
    states = {campaign: sum_disturbances(own) for campaign, own in campaigns.items()}
    known = {campaign: one for campaign, one in states.items() if one.seconds > 0}

    def badness(campaign: str) -> tuple[float, ...]:
        """Return a sort key: fewer broken limits, then a smaller share of disturbed rounds."""
        one = known[campaign]
        return len(one.complaints()), float(np.nan_to_num(one.disturbed / (one.rounds or np.nan)))

    worst_first = sorted(known, key=badness, reverse=True)
    return {campaign: known[campaign] for campaign in worst_first} or {"": sum_disturbances(runs)}


def sum_disturbances_by_sequence(records: Records) -> dict[str, Disturbance]:
    """Return what disturbed the timing of replays, by QP sequence, where it is known.

    Random problems, which are not timed alone, are not included.
    """
    replays = group_by_key(select_timed_replays(records), lambda run: run.sequence)
    disturbances = {sequence: sum_disturbances(runs) for sequence, runs in replays.items()}
    return {sequence: one for sequence, one in disturbances.items() if one.seconds > 0}


def find_largest_by_name(figures: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the largest number that is not NaN for each name, from pairs (name, number)."""
    known = group_by_key((f for f in figures if not math.isnan(f[1])), lambda figure: figure[0])
    return {name: max(0.0, *(figure for _, figure in own)) for name, own in known.items()}


def find_largest_median_by_test_solver(calibration: Sequence[RunRecord]) -> dict[str, float]:
    """Return the largest median timing [ns] of each of the benchmark's test solvers."""
    return find_largest_by_name((run.solver, run.raw_p50_ns) for run in calibration)


def find_shortest_wait_ns(calibration: Sequence[RunRecord]) -> float:
    """Return the shortest known wait by which the timing was checked [ns]; NaN for none."""
    waits = (
        WAITS_NS[name]
        for name in find_largest_median_by_test_solver(calibration)
        if name in WAITS_NS
    )
    return float(min(waits, default=math.nan))


def find_library_call_ns(records: Records) -> float:
    """Return the time of a solver call that only copies data [ns]; NaN if not run."""
    times = (run.algo_p50_ns for run in records.calibration if run.solver == COPY_ONLY)
    return min((ns for ns in times if math.isfinite(ns)), default=math.nan)
