"""Topics on replays and loops: routes, formulations, settings, two solvers, a search, control."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from dpbench.analysis.records.machine import compute_round_spread
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.analysis.statistics import (
    Interval,
    estimate_paired_time_ratio,
    estimate_percentile_interval,
)
from dpbench.analysis.times.contrasts import (
    RouteGain,
    compare_routes,
    count_wins_of_formulations,
    find_right_levels_by_solver,
    yield_matched_replays,
)
from dpbench.analysis.times.paired_times import (
    MACHINE_DISTURBED,
    TOO_FEW_STEPS,
    TimedReplay,
    compare_settings_of_solvers,
    match_times_by_step,
)
from dpbench.analysis.times.solver_tables import compare_own_settings_with_fastest
from dpbench.analysis.verdict.requirements import (
    Requirements,
    is_right_on_every_step,
    is_right_to_the_end,
)
from dpbench.analysis.verdict.verdict import Verdict, Verdicts
from dpbench.bench.judge.rules import median_of_known
from dpbench.bench.record.cell import sort_key_of_settings
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_error,
    format_time,
    join_with_and,
    plural,
    significant,
)
from dpbench.report.own_settings_text import describe_best_of_grids
from dpbench.report.page.section import Topic
from dpbench.report.settings_grids import make_grid_tables
from dpbench.report.verdict.verdict_text import (
    describe_answer,
    describe_paired_times,
    format_p99_interval,
)


def build_routes_topic(records: Records) -> Topic | None:
    """Return the report's part on ways to call a solver (wrapper, warm start); None for one way."""
    tables = []
    gains: dict[str, list[float]] = {}
    for sequence in records.sequences:
        rows = []
        for found in compare_routes(records, sequence):
            change = f"{' '.join(found.above)} → {' '.join(found.route)}"
            gains.setdefault(change, []).extend([] if found.separate else [found.gain.value])
            figures = _format_gain(found), format_time(found.median_ns)
            rows.append((found.solver, found.settings, change, *figures))
        if rows:
            head = ("solver", "settings", "from → to", "speed-up (95 %)", "p50")
            tables.append(Table(head, tuple(rows), sequence))
    if not tables:
        return None
    wording = (
        "Speed-up of a step, median over solvers and sequences: "
        + "; ".join(
            f"{change} {significant(median_of_known(gain)) if gain else MISSING}"
            for change, gain in gains.items()
        )
        + ".",
        "Speed-up: ratio of the step times before and after a change, by the native interface, "
        "then by a kept workspace, then by a warm start.",
    )
    return Topic("routes", "Routes", wording, (), tuple(tables))


def _format_gain(found: RouteGain) -> str:
    """Format the gain of a call mode; both medians where it was not interleaved."""
    if found.separate:
        return f"{format_time(found.above_ns)}, {format_time(found.median_ns)}: {found.separate}"
    return _format_ratio(found.gain)


def _format_ratio(ratio: Interval) -> str:
    """Format a ratio with its interval, where that is finite."""
    if not (isfinite(ratio.low) and isfinite(ratio.high)):
        return significant(ratio.value)
    return f"{significant(ratio.value)} ({significant(ratio.low)} to {significant(ratio.high)})"


def build_formulations_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on QP formulations; None if no QPs were solved in two."""
    tables = _make_median_tables(
        records,
        requirements,
        [run for run in records.all_runs if not run.is_outside_verdicts],
        varied=lambda run: run.formulation,
        kept=lambda run: run.configuration.moved_to_common_formulation.label,
    )
    if not tables:
        return None
    wins = count_wins_of_formulations(records, requirements)
    counts = ", ".join(f"{form.replace('_', ' ')} in {count}" for form, count in wins.most_common())
    wording = (
        f"The fastest formulation with accurate solutions, in {plural(wins.total(), 'pair')} of "
        f"configuration and sequence: {counts or 'none'}.",
        "The tables give the median step time of the same QPs in each formulation. The verdicts "
        "apply to the common formulation.",
    )
    return Topic("formulations", "Formulations", wording, (), tuple(tables))


def build_levels_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on solvers' tolerance settings; None if only one was run."""
    runs = sorted(records.runs, key=lambda run: sort_key_of_settings(run.settings))
    tables = _make_median_tables(
        records,
        requirements,
        runs,
        varied=lambda run: run.settings,
        kept=lambda run: replace(run.configuration, settings="default").label,
    )
    if not tables:
        return None
    wording = (
        _describe_right_levels(records, requirements),
        "Median step time at each tolerance preset, from the library's defaults to the tightest.",
    )
    return Topic("levels", "Settings", wording, (), tuple(tables))


def _describe_right_levels(records: Records, requirements: Requirements) -> str:
    """Return a text on the tolerance levels with which each solver is right on every step."""
    good = find_right_levels_by_solver(records, requirements)
    by_default = [name for name, levels in good.items() if "default" in levels]
    tried = {run.solver for run in records.runs if run.settings == "default"}
    others: dict[bool, list[str]] = {True: [], False: []}
    for name, levels in good.items():
        if levels and "default" not in levels:
            others[name in tried].append(f"{name} at {join_with_and(levels)}")
    never = [name for name, levels in good.items() if not levels]
    unverified = _list_unverified_of_accurate(records, good)
    right = "First moves accurate on every step" if unverified else "Accurate on every step"
    if all(run.has_no_optimum for run in records.runs):
        right = "No step has a feasible point. Reported correctly on every step"
    groups = {
        "default settings": [join_with_and(by_default) or "no solver"] if tried else [],
        "other settings only": others[True],
        "their own settings (default not run)": others[False],
        "no settings that were run": [join_with_and(never)] if never else [],
    }
    parts = [f"with {which}: {', '.join(named)}" for which, named in groups.items() if named]
    text = f"{right} {'; '.join(parts)}."
    return f"{text} Solutions not verified: {'; '.join(unverified)}." if unverified else text


def _list_unverified_of_accurate(records: Records, good: Mapping[str, Sequence[str]]) -> list[str]:
    """Return texts on settings with accurate first moves of which some solution is not verified.

    good : the settings by solver with accurate first moves.
    """
    worst: dict[str, RunRecord] = {}
    for run in sorted(records.runs, key=lambda run: -run.unverified_steps):
        if run.settings in good[run.solver] and run.unverified_steps:
            worst.setdefault(f"{run.solver} at {run.settings}", run)
    return [
        f"{name} in {format_count(run.unverified_steps)} of {plural(run.steps_done, 'step')}"
        for name, run in worst.items()
    ]


MOST_RATIOS = 6
"""Ratios of two settings that the page has at most of presets alone."""
MOST_PAIRS = 3
"""Pairs of settings that are named."""


def build_settings_topic(records: Records, verdicts: Verdicts) -> Topic | None:
    """Return the report's part on settings of one solver timed side by side; None without two.

    The best custom settings of each solver come first, against `default`, then the fastest solver.
    """
    found = compare_settings_of_solvers(records)
    own = {run.configuration.label for run in records.runs if run.options}
    named = [one for one in found if {one.first, one.second} & own]
    if not found or (not named and len(found) > MOST_RATIOS):
        return None
    against = compare_own_settings_with_fastest(records, verdicts)
    ranks = {label: i for i, label in enumerate(dict.fromkeys(one.second for one in against))}
    found = [*against, *found]
    ordered = sorted([*named, *against], key=lambda one: ranks.get(one.second, len(ranks)))
    pairs = group_by_key(ordered if named else found, lambda one: (one.second, one.first))
    judged = {one.configuration.label: one for one in verdicts.all_verdicts}
    texts = [
        f"{second} against {first}{_describe_call_modes(judged.get(second), judged.get(first))}: "
        f"{describe_paired_times(sizes)}."
        f"{_describe_failed(judged.get(second), judged.get(first))}"
        for (second, first), sizes in [*pairs.items()][:MOST_PAIRS]
    ]
    more = len(pairs) - len(texts)
    texts += [f"{plural(more, 'more pair')}: tables/paired_ratios.csv."] if more > 0 else []
    rows = [
        {
            "settings": one.second,
            "against": one.first,
            "variables": f"{one.variables:.0f}",
            "ratio (95 %)": MISSING if one.separate else _format_ratio(one.ratio),
            "steps": format_count(one.steps),
            "finding": one.finding_text,
        }
        for one in found
    ]
    note = "Geometric mean of the step time ratios on common steps. "
    note += "The intervals are valid for these measurements only."
    windows = any(run.steps_searched_for_hardest for run in records.runs)
    texts += ["Windows are not counted."] if windows else []
    table = Table.from_rows(rows, text_columns=2)
    grids = describe_best_of_grids(records, verdicts)
    return Topic(
        "settings",
        "Two settings of one solver",
        (" ".join(texts), *grids, note),
        (),
        (*make_grid_tables(verdicts), table),
        short="Settings",
    )


def _describe_call_modes(one: Verdict | None, other: Verdict | None) -> str:
    """Return that two configurations are called in different modes; "" otherwise."""
    modes = {(v.configuration.route, v.configuration.policy) for v in (one, other) if v}
    return ", in another call mode" if len(modes) > 1 else ""


def _describe_failed(*compared: Verdict | None) -> str:
    """Return a sentence that names those of two compared configurations that fail; "" for none."""
    failed = [v.configuration.label for v in compared if v is not None and v.state == "fail"]
    return f" {join_with_and(failed)} {'fails' if len(failed) == 1 else 'fail'}." if failed else ""


def build_race_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part that compares two solvers by step; None unless just two ran."""
    if len(records.solvers) != 2:
        return None
    first, second = records.solvers
    replays = list(yield_matched_replays(records, first, second))
    if len({run.configuration.call_text for (run, _), _ in replays}) != 1:
        return None
    rows, decided = [], list[str]()
    undecided: dict[str, list[str]] = {}
    for pair in replays:
        (run, here), (_, there) = pair
        ratio, why_none = _compare_race(records, *pair)
        where = f"`{run.sequence}` ({run.configuration.call_text})"
        if why_none:
            undecided.setdefault(why_none, []).append(where)
        else:
            decided.append(f"{ratio} in {where}")
        p50 = [format_time(median_of_known(times.algo_ns)) for times in (here, there)]
        tails = [estimate_percentile_interval(times.algo_ns, 99) for times in (here, there)]
        p99 = [f"{format_time(tail.value)}{format_p99_interval(tail)}" for tail in tails]
        cell = ", ".join(filter(None, (ratio, why_none)))
        rows.append((run.sequence, run.configuration.call_text, *p50, *p99, cell))
    times = [f"{solver} {time}" for time in ("p50", "p99") for solver in (first, second)]
    head = ("sequence", "call mode", *times, "ratio (95 %)")
    leads = {
        "Not accurate on every step: ": _list_inaccurate(replays, requirements),
        f"Step time of `{first}` over that of `{second}`: ": decided,
        **{f"Not decided ({why}): ": named for why, named in undecided.items()},
    }
    lead = " ".join(f"{text}{join_with_and(named)}." for text, named in leads.items() if named)
    note = "Geometric mean of the paired ratios of all common steps."
    title = f"{first} against {second}"
    return Topic("race", title, (lead, note), (), (Table(head, tuple(rows)),))


def _list_inaccurate(
    replays: Sequence[tuple[TimedReplay, TimedReplay]], requirements: Requirements
) -> list[str]:
    """Return texts on the replays of two solvers that are not accurate on every step."""
    return [
        f"`{run.solver}` in `{run.sequence}` (largest error of the first move "
        f"{format_error(run.error_move_max)})"
        for pair in replays
        for run, _ in pair
        if run.caching_sign is None and not is_right_on_every_step(run, requirements)
    ]


def _compare_race(records: Records, first: TimedReplay, second: TimedReplay) -> tuple[str, str]:
    """Return a ratio of step times, "" for none, and why it decides nothing, "" where it does."""
    (run, here), (rival, there) = first, second
    if separate := run.explain_separate_timing(rival):
        return "", separate
    ratio = estimate_paired_time_ratio(*match_times_by_step(here, there))
    if not math.isfinite(ratio.high):
        return _format_ratio(ratio), TOO_FEW_STEPS
    spread = max(compute_round_spread(records, *replay) for replay in (first, second))
    is_disturbed = spread > 1.0 and ratio.is_within_spread(spread)
    return _format_ratio(ratio), MACHINE_DISTURBED * is_disturbed


def _make_median_tables(
    records: Records,
    requirements: Requirements,
    runs: Sequence[RunRecord],
    varied: Callable[[RunRecord], str],
    kept: Callable[[RunRecord], str],
) -> list[Table]:
    """Return tables of median step times, one per QP sequence, rows and columns by given keys."""
    replays = [run for run in runs if run.mode == "replay" and not run.is_baseline_law]
    tables = []
    problems = group_by_key(replays, lambda run: (run.sequence, run.units))
    for (sequence, units), of_problem in problems.items():
        columns = list(dict.fromkeys(varied(run) for run in of_problem))
        if len(columns) < 2:
            continue
        rows = []
        for name, of_row in group_by_key(of_problem, kept).items():
            own = {varied(run): run for run in of_row}
            cells = (
                _format_median_time(records, own.get(column), requirements) for column in columns
            )
            rows.append((name, *cells))
        title = sequence + (" (SI units)" if units == "si" else "")
        tables.append(Table(("configuration", *columns), tuple(rows), title))
    return tables


def _format_median_time(records: Records, run: RunRecord | None, requirements: Requirements) -> str:
    """Return the median step time of a run as text, or why there is none."""
    times = None if run is None else records.get_step_times(run)
    if run is None or times is None:
        return MISSING if run is None else run.outcome.replace("_", " ")
    text = format_time(median_of_known(times.algo_ns))
    return text if is_right_on_every_step(run, requirements) else f"{text} (inaccurate)"


def build_worst_case_topic(records: Records) -> Topic | None:
    """Return the report's part on the worst step that a search found; None without a search."""
    requested = records.suite.get("report", {})
    k = requested.get("step")
    if k is None:
        return None
    runs = {run.run_id: run for run in records.runs}
    steps = records.yield_merged_and_raw_steps(records.runs)
    row_of = {run_id: _make_step_row(runs[run_id], of_run, k) for run_id, of_run, _ in steps}
    rows = [row for run_id in runs if (row := row_of.get(run_id)) is not None]
    if not rows:
        return None
    searched = str(requested.get("configuration") or "")
    rows.sort(key=lambda row: (row[0] != searched, row[0]))
    name, took, median, iterations, usual, error, answer = rows[0]
    counted = "" if iterations == MISSING else f", {iterations} iterations (median {usual})"
    lead = (
        f"At step {k}, {name} takes {took} (median {median}){counted}. Error of the first "
        f"move, in maximum increments: {error}; solution: {answer}."
    )
    head = (
        *("configuration", "time", "median time", "iterations", "median of the iterations"),
        *("error of the first move [maximum increments]", "solution"),
    )
    return Topic(
        "worst-case",
        "Step found by the search",
        (lead, "The table shows the same step with the other configurations."),
        (),
        (Table(head, tuple(rows), f"step {k}"),),
    )


def _make_step_row(run: RunRecord, steps: RunSteps, k: int) -> tuple[str, ...] | None:
    """Return a run's time, iterations and error at one step as a row of texts; None without one."""
    at = np.flatnonzero(steps.k == k)
    if not len(at):
        return None
    i = int(at[0])
    return (
        run.configuration.label,
        format_time(steps.time_ns[i]),
        format_time(float(np.median(steps.time_ns))),
        format_count(steps.iterations[i]),
        format_count(median_of_known(steps.iterations)),
        format_error(float(steps.error[i])),
        describe_answer(steps, i),
    )


def build_loops_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on solvers in closed loop; None without such runs."""
    loops = records.select_runs(mode="closed_loop")
    steered = [run for run in loops if not run.is_baseline_law and run.outcome != "refused"]
    by_name = group_by_key(steered, lambda run: run.configuration.moved_to_common_formulation.label)
    if not by_name:
        return None
    whole = {
        name: sum(is_right_to_the_end(run, requirements) for run in runs)
        for name, runs in by_name.items()
    }
    most = max(len(runs) for runs in by_name.values())
    right = [name for name, runs in by_name.items() if whole[name] == len(runs) == most]
    requested = plural(most, "closed loop")
    best = max(whole, key=lambda name: whole[name])
    lead = (
        f"No configuration is accurate on every step of {requested}; {best} is accurate in "
        f"{whole[best]} of them."
    )
    if right:
        rest = len(by_name) - len(right)
        names = join_with_and(right) if len(right) <= 4 else f"{len(right)} configurations"
        others = f" {plural(rest, 'configuration')} {'is' if rest == 1 else 'are'} not."
        lead = f"Accurate on every step of {requested}: {names}.{others if rest else ''}"
    rows = []
    for name, runs in by_name.items():
        off = [run for run in runs if isfinite(run.dev_position_max_m)]
        worst = max(off, key=lambda run: run.dev_position_max_m, default=None)
        farthest = MISSING if worst is None else f"{significant(worst.dev_position_max_m)} m"
        rows.append(
            {
                "configuration": name,
                "accurate in": f"{whole[name]} of {len(runs)}",
                "steps with a fallback": format_count(np.nansum([run.fallbacks for run in runs])),
                "largest deviation": farthest,
                "scenario": MISSING if worst is None else worst.scenario,
            }
        )
    rows.sort(key=lambda row: -whole[row["configuration"]])
    note = (
        "The largest deviation from the reference loop shows the effect of inaccurate or late "
        "solutions."
    )
    return Topic("loops", "Closed loops", (lead, note), (), (Table.from_rows(rows),))
