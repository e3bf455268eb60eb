"""Measurement quality: the machine, the harness measured by itself, what is not covered."""

from collections.abc import Mapping, Sequence

import pandas as pd

from dpbench.analysis.records.machine import (
    find_disturbed_replays,
    find_largest_median_by_test_solver,
    find_shortest_wait_ns,
    select_delayed_loops,
    select_timed_replays,
    sum_disturbances,
)
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.lateness import compute_repetition_spread
from dpbench.bench.judge.calibration import compute_excess_over_wait_ns, is_within_tolerance
from dpbench.bench.record.disturbance import MAX_DISTURBED_SHARE, Disturbance
from dpbench.report.charts.lines import draw_dots
from dpbench.report.commands_text import describe_machine_states
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_sample_share,
    format_share,
    join_with_and,
    plural,
    significant,
)
from dpbench.report.page.section import Figure, Topic
from dpbench.report.verdict.machine_text import (
    list_disturbance_facts,
    list_machine_facts,
    list_switching_solvers,
)
from dpbench.solvers.calibration import WAITS_NS

LEAST_CONFIGURATIONS = 4
"""Configurations with two rounds from which their spread is stated."""
COVERED = (
    "The results do not cover other {}, times measured on an embedded core, or steps harder than "
    "those that were run."
)


def _describe_round_spread(records: Records, *, is_quiet: bool) -> list[str]:
    """Return lines on when two step times differ, in a run, and how far those of rounds lie apart.

    Another run may differ by more than rounds do, and not even that much is known of a disturbed
    machine or of fewer than `LEAST_CONFIGURATIONS`.
    """
    usual, high, count = compute_repetition_spread(records)
    if not count:
        return []
    few = f"only {plural(count, 'configuration')} had two rounds"
    why = [
        *(() if is_quiet else ["the machine was disturbed"]),
        *([few] if count < LEAST_CONFIGURATIONS else ()),
    ]
    spread = (
        f"These results give no estimate of how much times differ from day to day, because "
        f"{join_with_and(why)}."
        if why
        else "The median step time differs between rounds by a factor of at most "
        f"{significant(usual)} for half of the configurations, and of at most "
        f"{significant(high)} for 95 % of them. Runs on other days can differ by more."
    )
    widened = "" if is_quiet else ", even after it is widened by the spread of the rounds"
    return [
        "In these results, a difference in step time is significant only if the 95 % interval of "
        f"the ratio excludes 1{widened}.",
        spread,
    ]


def _describe_measured_waits(measured: Mapping[str, float], shortest_ns: float) -> str:
    """Return a text on how exactly the benchmark measured waits of known length.

    measured : median of each [ns]; shortest_ns : the shortest wait.
    """
    below = f" Times below {shortest_ns / 1e3:g} µs, the shortest wait, were not checked."
    missed = {n: p50 for n, p50 in measured.items() if is_within_tolerance(n, p50) is False}
    if not missed:
        return (
            f"Waits of known length were measured to within 1 µs or 1 %, whichever "
            f"is larger.{below}"
        )
    waits = [
        f"{WAITS_NS[n] / 1e3:g} µs measured as {significant(p50 / 1e3, 4)} µs"
        for n, p50 in missed.items()
    ]
    errors = [
        f"{format_sample_share(abs(compute_excess_over_wait_ns(n, p50)) / WAITS_NS[n])} near "
        f"{WAITS_NS[n] / 1e3:g} µs"
        for n, p50 in missed.items()
    ]
    return (
        f"{len(missed)} of {plural(len(measured), 'wait')} of known length had an error above "
        f"both 1 µs and 1 %: {join_with_and(waits)}. Absolute times may be "
        f"wrong by {join_with_and(errors)}.{below}"
    )


def _describe_machine_load(timed: Sequence[RunRecord]) -> str:
    """Return a text on whether other load disturbed the machine while it timed solvers.

    Like the line on the machine, it judges each command; single replays may be worse.
    """
    states, disturbance = describe_machine_states(timed), sum_disturbances(timed)
    if not states.startswith("quiet"):
        causes = states.replace("affected by other load: ", "")
        return (
            f"Other load disturbed the machine: {causes}. The measured times may be longer than "
            "on an idle machine."
        )
    if timed[0].mode != "replay":
        return "Other load did not disturb these closed loops."
    windows = " and windows" * any(run.steps_searched_for_hardest for run in timed)
    return (
        f"Over all replays{windows}, the machine was quiet: "
        f"{_describe_disturbed_rounds(disturbance)}."
    )


def _describe_worse_replays(records: Records, timed: Sequence[RunRecord]) -> str:
    """Return a sentence on single replays that exceed a limit of a quiet machine; "" for none."""
    worse = len(find_disturbed_replays(records))
    if not worse or timed[0].mode != "replay":
        return ""
    windows = " and windows" * any(run.steps_searched_for_hardest for run in timed)
    kinds = dict.fromkeys(kind for run in timed for kind in sum_disturbances([run]).find_excesses())
    return (
        f"Taken one by one, {format_count(worse)} of {format_count(len(timed))} replays{windows} "
        f"exceeded a limit for a quiet machine ({' or '.join(kinds)}). For "
        "times from these, the rule is stricter: a difference is significant only if the interval "
        "of the ratio still excludes 1 after it is widened by the ratio of the slowest round to "
        "the fastest."
    )


def _describe_disturbed_rounds(disturbance: Disturbance) -> str:
    """Return how many rounds were repeated as other load disturbed them, and remained disturbed."""
    remaining, rounds = disturbance.disturbed, plural(disturbance.rounds, "round")
    limit = f"limit {100 * MAX_DISTURBED_SHARE:g} %"
    share = format_share(remaining / disturbance.rounds) if disturbance.rounds else MISSING
    is_repeated = disturbance.rerun > 0
    if not remaining and not is_repeated:
        return f"none of {rounds} was disturbed ({limit})"
    left = f"{format_count(remaining) if remaining else 'none'}"
    if not is_repeated:
        return f"{left} of {rounds} remained disturbed ({share}, {limit})"
    were = "was" if disturbance.rerun == 1 else "were"
    return (
        f"{format_count(disturbance.rerun)} of {rounds} {were} repeated because other load "
        f"disturbed them, and {left} remained disturbed ({share}, {limit})"
    )


def build_trust_topic(records: Records) -> Topic | None:
    """Return the report's part on how far its times can be trusted; None if nothing was timed."""
    timed = select_timed_replays(records) or select_delayed_loops(records)
    disturbance = sum_disturbances(timed)
    medians = find_largest_median_by_test_solver(records.calibration)
    waits = {name: p50_ns for name, p50_ns in medians.items() if name in WAITS_NS}
    if not disturbance.seconds > 0 and not waits:
        return None
    is_quiet = not timed or describe_machine_states(timed).startswith("quiet")
    spread = _describe_round_spread(records, is_quiet=is_quiet)
    lines, notes = spread[:1], spread[1:]
    figures = []
    if waits:
        is_exact = all(is_within_tolerance(n, p50) is not False for n, p50 in waits.items())
        text = _describe_measured_waits(waits, find_shortest_wait_ns(records.calibration))
        (notes if is_exact and lines else lines).append(text)
        requested = [
            (f"{WAITS_NS[name] / 1e3:g} µs", WAITS_NS[name] / 1e3, p50_ns / 1e3)
            for name, p50_ns in waits.items()
        ]
        table = pd.DataFrame(requested, columns=["name", "x", "y"])
        chart = draw_dots(table, "Waits of known length", "requested [µs]", "p50 of timings [µs]")
        figures.append(
            Figure(
                "calibration",
                chart,
                "Calibration: measured duration of waits of known length.",
            )
        )
    if disturbance.seconds > 0:
        lines.append(_describe_machine_load(timed))
        notes.append(_describe_worse_replays(records, timed))
    # The count of throttle events replaces whether they are visible.
    data = {
        **dict(list_machine_facts(records.machine)),
        **dict(list_disturbance_facts(disturbance) if disturbance.seconds > 0 else ()),
        **dict(list_switching_solvers(timed)),
    }
    is_of_own_plant = any(run.is_of_own_plant for run in records.runs)
    others = "plants, other disturbances" if is_of_own_plant else "ships, other weather"
    return Topic(
        id="trust",
        title="Measurement quality",
        short="Measurement",
        lines=(*lines, COVERED.format(f"{others}, other tunings")),
        figures=tuple(figures),
        tables=(
            Table(
                ("property", "value"),
                tuple(data.items()),
                "Machine and timing",
                " ".join(filter(None, notes)),
                folded=True,
            ),
        ),
    )
