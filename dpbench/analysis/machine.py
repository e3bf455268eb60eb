"""What disturbed the timed runs: which of them, on which sequence, and by whose doing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dpbench.analysis.records import Records, RunRecord, as_float, has_steps
from dpbench.bench.record.disturbance import MAX_SWITCHES_PER_S, Disturbance

OWN_A_STEP, OWN_TIMES = 0.5, 10.0
"""A configuration with so many involuntary switches a step, and so many times as many a second as
the median configuration and the rule allow, makes them itself: a library that starts a thread in
each solve is put off its only core by that thread, where a busy machine would put off its
neighbours too."""


SWITCHES = "involuntary_switches"


def timed_runs(records: Records) -> list[RunRecord]:
    """Every replay that was timed, the harness's own configurations too; once where it has several
    names.

    The involuntary switches that a configuration makes itself stand in `own_switches_a_step`, and
    are NaN among those that the machine is judged by.
    """
    return _own_apart(_once_each(records))


def delayed_runs(records: Records) -> list[RunRecord]:
    """Every loop on a slow computer that left a step, switches of its own doing told apart."""
    return _own_apart([row for row in records.delayed if has_steps(row)])


def _own_apart(rows: Sequence[RunRecord]) -> list[RunRecord]:
    rates = np.array([as_float(row[SWITCHES]) / as_float(row["replay_s"]) for row in rows])
    seen = rates[np.isfinite(rates)]
    usual = max(float(np.median(seen)), MAX_SWITCHES_PER_S) if len(seen) else np.inf
    found: list[RunRecord] = []
    for row, rate in zip(rows, rates, strict=True):
        rounds = 1.0 if row["mode"] == "closed_loop" else as_float(row["rounds"])
        a_step = as_float(row[SWITCHES]) / (rounds * as_float(row["steps_done"]))
        own = a_step >= OWN_A_STEP and rate > OWN_TIMES * usual
        found.append({**row, SWITCHES: np.nan, "own_switches_a_step": a_step} if own else row)
    return found


def _once_each(records: Records) -> list[RunRecord]:
    once: dict[tuple[str, ...], RunRecord] = {}
    for row in [*records.calibration, *records.all_runs]:
        if row["mode"] == "replay" and not row["family"] and has_steps(row):
            names = ("sequence", "solver", "route", "policy", "units", "formulation", "replay_s")
            # Settings without effect are one run under several names, to the nanosecond.
            once.setdefault((*(str(row[name]) for name in names), str(row["raw_max_ns"])), row)
    return list(once.values())


def disturbance_of(rows: Sequence[RunRecord]) -> Disturbance:
    """What disturbed some replays together."""
    columns = (
        "rounds",
        "disturbed_rounds",
        "counting_disturbed",
        "rerun_rounds",
        "replay_s",
        SWITCHES,
        "steal_s",
        "throttle_events",
    )
    parts = []
    for row in rows:
        kept, disturbed, both, *rest = (as_float(row[name]) for name in columns)
        parts.append(Disturbance(kept + disturbed - both, disturbed, *rest))
    return Disturbance.total(parts)


def disturbed_sequences(records: Records) -> dict[str, Disturbance]:
    """What disturbed the timed replays of each sequence; one that nothing is known of is left out.

    Random problems, which are not timed alone, are none of them.
    """
    rows: dict[str, list[RunRecord]] = {}
    for row in timed_runs(records):
        rows.setdefault(str(row["sequence"]), []).append(row)
    found = {sequence: disturbance_of(mine) for sequence, mine in rows.items()}
    return {sequence: one for sequence, one in found.items() if one.seconds > 0}
