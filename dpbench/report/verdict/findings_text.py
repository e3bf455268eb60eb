"""Findings that a verdict rests on as clauses."""

from collections.abc import Iterator, Sequence
from math import isnan, nan

from dpbench.analysis.records.loop_ratios import LOOP_SIGNS
from dpbench.analysis.records.machine import sum_disturbances
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.verdict.requirements import PERHAPS_BY_MACHINE, Finding
from dpbench.analysis.verdict.verdict import explain_outcome, find_solver_record_or_none
from dpbench.bench.judge.answer_caching import CachingSign
from dpbench.bench.run.timed_solver import HANG_DETAIL, INTERRUPT_DETAIL
from dpbench.report.formats import (
    describe_range_of_steps,
    describe_wait,
    format_count,
    format_error,
    format_share,
    format_time,
    join_with_and,
    plural,
    significant,
)
from dpbench.report.words import read_words
from dpbench.solvers.contract import SolverRecord
from dpbench.solvers.own_settings import decode_options_from_json


def describe_findings(findings: Sequence[Finding]) -> str:
    """Return the reasons for a verdict as clauses joined by semicolons.

    The machine's state comes first where it may be the reason of one of them. Times above one
    limit are one clause.
    """
    clauses = [
        describe_finding(alike[0]) if len(alike) == 1 else describe_late_times(alike)
        for alike in group_late_times(findings)
    ]
    return "; ".join([*describe_machine_state(findings), *clauses])


def describe_machine_state(findings: Sequence[Finding]) -> list[str]:
    """Return a clause on disturbed rounds that may be the reason of a finding; none without any."""
    perhaps = [f for f in findings if f.kind in PERHAPS_BY_MACHINE]
    runs = {run.run_id: run for f in perhaps for run in f.runs if run.disturbed_rounds > 0}
    if not runs:
        return []
    state, where = sum_disturbances([*runs.values()]), _name_experiments([*runs.values()])
    of_all = f"{format_count(state.disturbed)} of {plural(state.rounds, 'round')}"
    return [f"other load disturbed {of_all} of {where}"]


_WORDS: dict[str, str] = read_words(__file__)["findings"]
_LATE_WORDS: dict[str, str] = read_words(__file__)["late"]
_SHORT_WORDS: dict[str, str] = read_words(__file__)["short"]
_CACHING: dict[str, str] = read_words(__file__)["caching"]
_ENDINGS: dict[str, str] = read_words(__file__)["endings"]
MOST_QUOTED = 100
"""Characters of a library's message."""


def shorten_findings(kinds: str) -> str:
    """Return kinds of findings, joined by commas as in the table of verdicts, in a few words."""
    words = (_SHORT_WORDS[kind] for kind in kinds.split(", ") if kind)
    return ". ".join(
        text if text.startswith(("p5", "p9")) else text[0].upper() + text[1:] for text in words
    )


def _describe_ending(status: str, run: RunRecord) -> str:
    """Return in words what ended failed steps of a run, and what is known of its solver's.

    Of inaccurate answers, the iterations.
    """
    record = find_solver_record_or_none(run.configuration.solver)
    if status == "TIME_LIMIT" and _has_only_limit_of_harness(run, record):
        return _ENDINGS["HARNESS_LIMIT"]
    ending = _ENDINGS.get(status, f"the solver reports status {status}")
    known = (
        {} if record is None else {key.name: text for key, text in record.known_failures.items()}
    )
    if status in known:
        return f"{ending} (known of `{run.configuration.solver}`: {known[status]})"
    if status == "ERROR":
        return f"{ending}{_quote_library(run)}"
    if status == "INACCURATE" and not isnan(run.iterations_max):
        limit = "" if record is None else record.iteration_limit
        is_limit = decode_options_from_json(run.options).get(limit) == run.iterations_max
        most = f"{format_count(run.iterations_max)} iterations"
        return f"{ending} after at most {most}{f' ({limit} of the settings)' * is_limit}"
    return ending


def _has_only_limit_of_harness(run: RunRecord, record: SolverRecord | None) -> bool:
    """Return whether the harness ended a run's slow calls, or set the solver's own time limit."""
    if record is not None and record.time_limit:
        return record.time_limit not in decode_options_from_json(run.options)
    return any(words in run.outcome_message for words in (HANG_DETAIL, INTERRUPT_DETAIL))


def _quote_library(run: RunRecord) -> str:
    """Return the most frequent message of a run's failed steps, in brackets; "" without one."""
    _, times, message = run.outcome_message.partition(" × ")
    words = " ".join(message.partition("; ")[0].replace("`", "'").split())
    return f" (most frequent message: {words[:MOST_QUOTED]})" if times else ""


def describe_caching_sign(solver: str, sign: CachingSign | None) -> str:
    """Return in words what of a replay's times looks like cached answers; "" for none.

    Cached answers are named as the cause only of a solver that may keep them; else other load is
    named as the cause of slow closed loops.
    """
    if sign is None:
        return ""
    name, value = sign
    text = _CACHING[name].format(value=significant(value, 2), share=format_share(value))
    record = find_solver_record_or_none(solver)
    known = record is not None and record.extra != "plugin" and not record.keeps_answers
    if not known:
        return f"{text}: {_CACHING['cause']}"
    return f"{text}: {_CACHING['load']}" if name in LOOP_SIGNS else text


def describe_finding(finding: Finding) -> str:
    """Return one reason for a verdict, as a late or wrong step, as a clause."""
    words = {"value": finding.value, "steps": plural(finding.steps, "step")}
    if not finding.runs:
        return _WORDS[finding.kind].format(**words)
    first, *others = finding.runs
    window_of = first.scenario if first.steps_searched_for_hardest else ""
    also = _name_experiments(others, window_of)
    kind: str = finding.kind
    if kind == "failed" and finding.steps:
        kind = "failed steps"
    all_steps = plural(_count_steps(first, finding), "step")
    first_step = _name_first_step(finding) * (window_of == "")
    over = f", above the limit in {format_count(finding.steps)} of {all_steps}{first_step}"
    over *= finding.steps > 0
    return _WORDS[kind].format(
        **words,
        where=name_experiment(first),
        experiments=_name_experiments(finding.runs),
        detail=explain_outcome(first),
        number=format_count(finding.steps),
        first=first_step,
        fail="fails" if (finding.steps or finding.value) == 1 else "fail",
        infeasible=_describe_infeasible(finding),
        scaled=_describe_scaled_p99(finding),
        ending=_describe_ending(finding.status, first),
        caching=describe_caching_sign(first.configuration.solver, first.caching_sign),
        outcome=first.outcome,
        planned=format_count(first.steps_planned),
        done=plural(_count_steps(first, finding), "step"),
        of_steps=f"the {all_steps} of the window of `{window_of}`" if window_of else all_steps,
        in_where="" if window_of else f" in {name_experiment(first)}",
        counted=plural(finding.value, "step"),
        error=format_error(finding.value),
        time=format_time(finding.value),
        share=format_share(finding.value),
        timings=plural(finding.steps, "timing"),
        machine=_format_explained(finding.machine),
        only_machine=_format_explained(finding.machine, "only "),
        net=format_time(finding.machine),
        wait=describe_wait(finding.value, finding.value - finding.machine),
        net_range=_describe_uncertain_part(finding),
        limit=format_time(finding.limit),
        low=format_time(finding.value / finding.factor),
        high=format_time(finding.value * finding.factor),
        also=f" (also in {also})" if also else "",
        some_also=f" (some also in {also})" if also else "",
        over=over,
        also_over=f" ({'' if over else 'above the limit '}also in {also})" if also else "",
    )


def _describe_infeasible(finding: Finding) -> str:
    """Return how many failed steps have an infeasible QP, as a clause; "" for none."""
    if not finding.infeasible:
        return ""
    those = f"{format_count(finding.infeasible)} of them with"
    if finding.infeasible == finding.steps:
        those = "all with" if finding.steps > 1 else "with"
    return f", {those} an infeasible QP not reported as such,"


def _describe_scaled_p99(finding: Finding) -> str:
    """Return a clause on a p99 scaled up to the closed loop; "" where it reads the same."""
    text = format_time(finding.value * finding.runs[0].untimed_iterations)
    is_alike = text in (format_time(finding.value), format_time(nan))
    return "" if is_alike else f", and {text} if scaled up to the iterations of the closed loop"


def _format_explained(share: float, only: str = "") -> str:
    """Return the share of late timings that other load explains as text, after `only`, or none."""
    text = format_share(share)
    return "none of them" if text == format_share(0.0) else f"{only}{text}"


def _name_first_step(finding: Finding) -> str:
    """Return the first wrong step of a finding in its scenario, as a clause; "" if unknown."""
    if finding.first < 0:
        return ""
    step = finding.runs[0].first_step + finding.first
    return f", {'first ' if finding.steps > 1 else ''}at step {step}"


def _describe_uncertain_part(finding: Finding) -> str:
    """Return why a time without waits beyond the limit proves nothing; "" where it is below."""
    if not finding.machine > finding.limit:
        return ""
    low, high = finding.machine / finding.factor, finding.machine * finding.factor
    return f", and rounds differ by more ({format_time(low)} to {format_time(high)})"


def _count_steps(run: RunRecord, finding: Finding) -> int:
    """Return the steps of a run that ended early, but all planned ones where more of them failed.

    A step that fails in the warm-up of a replay is not among those of the counted rounds.
    """
    return run.steps_done if run.steps_done >= finding.steps else run.steps_planned


def name_experiment(row: RunRecord) -> str:
    """Return the name of the scenario, replay or window that a run solved."""
    if row.steps_searched_for_hardest:
        return f"the window of `{row.scenario}`"
    if row.mode == "replay":
        return f"the replay of {describe_range_of_steps(row.sequence)}"
    return f"`{row.scenario}`"


def _name_experiments(rows: Sequence[RunRecord], window_of: str = "") -> str:
    """Return the names of scenarios and replays of some runs as one text.

    window_of : scenario of a window that the text follows; its closed loop is not named again.
    """
    loops, windows, replays = list[str](), list[str](), list[str]()
    for row in rows:
        if row.steps_searched_for_hardest:
            windows.append(f"`{row.scenario}`")
        elif row.mode == "replay":
            replays.append(describe_range_of_steps(row.sequence))
        else:
            loops.append("its closed loop" if row.scenario == window_of else f"`{row.scenario}`")
    # A scenario may have several windows.
    loops, windows, replays = (list(dict.fromkeys(names)) for names in (loops, windows, replays))
    if replays:
        word = "replay" if len(replays) == 1 else "replays"
        loops.append(f"the {word} of {join_with_and(replays)}")
    if windows:
        word = "window" if len(windows) == 1 else "windows"
        loops.append(f"the {word} of {join_with_and(windows)}")
    return join_with_and(loops)


_SAME_LIMIT = {"window late": "p99 late"}
"""Kinds of findings that share the clause of another kind."""


def group_late_times(findings: Sequence[Finding]) -> Iterator[list[Finding]]:
    """Yield lists of findings in order: those of times above one limit together, others alone."""

    def kind_or_number(numbered: tuple[int, Finding]) -> str | int:
        i, finding = numbered
        kind = _SAME_LIMIT.get(finding.kind, finding.kind)
        return kind if kind in _LATE_WORDS else i

    for alike in group_by_key([*enumerate(findings)], kind_or_number).values():
        yield [finding for _, finding in alike]


def describe_late_times(alike: Sequence[Finding]) -> str:
    """Return the clause of several times above one limit, each behind its replay or window."""
    replays, windows = list[str](), list[str]()
    for finding in alike:
        run, time = finding.runs[0], format_time(finding.value)
        if run.steps_searched_for_hardest:
            windows.append(f"`{run.scenario}` ({time})")
        else:
            replays.append(f"{describe_range_of_steps(run.sequence)} ({time})")
    where = []
    if replays:
        where.append(f"the replay{'s' * (len(replays) > 1)} of {join_with_and(replays)}")
    if windows:
        where.append(f"the window{'s' * (len(windows) > 1)} of {join_with_and(windows)}")
    kind = _SAME_LIMIT.get(alike[0].kind, alike[0].kind)
    return _LATE_WORDS[kind].format(limit=format_time(alike[0].limit), where=join_with_and(where))
