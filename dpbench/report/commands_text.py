"""The commands that filled a result folder, in words: when they ran, how quiet the machine was."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from dpbench.analysis.records.machine import select_timed_replays, sum_disturbances_by_campaign
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.bench.record.machine import describe_version
from dpbench.bench.record.result_folder import SuiteDescription
from dpbench.report.formats import join_with_and, plural
from dpbench.report.verdict.machine_text import describe_disturbance
from dpbench.solvers.calibration import CALIBRATION

MOST_COMMANDS = 3
"""Commands, and sequences, that are named; of the others their number is."""
MOST_PARTS = 12
"""Scenarios, and settings, that are named; of the others their number is."""

BASELINE = "Baseline law (the unconstrained optimum, clipped to the limits)"


def describe_subject(records: Records, suite: SuiteDescription) -> str:
    """Return what the results are about, and the title of their suite, as text."""
    about = "QP solvers in the model predictive controller of a dynamically positioned ship"
    if any(run.is_of_own_plant for run in records.runs):
        about = "QP solvers in a model predictive controller"
    return ". ".join(filter(None, [about, str(suite.get("title", ""))]))


def describe_disturbed_times(records: Records) -> str:
    """Return what disturbed the timed replays, and what to do, as text; "" on a quiet machine."""
    states = describe_machine_states(select_timed_replays(records))
    note = "Times under such load do not rank solvers of similar speed; measure again on an idle"
    return "" if states.startswith("quiet") else f"{states}. {note} machine"


def describe_machine(records: Records, machine: Mapping[str, Any]) -> str:
    """Return the machine's name and what disturbed it, as text."""
    name = f"{machine.get('cpu_model', 'not known')}, {machine.get('cores', '?')} cores"
    disturbed = describe_disturbed_times(records)
    return (
        f"Machine: {name}, {machine.get('python', '')}. The times apply to this machine only."
        + f" It was {disturbed}." * bool(disturbed)
    )


def describe_versions(
    records: Records, suite: SuiteDescription, solvers: Collection[str] = ()
) -> str:
    """Return a line with the versions of solvers, all by default, of the suite's and of dpbench."""
    versions = dict.fromkeys(
        f"{run.solver} {run.solver_version}".strip()
        for run in records.runs
        if run.solver in (solvers or (run.solver,))
    )
    return (
        f"Versions: {', '.join(versions)}; suite {suite.get('name', '')}, "
        f"dpbench {suite.get('harness_version', '')}."
    )


def describe_how_results_were_made(
    records: Records, suite: SuiteDescription, machine: Mapping[str, Any]
) -> str:
    """Return a paragraph for a paper: suite, runs, steps, versions, machine, Python."""
    runs = [run for run in (*records.runs, *records.study) if run.solver not in CALIBRATION]
    of_solver = group_by_key(runs, lambda run: run.solver)
    solvers, laws = [
        ", ".join(
            " ".join(dict.fromkeys([f"`{solver}`", *filter(None, (r.solver_version for r in own))]))
            for solver, own in of_solver.items()
            if own[0].is_baseline_law == is_law
        )
        for is_law in (False, True)
    ]
    # A command may have run a part of the suite.
    parts = [
        f"{kind}: {', '.join(f'`{name}`' for name in names[:MOST_PARTS])}"
        + f" and {len(names) - MOST_PARTS} more" * (len(names) > MOST_PARTS)
        for kind, names in (
            ("Scenarios", [*dict.fromkeys(run.scenario for run in runs if run.scenario)]),
            ("Call modes", [*dict.fromkeys(f"{run.route} {run.policy}" for run in runs)]),
            ("Settings", [*dict.fromkeys(run.settings for run in runs)]),
        )
        if names
    ]
    steps = sum(int(run.steps_done) for run in runs)
    note = _describe_counted_runs(runs, records)
    numpy = machine.get("versions", {}).get("numpy", "")
    computer = (
        f"{machine.get('cpu_model', 'an unnamed CPU')}, {plural(machine.get('cores', 0), 'core')}, "
        f"{machine.get('memory_GiB', '?')} GiB of memory, {machine.get('kernel', '')}"
    )
    ran = describe_commands(records.all_runs, suite.get("started_utc", "")).removeprefix("run ")
    software = ", ".join([machine.get("python", ""), *[f"NumPy {numpy}"] * bool(numpy)])
    return (
        f"The suite `{suite.get('name', '')}` was run with {describe_version(suite)}, {ran}. "
        f"It has {plural(len(runs), 'run')} with {plural(steps, 'step')}{note}. "
        f"{'. '.join(parts)}. Solvers: {solvers}. {f'{BASELINE}: {laws}. ' if laws else ''}"
        f"{_describe_design(records)}Machine: {computer}; {software}."
    )


def _describe_design(records: Records) -> str:
    """Return sentences on the sizes of studies, and on rounds and load of timed replays."""
    by_study = group_by_key(records.study, lambda run: run.study)
    texts = [
        f"Study `{name}`: {plural(len({run.study_point for run in own}), 'point')} in "
        f"{plural(len({run.replicate for run in own}), 'realisation')}. "
        for name, own in by_study.items()
    ]
    if timed := select_timed_replays(records):
        counts = sorted({int(run.rounds) for run in timed})
        rounds = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
        has_windows = any(run.steps_searched_for_hardest for run in timed)
        replays = "replays and windows" if has_windows else "replays"
        texts.append(
            f"Rounds of each replay: {rounds}; the time of each step is that of its fastest round. "
            f"Over all {replays}, the machine was {describe_machine_states(timed)}. "
        )
    return "".join(texts)


def _describe_counted_runs(runs: Sequence[RunRecord], records: Records) -> str:
    """Return a clause on the runs that a count includes and excludes; "" for nothing to name."""
    refused = sum(run.outcome == "refused" for run in runs)
    twice = len(runs) - len({run.measurement_key for run in runs})
    apart = {
        "on simulated slower computers": len(records.delayed),
        "of consequence analyses": len(records.consequence),
        "at the edge of capability plots": len(records.at_edge),
    }
    excluded = [f"{plural(count, 'run')} {what}" for what, count in apart.items() if count]
    if calibration := len(records.calibration):
        excluded.append(plural(calibration, "calibration run"))
    notes = [f"include {plural(refused, 'refused run')}"] * bool(refused)
    if twice:
        why = "two settings names with the same solver options"
        notes.append(f"count {plural(twice, 'run')} twice ({why})")
    notes += [f"exclude {join_with_and(excluded)}"] * bool(excluded)
    return f". These numbers {join_with_and(notes)}" * bool(notes)


def describe_machine_states(runs: Sequence[RunRecord]) -> str:
    """Return words on what disturbed timed runs, of each command that timed some, worst first."""
    states = sum_disturbances_by_campaign(runs)
    texts = list(map(describe_disturbance, states.values()))
    if len(texts) == 1 or {*texts} == {"quiet"}:
        return texts[0] + (f" in all {len(texts)} commands" if len(texts) > 1 else "")
    named = [
        f"{text} ({f'command of {_format_utc(utc)}' if utc else 'an earlier command'})"
        for utc, text in zip(states, texts, strict=True)
    ]
    more = [f"{len(named) - MOST_COMMANDS} more"] if len(named) > MOST_COMMANDS else []
    return "; ".join([*named[:MOST_COMMANDS], *more])


def describe_commands(runs: Sequence[RunRecord], started: str) -> str:
    """Return when the commands of a result folder ran, as text: first start to last end.

    started : by `suite.json`, of the last command, for folders whose runs do not record it.
    """
    known = {run.campaign_utc for run in runs if run.campaign_utc}
    if not known:
        return f"started {_format_utc(started)}" if started else "start not recorded"
    ends = [run.judged_utc for run in runs if run.judged_utc]
    count = f" in {plural(len(known), 'command')}" if len(known) > 1 else ""
    unknown = any(not run.campaign_utc and run.has_steps for run in runs)
    others = "; when other runs were made is not recorded" if unknown else ""
    return f"run from {_format_utc(min(known))} to {_format_utc(max(ends))}{count}{others}"


def describe_turns(records: Records) -> str:
    """Return a caution on replays that were not interleaved, or may not have been; or ""."""
    timed = [
        run
        for run in select_timed_replays(records)
        if run.solver not in CALIBRATION
        and run.source.is_timed
        and records.has_comparable_times(run)
    ]
    by_sequence = group_by_key(timed, lambda run: (run.sequence, run.units))
    apart = {
        sequence: reason
        for (sequence, _), runs in by_sequence.items()
        if (reason := max(run.explain_separate_timing(runs[0]) for run in runs))
    }
    if apart:
        reason, others = max(apart.values()), len(apart) - MOST_COMMANDS
        names = join_with_and([*apart][:MOST_COMMANDS])
        more = f" and {others} more" if others > 0 else ""
        return (
            f"The solvers were {reason} on {names}{more}: such times have no ratio, and their "
            "order may be due to the machine. Run all solvers in one command with --fresh."
        )
    unknown = [run for run in timed if not run.turns and not run.campaign_utc]
    if unknown and len({run.configuration for run in timed}) > 1:
        return (
            "Which replays were interleaved is not recorded, as an earlier release wrote this "
            "folder: its ratios hold if one command timed them all."
        )
    return ""


def _format_utc(text: str) -> str:
    """Return a time of a result folder to the second, as `2026-11-28 21:40:05 UTC`."""
    return f"{text[:19].replace('T', ' ')} UTC"
