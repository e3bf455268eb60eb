"""Tables of step times, from replays alone: closed-loop times never enter a ranking."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dpbench.analysis.demand import Demand, is_right
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import RunRecord
from dpbench.analysis.statistics import percentile_interval, pooled_percentile_intervals
from dpbench.analysis.step_times import StepTimes
from dpbench.bench.judge.rules import percentile, supports
from dpbench.report.formats import (
    MISSING,
    count_text,
    interval_text,
    micro_text,
    plural,
    significant,
)
from dpbench.report.table import Cell, Table, row_of
from dpbench.report.tables_accuracy import settings_without_effect
from dpbench.report.time_marks import marks_legend, timed_name

PooledConfiguration = tuple[RunRecord, StepTimes]


def timed_configurations(view: Records, sequence: str) -> list[PooledConfiguration]:
    """Replayed configurations of a sequence with their step times, fastest median first."""
    configurations = [(row, view.times(row)) for row in view.replays(sequence)]
    timed = [(row, times) for row, times in configurations if times is not None]
    return sorted(timed, key=lambda configuration: float(np.median(configuration[1].algo_ns)))


def timing_tables(view: Records, sequence: str, demand: Demand) -> list[Table]:
    """The algorithmic step times of one sequence: settings `default`, then folded the others."""
    configurations = timed_configurations(view, sequence)
    usual = [
        configuration for configuration in configurations if configuration[0].settings == "default"
    ]
    if not configurations or len(usual) in (0, len(configurations)):
        return (
            [_timing_table(view, sequence, configurations, configurations, demand)]
            if configurations
            else []
        )
    others = [
        configuration for configuration in configurations if configuration[0].settings != "default"
    ]
    first = _timing_table(view, sequence, configurations, usual, demand)
    rest = _timing_table(view, sequence, configurations, others, demand)
    return [first, replace(rest, title=f"{rest.title}, other settings", folded=True)]


def _timing_table(
    view: Records,
    sequence: str,
    configurations: Sequence[PooledConfiguration],
    shown: Sequence[PooledConfiguration],
    demand: Demand,
) -> Table:
    """Some of the configurations of a sequence."""
    return Table(
        title=f"Step times in the replay of `{sequence}`",
        note=(
            f"{_population(view, configurations)} Algorithmic time: per step the minimum over "
            "the rounds "
            "(set-up + update + solve + read). Of medians: the same with the median over the "
            "rounds, what a usual round takes. Intervals: 95 %, block bootstrap over steps. "
            f"{plural(len(shown), 'configuration')} shown here; the section on rankings "
            "compares them in "
            f"pairs. {_refused_percentile(configurations)}{marks_legend(row for row, _ in shown)}"
        ),
        heads=(
            "solver",
            "settings",
            "policy",
            "route",
            "answers meet the demand",
            "p50 [µs]",
            "p50 95 %",
            "p95 [µs]",
            "p99 [µs]",
            "p99 95 %",
            "max [µs]",
            "p50 of medians [µs]",
            "p99 of medians [µs]",
            "p99 of medians 95 %",
            "steps",
        ),
        rows=tuple(_timing_row(configuration, demand) for configuration in shown),
        text_columns=5,
    )


def jitter_table(view: Records, sequence: str) -> Table | None:
    """Raw samples, phases and iterations of one sequence; None when nothing was replayed."""
    configurations = timed_configurations(view, sequence)
    if not configurations:
        return None
    return Table(
        title=f"Raw samples and phases in the replay of `{sequence}`",
        note=(
            f"{_population(view, configurations)} Raw: all samples pooled, the machine's jitter "
            "included. "
            "Intervals: 95 %, block bootstrap over steps, all samples of a step together. "
            "Phases: median over all samples; on route qpsolvers the solve holds the wrapper "
            "and cannot be split further. Set-up: part of every step under policy fresh on "
            "route native, else done once before the first step. A percentile without ten "
            f"samples beyond it is not printed.{marks_legend(row for row, _ in configurations)}"
        ),
        heads=(
            "solver",
            "settings",
            "policy",
            "route",
            "raw p50 [µs]",
            "raw p99 [µs]",
            "raw p99 95 %",
            "raw p99.9 [µs]",
            "raw p99.9 95 %",
            "raw max [µs]",
            "set-up [µs]",
            "update [µs]",
            "solve [µs]",
            "read [µs]",
            "iterations p50",
            "iterations max",
            "samples",
        ),
        rows=tuple(_jitter_row(configuration) for configuration in configurations),
        text_columns=4,
        folded=True,
    )


def _population(view: Records, configurations: Sequence[PooledConfiguration]) -> str:
    most = max(len(times.algo_ns) for _, times in configurations)
    few, many = (of(times.rounds for _, times in configurations) for of in (min, max))
    rounds = plural(many, "round") if few == many else f"{few} to {plural(many, 'round')}"
    same = settings_without_effect([row for row, _ in configurations])
    shown = (
        f" Settings have no effect on {', '.join(same)}: one run under all names." if same else ""
    )
    cpu = view.machine.get("cpu_model", "an unnamed CPU")
    return (
        f"Replay of identical QPs in scaled units, {plural(most, 'step')} × "
        f"{rounds}, {plural(len(configurations), 'configuration')}, {cpu}.{shown}"
    )


def _refused_percentile(configurations: Sequence[PooledConfiguration]) -> str:
    most = max(len(times.algo_ns) for _, times in configurations)
    if supports(most, 99):
        return ""
    return f"{plural(most, 'step')} do not support a p99 (it takes 1000), so none is printed."


def _timing_row(configuration: PooledConfiguration, demand: Demand) -> tuple[Cell, ...]:
    row, times = configuration
    algo = times.algo_ns
    middle = percentile_interval(algo, 50)
    far = percentile_interval(algo, 99)
    usual = percentile_interval(times.typical_ns, 99)
    right = is_right(row, demand)
    early = row.steps_planned > len(algo)
    return row_of(
        timed_name(row),
        row.settings,
        row.policy,
        row.route,
        Cell("yes" if right else "no", "good" if right else "bad"),
        micro_text(middle.value),
        interval_text(middle.low, middle.high, 1e3),
        micro_text(percentile(algo, 95)),
        Cell(micro_text(far.value), "bad" if far.value > demand.p99_ns else ""),
        interval_text(far.low, far.high, 1e3),
        micro_text(float(algo.max())),
        micro_text(percentile(times.typical_ns, 50)),
        micro_text(usual.value),
        interval_text(usual.low, usual.high, 1e3),
        Cell(count_text(len(algo)), "bad" if early else ""),
    )


def _jitter_row(configuration: PooledConfiguration) -> tuple[Cell, ...]:
    row, times = configuration
    raw = times.raw_ns
    tails = [
        text
        for found in pooled_percentile_intervals(raw, times.raw_k, (99.0, 99.9))
        for text in (micro_text(found.value), interval_text(found.low, found.high, 1e3))
    ]
    phases = dict(times.phase_ns)
    if math.isnan(phases["setup"]):
        once = row.setup_once_ns
        setup = f"once {micro_text(once)}" if math.isfinite(once) else MISSING
    else:
        setup = micro_text(phases["setup"])
    return row_of(
        timed_name(row),
        row.settings,
        row.policy,
        row.route,
        micro_text(percentile(raw, 50)),
        *tails,
        micro_text(float(raw.max())),
        setup,
        *(micro_text(phases[phase]) for phase in ("update", "solve", "read")),
        significant(times.iterations[0]),
        count_text(times.iterations[2]),
        count_text(len(raw)),
    )
