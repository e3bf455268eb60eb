"""Verdicts on solvers and on the machine in plain words; every number comes from rows."""

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from math import isnan

from dpbench.analysis.records.machine import find_shortest_wait_ns
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.analysis.statistics import LEAST_STEPS, Interval
from dpbench.analysis.times.paired_times import PairedComparison
from dpbench.analysis.verdict.requirements import (
    LATE,
    OWN_DOING,
    STATES,
    Finding,
    Requirements,
    State,
    is_right_on_every_step,
)
from dpbench.analysis.verdict.verdict import (
    SolverChoice,
    Verdict,
    Verdicts,
    find_solver_record_or_none,
    list_best_verdict_of_each_solver,
    select_run_in_both_modes,
)
from dpbench.bench.judge.rules import LEAST_STRETCH
from dpbench.bench.record.cell import Configuration
from dpbench.qp.residuals import TRUE_TOL
from dpbench.report.formats import (
    describe_range_of_steps,
    describe_wait,
    format_count,
    format_error,
    format_time,
    join_with_and,
    plural,
    significant,
    strip_markdown,
)
from dpbench.report.verdict.findings_text import (
    describe_findings,
    describe_machine_state,
    name_experiment,
)
from dpbench.solvers.contract import DEFAULT
from dpbench.solvers.own_settings import decode_options_from_json
from dpbench.solvers.settings import (
    find_default_tolerance,
    list_tolerance_options,
    list_tolerances_left_at_default,
)

MOST_NAMED = 3
"""Configurations that are named with their number of runs; of the others their number is."""
NOBODY = "No solver was run, so there is nothing to judge."


def describe_requirements(requirements: Requirements) -> str:
    """Return a sentence on the limits on a solver's error, failed steps and time."""
    failed = (
        "no failed step"
        if requirements.failed_steps == 0
        else (f"at most {plural(requirements.failed_steps, 'failed step')} per run")
    )
    limits = _describe_time_limits(requirements)
    return (
        f"Requirements: on every step with a feasible QP, an error of the first move of at most "
        f"{requirements.error_move:g} times the maximum increment; {failed}; {limits}."
    )


def _describe_time_limits(requirements: Requirements) -> str:
    """Return a part of a sentence on the limits on step time."""
    if not requirements.judges_step_times:
        return "and no limit on step time, as no deadline is known"
    share = f"{100.0 * requirements.p99_ms / requirements.deadline_ms:.2g}"
    return (
        f"a p99 step time of at most {requirements.p99_ms:g} ms ({share} % of the deadline); "
        f"and every step within the deadline of {requirements.deadline_ms:g} ms. The time of "
        "each step is that of its fastest round"
    )


_VERBS: dict[State, tuple[str, str]] = {
    "borderline": ("is borderline", "are borderline"),
    "late": ("is late", "are late"),
    "fail": ("fails", "fail"),
    "inconclusive": ("is inconclusive", "are inconclusive"),
    "not run": ("was not run", "were not run"),
}
"""Predicates of one solver and of several with a verdict, in the order they are named."""


def describe_which_solvers_pass(verdicts: Verdicts) -> str:
    """Return sentences on the solvers of each verdict, three named, with the reason if not pass."""
    if not verdicts.verdicts_on_references:
        return NOBODY
    by_state = group_by_key(list_best_verdict_of_each_solver(verdicts), lambda v: v.state)
    good, run = by_state.get("pass", []), len(verdicts.of) - len(by_state.get("not run", []))
    passing = [verdict.configuration.solver for verdict in good]
    named = [
        *(f"`{solver}`" for solver in passing[:MOST_NAMED]),
        *_count_others(len(passing), "", ""),
    ]
    passes = "passes" if 1 in (run, len(good)) else "pass"
    wording = [f"{len(good)} of {plural(run, 'solver')} {passes}"]
    by_default = {
        v.configuration.solver for v in verdicts.verdicts_on_references if v.state == "pass"
    }
    otherwise = [v.configuration for v in good if v.configuration.solver not in by_default]
    wording[0] += " in at least one configuration" * bool(otherwise)
    wording[0] += " (lateness not judged)" * (not verdicts.requirements.judges_step_times)
    wording[0] += f": {join_with_and(named)}" * bool(good)
    if otherwise:
        wording += _describe_passes_outside_default(verdicts, otherwise)
    for state, (verb, verbs) in _VERBS.items():
        # By time, those that crashed or hung would come last and remain unnamed.
        alike = sorted(by_state.get(state, []), key=lambda v: not _find_crashes_and_hangs(v.causes))
        wording += [
            f"{_name_solver_with_settings(verdicts, verdict)} {verb}: "
            f"{describe_main_reason(verdict)}"
            for verdict in alike[:MOST_NAMED]
        ]
        wording += _count_others(len(alike), verb, verbs)
    return ". ".join(wording) + "."


def _name_solver_with_settings(verdicts: Verdicts, verdict: Verdict) -> str:
    """Return a solver's name, with the settings of a verdict where others have another one.

    Of a solver that was run in several call modes, also the one of the verdict.
    """
    c = verdict.configuration
    own = [v for v in verdicts.of.get(c.solver, ()) if v.state != "not run"]
    is_mixed = len({(v.configuration.route, v.configuration.policy) for v in own}) > 1
    mode = f"{c.route} {c.policy}" * is_mixed
    if not any(v.configuration.options for v in own):
        return f"`{c.solver}`{format_settings_with_other_states(verdicts, verdict, mode)}"
    if c.settings != DEFAULT:
        return c.marked_label
    return f"`{c.solver}`{f' ({mode})' * is_mixed} with default settings"


def format_settings_with_other_states(verdicts: Verdicts, verdict: Verdict, mode: str = "") -> str:
    """Return the settings of a solver's best verdict in brackets; "" where all have its state.

    If that is no pass, also the states with the other settings. Where some configurations were run
    in both modes, those without a loop or a replay do not count. mode : call mode that precedes.
    """
    c = verdict.configuration
    whole = select_run_in_both_modes(verdicts.of.get(c.solver, ()))
    by_settings = group_by_key(whole, lambda v: v.configuration.settings)
    others = {
        settings: min((v.state for v in own), key=STATES.index)
        for settings, own in by_settings.items()
        if settings != c.settings
    }
    if set(others.values()) <= {verdict.state}:
        return f" ({mode})" if mode else ""
    clauses = [f"with {settings}: {state}" for settings, state in others.items()]
    first = f"{mode}, {c.settings}".removeprefix(", ")
    return f" ({'; '.join((first, *(clauses if verdict.state != 'pass' else ())))})"


def _describe_passes_outside_default(
    verdicts: Verdicts, passing: Sequence[Configuration]
) -> list[str]:
    """Return clauses on solvers that pass, but not in their reference configurations, and why."""
    missed = {v.configuration.solver: v for v in verdicts.verdicts_on_references}
    of_each = [missed[c.solver] for c in passing if c.solver in missed]
    reasons = [f"{_VERBS[v.state][0]}: {describe_main_reason(v)}" for v in of_each[:MOST_NAMED]]
    labels = join_with_and([configuration.marked_label for configuration in passing])
    # Of a grid of custom settings the reference is its first point, not the solver's default.
    is_default = all(v.configuration.settings == DEFAULT for v in of_each)
    kind = "default configuration" if is_default else "first configuration"
    if len(passing) == 1 and of_each:
        first = of_each[0].configuration
        return [f"{labels} passes, but its {kind}, {first.marked_label}, {reasons[0]}"]
    clauses = [
        f"In its {kind}, {v.configuration.marked_label} {reason}"
        for v, reason in zip(of_each, reasons, strict=False)
    ]
    which = " (default call mode and settings)" * is_default
    return [f"{labels} pass, but not in their {kind}s{which}", *clauses]


def _count_others(count: int, verb: str, verbs: str) -> list[str]:
    """Return a clause on how many more there are than are named; empty where all are named."""
    more = count - MOST_NAMED
    return [f"{more} more {verb if more == 1 else verbs}".rstrip()] if more > 0 else []


def describe_main_reason(verdict: Verdict) -> str:
    """Return the first reason why a configuration does not pass, in the run where it is worst.

    With it, that runs crashed or hung. Where a disturbed machine may be that reason, the machine's
    state and one reason of each kind.
    """
    if verdict.refusal:
        return verdict.refusal
    findings = verdict.causes or verdict.findings_that_bar_pass
    of_kind = map_first_by_key(findings, lambda finding: finding.kind).values()
    return _describe_first([replace(f, runs=f.runs[:1]) for f in of_kind])


def describe_lateness(verdict: Verdict) -> str:
    """Return the first reason why a configuration is late, in its worst run; "" for none."""
    late = [replace(f, runs=f.runs[:1]) for f in verdict.causes if f.kind in LATE]
    return describe_findings(late[:1])


def describe_kinds_of_reasons(verdict: Verdict) -> str:
    """Return the first cause of each kind why a configuration does not pass, or the first doubt.

    All causes that make it late are of one kind.
    """
    by_kind = map_first_by_key(verdict.causes, lambda f: "late" if f.kind in LATE else f.kind)
    causes = strip_markdown(describe_findings([*by_kind.values()]))
    return causes or describe_first_finding(verdict.findings_that_bar_pass)


def describe_first_finding(findings: Sequence[Finding]) -> str:
    """Return `_describe_first` as plain text."""
    return strip_markdown(_describe_first(findings))


def _describe_first(findings: Sequence[Finding]) -> str:
    """Return the first reason for a verdict, and crashes and hangs.

    All reasons where a disturbed machine may be the first.
    """
    if describe_machine_state(findings[:1]):
        return describe_findings(findings)
    return describe_findings([*findings[:1], *_find_crashes_and_hangs(findings[1:])])


def _find_crashes_and_hangs(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings on runs that crashed or hung."""
    return [finding for finding in findings if finding.kind in OWN_DOING]


def describe_stopped_runs(runs: Sequence[RunRecord]) -> str:
    """Return a text on how many runs their time limit stopped, and of what; "" for none.

    A run that several names of settings list counts once.
    """
    started = (run for run in runs if run.outcome != "refused")
    ran = map_first_by_key(started, lambda run: run.measurement_key).values()
    late = [run.configuration for run in ran if run.outcome == "timed_out"]
    if not late:
        return ""
    is_one = len({configuration.solver for configuration in late}) == 1
    stopped = Counter(c.marked_label if is_one else f"`{c.solver}`" for c in late)
    others = "configurations" if is_one else "solvers"
    return (
        f"The time limit of a run (`cell_limit_s`) stopped {len(late)} of "
        f"{plural(len(ran), 'started run')}: {name_counts(stopped.most_common(), others)}. "
        "A configuration with a stopped closed loop cannot pass; one with a stopped replay can "
        "pass only if each step was timed in at least one round. `tables/runs.csv` lists these "
        "runs with the outcome `timed_out`."
    )


def name_counts(counts: Sequence[tuple[str, int]], others: str = "configurations") -> str:
    """Return names with their counts as text, the largest first: three, and how many `others`."""
    ordered = sorted(counts, key=lambda named: -named[1])
    named = [f"{count} of {name}" for name, count in ordered[:MOST_NAMED]]
    more = len(ordered) - MOST_NAMED
    counted = f"{sum(n for _, n in ordered[MOST_NAMED:])} of other {others}"
    rest = [counted] if more > 0 else []
    return join_with_and([*named, *rest])


def describe_selection(listed: Sequence[str], ran: Collection[str]) -> str:
    """Return a text on the solvers of a suite that a folder leaves out; "" where it has all.

    listed : of the suite, by name; ran : those with a run, refused ones too.
    """
    left_out = [name for name in listed if name not in ran]
    if not left_out:
        return ""
    kept = len(listed) - len(left_out)
    count = (
        f"{kept} of {plural(len(listed), 'solver')} of the suite {'was' if kept == 1 else 'were'}"
    )
    return f"{count} selected; left out: {join_with_and(left_out)}."


def describe_deployment(solver: str) -> str:
    """Return a text on a solver's licence, its language, and whether it generates C code."""
    known = find_solver_record_or_none(solver)
    if known is None:
        return "Its licence and language are unknown."
    project = known.project
    return (
        f"Licence: {project.licence.value}. Language: {project.language.value}. Embeddable C code: "
        f"{project.c_code.value}."
    )


def explain_no_recommendation(
    view: Records, verdicts: Verdicts, recommendation: SolverChoice
) -> str:
    """Return why no solver is recommended, as text: none deployable, none timed, none passes."""
    refused = [run.outcome_message for run in view.runs if run.outcome == "refused"]
    if refused and len(refused) == len(view.runs):
        [(reason, count)] = Counter(refused).most_common(1)
        rest = f"; {len(refused) - count} for other reasons" * (count < len(refused))
        return f"Nothing is recommended, because every run was refused ({reason}{rest})."
    solved = [run for run in view.runs if run.has_steps and not run.is_baseline_law]
    if solved and all(run.has_no_optimum for run in solved):
        return _explain_lack_of_optima(solved, verdicts.requirements)
    if recommendation.faster is not None:
        return (
            "No solver that can be deployed passes. "
            f"{recommendation.faster.configuration.marked_label} passes but cannot be deployed: "
            f"{recommendation.because}."
        )
    if not any(row.has_steps for row in view.select_runs(mode="replay", units="scaled")):
        return "Nothing is recommended, because no replay has a step and therefore no time."
    states = {verdict.state for verdict in verdicts.all_verdicts}
    why = ": no solver passes in any configuration that was run"
    if "inconclusive" in states:
        why = " while the verdict on a solver is inconclusive"
    return f"Nothing is recommended{why}.{_describe_best_verdict_and_time(verdicts)}"


def _describe_best_verdict_and_time(verdicts: Verdicts) -> str:
    """Return a text on the solver with the best verdict and its time; "" if it was not timed."""
    limits = verdicts.requirements
    limit = f"; the p99 limit is {limits.p99_ms:g} ms" * limits.judges_step_times
    return "".join(
        f" The best verdict is that on {best.configuration.marked_label}: {best.state}. "
        f"Its {describe_limiting_time(best)}{limit}."
        for best in list_best_verdict_of_each_solver(verdicts)[:1]
        if best.timed_on
    )


def _explain_lack_of_optima(runs: Sequence[RunRecord], requirements: Requirements) -> str:
    """Return why runs without any optimum recommend nothing, and which solvers reported that."""
    by_solver = group_by_key(runs, lambda run: run.solver)
    right = [
        f"`{solver}`"
        for solver, own in by_solver.items()
        if all(is_right_on_every_step(run, requirements) for run in own)
    ]
    return (
        "Nothing is recommended, because no step has a feasible point. Solvers that reported this "
        f"correctly on every step of all their runs: {join_with_and(right) or 'none'}."
    )


def describe_limiting_time(verdict: Verdict) -> str:
    """Return a configuration's limiting p99 in words, or its p50 if there are too few steps."""
    run = verdict.p99_run
    if run is None or math.isnan(verdict.p99_ns):
        time = format_time(verdict.p50_ns)
        return f"p50 step time is {time} in the replay of `{verdict.timed_on}`"
    time, searched = format_time(verdict.p99_ns), run.steps_searched_for_hardest
    if 0 < searched < LEAST_STRETCH:
        return f"longest step is {time}, over the {plural(searched, 'step')} of `{run.scenario}`"
    interval = format_p99_interval(verdict.p99_interval)
    wait = describe_wait(verdict.p99_ns, verdict.p99_wait_ns)
    return f"limiting p99 is {time}{interval}{wait}, in {name_experiment(run)}"


def format_p99_interval(interval: Interval) -> str:
    """Return the 95 % interval of a p99 step time [ns] in brackets; "" where there is none."""
    if not interval.low > 0.0:
        return ""
    if not math.isfinite(interval.high):
        return f" (95 %: above {format_time(interval.low)}, no upper end: too few steps)"
    return f" (95 %: {format_time(interval.low)} to {format_time(interval.high)})"


def describe_times_compared_with(
    name: str, by_size: Sequence[PairedComparison], in_windows: int = 0
) -> str:
    """Return sentences that compare a configuration's step times with those of another by name.

    by_size, in_windows : as of `describe_paired_times`.
    """
    if by_size and not any(one.separate or one.is_of_one_run for one in by_size):
        takes = "This solver takes"
        if len(by_size) == 2:
            takes = f"At {by_size[0].variables:.0f} variables, this solver takes"
        return f"{takes} {describe_paired_times(by_size, in_windows, than=f' as {name}')}."
    return f"Compared with {name}: {describe_paired_times(by_size, in_windows)}."


def describe_paired_times(
    by_size: Sequence[PairedComparison], in_windows: int = 0, *, than: str = ""
) -> str:
    """Return in words two configurations' step time ratio at the smallest and largest QP.

    in_windows : steps that both solved in windows, which make no ratio.
    than : words that follow the first ratio, such as " as `daqp`".
    """
    if not by_size and in_windows:
        return f"too few common steps for a ratio ({in_windows} of {LEAST_STEPS})"
    if not by_size:
        return "no step was replayed by both"
    shown = (by_size[0], by_size[-1]) if len(by_size) > 1 else by_size
    more = len(by_size) - len(shown)
    sizes = [f" at {one.variables:.0f} variables" * (len(by_size) > 1) for one in shown]
    ends = [f"{than * (i == 0)}{size}" for i, size in enumerate(sizes)]
    ratios = [_describe_time_ratio(one, end) for one, end in zip(shown, ends, strict=True)]
    ratios += [f"{plural(more, 'more size')} in the table `paired_ratios`"] * (more > 0)
    left_out = ". Windows are left out of this comparison" * (in_windows > 0)
    if than and len(ratios) == 2 and not more:
        first, second = (_describe_time_ratio(*one) for one in zip(shown, (than, ""), strict=True))
        return f"{first}. At {shown[1].variables:.0f} variables, it takes {second}{left_out}"
    return "; ".join(ratios) + left_out


def _describe_time_ratio(compared: PairedComparison, end: str) -> str:
    """Return in words two configurations' step time ratio, its interval or why it has none.

    end : words that follow the ratio, such as " at 15 variables".
    """
    if compared.separate:
        times = (
            f"{format_time(compared.second_ns)} per step against {format_time(compared.first_ns)}"
        )
        means = f"{times}{end} (geometric means over the same steps)"
        return f"{means}, {compared.separate}, so no ratio"
    average = "on average " if compared.is_unstable else ""
    ratio = f"{average}{significant(compared.ratio.value)} times as long{end}"
    wording = f"{ratio} over the same steps"
    others = len(compared.sequences) - MOST_NAMED
    marked = [describe_range_of_steps(name) for name in compared.sequences[:MOST_NAMED]]
    names = [*marked, *[f"{others} more"] * (others > 0)]
    replays = "replays" if len(names) > 1 else "replay"
    wording += f" in the {replays} of {join_with_and(names)}" * bool(names)
    if compared.is_of_one_run:
        return f"the same run under another name{end}: the settings make no difference"
    if not math.isfinite(compared.ratio.high):
        few = f"no interval: fewer than {LEAST_STEPS} in each sequence"
        wording += f" (geometric mean of {plural(compared.steps, 'step')}, {few})"
    else:
        interval = f"{significant(compared.ratio.low)} to {significant(compared.ratio.high)}"
        wording += f" (95 % interval, for these measurements only: {interval})"
        if compared.is_tied:
            return f"{wording}: no significant difference, {_describe_slower_steps(compared)}"
    if not compared.is_unstable:
        return f"{wording}{_describe_spread(compared)}"
    slower = compared.first if compared.ratio.value < 1.0 else compared.second
    against = [name for name, leader in compared.leaders.items() if leader == slower]
    size = "larger" if slower == compared.first else "smaller"
    return f"{wording}, with the {size} {against[-1]}: which is faster depends on the measure"


def _describe_slower_steps(compared: PairedComparison) -> str:
    """Return in how many steps the second configuration is slower, or else faster."""
    slower, steps = compared.slower_steps, compared.steps
    is_slower = 2 * slower >= steps
    count = format_count(slower if is_slower else steps - slower)
    return f"{'slower' if is_slower else 'faster'} in {count} of {format_count(steps)} steps"


def _describe_spread(compared: PairedComparison) -> str:
    """Return why a time ratio ranks neither configuration on a disturbed machine; else ""."""
    if not math.isfinite(compared.ratio.high) or not compared.is_within_spread:
        return ""
    one_round = "there is a single round" if math.isinf(compared.spread) else ""
    rounds = one_round or f"rounds differ by a factor of up to {significant(compared.spread)}"
    return f": no ranking, as the machine was disturbed and {rounds}"


def describe_short_times(records: Records, compared: Sequence[Verdict]) -> str:
    """Return a caution on compared times below those by which the timing was checked; or ""."""
    shortest_ns = find_shortest_wait_ns(records.calibration)
    short = [verdict for verdict in compared if verdict.p50_ns < shortest_ns]
    if not short:
        return ""
    consequence = (
        ". Differences between such times may be due to the bindings, not the methods."
        if len(short) == len(compared) > 1
        else ". Ratios of such times may be less accurate than their intervals indicate."
    )
    names = join_with_and([verdict.configuration.marked_label for verdict in short])
    timed_on = {verdict.timed_on for verdict in short}
    where = f" in the replay of `{timed_on.pop()}`" if len(timed_on) == 1 else ""
    times = join_with_and([format_time(verdict.p50_ns) for verdict in short])
    what, are = ("The p50", "is") if len(short) == 1 else ("The p50 values", "are")
    return (
        f"{what} of {names}{where}, {times}, {are} below "
        f"{shortest_ns / 1e3:g} µs, the shortest time for which the timing was checked{consequence}"
    )


def describe_hardest_wait(
    records: Records, run: RunRecord | None, *, is_scaled: bool = True
) -> str:
    """State how much of a replay's longest step was a wait for the core; "" for hardly anything.

    is_scaled : whether the text follows the time as scaled to the closed loop's iterations.
    """
    times = None if run is None else records.get_step_times(run)
    if run is None or times is None:
        return ""
    wait = describe_wait(times.algo_ns.max(), times.hardest_wait_ns)
    if is_scaled and run.untimed_iterations_max > 1.0:
        return wait.replace(" for the core)", " for the core, before scaling)")
    return wait


def describe_longest_wait(records: Records, run: RunRecord | None) -> str:
    """State how much of a run's largest timing was a wait for the core; "" for hardly anything."""
    delays = None if run is None else records.read_delays_by_run([run]).get(run.run_id)
    if run is None or delays is None or not (delays.delay_ns == run.raw_max_ns).any():
        return ""
    at = int(delays.delay_ns.argmax())
    return describe_wait(run.raw_max_ns, delays.delay_ns[at] - delays.net_ns[at])


def describe_answer(steps: RunSteps, at: int) -> str:
    """Return words on a solver's answer at one step: reported as solved or not, verified or not.

    A claim of a QP without an optimum, or beyond the limits, is stated by its violation.
    """
    claimed, violation = steps.claimed[at], steps.violation[at]
    reported = "reported as solved" if claimed else "not reported as solved"
    if steps.true[at]:
        return f"{reported}, verified"
    if claimed and (isnan(steps.error[at]) or violation > TRUE_TOL) and violation > 0.0:
        return f"{reported}, violates a limit by {format_error(violation)}"
    return f"{reported}, not verified"


def describe_judged_runs(verdict: Verdict) -> str:
    """Return a text on how many closed loops, replays and windows a configuration was judged by."""
    kinds = {"closed loop": verdict.loops, "replay": verdict.replays, "window": verdict.windows}
    wording = [plural(count, kind) for kind, count in kinds.items() if count]
    return join_with_and(wording)


def describe_tolerances_left(verdict: Verdict) -> str:
    """Return a clause on tolerances that settings do not set; or "".

    Of accurate settings, only if these defaults are looser than what they set.
    """
    solver = verdict.configuration.solver
    is_inaccurate = any(finding.kind == "inaccurate" for finding in verdict.causes)
    options = decode_options_from_json(verdict.configuration.options)
    if not options or find_solver_record_or_none(solver) is None:
        return ""
    left = list_tolerances_left_at_default(solver, options)
    if not left:
        return ""
    defaults = {name: find_default_tolerance(solver, name) for name in left}
    own = {name: options[name] for name in list_tolerance_options(solver) if name in options}
    largest = max((v for v in own.values() if isinstance(v, (int, float))), default=0.0)
    is_looser = any(v is not None and v > largest for v in defaults.values())
    if not (is_inaccurate or is_looser):
        return ""
    names = join_with_and([f"`{name}`" for name in left])
    values = join_with_and([f"{v:g}" for v in defaults.values() if v is not None])
    are, default = ("is", "default") if len(left) == 1 else ("are", "defaults")
    text = f"{names} {are} left at {solver}'s {default} {values}".rstrip()
    set_names = join_with_and([f"`{name}`" for name in own])
    return f"{text}, so a solve can end before it reaches {set_names}" if is_looser else text
